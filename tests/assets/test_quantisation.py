"""Version 2 of the asset file: losses as stated, small files, every defect named."""

from dataclasses import replace

import h5py
import numpy as np
import pytest

from assets.asset import Asset, Cage, CageEmbedding
from assets.environment import Environment
from core.distance_grid import DistanceGrid
from core.rotation import matrices_from_quaternions
from core.tetmesh import box_mesh
from tests.assets.test_asset import edited, put, refused
from tests.support.samples import FIELDS, some_gaussians

CORNERS = np.array([[1.0, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]])


def bar(cells: int = 6) -> Cage:
    """Cubes of 0.1 m along x, of six tets each."""
    vertices, tets, surface = box_mesh((0.1 * cells, 0.1, 0.1), (cells, 1, 1))
    return Cage(vertices.astype(np.float32), tets.astype(np.int32), surface.astype(np.int32))


def weights_in(cage: Cage, host, points) -> np.ndarray:
    """Barycentric weights (N, 4) by solving for them."""
    x = cage.vertices.astype(np.float64)[cage.tets[host]]
    system = np.concatenate([np.moveaxis(x, 1, 2), np.ones((len(x), 1, 4))], 1)
    return np.linalg.solve(system, np.concatenate([points, np.ones((len(x), 1))], 1)[..., None])[..., 0]


def embedded(n: int = 700, exact: int = 5) -> Asset:
    """Gaussians in a bar, local tetrahedra about them; those of the first `exact` are of another shape."""
    rng = np.random.default_rng(3)
    cage = bar()
    g = some_gaussians(n, 0)
    means = rng.uniform((0.02, 0.02, 0.02), (0.58, 0.08, 0.08), (n, 3)).astype(np.float32)
    g = replace(g, means=means, log_scales=np.log(rng.uniform(0.001, 0.01, (n, 3))).astype(np.float32))
    axes = matrices_from_quaternions(g.quats)
    half = rng.uniform(0.005, 0.02, (n, 3))
    corners = means[:, None] + np.einsum("nci,ni,nji,kj->nkc", axes, half, axes, np.sqrt(3) * CORNERS)
    corners[:exact] += 0.02
    host = rng.integers(0, len(cage.tets), (n, 4))
    weights = weights_in(cage, host.ravel(), corners.reshape(-1, 3)).reshape(n, 4, 4)
    embedding = CageEmbedding(host.astype(np.int32), weights.astype(np.float32))
    axis = np.linspace(-0.4, 0.4, 17)
    distance = np.linalg.norm(np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), -1), axis=-1) - 0.3
    grid = DistanceGrid(distance.astype(np.float16), np.full(3, -0.4), 0.05)
    return Asset(g, cage, embedding, grid, environment=Environment(0.0, (0, 0, 0), (0, 1, 0), 1.0, (), (grid,)))


def stored(asset: Asset, path) -> Asset:
    asset.save(path, quantised=True)
    return Asset.load(path)


@pytest.mark.parametrize("degree", range(4))
def test_losses_are_as_stated(tmp_path, degree):
    g = some_gaussians(1000, degree)
    read = stored(Asset(g), tmp_path / "a.h5").gaussians
    np.testing.assert_array_equal(read.object_id, g.object_id)
    width = np.sort(np.exp(g.log_scales), axis=1)[:, 1]
    smallest = np.array([width[i : i + 256].min() for i in range(0, 1000, 256)])
    assert (np.abs(read.means - g.means).max(1) <= np.repeat(smallest, 256)[:1000] / 32 * (1 + 1e-5)).all()
    apart = 2 * np.arccos(np.abs((read.quats.astype(float) * g.quats).sum(1)).clip(0, 1))
    assert apart.max() < 5e-3
    for name, error in (("log_scales", 1 / 128), ("logit_opacities", 1 / 64), ("sh", 1 / 256)):
        assert np.abs(getattr(read, name) - getattr(g, name)).max() <= error * (1 + 1e-5)
    for name in FIELDS:
        assert getattr(read, name).dtype == np.float32


def test_distant_and_tiny_gaussians_keep_the_precision_of_float32(tmp_path):
    g = some_gaussians(300, 0)
    scales = np.linspace(-300, 39, 900).reshape(300, 3).astype(np.float32)
    g = replace(g, means=g.means * np.float32(1e14), log_scales=scales, sh=g.sh * np.float32(1e14))
    read = stored(Asset(g), tmp_path / "a.h5").gaussians
    assert np.abs(read.means - g.means).max() <= np.abs(g.means).max() / 2**23
    np.testing.assert_allclose(read.log_scales, scales, atol=0.01)
    np.testing.assert_allclose(read.sh, g.sh, rtol=1e-6, atol=0.01)


