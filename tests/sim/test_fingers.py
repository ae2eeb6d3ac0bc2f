"""Fingers: capsules that push, carry, pinch and go through soft and rigid bodies."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from bench.physics import box
from core.material import Material
from core.tetmesh import tet_volumes
from core.vocabulary import Box, Capsule, Hand, Touch
from sim.bodies import RigidBody, SoftBody
from sim.contact.finger_capsules import CAPSULES_PER_HAND, MAX_RADIUS, capsules_of
from sim.hands.grasp import MAX_HAND_FORCE
from sim.solver import Solver
from tests.support.runtime import runtime

SOFT = Material(young=5e4, poisson=0.3, density=1000.0, friction=0.6)
DT, R = 1 / 60, 0.009
SIDE, WEIGHT = 0.06, 0.06**3 * 1000 * 9.81
X, TETS, SURFACE = box((SIDE,) * 3, (3, 3, 3))
BRICK = 0.3  # where the rigid brick stands [m]
TABLE = Box((0, -0.05, 0), (1.5, 0.05, 0.5))


def bodies():
    cube = SoftBody("cube", X - SIDE / 2, TETS, SURFACE, SOFT, position=(0, SIDE / 2, 0))
    brick = RigidBody.box("brick", (0.05,) * 3, density=800, position=(BRICK, 0.025, 0), friction=0.6)
    return [cube, brick]


@pytest.fixture(scope="module")
def solver(ti_cpu):
    """A soft cube and a rigid brick on a table."""
    return Solver(bodies(), [TABLE], fingers=True)


@pytest.fixture(autouse=True)
def begin(solver):
    solver.reset()


def play(solver, frames, touch=lambda k: (), **hand):
    for k in range(frames):
        solver.step(DT, [Hand(touch=tuple(touch(k)), **hand)])


def upright(x, y, length=0.1):
    return Touch((x, y, 0.0), (x, y + length, 0.0), R)


def along_z(x, y):
    return Touch((x, y, -0.02), (x, y, 0.02), R)


def least_volume(solver):
    """Of the cube's tets, against rest."""
    n = solver.vertex_offset[1]
    return (tet_volumes(solver.x.to_numpy()[:n], TETS) / tet_volumes(X, TETS)).min()


def test_a_finger_pushes_bodies_along_and_ahead_of_it(solver):
    play(solver, 60, lambda k: [along_z(x - 0.1 + 0.002 * k, 0.03) for x in (0.0, BRICK)])
    front = -0.1 + 0.002 * 59 + R
    cube, brick = solver.bodies()
    assert front - 0.003 < cube.low[0] < front + 0.005
    assert front + BRICK - 0.003 < brick.low[0] < front + BRICK + 0.002
    assert_allclose(brick.velocity[0], 0.12, rtol=0.1)
    assert least_volume(solver) > 0.5


def test_resting_fingers_carry_the_weight_of_a_soft_and_of_a_rigid_body(solver):
    """Two rails each are lifted under them: then the table carries nothing."""
    solver.restore({"x": solver.x.to_numpy()[:72] + [0, 0.1, 0], "v": np.zeros((72, 3))})
    solver.gravity = (0.0, -9.81, 0.0)
    rails = [Touch((x - 0.05, 0.09, z), (x + 0.05, 0.09, z), R) for x in (0.0, BRICK) for z in (-0.012, 0.012)]
    for _ in range(90):
        solver.step(DT, [Hand(touch=tuple(rails[:2])), Hand(touch=tuple(rails[2:]))])
    forces = np.mean([sample(solver, rails) for _ in range(10)], axis=0)
    assert_allclose(forces[0, 1], WEIGHT, rtol=0.04)
    assert_allclose(forces[1, 1], 0.05**3 * 800 * 9.81, rtol=0.02)
    assert_allclose(solver.hand_forces(), 0.0)
    play(solver, 2)
    assert_allclose(solver.touch_forces(), 0.0)


def sample(solver, rails):
    solver.step(DT, [Hand(touch=tuple(rails[:2])), Hand(touch=tuple(rails[2:]))])
    return solver.touch_forces()


@pytest.mark.parametrize("x", [0.0, BRICK])
def test_two_fingers_pinch_and_lift_by_friction(solver, x):
    def fingers(k):
        d, y = 0.06 - 0.0007 * min(k, 45), 0.03 + 0.002 * max(0, k - 50)
        return [Touch((x + s * d, y, 0), (x + s * (d + 0.05), y + 0.02, 0), R) for s in (-1, 1)]

    play(solver, 90, fingers)
    lifted, other = solver.bodies() if x == 0.0 else solver.bodies()[::-1]
    assert lifted.low[1] > 0.06 and other.low[1] < 1e-3
    assert least_volume(solver) > 0.5


