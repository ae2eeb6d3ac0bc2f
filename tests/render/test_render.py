"""Pictures against gsplat's and against the float64 twin, and what must never break a picture."""

import numpy as np
import pytest

from assets.gaussians import Gaussians, concatenate
from assets.splat_files import read_gaussians
from core.camera import Camera, look_at, perspective
from core.rotation import matrices_from_quaternions
from tests.support import reference_render as reference
from tests.support.compiling import compiled

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


def single(mean=(0.0, 0.0, 1.0), size=0.05, opacity=0.9, color=(0.2, 0.5, 0.9), count: int = 1) -> Gaussians:
    """`count` copies of one round Gaussian; opacity may be exactly 0 or 1."""
    logit = {0.0: -80.0, 1.0: 80.0}.get(opacity) or np.log(opacity / (1 - opacity))
    dc = (np.asarray(color) - 0.5) / 0.28209479177387814
    each = [np.tile(a, (count, 1)) for a in (mean, [1, 0, 0, 0], np.full(3, np.log(size)), dc)]
    return Gaussians.of(each[0], each[1], each[2], np.full(count, logit), each[3].reshape(count, 1, 3))


class Stage:
    """One renderer for many small sets of Gaussians, so that it is compiled once."""

    def __init__(self, capacity: int, camera: Camera, **options):
        from render.renderer import Renderer
        from render.splats import Splats

        self.camera = camera
        self.splats = Splats(single(count=capacity))
        self.renderer = Renderer(self.splats, camera.width, camera.height, outputs="float", **options)

    def draw(self, g: Gaussians, camera: Camera | None = None):
        """rgb, alpha, depth of one view."""
        from render.splats import covariances

        return self.draw_fields(g.means, covariances(g), g.opacities.astype(np.float32), g.sh, camera)

    def draw_fields(self, mean, cov, opacity, sh, camera: Camera | None = None):
        """The same of what the device's fields are to hold."""

        def padded(values):
            return np.concatenate([values, np.zeros((self.splats.capacity - len(mean), *values.shape[1:]), np.float32)])

        self.splats.count = len(mean)
        self.splats.mean.from_numpy(padded(mean))
        self.splats.cov.from_numpy(padded(cov))
        self.splats.opacity.from_numpy(padded(opacity))
        self.splats.sh.from_numpy(padded(sh))
        self.renderer.render([camera or self.camera])
        return [f.to_numpy()[0] for f in (self.renderer.rgb, self.renderer.alpha, self.renderer.depth)]


@pytest.fixture(scope="module")
def stage(ti_cpu):
    """A camera at the origin that looks along +z; sides that no tile divides."""
    return Stage(5000, Camera(43, 29, 40.0, 40.0, 21.5, 14.5, np.eye(4)))


def test_no_gaussians_give_an_empty_picture(stage):
    stage.draw(single())
    for image in stage.draw(single().select(np.zeros(0, int))):
        np.testing.assert_array_equal(image, 0)


@pytest.mark.parametrize("opacity", [0.0, 0.003, 0.004, 0.5, 0.9999, 1.0])
def test_one_gaussian_of_any_opacity(stage, opacity):
    g = single(opacity=opacity)
    rgb, alpha, depth = stage.draw(g)
    expected = reference.render(g, stage.camera)
    np.testing.assert_allclose(rgb, expected[0], atol=1e-5)
    np.testing.assert_allclose(alpha, expected[1], atol=1e-5)
    np.testing.assert_allclose(depth, expected[2], atol=1e-5)
    assert alpha.max() == pytest.approx(min(opacity, 0.999) if opacity > 1 / 255 else 0, abs=0.01 * opacity)


@pytest.mark.parametrize("size", [1e-7, 1e-3, 0.3, 30.0, 1e4])
@pytest.mark.parametrize("mean", [(0.0, 0.0, 1.0), (0.4, -0.2, 0.5), (3.0, 0.0, 0.02), (0.0, 0.0, -0.5)])
def test_subpixel_and_huge_gaussians_at_any_place(stage, mean, size):
    g = single(mean=mean, size=size)
    rgb, alpha, _ = stage.draw(g)
    expected = reference.render(g, stage.camera)
    assert np.isfinite(rgb).all()
    np.testing.assert_allclose(rgb, expected[0], atol=2e-4)
    np.testing.assert_allclose(alpha, expected[1], atol=2e-4)


@pytest.mark.parametrize("z, seen", [(0.0099, False), (0.0101, True), (0.0, False), (-1.0, False)])
def test_what_lies_before_the_near_plane_is_not_drawn(stage, z, seen):
    assert (stage.draw(single(mean=(0, 0, z), size=0.001))[1].max() > 0) == seen


