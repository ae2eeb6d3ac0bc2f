"""Rigid editing: a body follows one hand rigidly, or two hands with its size, and is then rescaled."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from bench.physics import box
from core.material import Material
from core.vocabulary import Hand
from sim.bodies import SoftBody
from sim.hands.rigid_editing import MAX_SCALE, MIN_SCALE
from tests.support.soft_world import soft_solver

SOFT = Material(young=5e4, poisson=0.3, density=1000.0, friction=0.6)
DT, SIDE = 1 / 60, 0.06
X, TETS, SURFACE = box((SIDE,) * 3, (3, 3, 3))
BESIDE = SIDE / 2 + 0.005
QUARTER_TURN_Z = (np.cos(np.pi / 4), 0.0, 0.0, np.sin(np.pi / 4))  # y -> -x


@pytest.fixture(scope="module")
def solver(ti_cpu):
    """Two cubes on the floor, in the hands of an editor."""
    cubes = [SoftBody(f"cube{k}", X - SIDE / 2, TETS, SURFACE, SOFT, position=(0.2 * k, SIDE / 2, 0)) for k in range(2)]
    return soft_solver(cubes, interaction="transform")


@pytest.fixture(autouse=True)
def begin(solver):
    solver.reset()
    if (size := np.ptp(solver.x.to_numpy()[: len(X), 0])) != SIDE:
        solver.rescale(0, SIDE / size)
    solver.reset()
    solver.interaction = "transform"


def hold(solver, left, right, grips=(True, True)):
    """One frame with the hands at these places; where the first cube is then."""
    hands = [Hand(tuple(p), grip=g, reach=0.02) for p, g in zip((left, right), grips, strict=True)]
    solver.step(DT, hands)
    return solver.x.to_numpy()[: len(X)]


def gripped(solver):
    """Both hands on the sides of the first cube."""
    a, b = np.array([-BESIDE, SIDE / 2, 0]), np.array([BESIDE, SIDE / 2, 0])
    hold(solver, a, b, (False, False))
    x = hold(solver, a, b)
    assert solver.contacts.hands.grasped_bodies()[:2] == [0, 0]
    return a, b, x


def test_a_body_follows_one_hand_rigidly_and_nothing_else_moves(solver):
    at, idle = np.array([BESIDE, SIDE / 2, 0.0]), Hand(position=(9.0, 9.0, 9.0))
    hold(solver, at, idle.position, (False, False))
    start = solver.snapshot()["x"].astype(np.float64)
    hold(solver, at, idle.position, (True, False))
    assert [b.held for b in solver.bodies()] == [True, False]
    for _ in range(3):
        solver.step(DT, [Hand((0.4, 0.3, 0.2), QUARTER_TURN_Z, grip=True), idle])
    turn = np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1]])
    x = solver.snapshot()["x"]
    assert_allclose(x[: len(X)], (start[: len(X)] - at) @ turn.T + [0.4, 0.3, 0.2], atol=1e-6)
    assert_array_equal(x[len(X) :], start[len(X) :].astype(np.float32))
    solver.step(DT, [Hand((0.0, 0.0, 0.0)), idle])
    assert_array_equal(solver.snapshot()["x"], x)
    assert not any(b.held for b in solver.bodies())
    solver.interaction = "physics"
    solver.step(DT)
    assert solver.bodies()[0].velocity[1] == pytest.approx(-9.81 * DT, rel=1e-3)


def test_a_second_hand_too_near_the_first_to_scale_leaves_it_in_the_first(solver):
    at, aside = np.array([BESIDE, SIDE / 2, 0.0]), np.array([9.0, 9.0, 9.0])
    hold(solver, at, aside, (False, False))
    start = hold(solver, at, aside, (True, False))
    at = at + [0.0, 0.1, 0.0]
    hold(solver, at, at + [0, 0.01, 0], (True, False))
    hold(solver, at, at + [0, 0.01, 0])
    assert solver.contacts.hands.grasped_bodies()[:2] == [0, 0]
    after = hold(solver, at + [0.0, 0.1, 0.0], at + [0, 0.11, 0])
    assert_allclose(after, start + [0.0, 0.2, 0.0], atol=1e-6)


def test_a_body_grows_with_the_distance_of_two_hands_about_their_middle(solver):
    a, b, x = gripped(solver)
    after = hold(solver, 1.5 * (a - [0, SIDE / 2, 0]) + [0, 0.1, 0], 1.5 * (b - [0, SIDE / 2, 0]) + [0, 0.1, 0])
    assert_allclose(after, 1.5 * (x - [0, SIDE / 2, 0]) + [0, 0.1, 0], atol=1e-6)
    assert solver.take_scaling() is None  # not yet
    other = solver.x.to_numpy()[len(X) : 2 * len(X)]
    assert_allclose(other.mean(0), [0.2, SIDE / 2, 0], atol=1e-3)


def test_it_turns_with_the_line_between_them(solver):
    a, b, x = gripped(solver)
    m = 0.5 * (a + b)
    after = hold(solver, m + [0, -BESIDE, 0], m + [0, BESIDE, 0])
    r = x - m
    assert_allclose(after, m + np.stack([-r[:, 1], r[:, 0], r[:, 2]], 1), atol=1e-6)


@pytest.mark.parametrize("keeps", [(False, False), (True, False)])
def test_the_rescaled_body_is_where_the_preview_was(solver, keeps):
    """About its foot if both hands let go, about its centre of mass if one holds on."""
    a, b, x = gripped(solver)
    seen = hold(solver, a + [-0.02, 0.05, 0.01], b + [0.03, 0.05, 0.0])
    after = hold(solver, a + [-0.02, 0.05, 0.01], b + [0.03, 0.05, 0.0], keeps)
    edge = lambda p: np.linalg.norm(p[1] - p[0]) / np.linalg.norm(x[1] - x[0])  # noqa: E731
    assert_allclose(edge(after), 1.0, atol=1e-4)  # its own size
    body, factor = solver.take_scaling()
    assert body == 0 and solver.take_scaling() is None
    assert_allclose(factor, edge(seen), rtol=1e-4)
    stay = after.mean(0) if keeps[0] else np.array([after[:, 0].mean(), after[:, 1].min(), after[:, 2].mean()])
    solver.rescale(body, factor, about=stay)
    assert_allclose(solver.x.to_numpy()[: len(X)], seen, atol=2e-4)


def test_a_body_that_both_hands_let_go_is_observed_at_its_own_size(solver):
    a, b, _ = gripped(solver)
    hold(solver, a - [0.05, 0, 0], b)
    wide = solver.observe().bodies[0]
    after = hold(solver, a - [0.05, 0, 0], b, (False, False))
    seen = solver.observe().bodies[0]
    assert wide.held and not seen.held
    assert_allclose([seen.low, seen.high], [after.min(0), after.max(0)], atol=1e-6)


def test_a_trembling_hand_rescales_nothing(solver):
    a, b, _ = gripped(solver)
    hold(solver, a - [0.0003, 0, 0], b)
    hold(solver, a, b, (False, False))
    assert solver.take_scaling() is None


def test_sizes_are_bounded(solver):
    a, b, _ = gripped(solver)
    wide = hold(solver, a - [0.9, 0, 0], b)
    assert_allclose(np.ptp(wide[:, 0]), MAX_SCALE * SIDE, rtol=1e-3)
    narrow = hold(solver, b, b)
    assert_allclose(np.ptp(narrow, axis=0).max(), MIN_SCALE * SIDE, rtol=0.01)
    assert np.isfinite(narrow).all()


def test_physics_never_sees_a_preview(solver):
    a, b, _ = gripped(solver)
    hold(solver, a - [0.05, 0, 0], b)
    solver.interaction = "physics"
    x = hold(solver, a - [0.05, 0, 0], b, (False, False))
    assert_allclose(np.ptp(x, axis=0), SIDE, rtol=0.05)
    assert solver.take_scaling() is not None
    assert solver.stats["finite"]
