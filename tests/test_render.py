"""Pictures against gsplat's and against the float64 twin, and what must never break a picture."""

import numpy as np
import pytest
import reference_render as reference

from assets.camera import Camera, look_at
from assets.files import read_gaussians
from assets.gaussians import Gaussians

PICTURES = {  # name of the reference: file, antialiased
    "toy_cat": ("toy_cat", False),
    "plush_dragon": ("plush_dragon", False),
    "fruit_drops": ("fruit_drops_minimal", False),
    "toy_cat_antialiased": ("toy_cat", True),
}


@pytest.mark.shared
@pytest.mark.parametrize("name", PICTURES)
def test_pictures_equal_those_of_gsplat(ti_cpu, shared, name):
    from render.renderer import Renderer
    from render.splats import Splats

    file, antialias = PICTURES[name]
    truth = np.load(shared / "reference" / f"{name}.npz")
    K, width, height = truth["K"], int(truth["width"]), int(truth["height"])
    splats = Splats(read_gaussians(shared / "data" / "splats" / f"{file}.ply"))
    renderer = Renderer(splats, width, height, antialias=antialias, outputs="float")
    for v, world_to_camera in enumerate(truth["world_to_camera"]):
        renderer.render([Camera(width, height, K[0, 0], K[1, 1], K[0, 2], K[1, 2], world_to_camera)])
        error = np.abs(renderer.rgb.to_numpy()[0] - truth["rgb"][v])
        alpha_error = np.abs(renderer.alpha.to_numpy()[0] - truth["alpha"][v])
        solid = truth["alpha"][v] > 0.5
        depth_error = np.abs(renderer.depth.to_numpy()[0] - truth["depth"][v])[solid]
        assert error.mean() <= 1e-3
        assert (error.max(axis=-1) <= 2 / 255).mean() >= 0.999
        assert alpha_error.mean() <= 1e-3 and (alpha_error <= 2 / 255).mean() >= 0.999
        assert depth_error.max() <= 2e-3 * truth["depth"][v].max()  # half an ulp of float16 is 5e-4


def cloud(rng, count: int, degree: int = 0, size=0.05) -> Gaussians:
    """A ball of Gaussians around the origin."""
    sh = rng.normal(0, 0.4, (count, (degree + 1) ** 2, 3))
    scales = np.log(size) + rng.normal(0, 0.7, (count, 3))
    return Gaussians.of(
        rng.normal(0, 0.3, (count, 3)), rng.normal(size=(count, 4)), scales, rng.normal(0, 2, count), sh
    )


def draw(gaussians: Gaussians, cameras: list[Camera], **options):
    """rgb (V, H, W, 3), alpha (V, H, W), depth (V, H, W) and the renderer."""
    from render.renderer import Renderer
    from render.splats import Splats

    c = cameras[0]
    renderer = Renderer(Splats(gaussians), c.width, c.height, views=len(cameras), outputs="float", **options)
    renderer.render(cameras)
    return renderer.rgb.to_numpy(), renderer.alpha.to_numpy(), renderer.depth.to_numpy(), renderer


@pytest.mark.parametrize("antialias", [False, True])
def test_a_cloud_equals_its_twin(ti_cpu, antialias):
    """An odd size, an off-centre lens, Gaussians behind, across and before the near plane."""
    g = cloud(np.random.default_rng(1), 150, degree=3, size=0.03)
    camera = Camera(53, 37, 40.0, 44.0, 31.5, 12.25, look_at((0.1, 0.2, -0.35), (0.0, 0.0, 0.3)))
    rgb, alpha, depth, _ = draw(g, [camera], antialias=antialias)
    expected_rgb, expected_alpha, expected_depth = reference.render(g, camera, antialias=antialias)
    assert 0.1 < expected_alpha.mean() < 0.9
    close = np.abs(rgb[0] - expected_rgb).max(axis=-1) < 1e-3
    assert close.mean() > 0.999  # a pixel at a threshold (1/255, 1e-4) may fall on either side in float32
    np.testing.assert_allclose(np.median(np.abs(alpha[0] - expected_alpha)), 0, atol=1e-5)
    np.testing.assert_allclose(np.median(np.abs(depth[0] - expected_depth)), 0, atol=1e-4)
