"""The renderer's kernels once with Taichi's checks on: every index within its field, no integer overflow."""

import numpy as np
import pytest

from tests.render.test_projection import gaussians
from tests.support.drawing import Drawing
from tests.support.hard_pictures import DEGREE, SIDE, hard_pictures
from tests.support.runtime import runtime


@pytest.fixture(scope="module")
def checked():
    """Taichi with debug=True, for this file alone."""
    with runtime(debug=True) as ti:
        yield ti


@pytest.mark.parametrize("options", [{}, {"sort": "pixel", "buffer_size": 3}], ids=["z", "pixel"])
def test_every_index_is_within_its_field(checked, options):
    """Odd sizes, nothing at all, the whole sky, thousands in a pixel, splats that exceed a tile mask; two eyes."""
    drawing = Drawing(4100, 2, SIDE, degree=DEGREE, **options)
    for g, eyes in hard_pictures().values():
        images = drawing.draw(g, eyes)
        assert all(np.isfinite(image).all() for image in images)
        assert images[1].max() > 0.5 or len(g) == 0


def test_every_index_of_a_shadow_is_within_its_field(checked):
    """A light that looks at all of it, then one that most of it lies behind."""
    from core.vocabulary import Light
    from render.shadow_map import ShadowMap
    from render.splats import Splats

    g = gaussians(400, 0)
    splats = Splats(g)
    shadow = ShadowMap(splats, Light((0.0, 3.0, 0.5), (0.0, 0.0, 0.0)), 150)
    shadow.keep_captured_shadows([(150, 200)])
    shadow.cast()
    light = splats.visibility.to_numpy()[: len(g)]
    assert light.min() < 0.8 and light.max() > 0.9
    shadow.set_light(Light((0.1, 0.2, 0.0), (3.0, 0.2, 0.0)))
    shadow.cast()
    assert np.isfinite(splats.visibility.to_numpy()).all()


def test_the_checks_are_on(checked):
    ti = checked
    field = ti.field(ti.i32, 4)

    @ti.kernel
    def beyond():
        field[7] = 1

    with pytest.raises(AssertionError, match="with indices"):
        beyond()
