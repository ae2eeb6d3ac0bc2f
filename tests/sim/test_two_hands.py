"""Two hands on a body, in several materials at once; throwing; and hands that the tracking loses."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from bench.physics import box
from core.material import Material
from core.tetmesh import tet_volumes
from core.vocabulary import Hand
from sim.bodies import SoftBody
from sim.hands.grasp import MAX_HAND_FORCE
from sim.solver import Solver
from tests.support.soft_world import soft_solver, vertices_of

DT = 1 / 60
X, TETS, SURFACE = box((0.36, 0.06, 0.06), (14, 2, 2))
X = X - [0.18, 0.03, 0.03]
MATERIALS = [
    Material(young=young, poisson=poisson, density=1000.0, damping=6.0)
    for young, poisson in ((5e3, 0.3), (5e3, 0.45), (5e4, 0.3), (2e5, 0.45))
]
PLACES = np.array([[0.0, 0.0, 2.0 * k] for k in range(len(MATERIALS))])
MASS = 0.36 * 0.06 * 0.06 * 1000
REACH = 0.045
STILL = (1.0, 0.0, 0.0, 0.0)


@pytest.fixture(scope="module")
def solver(ti_cpu) -> Solver:
    bars = [
        SoftBody(f"{m.young:g} Pa, {m.poisson}", X, TETS, SURFACE, m, position=tuple(place))
        for m, place in zip(MATERIALS, PLACES, strict=True)
    ]
    return soft_solver(bars, floor=False, gravity=(0.0, 0.0, 0.0))


@pytest.fixture(autouse=True)
def begin(solver):
    solver.reset()
    solver.gravity = (0.0, 0.0, 0.0)


def about_x(angle):
    return (np.cos(angle / 2), np.sin(angle / 2), 0.0, 0.0)


def play(solver, seconds, left, right, *, grip=True):
    """Two hands at the ends of every bar; left and right give (position in the bar's frame, rotation) at a time."""
    for f in range(round(seconds / DT)):
        hands = []
        for place in PLACES:
            for position, rotation in (left((f + 1) * DT), right((f + 1) * DT)):
                hands.append(Hand(tuple(place + position), rotation, grip, REACH))
        solver.step(DT, hands)
        for force in solver.hand_forces():
            assert np.linalg.norm(force) <= 1.001 * MAX_HAND_FORCE


def at(x, turn=0.0):
    return np.array([x, 0.0, 0.0]), about_x(turn)


def comes_back(solver, seconds=3.0, *, count=len(MATERIALS)):
    """After letting go: finite, at rest in its own shape, nothing inverted; of the first `count` bars."""
    for _ in range(2):
        play(solver, seconds / 2, lambda t: at(-9.0), lambda t: at(9.0), grip=False)
        end = solver.snapshot()
        solver.restore({**end, "v": 0 * end["v"]})  # as a floor would: what spins is not untangled
    assert solver.stats["finite"]
    rest = tet_volumes(X, TETS)
    edges = TETS[:, [0, 0, 0, 1, 1, 2]], TETS[:, [1, 2, 3, 2, 3, 3]]
    for body, x in zip(solver.bodies()[:count], vertices_of(solver), strict=False):
        volumes = tet_volumes(x, TETS) / rest
        assert volumes.min() > 0.9, f"{body.name}: a tet of {volumes.min():.2f} of its volume"
        assert volumes @ rest == pytest.approx(rest.sum(), rel=0.005), body.name
        lengths, wanted = (np.linalg.norm(y[edges[0]] - y[edges[1]], axis=-1) for y in (x, X))
        assert np.abs(lengths / wanted - 1).max() < 0.05, body.name
        assert not body.held


@pytest.fixture
def held(solver):
    play(solver, 0.1, lambda t: at(-0.18), lambda t: at(0.18))
    assert all(b.held for b in solver.bodies())
    return solver


def test_pulled_apart(held):
    """By 60 cm: the stiff ones do not give so much, and slip no further than the hands' force pulls them."""
    play(held, 0.5, lambda t: at(-0.18 - 0.6 * t), lambda t: at(0.18 + 0.6 * t))
    play(held, 0.5, lambda t: at(-0.48), lambda t: at(0.48))
    lengths = [np.ptp(x[:, 0]) for x in vertices_of(held)]
    assert lengths[0] > 0.7 > lengths[2] and lengths[2] > lengths[3] > 0.37
    comes_back(held)


def test_a_light_body_is_pulled_as_firmly(solver):
    """13 g: on springs that only carry its weight it would follow the hands instead of stretching."""
    solver.set_material(0, replace(MATERIALS[0], density=10.0))
    try:
        play(solver, 0.1, lambda t: at(-0.18), lambda t: at(0.18))
        play(solver, 0.2, lambda t: at(-0.18 - 0.5 * t), lambda t: at(0.18 + 0.5 * t))
        play(solver, 0.4, lambda t: at(-0.28), lambda t: at(0.28))
        assert np.ptp(vertices_of(solver)[0][:, 0]) > 0.36 + 0.17
    finally:
        solver.set_material(0, MATERIALS[0])


def test_squeezed_flat(held):
    play(held, 0.5, lambda t: at(-0.18 + 0.356 * t), lambda t: at(0.18 - 0.356 * t))
    play(held, 0.5, lambda t: at(-0.002), lambda t: at(0.002))
    assert np.ptp(vertices_of(held)[0][:, 0]) < 0.3
    comes_back(held)


def test_squeezed_through_each_other(held):
    """All but the stiffest, which these hands cannot invert: it buckles, and of twelve places in which it is held a
    little otherwise, its ends lock into each other in one."""
    play(held, 0.5, lambda t: at(-0.18 + 0.66 * t), lambda t: at(0.18 - 0.66 * t))
    play(held, 0.5, lambda t: at(0.15), lambda t: at(-0.15))
    comes_back(held, 5.0, count=3)


def test_twisted_by_720_degrees(held):
    """Halfway the ends of the soft ones are a whole turn apart. (The stiff ones are stronger than the hands, and two
    turns may slip off, as the loops of a belt do.)"""
    turn = 4 * np.pi / 1.5
    play(held, 0.75, lambda t: at(-0.18), lambda t: at(0.18, turn * t))
    edge = np.lexsort((X[:, 0], np.round(np.abs(X[:, 1:] - 0.03).sum(1), 6)))[:15]  # along the bar
    for x, place in zip(vertices_of(held)[:2], PLACES, strict=False):
        line = (x - place)[edge, 1:]
        angle = np.unwrap(np.arctan2(line[:, 1], line[:, 0]))
        assert angle[-1] - angle[0] == pytest.approx(2 * np.pi, abs=0.5)
    play(held, 0.75, lambda t: at(-0.18), lambda t: at(0.18, turn * (0.75 + t)))
    play(held, 0.5, lambda t: at(-0.18), lambda t: at(0.18, 4 * np.pi))
    comes_back(held)


def test_two_hands_in_the_same_place_share_the_weight(solver):
    solver.gravity = (0.0, -9.81, 0.0)
    play(solver, 1.5, lambda t: at(0.0), lambda t: at(0.0))
    forces = np.array(solver.hand_forces()).reshape(-1, 2, 3)
    assert_allclose(forces.sum(1), [[0, MASS * 9.81, 0]] * len(forces), atol=0.1 * MASS * 9.81)
    assert_allclose(forces[:, 0], forces[:, 1], atol=0.2 * MASS * 9.81)
    assert solver.stats["finite"]


def carried(seconds, position, *, omega=0.0):
    """The frames of a hand on the first bar, position and rotation as functions of time."""
    times = DT * np.arange(1, round(seconds / DT) + 1)
    return [Hand(tuple(position(t)), about_x(omega * t), True, REACH) for t in times]


def release(solver, frames):
    for hand in frames:
        solver.step(DT, [hand])
    solver.step(1e-4, [replace(frames[-1], grip=False)])
    return solver.bodies()[0]


def test_a_throw_is_the_mean_of_the_last_moments(solver):
    """Swung faster and faster, then steadily for a tenth of a second, turning: v + omega x (c - p)."""

    def position(t):
        steady = max(t - 0.4, 0.0)
        return np.array([0.0, 0.04 + 3.0 * (0.5 * min(t, 0.4) ** 2 / 0.4 + steady), 0.0])

    body = release(solver, carried(0.5, position, omega=2.0))
    hand = position(0.5)
    expected = [0, 3.0, 0] + np.cross([2.0, 0, 0], body.centroid - hand)
    assert_allclose(body.velocity, expected, atol=0.02)
    x, v = (solver.snapshot()[n][: len(X)].astype(np.float64) for n in ("x", "v"))
    m = solver.body_models[0].mass
    r = x - m @ x / MASS
    assert m @ (r[:, 1] * v[:, 2] - r[:, 2] * v[:, 1]) / (m @ (r[:, 1:] ** 2).sum(1)) == pytest.approx(2.0, rel=0.02)


def test_fingers_that_slow_down_as_they_open_still_throw(solver):
    """The hand stands still in its last frame."""
    body = release(solver, carried(0.3, lambda t: np.array([0.0, 3.0 * min(t, 0.3 - DT), 0.0])))
    assert 0.7 * 3.0 < body.velocity[1] < 3.0


def test_a_hand_that_has_stopped_drops(solver):
    def position(t):
        return np.array([0.0, 3.0 * min(t, 0.3), 0.0])

    body = release(solver, carried(0.3 + 0.1, position))
    assert np.linalg.norm(body.velocity) < 0.01


def test_a_hand_that_is_gone_leaves_the_velocities_alone(solver):
    """The mouse's hand ends its swing so, at a velocity that it has averaged itself."""
    frames = carried(0.3, lambda t: np.array([0.0, 2.0 * t, 0.0]))
    for hand in frames:
        solver.step(DT, [hand])
    before = solver.bodies()[0].velocity
    solver.step(1e-4, [])
    body = solver.bodies()[0]
    assert not body.held
    assert_allclose(body.velocity, before, atol=1e-3)


def test_what_another_hand_holds_is_not_thrown(solver):
    left = Hand((-0.18, 0.0, 0.0), grip=True, reach=REACH)
    for hand in carried(0.2, lambda t: np.array([0.18, 0.05 * t, 0.0])):
        solver.step(DT, [left, hand])
    before = solver.bodies()[0].velocity
    solver.step(1e-4, [left, replace(hand, grip=False)])
    assert_allclose(solver.bodies()[0].velocity, before, atol=5e-3)
    assert solver.bodies()[0].held


def test_a_throw_is_no_stronger_than_the_hand(solver):
    """A body that is held back is not shot off: 80 N for 80 ms at most."""
    solver.set_material(0, replace(MATERIALS[2], density=30000.0))
    try:
        body = release(solver, carried(0.3, lambda t: np.array([0.0, 15.0 * (t - DT), 0.0])))
        assert 0.1 < body.velocity[1] * MASS * 30 < MAX_HAND_FORCE * (0.3 + 0.08) * 1.1
    finally:
        solver.set_material(0, MATERIALS[0])


def test_a_hand_without_a_pose_holds_still(solver):
    here = Hand((0.0, 0.0, 0.0), grip=True, reach=REACH)
    broken = [None, replace(here, position=(np.nan, 0.0, 0.0)), replace(here, rotation=(0.0, 0.0, 0.0, 0.0))]
    for hand in [None, here, *broken, here, *broken]:
        solver.step(DT, [hand])
    body = solver.bodies()[0]
    assert body.held and np.abs(body.velocity).max() < 1e-4 and solver.stats["finite"]
    solver.interaction = "transform"
    try:
        before = solver.bodies()[0].centroid
        for hand in [replace(here, position=(0.0, 0.1, 0.0)), *broken]:
            solver.step(DT, [hand])
        assert_allclose(solver.bodies()[0].centroid, before, atol=1e-5)
    finally:
        solver.interaction = "physics"
