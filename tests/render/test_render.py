"""Pictures against gsplat's, their format, and what happens when they or their contents grow."""

import numpy as np
import pytest
import taichi as ti

from assets.gaussians import Gaussians
from assets.splat_files import read_gaussians
from core.camera import Camera, look_at, perspective
from tests.support import reference_render as reference
from tests.support.compiling import compiled
from tests.support.drawing import Drawing
from tests.support.hard_pictures import cloud, round_ones

PICTURES = {  # name of the reference: file, antialiased
    "toy_cat": ("toy_cat", False),
    "plush_dragon": ("plush_dragon", False),
    "fruit_drops": ("fruit_drops_minimal", False),
    "toy_cat_antialiased": ("toy_cat", True),
}


@pytest.fixture(scope="module")
def drawings(ti_cpu):
    """A drawing for all files by gsplat's rules, plain and antialiased."""
    how = {"degree": 3, "linear": True}
    return {antialias: Drawing(62_500, 1, 384, antialias=antialias, **how) for antialias in (False, True)}


@pytest.mark.shared
@pytest.mark.parametrize("name", PICTURES)
def test_pictures_equal_those_of_gsplat(drawings, shared, name):
    file, antialias = PICTURES[name]
    truth = np.load(shared / "reference" / f"{name}.npz")
    K, width, height = truth["K"], int(truth["width"]), int(truth["height"])
    g = read_gaussians(shared / "data" / "splats" / f"{file}.ply")
    for v, world_to_camera in enumerate(truth["world_to_camera"]):
        camera = Camera(width, height, K[0, 0], K[1, 1], K[0, 2], K[1, 2], world_to_camera)
        rgb, alpha, depth = (image[0] for image in drawings[antialias].draw(g, [camera]))
        error = np.abs(rgb - truth["rgb"][v])
        alpha_error = np.abs(alpha - truth["alpha"][v])
        solid = truth["alpha"][v] > 0.5
        depth_error = np.abs(depth - truth["depth"][v])[solid]
        assert error.mean() <= 1e-3
        assert (error.max(axis=-1) <= 2 / 255).mean() >= 0.999
        assert alpha_error.mean() <= 1e-3 and (alpha_error <= 2 / 255).mean() >= 0.999
        assert depth_error.max() <= 2e-3 * truth["depth"][v].max()  # half an ulp of float16 is 5e-4


def test_powers_of_two_equal_numpys(ti_cpu):
    from render.blend import CUTOFF_BITS, exp2

    x = np.linspace(-140.0 if ti.cfg.arch == ti.cuda else -CUTOFF_BITS, 0.01, 10_000).astype(np.float32)
    values = ti.field(ti.f32, len(x))
    values.from_numpy(x)

    @ti.kernel
    def raise_two():
        for i in values:
            values[i] = exp2(values[i])

    raise_two()
    expected = np.where(x < -126, 0.0, 2 ** x.astype(np.float64))
    np.testing.assert_allclose(values.to_numpy(), expected, rtol=5e-6)


def test_more_pairs_than_the_capacity_draw_the_same_picture(ti_cpu):
    """Gaussians that cover the picture need far more pairs than the first buffers hold."""
    g = cloud(np.random.default_rng(3), 200, size=1.0).with_sh_degree(0)
    camera = perspective(160, 120, 1.0, look_at((0, 0, -1), (0, 0, 0)))
    drawing = Drawing(200, 1, 160, degree=0)
    before = drawing.rasterizer.pair_capacity
    rgb = drawing.draw(g, [camera])[0]
    assert drawing.rasterizer.pair_capacity >= drawing.rasterizer.pairs > before
    np.testing.assert_array_equal(drawing.draw(g, [camera])[0], rgb)
    close = np.abs(rgb[0] - reference.render(g, camera)[0]).max(axis=-1) < 2e-3
    assert close.mean() > 0.999


