"""Candidates side by side: each moves as a body alone does."""

import numpy as np
import pytest

from core.errors import BadInput
from core.material import Material
from core.tetmesh import boundary_surface
from core.vocabulary import Plane
from sim.bodies import SoftBody
from sim.rollouts import Candidate, Rollouts, level_direction, of_pair
from sim.solver import Solver
from tests.support.samples import tet_bar

X, TETS = tet_bar((3, 1, 1), (0.3, 0.1, 0.1))
X = X.astype(np.float64)
HELD = np.flatnonzero(X[:, 0] < 1e-6)
TIMES = np.arange(10) / 50
SOFT, STIFF = Material(2e4, 0.3, 300.0, 0.2), Material(2e5, 0.3, 300.0, 0.6, damping=0.5)
SLOPE = np.array([[0.6, 0.8, 0.0, 0.0]])  # a block slides on it below a friction of 0.75


def alone(material, x, v, floors=(), held=None):
    body = SoftBody("alone", X, TETS, boundary_surface(TETS), material, pinned=held)
    solver = Solver([body], floors, contacts=bool(floors), self_contact=False, sleep=False, integrator="vbd", hands=0)
    solver.restore({"x": x, "v": v})
    found = []
    for k in range(len(TIMES)):
        if k:
            for _ in range(2):
                solver.step((TIMES[k] - TIMES[k - 1]) / 2)
        q = solver.snapshot()
        found.append(q["x"].astype(np.float64) + q["x_lo"])
    return np.stack(found)


def test_each_candidate_moves_as_a_body_alone(ti_cpu):
    v = np.zeros_like(X)
    v[:, 2] = np.where(X[:, 0] < 1e-6, 0.0, 0.5)
    rollouts = Rollouts(X, TETS, HELD, 5)
    for materials in ((SOFT, STIFF, SOFT), (STIFF,)):  # fewer than fit, and fewer again
        found = rollouts.run([Candidate(m, X, v) for m in materials], TIMES, lambda x: x)
        assert found.shape == (10, len(materials), len(X), 3)
        for k, m in enumerate(materials):
            np.testing.assert_allclose(found[:, k], alone(m, X, v, held=HELD), atol=2e-6)
    assert np.abs(found[:, 0, HELD] - X[HELD]).max() == 0
    other = np.flatnonzero(X[:, 0] > 0.3 - 1e-6)
    rollouts.hold(other)
    found = rollouts.run([Candidate(SOFT, X, 0 * X)], TIMES, lambda x: x)
    np.testing.assert_allclose(found[:, 0], alone(SOFT, X, 0 * X, held=other), atol=2e-6)
    with pytest.raises(BadInput, match="6 candidates, where up to 5 fit"):
        rollouts.run([Candidate(SOFT, X, v)] * 6, TIMES, lambda x: x)
    rollouts.destroy()


def test_the_held_part_is_let_go_in_time(ti_cpu):
    """Before, it stands; after, the centre of mass falls freely."""
    rollouts = Rollouts(X, TETS, HELD, 1)
    release = 0.07  # between two times
    found = rollouts.run([Candidate(STIFF, X, 0 * X)], TIMES, lambda x: x, release)[:, 0]
    held = release >= TIMES
    assert np.abs(found[held][:, HELD] - X[HELD]).max() == 0
    mass = SoftBody("bar", X, TETS, boundary_surface(TETS), STIFF).masses()
    height = (found[~held] @ [0, 1.0, 0]) @ mass / mass.sum()
    np.testing.assert_allclose(np.diff(height, 2), -9.81 * 0.02**2, rtol=0.02)
    rollouts.destroy()


def test_candidates_slide_by_their_own_friction(ti_cpu):
    """Down a slope of 36.9 degrees: a = g (0.6 - mu 0.8); the pair's friction is the candidate's, not its root."""
    turn = np.array([[0.8, 0.6, 0.0], [-0.6, 0.8, 0.0], [0.0, 0.0, 1.0]])
    x = (X - X.mean(0)) @ turn.T + np.array([0.6, 0.8, 0.0]) * 0.0505
    stiff = [Material(3e5, 0.3, 300.0, mu, damping=5.0) for mu in (0.2, 0.5)]
    rollouts = Rollouts(X, TETS, np.zeros(0, int), 2, planes=SLOPE, apart=1.0)
    times = np.arange(0, 0.5, 0.05)
    way = rollouts.run([Candidate(m, x, 0 * x) for m in stiff], times, lambda x: x.mean(1) @ [0.8, -0.6, 0.0])
    acceleration = np.polyfit(times[2:], way[2:], 2)[0] * 2
    np.testing.assert_allclose(acceleration, 9.81 * (0.6 - 0.8 * np.array([0.2, 0.5])), rtol=0.03)
    floor = [Plane((0.0, 0.0, 0.0), (0.6, 0.8, 0.0), friction=1.0)]
    np.testing.assert_allclose(
        rollouts.run([Candidate(stiff[1], x, 0 * x)], TIMES, lambda x: x)[:, 0],
        alone(of_pair(stiff[1]), x, 0 * x, floor),
        atol=1e-4,
    )
    rollouts.destroy()


def test_candidates_stand_along_all_planes_and_a_corner_has_no_room():
    direction = level_direction(SLOPE, (0, -9.81, 0))
    np.testing.assert_allclose(np.abs(direction), [0, 0, 1], atol=1e-12)
    wall = np.array([[0.6, 0.8, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0]])
    np.testing.assert_allclose(wall[:, :3] @ level_direction(wall, (0, -9.81, 0)), 0, atol=1e-12)
    with pytest.raises(BadInput, match="no room for candidates side by side"):
        level_direction(np.eye(3, 4), (0, -9.81, 0))
