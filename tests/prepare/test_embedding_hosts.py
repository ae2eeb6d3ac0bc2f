"""Point location in a cage, and the offline half of the two-level embedding."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from core.point_location import TetLocator
from core.rotation import matrices_from_quaternions
from prepare.cage.embedding_hosts import embed, fraction_inside
from tests.support.samples import random_gaussians, tet_bar

BAR = tet_bar((10, 2, 2), (1.0, 0.2, 0.2))
CORNERS = np.sqrt(3.0) * np.array([[1.0, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]])
MAX_WEIGHT = 3.0


def brute_weights(vertices, tets, points):
    """Barycentric weights of all points in all tets, (M, T, 4)."""
    x = vertices.astype(float)[tets]
    last = np.einsum("tij,mtj->mti", np.linalg.inv(np.moveaxis(x[:, 1:] - x[:, :1], 1, 2)), points[:, None] - x[:, 0])
    return np.concatenate([1 - last.sum(2, keepdims=True), last], 2)


def check_location(vertices, tets, rng):
    low, high = vertices.min(0), vertices.max(0)
    points = rng.uniform(low - 0.1 * (high - low), high + 0.1 * (high - low), (400, 3))
    locator = TetLocator(vertices, tets)
    host = locator.find(points)
    weights = brute_weights(vertices, tets, points)
    best = weights.min(2).max(1)
    assert (host[best > 1e-9] >= 0).all() and (host[best < -1e-6] < 0).all()
    held = np.flatnonzero(host >= 0)
    assert len(held) > 10 and len(held) < len(points)
    assert (weights[held, host[held]].min(1) >= -1e-6).all()
    assert_allclose(locator.weights(host[held], points[held]), weights[held, host[held]], atol=1e-6)
    return points, host


def test_the_grid_finds_what_a_search_of_all_tets_finds():
    check_location(*BAR, np.random.default_rng(0))


@pytest.mark.parametrize("name", ["torus_low_res_sofa", "bear_newton", "armadillo_4k_pbd"])
def test_the_grid_finds_hosts_in_unstructured_cages(shared, name):
    with np.load(shared / "data" / "tets" / f"{name}.npz") as file:
        arrays = {k: file[k] for k in file.files}
    vertices = next(a for a in arrays.values() if a.ndim == 2 and a.shape[1] == 3 and a.dtype.kind == "f")
    tets = next(a for a in arrays.values() if a.ndim == 2 and a.shape[1] == 4 and a.dtype.kind in "iu").astype(int)
    check_location(vertices.astype(float), tets, np.random.default_rng(1))


def test_the_nearest_boundary_is_found():
    """The distance to a box is known; a face has a sample of the boundary within 2 cm."""
    locator = TetLocator(*BAR)
    points = np.random.default_rng(2).uniform([-0.3, -0.3, -0.3], [1.3, 0.5, 0.5], (500, 3))
    points = points[locator.find(points) < 0]
    host, foot = locator.nearest(points)
    true = np.linalg.norm(points - points.clip(0, [1, 0.2, 0.2]), axis=1)
    found = np.linalg.norm(points - foot, axis=1)
    assert (found >= true - 1e-6).all() and (found <= true + 0.02).all()
    weights = locator.weights(host, foot)
    assert weights.min() > -1e-6  # the tet next to it has the foot on its face
    assert_allclose(weights.min(1), 0, atol=1e-6)


def corners_of(embedded, vertices, tets):
    return np.einsum("nkj,nkjc->nkc", embedded.weights.astype(float), vertices.astype(float)[tets[embedded.host]])


def embedded_in_bar(g, **options):
    return embed(g.means, g.quats, np.exp(g.log_scales), *BAR, **options)


def test_the_paper_s_local_tetrahedron_surrounds_the_ellipsoid():
    """floor=0: the corners are the affine image of a regular tetrahedron round the k-sigma ellipsoid."""
    g = random_gaussians(np.random.default_rng(3), 300, low=(0.1, 0.08, 0.08), high=(0.9, 0.12, 0.12), sigma=0.005)
    k = 1.5
    y = corners_of(embedded_in_bar(g, k=k, floor=0), *BAR)
    assert_allclose(y.mean(1), g.means, atol=1e-6)
    A = matrices_from_quaternions(g.quats) * np.exp(g.log_scales.astype(float))[:, None]
    round_ = np.einsum("nij,nkj->nki", np.linalg.inv(A), y - g.means[:, None])  # the ellipsoid's sphere of radius k
    assert_allclose(np.linalg.norm(round_, axis=2), 3 * k, rtol=1e-3)
    for face in range(4):  # regular: the insphere has a third of the circumsphere's radius
        assert_allclose(np.linalg.norm(np.delete(round_, face, 1).mean(1), axis=1), k, rtol=1e-3)


def test_corners_keep_to_the_floor_and_to_one_frame():
    """Tiny and flat Gaussians take the same regular tetrahedron, however they are turned."""
    g = random_gaussians(np.random.default_rng(4), 200, low=(0.2, 0.09, 0.09), high=(0.8, 0.11, 0.11), sigma=1e-5)
    y = corners_of(embedded_in_bar(g, floor=0.1), *BAR)
    edge = 0.1 * 2 ** (1 / 6)  # the regular tet of a sixth of the cell's volume
    assert_allclose(y - g.means[:, None], np.tile(0.1 * edge * CORNERS, (200, 1, 1)), atol=1e-5)


def test_weights_are_bounded_wherever_gaussians_are():
    """Far floaters, huge ones, ones of no thickness: bounded weights, no flat local tetrahedron."""
    rng = np.random.default_rng(5)
    g = random_gaussians(rng, 2000, low=(-3, -3, -3), high=(3, 3, 3), sigma=0.05, spread=2.0)
    e = embedded_in_bar(g)
    assert e.host.dtype == np.int32 and e.weights.dtype == np.float32
    assert np.isfinite(e.weights).all() and np.abs(e.weights).max() <= MAX_WEIGHT + 1
    assert_allclose(e.weights.sum(2), 1, atol=2e-6)
    y = corners_of(e, *BAR)
    D = y[:, 1:] - y[:, :1]
    assert (np.abs(np.linalg.det(D)) > 5e-4 * np.linalg.norm(D, axis=2).max(1) ** 3).all()


def test_centroids_are_pulled_in_only_far_outside():
    """Within 5 cm, half a tet, the weights need no bound: the centroid is the mean."""
    g = random_gaussians(np.random.default_rng(7), 500, low=(-0.05, -0.05, -0.05), high=(1.05, 0.25, 0.25), spread=2.0)
    assert_allclose(corners_of(embedded_in_bar(g), *BAR).mean(1), g.means, atol=1e-6)


def test_a_gaussian_outside_follows_one_tet():
    """Corners torn apart over the gaps between extended tets would leave it a wild F."""
    g = random_gaussians(np.random.default_rng(6), 500, low=(0, 0.26, 0), high=(1, 0.28, 0.2), sigma=1e-3, spread=0)
    host = embedded_in_bar(g, floor=0.01).host
    assert (host == host[:, :1]).all()


def test_nothing_to_embed_is_no_error():
    none = embed(np.zeros((0, 3)), np.zeros((0, 4)), np.zeros((0, 3)), *BAR)
    assert none.host.shape == (0, 4) and none.weights.shape == (0, 4, 4)


def test_the_fraction_inside_is_that_of_the_points_in_a_tet():
    points = np.random.default_rng(9).uniform((-0.2, -0.1, -0.1), (1.2, 0.3, 0.3), (3000, 3))
    inside = ((points >= 0) & (points <= [1, 0.2, 0.2])).all(1)
    assert fraction_inside(*BAR, points) == pytest.approx(inside.mean(), abs=1e-3)
    assert fraction_inside(*BAR, points[:0]) == 1.0