def test_a_resized_picture_equals_one_of_that_size_and_costs_no_kernels_but_its_own(ti_cpu):
    """Smaller, larger, and with more tiles than the capacity, in the midst of play."""
    from render.renderer import Renderer
    from render.splats import Splats

    def pixels(renderer, width, height):
        renderer.render([perspective(width, height, 1.0, look_at((0, 0, -2), (0, 0, 0)))])
        assert renderer.pixels().std() > 5
        return renderer.pixels()

    splats = Splats(cloud(np.random.default_rng(7), 60).with_sh_degree(0))
    small, large = (Renderer(splats, *size, background=(0.2, 0.3, 0.4)) for size in ((40, 30), (700, 500)))
    expected = {size: pixels(renderer, *size) for size, renderer in (((40, 30), small), ((700, 500), large))}
    splats.visibility.fill(1.0)
    with compiled() as names:
        large.resize(33, 21)
        pixels(large, 33, 21)
        large.resize(40, 30)
        np.testing.assert_array_equal(pixels(large, 40, 30), expected[40, 30])
        assert names == []
        small.resize(700, 500)
        np.testing.assert_array_equal(pixels(small, 700, 500), expected[700, 500])
        splats.visibility.fill(1.0)
        np.testing.assert_array_equal(pixels(large, 40, 30), expected[40, 30])
    more_tiles = {"TilePass._blend_to_ndarray", "TilePass._bin"} if ti.cfg.arch != ti.cuda else set()  # they all fit
    assert set(names) == more_tiles


def test_what_stands_still_is_projected_once_a_view_and_shaded_in_each_picture(ti_cpu):
    """Pictures equal those of a renderer that keeps nothing: in new light, with others moved, of other views."""
    from render.renderer import Renderer
    from render.splats import Splats

    rng, still = np.random.default_rng(3), 40
    splats = Splats(cloud(rng, 60))
    keeping, plain = (Renderer(splats, 96, 64, sort="radial", still=n) for n in (still, 0))

    def compare(eye=(0, 0, -2)):
        camera = perspective(keeping.width, keeping.height, 1.0, look_at(eye, (0, 0, 0)))
        for renderer in (keeping, plain):
            renderer.render([camera])
        assert keeping.pixels().std() > 5
        np.testing.assert_array_equal(keeping.pixels(), plain.pixels())
        return keeping.pixels()

    first = compare()
    splats.visibility.from_numpy(rng.uniform(0.2, 1.0, splats.capacity).astype(np.float32))
    assert (compare() != first).any()
    means = splats.mean.to_numpy()
    means[still:] += 0.1
    splats.mean.from_numpy(means)
    moved = compare()
    means[0] += 5.0  # it is promised that this one never moves: it is still drawn where it was
    splats.mean.from_numpy(means)
    keeping.render([perspective(96, 64, 1.0, look_at((0, 0, -2), (0, 0, 0)))])
    np.testing.assert_array_equal(keeping.pixels(), moved)
    compare((0.3, 0.2, -2))
    for renderer in (keeping, plain):
        renderer.resize(80, 50)
    compare((0.3, 0.2, -2))


def test_colours_of_what_stands_still_are_seen_anew_when_the_eye_has_moved(ti_cpu):
    """They are kept for 2 mm, of what was out of the picture not at all, and not if it has changed after all."""
    from render.renderer import Renderer
    from render.splats import Splats

    splats = Splats(cloud(np.random.default_rng(3), 60))
    keeping, plain = (Renderer(splats, 96, 64, sort="radial", still=n) for n in (60, 0))

    def off(x: float, target=(0, 0, 0)) -> int:
        """Largest difference of the two pictures from an eye at x [m]."""
        camera = perspective(96, 64, 1.0, look_at((x, 0, -2), target))
        for renderer in (keeping, plain):
            renderer.render([camera])
        assert plain.pixels().std() > 5
        return np.abs(keeping.pixels().astype(int) - plain.pixels()).max()

    assert off(0.0, (0.9, 0, 0)) == 0 and off(0.0) == 0  # many were out of the first picture
    assert off(0.0015) <= 1 and off(-0.0015) <= 1
    splats.sh.from_numpy(splats.sh.to_numpy()[:, :, ::-1].copy())
    assert off(0.0005) > 20  # they are those of before
    assert off(0.0025) == 0
    splats.sh.from_numpy(splats.sh.to_numpy()[:, :, ::-1].copy())
    keeping.forget()
    assert off(0.0025) == 0