def test_thousands_on_one_pixel_stop_at_the_opaque_limit(stage):
    """Also in front of a bright wall: what comes after the limit must not shine through."""
    faint = single(opacity=0.05, count=4000, color=(0.1, 0.1, 0.1))
    wall = single(mean=(0, 0, 3), size=0.5, color=(9.0, 9.0, 9.0))
    g = concatenate([wall, faint])
    rgb, alpha, _ = stage.draw(g)
    expected = reference.render(g, stage.camera)
    np.testing.assert_allclose(rgb, expected[0], atol=1e-3)
    assert 1 - 1.1e-4 / 0.9 < alpha[14, 21] <= 1 - 1e-4


def test_a_broken_gaussian_is_left_out(stage):
    """A simulation that blew up must not take the picture with it."""
    g = single(count=4)
    broken = g.means.copy()
    broken[1], broken[2] = np.nan, np.inf
    rgb, alpha, _ = stage.draw(Gaussians(broken, g.quats, g.log_scales, g.logit_opacities, g.sh, g.object_id))
    expected = stage.draw(g.select(np.array([0, 3])))
    np.testing.assert_array_equal(rgb, expected[0])
    np.testing.assert_array_equal(alpha, expected[1])


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 1e9])
def test_a_gaussian_of_no_colour_is_left_out(stage, value):
    g = single(count=4)
    broken = g.sh.copy()
    broken[1:3, 0, 1] = value
    pictures = stage.draw(Gaussians(g.means, g.quats, g.log_scales, g.logit_opacities, broken, g.object_id))
    for found, expected in zip(pictures, stage.draw(g.select(np.array([0, 3]))), strict=True):
        np.testing.assert_array_equal(found, expected)


@pytest.mark.parametrize("seed", range(6))
def test_broken_numbers_anywhere_leave_the_rest_as_it_is(stage, seed):
    """NaN, infinities, denormals and huge values in any field of some Gaussians: the picture stays finite."""
    from render.splats import covariances

    rng = np.random.default_rng(seed)
    g = cloud(rng, 300)
    g = g.transformed(np.eye(3), (0.0, 0.0, 2.0))
    fields = [g.means, covariances(g), g.opacities.astype(np.float32)[:, None], g.sh[:, :1].reshape(len(g), 3)]
    fields = [f.astype(np.float32).copy() for f in fields]
    bad = [np.nan, np.inf, -np.inf, 1e38, -1e38, 1e-42, -1e-42]
    broken = rng.choice(len(g), 60, replace=False)
    for k in broken:
        f = fields[rng.integers(4)]
        f[k, rng.integers(f.shape[1])] = rng.choice(bad)
    mean, cov, opacity, sh = fields
    rgb, alpha, depth = stage.draw_fields(mean, cov, opacity[:, 0], sh[:, None])
    for image in (rgb, alpha, depth):
        assert np.isfinite(image).all()
    assert alpha.min() >= 0.0 and alpha.max() <= 1.0


def test_the_shift_of_the_lens_shifts_the_picture(stage):
    """An off-centre principal point, as the two eyes of a headset have."""
    g = single(mean=(0.0, 0.0, 1.0), size=0.03)
    c = stage.camera
    centred = stage.draw(g)[1]
    shifted = stage.draw(g, Camera(c.width, c.height, c.fx, c.fy, c.cx + 7, c.cy - 3, c.world_to_camera))[1]
    np.testing.assert_allclose(shifted[:-3, 7:], centred[3:, :-7], atol=1e-5)


def test_more_pairs_than_room_draw_the_same_picture(ti_cpu):
    """6,000 Gaussians that cover the picture need far more pairs than the first buffers hold."""
    g = cloud(np.random.default_rng(3), 6000, size=1.0)
    camera = perspective(160, 120, 1.0, look_at((0, 0, -1), (0, 0, 0)))
    rgb, _, _, renderer = draw(g, [camera])
    pairs = renderer.raster.order.pairs[None]
    assert pairs > 8 * g.means.shape[0] and renderer.raster.stage.bins.capacity >= pairs
    renderer.render([camera])
    np.testing.assert_array_equal(renderer.rgb.to_numpy(), rgb)
    close = np.abs(rgb[0] - reference.render(g, camera)[0]).max(axis=-1) < 2e-3
    assert close.mean() > 0.999


def test_larger_pictures_cost_no_kernels_but_their_own(ti_cpu):
    """More tiles than there is room for, in the midst of play: nothing else of the program is compiled anew."""
    from render.renderer import Renderer
    from render.splats import Splats

    def pixels(renderer, width, height):
        renderer.render([perspective(width, height, 1.0, look_at((0, 0, -2), (0, 0, 0)))])
        return renderer.pixels()

    splats = Splats(cloud(np.random.default_rng(7), 60))
    other, renderer = Renderer(splats, 40, 30), Renderer(splats, 40, 30)
    before = pixels(other, 40, 30)
    np.testing.assert_array_equal(pixels(renderer, 40, 30), before)
    with compiled() as names:
        renderer.resize(700, 500)
        assert pixels(renderer, 700, 500).any()
        splats.light.fill(1.0)
        np.testing.assert_array_equal(pixels(other, 40, 30), before)
    assert set(names) == {"DrawStage._draw_ndarray", "DrawStage._fill"}


