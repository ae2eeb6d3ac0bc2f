"""Relaxing a cage: kernels against their twin, longer substeps, better angles, the wished volume."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from core.tetmesh import tet_volumes
from prepare.cage.mesh_quality import QualityEnergy, dihedral_angles
from prepare.cage.relaxation import Descent, lift_slivers, min_angles, relax
from prepare.cage.stuffing import stuff
from tests.support.distance_shapes import bumpy, sampled, sphere, torus, uniform_lattice
from tests.support.reference_quality import energy


def stuffed(distance, cell: float):
    grid = sampled(distance)
    return stuff(uniform_lattice(grid, cell), grid), grid


def relaxed(cage, grid, volume: float):
    return relax(cage, Descent(cage.tets, len(cage.vertices), grid), volume)


def test_the_gradient_of_the_twin_is_right():
    """Central differences on two tets that share a face; 1e-6 steps leave nine digits."""
    rng = np.random.default_rng(0)
    x, tets = rng.normal(size=(5, 3)), np.array([[0, 1, 2, 3], [1, 2, 3, 4]])
    wrong = tet_volumes(x, tets) < 0
    tets[wrong] = tets[wrong][:, [0, 1, 3, 2]]
    _, gradient, _ = energy(x, tets, 5.0)
    numeric = np.zeros_like(gradient)
    for i in np.ndindex(x.shape):
        step = np.zeros_like(x)
        step[i] = 1e-6
        numeric[i] = (energy(x + step, tets, 5.0)[0] - energy(x - step, tets, 5.0)[0]) / 2e-6
    assert_allclose(gradient, numeric, atol=1e-7 * np.abs(numeric).max())


@pytest.mark.parametrize("distance, cell", [(torus, 0.2), (lambda p: bumpy(p, 1), 0.25)])
def test_relaxing_makes_longer_substeps_stable_and_keeps_the_shape(ti_cpu, distance, cell):
    before, grid = stuffed(distance, cell)
    volume = before.volumes().sum()
    after = relaxed(before, grid, volume)
    after.check("relaxed")
    longer = np.sqrt(energy(before.vertices, before.tets)[2].max() / energy(after.vertices, after.tets)[2].max())
    assert longer > 1.5  # of the substep; measured 1.9 to 2.6
    assert dihedral_angles(after.vertices, after.tets).min() >= 12
    assert_allclose(after.volumes().sum(), volume, rtol=0.02)


def test_the_kernels_agree_with_the_twin(ti_cpu):
    """Both in float64; only the order of sums differs."""
    cage, _ = stuffed(torus, 0.25)
    x = cage.vertices.astype(np.float64)
    kernels = QualityEnergy(cage.tets, len(x))
    gradient = kernels.vectors()
    for unit in (1.0, 300.0):
        value, (twin, by_twin, of_twin) = kernels.energy(kernels.vectors(x), gradient, unit), energy(x, cage.tets, unit)
        assert_allclose(value, twin, rtol=1e-11)
        assert_allclose(gradient.to_numpy(), by_twin, atol=1e-11 * np.abs(by_twin).max())
        assert_allclose(kernels.kappa.to_numpy(), of_twin, rtol=1e-11)
    x[cage.tets[0, 0]] = x[cage.tets[0, 1]] + 10  # inverted
    assert kernels.energy(kernels.vectors(x), gradient, 1.0) == np.inf


@pytest.mark.parametrize("growth", [-0.02, 0.03])
def test_a_cage_gets_the_volume_asked_for(ti_cpu, growth):
    cage, grid = stuffed(sphere, 0.25)
    wanted = (1 + growth) * 4 / 3 * np.pi
    after = relaxed(cage, grid, wanted)
    after.check("grown")
    assert_allclose(after.volumes().sum(), wanted, rtol=0.003)
    radius = np.linalg.norm(after.vertices[np.unique(after.surface)], axis=1)
    assert np.ptp(radius) < 0.01  # it grew evenly


def test_slivers_are_lifted_and_the_surface_stays():
    cage, grid = stuffed(sphere, 0.25)
    x, outer = cage.vertices.astype(np.float64), np.unique(cage.surface)
    level = grid.sample(x[outer])
    inner = np.setdiff1d(cage.tets, outer)[:30]
    bad = x.copy()
    bad[inner] += np.random.default_rng(0).normal(0, 0.05, (len(inner), 3))
    assert tet_volumes(bad, cage.tets).min() > 0
    before = dihedral_angles(bad, cage.tets).min()
    after = lift_slivers(bad, cage.tets, grid, outer, level, np.full(len(x), 0.25))
    assert before < 10 and dihedral_angles(after, cage.tets).min() > 12
    assert np.abs(grid.sample(after[outer]) - level).max() < 0.002
    assert_allclose(min_angles(after[cage.tets]), dihedral_angles(after, cage.tets).min(1), atol=1e-6)
