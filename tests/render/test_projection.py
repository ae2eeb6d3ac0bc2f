"""Projection, colour and tiles against the float64 twin, Gaussian by Gaussian."""

import numpy as np
import pytest
import taichi as ti

from assets.gaussians import Gaussians
from core.camera import Camera, look_at
from render.footprint import ACROSS, DOWN, box_of, touched_cells
from tests.support import reference_render as reference
from tests.support.drawing import Drawing

CAMERA = Camera(150, 97, 130.0, 120.0, 60.0, 55.0, look_at((0.3, 0.4, -1.5), (0.1, 0.0, 0.0)))


def gaussians(count: int, degree: int) -> Gaussians:
    """From needles to discs, in front of, beside and behind the camera."""
    rng = np.random.default_rng(degree)
    means = rng.normal(0, 0.6, (count, 3))
    scales = rng.normal(-4.0, 1.3, (count, 3))
    sh = rng.normal(0, 0.5, (count, (degree + 1) ** 2, 3))
    return Gaussians.of(means, rng.normal(size=(count, 4)), scales, rng.normal(0, 2.5, count), sh)


@pytest.fixture(scope="module")
def drawings(ti_cpu):
    """A drawing each, plain and antialiased."""
    return {antialias: Drawing(1500, 1, CAMERA.width, degree=0, antialias=antialias) for antialias in (False, True)}


def members_of_tiles(bins) -> list[np.ndarray]:
    """Indices of the Gaussians of each tile, front to back."""
    members, begin, end = bins.members.to_numpy() >> 32, *(f.to_numpy()[: bins.tiles] for f in (bins.begin, bins.end))
    return [members[b:e] for b, e in zip(begin, end, strict=True)]


def tiles_with_a_visible_pixel(uv, sigma, opacity, tile: tuple[int, int], shape: tuple[int, int]) -> np.ndarray:
    """Mask of tiles (rows, columns) with a pixel where alpha reaches 1/255."""
    v, u = np.mgrid[: CAMERA.height, : CAMERA.width] + 0.5
    a, b, c = np.linalg.inv(sigma)[[0, 0, 1], [0, 1, 1]]
    dx, dy = u - uv[0], v - uv[1]
    width, height = tile
    seen = np.zeros((shape[0] * height, shape[1] * width), bool)
    alpha = opacity * np.exp(-0.5 * (a * dx * dx + 2 * b * dx * dy + c * dy * dy))
    seen[: CAMERA.height, : CAMERA.width] = alpha >= 1 / 255 * (1 + 1e-5)  # a hair more: not a matter of rounding
    return seen.reshape(shape[0], height, shape[1], width).any(axis=(1, 3))


@pytest.mark.parametrize("antialias", [False, True])
def test_splats_and_their_tiles_equal_the_twin(drawings, antialias):
    g, rasterizer = gaussians(1500, 0), drawings[antialias].rasterizer
    drawings[antialias].draw(g, [CAMERA])
    p, lists = rasterizer.projection, members_of_tiles(rasterizer.tile_pass.bins)
    mean2d, conic, mask = (f.to_numpy()[0, : len(g)] for f in (p.mean2d, p.conic, p.tile_mask))
    cov = reference.covariances(g)
    uv, sigma, opacity, z, kept = reference.project(g.means, cov, g.opacities, CAMERA, antialias=antialias)
    tiles = np.where(mask[:, 1] < 0, -mask[:, 1], np.bitwise_count(np.maximum(mask[:, 1], 0)))
    drawn = tiles > 0
    assert (mask[:, 1] < 0).any() and (mask[:, 1] > 0).sum() > 200
    assert 200 < drawn.sum() < len(g)
    assert not drawn[~kept].any()
    np.testing.assert_allclose(mean2d[drawn][:, :2], uv[drawn], rtol=2e-5, atol=2e-3)  # float32 of hundreds of px
    np.testing.assert_allclose(mean2d[drawn][:, 3], z[drawn], rtol=1e-5)
    np.testing.assert_allclose(2 ** mean2d[drawn][:, 2], opacity[drawn], rtol=2e-3)
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


@pytest.mark.parametrize("tile", [(32, 16), (32, 32)])
def test_cells_hold_all_splats_with_a_visible_pixel_in_them_and_few_others(drawings, tile):
    g, p = gaussians(1500, 0), drawings[False].rasterizer.projection
    drawings[False].draw(g, [CAMERA])
    columns, rows = -(-CAMERA.width // tile[0]), -(-CAMERA.height // tile[1])
    found = ti.field(ti.i32, (len(g), rows, columns))

    @ti.kernel
    def find():
        for i, row, column in found:
            mean2d, conic = p.mean2d[0, i], p.conic[0, i]
            found[i, row, column] = touched_cells(row, column, mean2d, conic, box_of(mean2d, conic), tile)

    find()
    drawn = p.tile_mask.to_numpy()[0, : len(g), 1] != 0
    bits = found.to_numpy()[..., None] >> np.arange(ACROSS * DOWN) & 1
    touched = bits.reshape(len(g), rows, columns, DOWN, ACROSS).swapaxes(2, 3).reshape(len(g), rows * DOWN, -1)
    uv, sigma, opacity, _, _ = reference.project(g.means, reference.covariances(g), g.opacities, CAMERA)
    cell, needed = (tile[0] // ACROSS, tile[1] // DOWN), np.zeros(touched.shape, bool)
    for i in np.flatnonzero(drawn):
        needed[i] = tiles_with_a_visible_pixel(uv[i], sigma[i], opacity[i], cell, touched.shape[1:])
    assert not (needed & (touched == 0)).any()
    assert touched[drawn].sum() < 1.1 * needed.sum()


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_colors_equal_the_twin(ti_cpu, degree):
    import taichi as ti

    from render.splats import Splats, color_of

    g = gaussians(400, degree)
    g.sh[:100, 1:] = g.sh[-50:, 1:] = 0  # parts of a scene without harmonics, which the renderer may know
    splats = Splats(g)
    assert splats.sh_range == ((100, 350) if degree else (0, 0))
    eye, found = CAMERA.position, np.zeros((len(g), 3), np.float32)

    @ti.kernel
    def colors(eye: ti.types.vector(3, ti.f32), out: ti.types.ndarray(ti.f32, ndim=2)):
        for i in range(splats.count):
            c = color_of(splats, i, splats.mean[i] - eye)
            for k in ti.static(range(3)):
                out[i, k] = c[k]

    colors(ti.Vector(eye.tolist()), found)
    np.testing.assert_allclose(np.maximum(found, 0.0), reference.colors(g, CAMERA), atol=2e-5)


def test_depth_keys_compare_like_depths(ti_cpu):
    """Also below zero: an eye may see what lies behind the other; and they leave room for the number of pairs."""
    ti = ti_cpu
    from render.projection import DEPTH_BITS, depth_key

    values = np.geomspace(0.5, 1.9e6, 2000) - 1
    values = np.r_[-9, np.sort(np.r_[values, values + 2e-6 * (1 + values)]), 3e6].astype(np.float32)
    keys = np.zeros(len(values), np.uint32)

    @ti.kernel
    def fill(values: ti.types.ndarray(ti.f32, ndim=1), keys: ti.types.ndarray(ti.u32, ndim=1)):
        for i in keys:
            keys[i] = depth_key(values[i])

    fill(values, keys)
    assert (np.diff(keys[1:].astype(np.int64)) > 0).all() and keys[0] == 0 and keys[-1] < 1 << DEPTH_BITS
