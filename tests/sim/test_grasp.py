"""Hands through the solver: grip, lift, carry, throw, and pulling at what does not give."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from bench.physics import box
from core.material import Material
from core.rotation import matrices_from_quaternions
from core.vocabulary import Hand
from sim.bodies import SoftBody
from sim.hands.grasp import MAX_HAND_FORCE, Grasp, GraspState, extended, hand_motion, throw_velocities
from tests.support.soft_world import soft_solver

SOFT = Material(young=5e4, poisson=0.3, density=1000.0, friction=0.6)
DT = 1 / 60
MASS = 0.06**3 * 1000  # of a cube [kg]


@pytest.fixture(scope="module")
def solver(ti_cpu):
    """Two cubes on the floor, 20 cm apart."""
    x, tets, surface = box((0.06,) * 3, (3, 3, 3))
    cubes = [SoftBody(f"cube{k}", x - 0.03, tets, surface, SOFT, position=(0.2 * k, 0.03, 0)) for k in range(2)]
    return soft_solver(cubes)


@pytest.fixture(autouse=True)
def begin(solver):
    solver.reset()
    solver.gravity = (0.0, -9.81, 0.0)


def grasped(solver):
    """Bodies in the first two hands, -1 for none."""
    return solver.contacts.hands.grasped_bodies()[:2]


def play(solver, seconds, *paths, grip=True, reach=0.04, turn=None):
    """Run with hands whose positions are functions of the time since now [s]."""
    frames = round(seconds / DT)
    for f in range(frames):
        t = (f + 1) * DT
        rotation = (1.0, 0.0, 0.0, 0.0) if turn is None else turn(t)
        solver.step(DT, [Hand(tuple(path(t)), rotation, grip, reach) for path in paths])


def still(*position):
    return lambda t: np.array(position, float)


def test_a_grasp_of_a_body_that_was_moved_is_of_its_new_places():
    """Whatever the attitude of the hand: where it wants the vertices moves as they do; another body's grasp stays."""
    rng = np.random.default_rng(0)
    hand = Hand((0.1, 0.2, 0.3), tuple(rng.normal(size=4)), True)
    R = matrices_from_quaternions(hand.rotation)
    grasp = Grasp(1, np.array([4, 0, 2]), rng.normal(size=(3, 3)))
    state, shift = GraspState((grasp, None), (hand, None), ((), ())), rng.normal(size=(6, 3))
    (moved, _), (same, _) = state.shifted(1, shift).grasps, state.shifted(0, shift).grasps
    assert_allclose(moved.positions @ R.T, grasp.positions @ R.T + shift[grasp.vertices], atol=1e-12)
    assert same is grasp


def test_a_hand_that_turns_evenly_throws_with_that_turn_whatever_its_attitude():
    """Velocity and angular velocity of the world, and of a body that it holds at arm's length those of each vertex."""
    rng, dt, omega, speed = np.random.default_rng(0), 0.01, np.array([1.0, -2.0, 3.0]), np.array([0.3, 0.1, -0.2])
    start, history = Rotation.from_quat(rng.normal(size=4)), ()
    for k in range(6):
        turn = Rotation.from_rotvec(k * dt * omega) * start
        history = extended(history, dt, Hand(tuple(k * dt * speed), tuple(turn.as_quat(scalar_first=True)), True))
    at, velocity, spin = hand_motion(history)
    assert_allclose(np.concatenate([at, velocity, spin]), [*(5 * dt * speed), *speed, *omega], atol=1e-9)
    x = at + rng.uniform(-0.1, 0.1, (9, 3)) + [0.2, 0.0, 0.1]
    mass = np.full(9, 1e-4)  # so light that the hand is strong enough
    change = throw_velocities(history, x, np.zeros((9, 3)), mass)
    assert_allclose(change, speed + np.cross(omega, x - at), atol=1e-4)


