"""Sleeping soft bodies: what falls asleep and what must not, that nothing of it moves, and what wakes it in time."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from bench.physics import box
from bench.physics_contact import pile, run
from core.material import Material
from core.vocabulary import Hand, Plane, Touch
from sim.bodies import SoftBody
from sim.model import Capacity, models_of
from sim.sleeping import REST_TIME, bits
from sim.solver import Solver

FRAME, G = 1 / 60, 9.81
FOAM = Material(young=5e4, poisson=0.3, density=300.0, friction=0.5, damping=20.0)
SIDE = 0.08
X, TETS, SURFACE = box((SIDE,) * 3, (2, 2, 2))
BAR = box((0.2, 0.04, 0.04), (4, 2, 2))
CAPACITY = Capacity(vertices=200, tets=400, triangles=400, samples=2000, nodes=400_000, bodies=8)
MOTION = ("x", "x_lo", "v", "v_lo")


def cube(x=0.0, y=SIDE / 2, z=0.0, **options) -> SoftBody:
    """A cube with its centre there; by default on the floor."""
    options = {"material": FOAM, **options}
    return SoftBody(f"cube {x} {y} {z}", X - SIDE / 2, TETS, SURFACE, position=(x, y, z), **options)


@pytest.fixture(scope="module")
def world(ti_cpu) -> Solver:
    """A floor, fingers, and capacity for some bodies."""
    return Solver([cube()], [Plane((0, 0, 0), (0, 1, 0), 0.5)], capacity=CAPACITY, fingers=True)


def put(solver: Solver, *bodies: SoftBody, gravity=(0.0, -G, 0.0)) -> Solver:
    """The solver with these bodies, awake."""
    solver.interaction, solver.gravity = "physics", gravity
    solver.reset(models_of(bodies))
    return solver


def asleep(solver: Solver) -> list[bool]:
    return solver.snapshot()["asleep"].tolist()


def lull(solver: Solver, *bodies: SoftBody) -> Solver:
    """The solver with these bodies, which have come to rest and fallen asleep."""
    put(solver, *bodies)
    for _ in range(round(4.0 / FRAME)):
        solver.step(FRAME)
        if all(asleep(solver)):
            return solver
    raise AssertionError(f"asleep after 4 s: {asleep(solver)}")


def vertices(solver: Solver, body: int) -> slice:
    return slice(*solver.vertex_offset[body : body + 2])


# what falls asleep


def test_what_rests_falls_asleep_and_then_costs_and_moves_nothing(world, monkeypatch):
    solver = lull(world, cube(), cube(0.5))
    before = solver.snapshot()
    assert solver.stats["asleep"] == 2 and not before["v"].any() and not before["v_lo"].any()
    states = solver.bodies()
    assert solver.observe().moved
    monkeypatch.setattr(solver.contacts, "detect", None)  # what a frame that simulates would call
    monkeypatch.setattr(solver.state, "begin_frame", None)
    for _ in range(60):
        solver.step(FRAME, [Hand((0, 1, 0))])
        seen = solver.observe()
        assert not seen.moved and solver.stats["substeps"] == 0
    after = solver.snapshot()
    for name in MOTION:
        assert_array_equal(before[name], after[name])
    assert_array_equal([s.centroid for s in states], [s.centroid for s in seen.bodies])


def test_what_starts_asleep_stays_until_something_reaches_it(world):
    """Two cubes in the air, one of which the other falls on."""
    put(world, cube(y=0.5, asleep=True), cube(0.3, 0.5, asleep=True), cube(0.3, 0.65))
    run(world, 0.1)
    assert asleep(world) == [True, True, False]
    run(world, 0.3)
    x = world.x.to_numpy()
    assert asleep(world) == [True, False, False]
    assert_array_equal(x[vertices(world, 0)], world.snapshot()["bodies"][0].start[0])
    assert x[vertices(world, 1), 1].mean() < 0.45
    world.reset()
    assert asleep(world) == [True, True, False]


def test_a_pile_that_has_come_to_rest_sleeps_within_seconds_and_creeps_no_more(ti_cpu):
    """Its stacks would rock for half a minute: in the first second they are stopped."""
    solver = pile(sleep=True)
    for k in range(60):
        solver.step(FRAME)
        if k % 6 == 5:
            solver.state.v.fill(0.0)
            solver.state.v_lo.fill(0.0)
    run(solver, 2.5)
    before = solver.snapshot()
    assert before["asleep"].all()
    run(solver, 5.0)
    after = solver.snapshot()
    for name in MOTION:
        assert_array_equal(before[name], after[name])


def test_nothing_sleeps_where_that_is_not_wanted(ti_cpu):
    """Nor without contacts: nothing could wake it."""
    awake = Solver([cube()], [Plane((0, 0, 0), (0, 1, 0), 0.5)], sleep=False)
    for solver in (awake, Solver([cube()], contacts=False, gravity=(0, 0, 0))):
        run(solver, 2.0)
        assert solver.stats["asleep"] == 0 and solver.stats["substeps"] > 0


# what must not fall asleep


def test_a_pendulum_does_not_stop_where_it_turns(world):
    """A swing of 7 mm that takes 5 s: where it turns, it stays within half a millimetre for 0.7 s."""
    x, tets, surface = BAR
    hinge = np.flatnonzero((x[:, 0] < 1e-9) & (np.abs(x[:, 1] - 0.02) < 1e-9))
    down = (np.sqrt(0.5), 0, 0, -np.sqrt(0.5))
    bar = SoftBody("bar", x, tets, surface, replace(FOAM, young=1e6, damping=0.0), down, (0, 1, 0), pinned=hinge)
    g, amplitude = 0.2, 0.007
    put(world, bar, gravity=(0, -g, 0))
    x, mass = world.snapshot()["x"].astype(np.float64), bar.masses()
    arm = x - x[hinge].mean(0)
    omega = np.sqrt(-g * (mass @ arm)[1] / (mass @ (arm[:, :2] ** 2).sum(1)))
    assert 2 * np.pi / omega == pytest.approx(5.0, abs=0.5)
    world.restore({"x": x, "v": np.cross([0, 0, amplitude / -arm[:, 1].min() * omega], arm)})
    tip, way = int(np.argmin(arm[:, 1])), []
    for _ in range(round(1.6 * np.pi / omega / FRAME)):
        world.step(FRAME)
        way.append(world.snapshot()["x"][tip, 0] - x[tip, 0])
        assert asleep(world) == [False]
    assert max(way) == pytest.approx(amplitude, rel=0.1) and min(way) < -0.9 * amplitude


def test_a_throw_does_not_stop_at_its_apex_nor_a_body_that_slides_slowly(world):
    """On a floor without friction a body goes on at 2 mm/s."""
    ice = replace(FOAM, friction=0.0)
    solver = put(world, cube(0, 1.0, velocity=(0, 2.0, 0)), cube(1.0, material=ice))
    run(solver, 0.3)
    snapshot = solver.snapshot()
    snapshot["v"][vertices(solver, 1)] = [0.002, 0, 0]
    solver.restore(snapshot)
    for _ in range(180):
        solver.step(FRAME)
        assert not asleep(solver)[1]
    assert solver.bodies()[0].centroid[1] < 0.05
    assert_allclose(solver.bodies()[1].velocity[0], 0.002, rtol=0.05)


def test_a_body_that_begins_to_slip_on_a_slope_goes_on_slipping(world):
    """A degree over the friction angle: it starts from rest."""
    a = np.arctan(0.5) + np.radians(1.0)
    solver = put(world, cube(), gravity=(G * np.sin(a), -G * np.cos(a), 0.0))
    for _ in range(180):
        solver.step(FRAME)
        assert asleep(solver) == [False]
    assert solver.bodies()[0].velocity[0] > 0.1
    a = np.arctan(0.5) - np.radians(3.0)
    solver.gravity = (G * np.sin(a), -G * np.cos(a), 0.0)
    run(solver, 4.0)
    assert asleep(solver) == [True]


# what wakes it


def test_what_hits_a_pile_wakes_all_of_it_in_time_and_nothing_else(world):
    lull(world, cube(0.3), cube(0.3, 1.5 * SIDE), cube(2.0))
    snapshot = world.snapshot()
    world.add(cube(0, 0.06, velocity=(5.0, 0.3, 0)))
    world.restore({**world.snapshot(), "asleep": [True] * 3 + [False]})
    steps = 0
    while world.bodies()[0].velocity[0] < 0.01 and steps < 10:
        assert asleep(world) == [True] * 3 + [False]
        world.step(FRAME)
        steps += 1
    assert 1 < steps < 10 and asleep(world) == [False, False, True, False]
    run(world, 0.3)
    assert world.stats["asleep"] == 1
    assert_array_equal(snapshot["x"][vertices(world, 2)], world.snapshot()["x"][vertices(world, 2)])


def test_a_hit_loses_nothing_by_sleep(world):
    """In its first frame a ball reaches a pile, which sleeps or does not: momenta and ways are the same."""
    lull(world, cube(0.3), cube(0.3, 1.5 * SIDE))
    world.add(cube(0.2, 0.06, velocity=(5.0, 0.3, 0), material=replace(FOAM, density=600.0)))
    start, ends = world.snapshot(), []
    mass = np.array([m.mass.sum() for m in world.body_models])
    for sleeping in (True, False):
        world.restore({**start, "asleep": [sleeping, sleeping, False]})
        world.step(FRAME)
        assert world.bodies()[0].velocity[0] > 0.3
        run(world, 0.05)
        ends.append((mass @ np.array([s.velocity for s in world.bodies()]), [s.centroid for s in world.bodies()]))
    (p, at), (q, other) = ends
    assert_allclose(p, q, atol=2e-3 * np.linalg.norm(q))
    assert_allclose(at, other, atol=2e-4)


@pytest.mark.parametrize("speed", [3.0, 15.0])
def test_nothing_tunnels_through_a_sleeping_body(world, speed):
    lull(world, cube())
    world.add(cube(-0.5, SIDE / 2 + 0.002, velocity=(speed, 0, 0)))
    world.restore({**world.snapshot(), "asleep": [True, False]})
    run(world, 0.5)
    target, ball = world.bodies()
    assert ball.centroid[0] < target.centroid[0] - 0.7 * SIDE and target.centroid[0] > 0.05


def test_edits_wake_what_rests_on_a_body(world):
    edits = {
        "remove": lambda: world.remove(0),
        "displace": lambda: world.displace(0, np.eye(4) + np.outer([1, 0, 0, 0], [0, 0, 0, 1])),
        "smaller": lambda: world.rescale(0, 0.5, about=(0, 0, 0)),
        "softer": lambda: world.set_material(0, replace(FOAM, young=1e4)),
    }
    lull(world, cube(), cube(0, 1.5 * SIDE))
    rest, height = world.snapshot(), world.bodies()[1].centroid[1]
    for name, edit in edits.items():
        world.restore(rest)
        run(world, 0.2)
        assert world.bodies()[1].centroid[1] == height, name
        edit()
        run(world, 0.5)
        assert world.bodies()[-1 if name != "remove" else 0].centroid[1] < height - 0.001, name


def test_gravity_wakes(world):
    lull(world, cube())
    world.gravity = (0.0, 1.0, 0.0)
    run(world, 0.5)
    assert world.bodies()[0].centroid[1] > 0.1


def test_a_hand_that_holds_a_body_wakes_it_and_what_lies_on_it(world):
    lull(world, cube(), cube(0, 1.5 * SIDE), cube(1.0))
    hand = Hand((0, SIDE / 2, 0), grip=False, reach=0.06)
    run(world, 0.1, [hand])
    assert asleep(world) == [True] * 3
    run(world, FRAME, [replace(hand, grip=True)])
    assert asleep(world) == [False, False, True]
    for k in range(120):  # it holds still for a second, and then pulls
        x = min(0.0, 0.6 - 0.01 * k)
        world.step(FRAME, [replace(hand, grip=True, position=(x, SIDE / 2, 0))])
        assert not asleep(world)[0]
    assert world.bodies()[1].centroid[1] < 1.3 * SIDE
    run(world, 4.0, [replace(hand, position=(-1, 1, 0))])
    assert asleep(world) == [True] * 3


def test_rigid_editing_wakes_what_lies_on_the_body(world):
    lull(world, cube(), cube(0, 1.5 * SIDE))
    world.interaction = "transform"
    for k in range(20):
        world.step(FRAME, [Hand((0.02 * k, SIDE / 2, 0), grip=k > 0, reach=0.06)])
    world.interaction = "physics"
    run(world, 0.5)
    assert world.bodies()[1].centroid[1] < SIDE


def test_a_finger_wakes_what_it_comes_to_touch_and_nothing_else(world):
    lull(world, cube(), cube(0, 1.5 * SIDE), cube(1.0))

    def finger(x):
        return [Hand((x, 0.5, 0), touch=(Touch((x, SIDE / 2, -0.02), (x, SIDE / 2, 0.02), 0.008),))]

    run(world, 0.5, finger(-0.2))
    assert asleep(world) == [True] * 3
    for k in range(30):
        world.step(FRAME, finger(-0.2 + 0.006 * k))
        if world.bodies()[0].velocity[0] > 1e-3:
            break
    assert asleep(world) == [False, False, True]
    for _ in range(150):  # at once, without a path: the tracking had lost it; it then rests there
        world.step(FRAME, finger(1.0 - SIDE / 2 - 0.006))
        assert not asleep(world)[2]  # one never knows what a hand that touches does next


def test_driven_vertices_wake(world):
    x, tets, surface = BAR
    root = np.flatnonzero(x[:, 0] < 1e-9)
    lull(world, SoftBody("bar", x, tets, surface, replace(FOAM, young=1e6), position=(0, 0.5, 0), pinned=root))
    start = world.snapshot()["x"][root]
    for k in range(30):
        world.kinematic.drive_vertices(0, root, start + [0, 0.005 * k, 0])
        world.step(FRAME)
        assert asleep(world) == [False]
    assert world.bodies()[0].centroid[1] > 0.6
    run(world, 4.0)
    assert asleep(world) == [True]


def test_a_body_with_inverted_tets_does_not_sleep(world):
    """Inverted by force, or in a kink: it is led to its rest shape first."""
    lull(world, cube())
    world.state.inverted[0] = 1
    world.wake()
    world.step(FRAME)
    assert asleep(world) == [False]


# states that are kept


def test_runs_with_sleep_repeat_bit_for_bit_and_a_snapshot_sleeps_on(world):
    lull(world, cube(), cube(1.0))
    start = world.snapshot()
    ends = []
    for _ in range(2):
        world.restore(start)
        assert asleep(world) == [True, True]
        run(world, 0.2)
        for name in MOTION:
            assert_array_equal(world.snapshot()[name], start[name])
        run(world, 0.3, [Hand((0, SIDE / 2, 0), grip=True, reach=0.06)])
        run(world, 2.0, [Hand((0.3, 0.2, 0), grip=False)])
        ends.append(world.snapshot())
    for name in (*MOTION, "asleep"):
        assert_array_equal(ends[0][name], ends[1][name])


def test_forces_of_sleeping_bodies_are_those_of_their_rest(world):
    """While another one falls: the lower cube carries the upper one, and the floor both."""
    lull(world, cube(), cube(0, 1.5 * SIDE))
    world.add(cube(2.0, 12.0))
    run(world, 1.4)
    assert asleep(world) == [True, True, False]
    weight = G * world.body_models[0].mass.sum()
    assert_allclose(world.contact_forces()[:2, 1], weight, rtol=0.1)
    force = world.state.mass.to_numpy() @ world.contacts.forces.correction.to_numpy()[:, 1]
    assert_allclose(force / world.stats["dt"] ** 2, 2 * weight, rtol=0.1)


def test_bits_of_all_bodies_fit():
    assert bits([]) == 0 and bits([0, 2, 2]) == 5 and bits([63]) == -(1 << 63) and bits(range(64)) == -1
    assert REST_TIME > 0
