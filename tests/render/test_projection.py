"""Projection, colour and tiles against the float64 twin, Gaussian by Gaussian."""

import numpy as np
import pytest

from assets.gaussians import Gaussians
from core.camera import Camera, look_at
from tests.support import reference_render as reference

CAMERA = Camera(150, 97, 130.0, 120.0, 60.0, 55.0, look_at((0.3, 0.4, -1.5), (0.1, 0.0, 0.0)))


def gaussians(count: int, degree: int) -> Gaussians:
    """From needles to discs, in front of, beside and behind the camera."""
    rng = np.random.default_rng(degree)
    means = rng.normal(0, 0.6, (count, 3))
    scales = rng.normal(-4.0, 1.3, (count, 3))
    sh = rng.normal(0, 0.5, (count, (degree + 1) ** 2, 3))
    return Gaussians.of(means, rng.normal(size=(count, 4)), scales, rng.normal(0, 2.5, count), sh)


def project(g: Gaussians, *, antialias=False, crew=None):
    """A raster that has arranged and binned `g`, and one list of Gaussians per tile.

    `crew` threads share each large splat; as many as the backend likes if None.
    """
    from render.rasterizer import Rasterizer
    from render.renderer import FloatImages
    from render.splats import Splats

    sink = FloatImages(1, CAMERA.height, CAMERA.width)
    raster = Rasterizer(Splats(g), CAMERA.width, CAMERA.height, views=1, sink=sink, antialias=antialias)
    raster.set_camera(0, CAMERA)
    raster.stage.bins.crew = crew or raster.stage.bins.crew
    raster.draw(0)
    bins = raster.stage.bins
    members, begin, end = bins.members.to_numpy() >> 32, *(f.to_numpy()[: bins.tiles] for f in (bins.begin, bins.end))
    return raster, [members[b:e] for b, e in zip(begin, end, strict=True)]


def tiles_with_a_visible_pixel(uv, sigma, opacity, tile: tuple[int, int], shape: tuple[int, int]) -> np.ndarray:
    """Which tiles (rows, columns) hold a pixel where alpha reaches 1/255."""
    v, u = np.mgrid[: CAMERA.height, : CAMERA.width] + 0.5
    a, b, c = np.linalg.inv(sigma)[[0, 0, 1], [0, 1, 1]]
    dx, dy = u - uv[0], v - uv[1]
    width, height = tile
    seen = np.zeros((shape[0] * height, shape[1] * width), bool)
    alpha = opacity * np.exp(-0.5 * (a * dx * dx + 2 * b * dx * dy + c * dy * dy))
    seen[: CAMERA.height, : CAMERA.width] = alpha >= 1 / 255 * (1 + 1e-5)  # a hair more: not a matter of rounding
    return seen.reshape(shape[0], height, shape[1], width).any(axis=(1, 3))


@pytest.mark.parametrize("antialias", [False, True])
def test_splats_and_their_tiles_equal_the_twin(ti_cpu, antialias):
    g = gaussians(1500, 0)
    raster, lists = project(g, antialias=antialias)
    p = raster.projection
    place, conic, window = (f.to_numpy()[0, : len(g)] for f in (p.place, p.conic, p.window))
    cov = reference.covariances(g)
    uv, sigma, opacity, z, kept = reference.project(g.means, cov, g.opacities, CAMERA, antialias=antialias)
    tiles = np.where(window[:, 1] < 0, -window[:, 1], np.bitwise_count(np.maximum(window[:, 1], 0)))
    drawn = tiles > 0
    assert (window[:, 1] < 0).any() and (window[:, 1] > 0).sum() > 200
    assert 200 < drawn.sum() < len(g)
    assert not drawn[~kept].any()
    np.testing.assert_allclose(place[drawn][:, :2], uv[drawn], rtol=2e-5, atol=2e-3)  # float32 of hundreds of px
    np.testing.assert_allclose(place[drawn][:, 3], z[drawn], rtol=1e-5)
    np.testing.assert_allclose(2 ** place[drawn][:, 2], opacity[drawn], rtol=2e-3)
    inverse = np.linalg.inv(sigma)[drawn][:, [0, 0, 1], [0, 1, 1]]
    size = np.linalg.norm(inverse, axis=1, keepdims=True)
    np.testing.assert_allclose(conic[drawn][:, :3] / (0.5 * np.log2(np.e)) / size, inverse / size, atol=1e-4)

    shape = p.tiles[::-1]
    binned = np.zeros((len(g), len(lists)), bool)
    for t, members in enumerate(lists):
        assert (np.diff(z[members].astype(np.float32)) >= -1e-6).all()  # front to back
        binned[members, t] = True
    np.testing.assert_array_equal(binned.sum(1), tiles)  # each pair once
    needed = np.zeros_like(binned)
    for i in np.flatnonzero(kept):
        needed[i] = tiles_with_a_visible_pixel(uv[i], sigma[i], opacity[i], p.tile, shape).ravel()
    assert not (needed & ~binned).any()
    assert binned.sum() < 1.1 * needed.sum()  # a strip's span counts between pixel centres, too


def test_threads_may_share_a_large_splat(ti_cpu):
    g = gaussians(1500, 0)
    alone, shared = project(g, crew=1)[1], project(g, crew=32)[1]
    for a, b in zip(alone, shared, strict=True):
        np.testing.assert_array_equal(a, b)


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_colors_equal_the_twin(ti_cpu, degree):
    g = gaussians(400, degree)
    g.sh[:100, 1:] = g.sh[-50:, 1:] = 0  # parts of a scene without bands, which the renderer may know
    raster, _ = project(g)
    assert raster.splats.banded == ((100, 350) if degree else (0, 0))
    drawn = raster.projection.window.to_numpy()[0, : len(g), 1] != 0
    color = raster.projection.color.to_numpy()[0, : len(g), :3]
    np.testing.assert_allclose(color[drawn], reference.colors(g, CAMERA)[drawn], atol=2e-5)


def test_covariances_are_those_of_scales_and_rotations(ti_cpu):
    from core.fields import round_up_capacity
    from render.splats import Splats

    g = gaussians(50, 0)
    cov = Splats(g).cov.to_numpy()[:50]
    expected = reference.covariances(g)
    i, j = np.triu_indices(3)
    np.testing.assert_allclose(cov, expected[:, i, j], rtol=1e-5, atol=1e-7 * np.abs(expected).max())
    for count in (0, 1, 255, 256, 257, 100_000, 262_144, 262_145):
        assert count <= round_up_capacity(count) <= count + max(256, count // 4)


def test_depth_keys_compare_like_floats(ti_cpu):
    """Also below zero: an eye may see what lies behind the other."""
    ti = ti_cpu
    from render.projection import ordered_bits

    values = np.sort(np.random.default_rng(0).normal(0, 10, 1000).astype(np.float32))
    keys = np.zeros(1000, np.uint32)

    @ti.kernel
    def fill(values: ti.types.ndarray(ti.f32, ndim=1), keys: ti.types.ndarray(ti.u32, ndim=1)):
        for i in keys:
            keys[i] = ordered_bits(values[i])

    fill(values, keys)
    assert (np.diff(keys.astype(np.int64)) > 0).all()