def test_two_eyes_share_one_sort_but_not_their_matrices(ti_cpu):
    """Each eye equals the twin drawn with its own camera, the mean depth's order and the shared colour."""
    g = cloud(np.random.default_rng(4), 200, degree=1, size=0.03)
    eyes = []
    for x in (-0.032, 0.032):
        eyes.append(Camera(60, 50, 50.0, 52.0, 30 + 150 * x, 24.0, look_at((x, 0.1, -0.8), (x, 0.0, 0.0))))
    rgb, alpha, _, _ = draw(g, eyes)
    depths = [reference.project(g.means, reference.covariances(g), g.opacities, eye)[3] for eye in eyes]
    middle = Camera(60, 50, 50.0, 52.0, 30.0, 24.0, look_at((0, 0.1, -0.8), (0, 0.0, 0.0)))
    shared = {"order_by": np.mean(depths, axis=0), "rgb": reference.colors(g, middle)}
    assert np.abs(rgb[0] - rgb[1]).max() > 0.05
    for v, eye in enumerate(eyes):
        expected, expected_alpha, _ = reference.render(g, eye, **shared)
        assert (np.abs(rgb[v] - expected).max(axis=-1) < 1e-3).mean() > 0.999
        assert (np.abs(alpha[v] - expected_alpha) < 1e-3).mean() > 0.999


def test_the_picture_has_the_background_and_the_byte_order_it_promises(ti_cpu):
    from render.renderer import Renderer
    from render.splats import Splats

    camera = Camera(20, 12, 40.0, 40.0, 4.5, 2.5, np.eye(4))  # the Gaussian falls on pixel (4, 2)
    renderer = Renderer(Splats(single(size=1e-4, opacity=1.0)), 20, 12, background=(1.0, 0.5, 0.0))
    renderer.render([camera])
    packed = renderer.picture.to_numpy()
    assert packed.shape == (12, 20) and packed.dtype == np.uint32
    level = [int(0.999 * c * 255 + 0.001 * b * 255 + 0.5) for c, b in zip((0.2, 0.5, 0.9), (1, 0.5, 0), strict=True)]
    assert packed[2, 4] == level[0] | level[1] << 8 | level[2] << 16 | 255 << 24
    assert packed[11, 19] == 255 | 128 << 8 | 0 << 16 | 255 << 24
    np.testing.assert_array_equal(renderer.pixels()[0, 2, 4], [*level, 255])


def test_the_light_and_the_frame_of_the_harmonics_belong_to_each_gaussian(ti_cpu):
    """Colour = light * max(0, 0.5 + SH(R^T d)); a body that turns keeps its highlights."""
    from render.renderer import Renderer
    from render.splats import Splats

    rng = np.random.default_rng(5)
    g = cloud(rng, 100, degree=2, size=0.03)
    quats = rng.normal(size=(100, 4))
    quats /= np.linalg.norm(quats, axis=1, keepdims=True)
    light = rng.uniform(0.2, 1, 100)
    splats = Splats(g)
    splats.rotation.from_numpy(splats._padded(quats))
    splats.light.from_numpy(splats._padded(light))
    camera = perspective(40, 40, 0.8, look_at((0, 0, -1.2), (0, 0, 0)))
    renderer = Renderer(splats, 40, 40, outputs="float")
    renderer.render([camera])
    colors = reference.colors(g, camera, matrices_from_quaternions(quats)) * light[:, None]
    expected = reference.render(g, camera, rgb=colors)[0]
    assert (np.abs(renderer.rgb.to_numpy()[0] - expected).max(axis=-1) < 1e-3).mean() > 0.999


def test_a_resized_picture_equals_one_made_so(ti_cpu):
    """Smaller, larger, and with more tiles than there was room for."""
    from render.renderer import Renderer
    from render.splats import Splats

    splats = Splats(cloud(np.random.default_rng(7), 60))
    resized = Renderer(splats, 40, 30, background=(0.2, 0.3, 0.4))
    for width, height in [(33, 21), (150, 97), (700, 500), (40, 30)]:
        camera = Camera(
            width, height, 0.8 * width, 0.8 * width, 0.5 * width, 0.5 * height, look_at((0, 0, -2), (0, 0, 0))
        )
        resized.resize(width, height)
        resized.render([camera])
        fresh = Renderer(splats, width, height, background=(0.2, 0.3, 0.4))
        fresh.render([camera])
        assert resized.pixels().std() > 5
        np.testing.assert_array_equal(resized.pixels(), fresh.pixels())
        fresh.destroy()