def test_a_hand_grips_the_nearest_body_within_reach(solver):
    play(solver, 2 * DT, still(0.2, 0.07, 0))
    assert grasped(solver) == [1, -1]
    assert [b.held for b in solver.bodies()] == [False, True]
    play(solver, DT, still(0.2, 0.07, 0), grip=False)
    assert grasped(solver) == [-1, -1]


def test_a_hand_out_of_reach_grips_nothing(solver):
    play(solver, 2 * DT, still(0.0, 0.12, 0))
    assert grasped(solver) == [-1, -1]
    play(solver, 2 * DT, still(0.0, 0.03, 0))  # closed already: coming near does not grip
    assert grasped(solver) == [-1, -1]


def test_a_small_reach_takes_the_nearest_vertices(solver):
    """Over a corner, 2 cm from the next vertices: within 1.6 cm lies one, within half as much again two more."""
    play(solver, DT, still(0.03, 0.065, 0.03), reach=0.016)
    x = solver.x.to_numpy()[solver.contacts.hands.grasps[0].vertices]  # of the first body
    assert_allclose(x[np.lexsort(x.T)], [[0.03, 0.06, 0.01], [0.01, 0.06, 0.03], [0.03, 0.06, 0.03]], atol=1e-4)


def test_a_held_body_is_lifted_and_hangs_with_its_weight(solver):
    play(solver, 1.0, lambda t: np.array([0, 0.06 + 0.2 * min(t, 0.5), 0]))
    play(solver, 1.5, still(0, 0.16, 0))
    body = solver.bodies()[0]
    assert 0.08 < body.low[1] < 0.1  # lifted by 10 cm, less its own stretch
    assert_allclose(solver.hand_forces()[0], [0, MASS * 9.81, 0], atol=0.05 * MASS * 9.81)
    assert solver.bodies()[1].low[1] > -1e-4


def test_a_turning_hand_turns_the_body(solver):
    solver.gravity = (0.0, 0.0, 0.0)
    x0 = solver.x.to_numpy()[:64]

    def turn(t):
        half = 0.5 * np.pi / 2 * min(t / 0.5, 1.0)
        return (np.cos(half), np.sin(half), 0.0, 0.0)

    play(solver, 0.3, still(0, 0.1, 0), reach=0.05)
    play(solver, 1.5, still(0, 0.1, 0), reach=0.05, turn=turn)
    r = x0 - (0, 0.1, 0)
    expected = np.stack([r[:, 0], -r[:, 2], r[:, 1]], 1) + (0, 0.1, 0)  # y -> z -> -y about x
    assert np.abs(solver.x.to_numpy()[:64] - expected).max() < 5e-3


def test_pulling_through_the_table_stays_finite_and_comes_back(solver):
    """The hand's force is clamped, so the cube stays on the table however deep the hand goes."""
    play(solver, 0.5, still(0, 0.05, 0))
    play(solver, 0.5, lambda t: np.array([0, 0.05 - 2 * t, 0]))
    force = np.linalg.norm(solver.hand_forces()[0])
    assert force <= 1.001 * MAX_HAND_FORCE
    assert solver.stats["finite"]
    play(solver, 0.5, lambda t: np.array([0, -0.95 + 2 * t, 0]))
    play(solver, DT, still(0, 0.05, 0), grip=False)
    play(solver, 3.0, still(0, 1, 0), grip=False)
    body = solver.bodies()[0]
    assert solver.stats["finite"]
    assert body.low[1] > -1e-3 and 0.05 < body.high[1] < 0.07


def test_a_grip_begins_without_a_jerk(solver):
    """A hand that moved 10 cm in the frame in which it closes takes the body where it is."""
    solver.gravity = (0.0, 0.0, 0.0)
    play(solver, DT, still(0.0, 0.15, 0), grip=False)
    play(solver, DT, still(0.0, 0.05, 0))
    assert grasped(solver)[0] == 0
    assert np.abs(solver.v.to_numpy()).max() < 1e-3