@pytest.mark.parametrize("sort", ["radial", "pixel"])
def test_tiles_in_which_nothing_changes_keep_their_pixels(ti_cpu, sort):
    """Pictures equal those drawn as a whole, when Gaussians move, appear, vanish, change colour or are broken."""
    from render.renderer import Renderer
    from render.splats import Splats

    if ti.cfg.arch == ti.cuda:
        pytest.skip("a GPU draws all tiles")
    rng, splats = np.random.default_rng(4), Splats(cloud(np.random.default_rng(3), 60))
    keeping, whole = (Renderer(splats, 96, 64, sort=sort, still=n) for n in (20, 0))
    camera = perspective(96, 64, 1.0, look_at((0, 0, -2), (0, 0, 0)))
    tiles = keeping.rasterizer.projection.changed

    def compare() -> int:
        """Number of tiles that were drawn anew."""
        whole.rasterizer.resize(96, 64)  # so that it keeps nothing
        for renderer in (keeping, whole):
            renderer.render([camera])
        np.testing.assert_array_equal(keeping.pixels(), whole.pixels())
        if tiles.whole[None] == tiles.picture[None]:
            return 96
        return int((tiles.last.to_numpy()[:96] == tiles.picture[None]).sum())

    assert compare() == 96 and compare() == 0
    means, opacity, visibility = splats.mean.to_numpy(), splats.opacity.to_numpy(), splats.visibility.to_numpy()
    for _ in range(12):
        g = rng.integers(20, 60)
        means[g] += 0.05 * rng.normal(size=3)
        splats.mean.from_numpy(means)
        assert compare() < 96
        visibility[rng.integers(0, 60)] = rng.uniform(0.2, 1.0)
        splats.visibility.from_numpy(visibility)
        opacity[g] = 0.0 if opacity[g] > 0 else 0.8
        splats.opacity.from_numpy(opacity)
        compare()
        sorted_splats = (r.rasterizer.order.sorter.kept[None] for r in (keeping, whole))
        assert next(sorted_splats) < next(sorted_splats)  # those that touch no tile which is drawn anew are left out
    means[30], means[31] = np.nan, (0, 0, -50)  # behind the camera
    splats.mean.from_numpy(means)
    compare()
    splats.count = 45
    assert compare() == 96
    camera = perspective(96, 64, 1.0, look_at((0.1, 0, -2), (0, 0, 0)))
    assert compare() == 96 and compare() == 0


def test_the_splat_that_finishes_a_pixel_counts_on_the_screen(ti_cpu):
    """And the pixel shows nothing of a background of which 5e-5 is left; in float images it stops before, as gsplat."""
    from render.renderer import Renderer
    from render.splats import Splats

    g = round_ones(((0.0, 0.0, 1.0), (0.0, 0.0, 1.2)), size=0.1, opacity=(0.95, 0.9995))
    black = np.full((2, 1, 3), -0.5 / 0.28209479177387814)
    g = Gaussians.of(g.means, g.quats, g.log_scales, g.logit_opacities, black)
    for outputs, least, most in (("rgba8", 0, 0), ("float", 0.949, 0.951)):
        renderer = Renderer(Splats(g), 9, 9, background=(1.0, 1.0, 1.0), outputs=outputs)
        renderer.render([Camera(9, 9, 40.0, 40.0, 4.5, 4.5, np.eye(4))])
        shown = renderer.alpha.to_numpy() if outputs == "float" else renderer.pixels()[..., 0]
        assert least <= shown[0, 4, 4] <= most


def test_the_picture_has_the_background_and_the_byte_order_it_promises(ti_cpu):
    from render.renderer import Renderer
    from render.splats import Splats

    camera = Camera(20, 12, 40.0, 40.0, 4.5, 2.5, np.eye(4))  # the Gaussian falls on pixel (4, 2)
    g = round_ones((0.0, 0.0, 1.0), size=1e-4, opacity=1.0)
    dc = (np.array([[[0.2, 0.5, 0.9]]]) - 0.5) / 0.28209479177387814
    g = Gaussians.of(g.means, g.quats, g.log_scales, g.logit_opacities, dc)
    renderer = Renderer(Splats(g), 20, 12, background=(1.0, 0.5, 0.0))
    renderer.render([camera])
    packed = renderer.picture.to_numpy()
    assert packed.shape == (12, 20) and packed.dtype == np.uint32
    level = [int(0.999 * c * 255 + 0.001 * b * 255 + 0.5) for c, b in zip((0.2, 0.5, 0.9), (1, 0.5, 0), strict=True)]
    assert packed[2, 4] == level[0] | level[1] << 8 | level[2] << 16 | 255 << 24
    assert packed[11, 19] == 255 | 128 << 8 | 0 << 16 | 255 << 24
    np.testing.assert_array_equal(renderer.pixels()[0, 2, 4], [*level, 255])
