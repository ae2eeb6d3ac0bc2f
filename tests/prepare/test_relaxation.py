"""Relaxing a cage: its energy, longer substeps, better angles, the wished volume."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from core.tetmesh import tet_volumes
from prepare.cage.mesh_quality import dihedral_angles, quality_energy
from prepare.cage.relaxation import lift_slivers, min_angles, relax
from prepare.cage.stuffing import stuff
from tests.support.distance_shapes import bumpy, sampled, sphere, torus, uniform_lattice


def stuffed(distance, cell: float):
    grid = sampled(distance)
    return stuff(uniform_lattice(grid, cell), grid), grid


@pytest.fixture
def two_tets():
    """Vertices and tets of two tets that share a face."""
    x, tets = np.random.default_rng(0).normal(size=(5, 3)), np.array([[0, 1, 2, 3], [1, 2, 3, 4]])
    wrong = tet_volumes(x, tets) < 0
    tets[wrong] = tets[wrong][:, [0, 1, 3, 2]]
    return x, tets


def test_the_energy_is_that_of_its_definition(two_tets):
    """sum_t (kappa_t W^(2/3) / unit)^8 + (2 q_t / q of a regular tet)^8; infinite where a tet is inverted."""
    x, tets = two_tets
    volume = tet_volumes(x, tets)
    mass = [sum(volume[(tets == v).any(1)]) / 4 for v in range(5)]
    total = 0.0
    for tet, v in zip(tets, volume, strict=True):
        kappa, square = 0.0, sum(((x[a] - x[b]) ** 2).sum() for i, a in enumerate(tet) for b in tet[:i])
        for a in tet:
            p, q, r = x[[b for b in tet if b != a]]
            kappa += (np.linalg.norm(np.cross(q - p, r - p)) / 2) ** 2 / (9 * v * mass[a])
        total += (kappa * volume.sum() ** (2 / 3) / 5.0) ** 8 + (2 * square**1.5 / v / (6**1.5 * 6 * 2**0.5)) ** 8
    assert_allclose(quality_energy(x, tets, 5.0)[0], total, rtol=1e-10)
    assert quality_energy(x, tets[:, [1, 0, 2, 3]], 1.0)[0] == np.inf


def test_the_gradient_is_that_of_the_energy(two_tets):
    """Central differences; 1e-6 steps leave nine digits."""
    x, tets = two_tets
    numeric = np.zeros_like(x)
    for i in np.ndindex(x.shape):
        step = np.zeros_like(x)
        step[i] = 1e-6
        numeric[i] = (quality_energy(x + step, tets, 5.0)[0] - quality_energy(x - step, tets, 5.0)[0]) / 2e-6
    assert_allclose(quality_energy(x, tets, 5.0)[1], numeric, atol=1e-7 * np.abs(numeric).max())


@pytest.mark.parametrize("distance, cell", [(torus, 0.2), (lambda p: bumpy(p, 1), 0.25)])
def test_relaxing_makes_longer_substeps_stable_and_keeps_the_shape(distance, cell):
    before, grid = stuffed(distance, cell)
    volume = before.volumes().sum()
    after = relax(before, grid, volume)
    after.check("relaxed")
    stiffest = [quality_energy(c.vertices.astype(float), c.tets, 1.0)[2].max() for c in (before, after)]
    longer = np.sqrt(stiffest[0] / stiffest[1])
    assert longer > 1.5  # of the substep; measured 1.9 to 2.6
    assert dihedral_angles(after.vertices, after.tets).min() >= 12
    assert_allclose(after.volumes().sum(), volume, rtol=0.02)


@pytest.mark.parametrize("growth", [-0.02, 0.03])
def test_a_cage_gets_the_volume_asked_for(growth):
    cage, grid = stuffed(sphere, 0.25)
    wanted = (1 + growth) * 4 / 3 * np.pi
    after = relax(cage, grid, wanted)
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