@pytest.mark.parametrize("young", [1e4, 5e4])
def test_six_fingers_go_through_with_no_more_than_the_force_of_a_hand(solver, young):
    """Down into the table and out at the sides; they crush no cell, however soft, and leave all as it was."""
    worst, hardest = 1.0, 0.0
    solver.set_material(0, replace(SOFT, young=young))
    try:
        for k in range(100):
            y, aside = max(0.1 - 0.003 * k, -0.1), 0.0 if k < 70 else 0.003 * (k - 70)
            touch = [upright(x + aside + d, y) for x in (0.0, BRICK) for d in (-0.02, 0.0, 0.02)]
            play(solver, 1, lambda _, t=touch: t)
            worst, hardest = min(worst, least_volume(solver)), max(hardest, np.linalg.norm(solver.touch_forces()[0]))
            assert max(np.linalg.norm(b.velocity) for b in solver.bodies()) < 3.0
        play(solver, 60)
        assert solver.stats["finite"] and least_volume(solver) > 0.8
        assert all(b.low[1] > -1e-3 for b in solver.bodies())
    finally:
        solver.set_material(0, SOFT)
    assert worst > 0.4 and 30.0 < hardest < 1.25 * MAX_HAND_FORCE


@pytest.mark.parametrize("jump", [2.0, 0.3])
def test_what_appears_inside_or_jumps_there_pushes_out_gently(solver, jump):
    speeds = []
    for k in range(40):
        y = 0.03 + jump * (k < 5)  # then that far away at once
        touch = [Touch((x + 0.015, y, -0.005), (x + 0.015, y, 0.005), R) for x in (0.0, BRICK)]
        play(solver, 1, lambda _, t=touch: t)
        speeds.append(max(np.linalg.norm(b.velocity) for b in solver.bodies()))
    assert max(speeds[:5]) < 0.05
    assert max(speeds) < 1.5  # and not 120 or 18 m/s, at which it came
    cube, brick = solver.bodies()
    assert cube.centroid[0] < -0.005 and brick.high[0] < BRICK + 0.015
    assert solver.stats["finite"] and least_volume(solver) > 0.1


def test_a_hand_passes_through_what_it_holds_and_what_it_has_just_let_go(solver):
    touch = (upright(0.0, 0.03),)
    for k in range(30):
        solver.step(DT, [Hand((0.0, 0.065, 0.0), grip=k > 0, reach=0.02, touch=touch if k > 1 else ())])
        assert_allclose(solver.touch_forces(), 0.0)
    for _ in range(20):
        solver.step(DT, [Hand((0.0, 0.065, 0.0), touch=touch)])
        assert_allclose(solver.touch_forces(), 0.0)
    play(solver, 2, lambda k: [upright(0.0, 0.2)])
    play(solver, 3, lambda k: [upright(0.0, 0.06)])
    assert solver.touch_forces()[0][1] < -0.5  # it has been away, so it touches again


def test_the_other_hand_feels_what_one_hand_holds(solver):
    for k in range(30):
        holds = Hand((0.0, 0.065, 0.0), grip=k > 0, reach=0.02, touch=(upright(0.0, 0.04),) if k > 1 else ())
        solver.step(DT, [holds, Hand(touch=(along_z(-0.06 + 0.001 * k, 0.03),))])
    mine, others = solver.touch_forces()
    assert_allclose(mine, 0.0)
    assert others[0] > 0.3


@pytest.mark.long
def test_without_touches_all_moves_as_without_fingers(solver, ti_cpu):
    plain = Solver(bodies(), [TABLE])
    for k in range(25):
        hands = [Hand((0.0, 0.065 + 0.004 * k, 0.0), grip=3 < k < 15, reach=0.03)]
        for s in (solver, plain):
            s.step(DT, hands)
    assert plain.touch_forces() == []
    assert (solver.x.to_numpy() == plain.x.to_numpy()).all() and (solver.v.to_numpy() == plain.v.to_numpy()).all()


def test_a_repeated_poke_agrees_bit_for_bit(solver):
    ends = []
    for _ in range(2):
        solver.reset()
        play(solver, 20, lambda k: [along_z(-0.05 + 0.002 * k, 0.03), upright(BRICK, 0.1 - 0.004 * k)])
        ends.append(solver.x.to_numpy())
    assert (ends[0] == ends[1]).all()


def test_only_numbers_touch():
    bad = (Touch((0, 0, np.nan), (0, 0, 0), 0.01), Touch((0, 0, 0), (1, 0, 0), -0.01), Touch((0, 0, 0), (1, 0, 0), 9.0))
    table = capsules_of(Hand(touch=bad * 20))
    assert table.shape == (CAPSULES_PER_HAND, 7)
    assert_allclose(table[:, 6], np.tile([0, 0, MAX_RADIUS], 7)[:CAPSULES_PER_HAND])
    assert not capsules_of(None).any()


@pytest.mark.long
def test_contacts_of_fingers_read_nothing_outside_of_their_fields():
    """Taichi checks it when it is asked to; the last test here, since it starts Taichi anew."""
    with runtime("cpu", debug=True, offline_cache=False):
        peg = Capsule((0, 0, 0.4), (0, 1, 0.4), 0.02)  # with its samples the hash has room for more than there are
        solver = Solver(bodies(), [TABLE, peg], fingers=True)
        play(solver, 3, lambda k: [upright(0.0, 0.03)])
        assert solver.observe().moved