def test_weights_are_made_again(tmp_path):
    asset = embedded()
    read = stored(asset, tmp_path / "a.h5")
    np.testing.assert_array_equal(read.embedding.host, asset.embedding.host)
    np.testing.assert_array_equal(read.embedding.weights[:5], asset.embedding.weights[:5])  # stored as they were
    x = asset.cage.vertices.astype(float)[asset.cage.tets[asset.embedding.host]]
    corners = [np.einsum("nkj,nkjc->nkc", a.embedding.weights.astype(float), x)[5:] for a in (asset, read)]
    centres = [c.mean(1) for c in corners]
    moved = (read.gaussians.means - asset.gaussians.means)[5:]
    np.testing.assert_allclose(centres[1] - centres[0], moved, atol=1e-6)
    shape = [c - m[:, None] for c, m in zip(corners, centres, strict=True)]
    size = np.abs(shape[0]).max((1, 2))
    assert (np.abs(shape[1] - shape[0]).max((1, 2)) < 0.03 * size).all()
    with h5py.File(tmp_path / "a.h5") as file:
        np.testing.assert_array_equal(file["embedding/exact"][()], range(5))


def test_distances_are_within_a_128th_of_the_spacing(tmp_path):
    asset = embedded()
    read = stored(asset, tmp_path / "a.h5")
    for grid in read.grids:
        assert grid.values.dtype == np.float16 and grid.spacing == 0.05
        error = np.abs(grid.values.astype(float) - asset.sdf.values.astype(float))
        assert (error <= 0.05 / 128 + np.spacing(np.abs(grid.values)).astype(float)).all()
        np.testing.assert_array_equal(grid.origin, asset.sdf.origin)


def test_a_second_time_nothing_is_lost(tmp_path):
    once = stored(embedded(), tmp_path / "a.h5")
    twice = stored(once, tmp_path / "b.h5")
    for name in FIELDS:
        np.testing.assert_allclose(getattr(twice.gaussians, name), getattr(once.gaussians, name), atol=2e-3)
    np.testing.assert_array_equal(twice.sdf.values, once.sdf.values)


def test_a_flat_gaussian_takes_no_more_than_17_bytes_unpacked_and_the_file_is_small(tmp_path):
    """Random numbers, which do not compress: surfaces take less."""
    asset = Asset(some_gaussians(5000, 0))
    asset.save(tmp_path / "a.h5")
    asset.save(tmp_path / "b.h5", quantised=True)
    large, small = ((tmp_path / name).stat().st_size for name in ("a.h5", "b.h5"))
    assert small < 0.5 * large


DEFECTS = {
    "missing dataset 'gaussians/block_low'": lambda f: f.pop("gaussians/block_low"),
    "block_low has shape (2, 3), expected (3, 3)": put("gaussians/block_low", np.zeros((2, 3), int)),
    "a step of gaussians/block_step is not positive": put("gaussians/block_step", np.array([1.0, 0.0, 1.0])),
    "block_step is not positive": put("gaussians/block_step", np.array([1.0, np.nan, 1.0])),
    "gaussians/means holds float32": put("gaussians/means", np.zeros((700, 3), np.float32)),
    "188 of 700 Gaussians are not finite": put("gaussians/block_step", np.array([1.0, 1.0, 1e300])),
    "the step of gaussians/sh is not positive": lambda f: f["gaussians/sh"].attrs.update(step=-1.0),
    "missing attribute 'step' of gaussians/logit_opacities": lambda f: f["gaussians/logit_opacities"].attrs.pop("step"),
    "sh has shape (700, 2, 3)": put("gaussians/sh", np.zeros((700, 2, 3), np.int8)),
    "gaussians/quats holds an index out of range": put("gaussians/quats", np.full(700, -1)),
    "700 of 700 Gaussians are not finite": put("gaussians/log_scales", np.full((700, 3), 99 * 64)),
    "names a tet outside 0..35": put("embedding/host", np.full((700, 4), 36)),
    "embedding/host has shape (3, 4)": put("embedding/host", np.zeros((3, 4), int)),
    "embedding/half_axes has shape (700, 2)": put("embedding/half_axes", np.zeros((700, 2), np.int8)),
    "the step of embedding/half_axes is not positive": lambda f: f["embedding/half_axes"].attrs.update(step=0.0),
    "an embedding weight is not finite": put("embedding/half_axes", np.full((700, 3), 1 << 40)),
    "embedding/exact does not name": put("embedding/exact", np.array([0, 1, 2, 2, 3])),
    "exact does not name Gaussians in order": put("embedding/exact", np.array([0, 1, 2, 3, 700])),
    "embedding/exact_weights has shape (5, 4, 3)": put("embedding/exact_weights", np.zeros((5, 4, 3))),
    "the step of sdf/values is not positive": lambda f: f["sdf/values"].attrs.update(step=0.0),
    "sdf/values holds float32": put("sdf/values", np.zeros((3, 3, 3), np.float32)),
    "signed distance is not finite": put("sdf/values", np.full((9, 9, 9), 1 << 50)),
    "the step of stage/fine0 is not positive": lambda f: f["stage/fine0"].attrs.update(step=np.inf),
}


@pytest.mark.parametrize("defect", DEFECTS)
def test_each_defect_is_named(tmp_path, defect):
    assert defect in refused(edited(tmp_path, DEFECTS[defect], embedded(), quantised=True))
