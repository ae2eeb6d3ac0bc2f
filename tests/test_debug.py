"""The renderer's kernels once with Taichi's checks on: every index within its field, no integer overflow."""

import numpy as np
import pytest
from test_project import CAMERA, gaussians


@pytest.fixture(scope="module")
def checked():
    """Taichi with debug=True, for this file alone."""
    import taichi as ti

    ti.init(arch=ti.cpu, default_fp=ti.f32, debug=True, offline_cache=True, log_level=ti.WARN)
    yield ti
    ti.reset()


@pytest.mark.parametrize(("views", "sort"), [(1, "z"), (2, "z"), (2, "pixel")])
def test_every_index_is_within_its_field(checked, views, sort):
    from dataclasses import replace

    from render.renderer import Renderer
    from render.splats import Splats

    g = gaussians(2000, 3)
    eyes = [CAMERA]
    if views == 2:
        matrix = CAMERA.world_to_camera.copy()
        matrix[0, 3] -= 0.064
        eyes.append(replace(CAMERA, world_to_camera=matrix))
    renderer = Renderer(Splats(g), CAMERA.width, CAMERA.height, views=views, sort=sort)
    renderer.render(eyes)
    pixels = renderer.pixels()[..., :3]
    assert pixels.shape == (views, CAMERA.height, CAMERA.width, 3) and np.ptp(pixels) > 100
    if views == 2:
        assert (pixels[0] != pixels[1]).any()
    renderer.destroy()


def test_the_checks_are_on(checked):
    ti = checked
    field = ti.field(ti.i32, 4)

    @ti.kernel
    def beyond():
        field[7] = 1

    with pytest.raises(ti.TaichiAssertionError, match="with indices"):
        beyond()
