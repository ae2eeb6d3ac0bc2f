"""Rigid bodies through the solver: free motion, bouncing, friction, stacks, kinematic bodies, hands."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial import ConvexHull

from bench import physics_contact
from bench.physics_contact import SIDE, playground
from core.errors import BadInput
from core.rotation import matrices_from_quaternions
from core.vocabulary import Hand, Plane
from sim.bodies import RigidBody
from sim.contact.static_shapes import MAX_SHAPES
from sim.model import MAX_BODIES
from sim.rigid.rigid_broad_phase import SLOTS, WORLD
from sim.solver import Solver

FRAME = 1 / 60


@pytest.fixture(scope="module")
def place(ti_cpu):
    return playground()


@pytest.fixture(scope="module")
def free(ti_cpu):
    """A book that spins about its middle axis, and a box that only flies."""
    book = RigidBody.box(
        "book", (0.3, 0.2, 0.1), density=1000.0, angular_velocity=(0.05, 5.0, 0.0), velocity=(0.1, 0, 0)
    )
    box = RigidBody.box("box", (0.1,) * 3, density=500.0, position=(3, 3, 3))
    corners = 0.2 * np.stack(np.meshgrid([-1.0, 1.5], [0.0, 1.0], [0.5, 1.0]), -1).reshape(-1, 3)
    plate = RigidBody.convex("plate", corners, density=500.0, position=(-2, 0, 0), kinematic=True)  # off its frame
    return Solver([book, box, plate], contacts=False)


def momentum(solver, b=0):
    """Spin momentum and energy of a body."""
    m = solver.rigid_bodies
    L, omega = (f.to_numpy()[b].astype(np.float64) for f in (m.angular_momentum, m.angular_velocity))
    return L, 0.5 * L @ omega


def test_a_free_spin_about_the_middle_axis_flips_and_keeps_momentum_and_energy(free):
    free.reset()
    free.gravity = (0.0, 0.0, 0.0)
    (L0, E0), sides = momentum(free), []
    for _ in range(300):
        free.step(FRAME)
        sides.append(free.rigid_bodies.R.to_numpy()[0][1, 1])
    L, E = momentum(free)
    assert_allclose(L, L0, rtol=0, atol=1e-6 * np.linalg.norm(L0))
    assert_allclose(E, E0, rtol=1e-4)
    assert min(sides) < -0.9 and max(sides) > 0.9  # it tumbled (Dzhanibekov)
    assert_allclose(free.bodies()[0].velocity, [0.1, 0, 0], atol=1e-6)


def test_a_free_fall_is_exact_in_fp32(free):
    free.reset()
    free.gravity = (0.0, -9.81, 0.0)
    for _ in range(30):
        free.step(FRAME)
    box = free.bodies()[1]
    assert_allclose(box.velocity[1], -9.81 * 0.5, rtol=1e-4)
    assert_allclose(box.centroid[1] - 3, -0.5 * 9.81 * 0.5 * (0.5 + free.stats["dt"]), rtol=1e-4)


def test_vertices_go_where_their_velocities_say_and_keep_those_that_they_were_given(free):
    """Of a book in any attitude that spins about a slanted axis, and of a plate that is driven round."""
    free.reset()
    free.gravity = (0.0, 0.0, 0.0)
    x, ends, dt = free.snapshot()["x"].astype(np.float64), free.vertex_offset, 1e-3
    book, plate = slice(ends[0], ends[1]), slice(ends[2], ends[3])
    turn = matrices_from_quaternions([0.5, 0.1, -0.7, 0.3])
    r = (x[book] - x[book].mean(0)) @ turn.T
    x[book] = r + [0.2, 0.1, 0.3]
    given = np.zeros_like(x)
    given[book] = np.cross([1.0, -2.0, 3.0], r) + [0.1, 0.0, -0.2]
    free.restore({"x": x, "v": given})
    driven = (np.cos(1e-3), 0, np.sin(1e-3), 0)
    free.kinematic.drive(2, (-2 + 2e-4, 0, 1e-4), driven)  # 2 rad/s
    free.step(dt)
    after = free.snapshot()
    moved, v = after["x"].astype(np.float64) + after["x_lo"] - x, after["v"].astype(np.float64)
    assert_allclose(v[book], given[book], atol=0.01)  # 14 / s^2 by 0.2 m, for a millisecond
    assert_allclose(moved[book], 0.5 * dt * (v[book] + given[book]), atol=1e-7)
    assert np.linalg.norm(v[plate], axis=1).max() > 0.4
    places = free.body_models[2].shape.vertices @ matrices_from_quaternions(driven).T + [-2 + 2e-4, 0, 1e-4]
    assert_allclose((x + moved)[plate], places, atol=1e-6)
    assert_allclose(moved[plate], dt * v[plate], atol=2e-6)  # it turns by 2e-3, and v is that at the start


def test_what_is_too_fast_for_a_substep_is_slowed(free):
    """Half a radian, and half a body's smallest width: beyond, increments mean nothing and contacts are passed."""
    free.reset()
    x = free.snapshot()["x"]
    v, n = np.zeros_like(x), free.vertex_offset[1]
    v[:n], v[n:, 0] = np.cross([0, 1e5, 0], x[:n] - x[:n].mean(0)), 1e4
    free.restore({"x": x, "v": v})
    free.step(FRAME)
    m, dt = free.rigid_bodies, free.stats["dt"]
    assert free.stats["finite"]
    assert 0.1 < np.linalg.norm(m.angular_velocity.to_numpy()[0]) * dt < 0.5001
    assert 0.01 < np.linalg.norm(m.v.to_numpy()[1]) * dt < 0.05001


@pytest.mark.parametrize(
    "measure",
    [
        pytest.param(physics_contact.rigid_bounce, marks=pytest.mark.long),
        pytest.param(physics_contact.rigid_stack, marks=pytest.mark.long),
        physics_contact.slope,
    ],
)
def test_rebounds_stacks_and_friction_are_as_they_should(measure, place):
    rows = measure(place)
    assert rows and not [r for r in rows if not r["pass"]]


def test_a_heavy_box_rests_on_a_light_one(place):
    solver, where = physics_contact.started(place)
    physics_contact.run(solver, 3.0)
    light, heavy = solver.bodies()[where["heavy_on_light"]]
    assert_allclose(light.centroid[1], SIDE / 2, atol=2e-3)
    assert_allclose(heavy.centroid[1], 1.5 * SIDE, atol=4e-3)
    assert np.linalg.norm(heavy.velocity) < 0.2  # a hundred to one: it sways, but stays up
    settled = solver.bodies()[where["bouncing"]][2]  # of restitution 0.5: it has bounced for a second
    assert_allclose(settled.centroid[1], SIDE / 2, atol=1e-4)
    assert np.linalg.norm(settled.velocity) < 1e-4


def test_a_plate_carries_a_box_by_friction(place):
    solver, where = physics_contact.started(place)
    plate, load = where["conveyor"].start, where["conveyor"].start + 1
    physics_contact.run(solver, 0.3)
    start, x = solver.bodies()[load].centroid[0], 0.0
    for k in range(60):
        x += min(k / 20, 1.0) * 0.5 * FRAME  # to 0.5 m/s in a third of a second
        solver.kinematic.drive(plate, (x, 0.5, 14))
        solver.step(FRAME)
    assert_allclose(solver.bodies()[plate].velocity[0], 0.5, rtol=1e-3)
    assert_allclose(solver.bodies()[load].velocity[0], 0.5, rtol=0.02)
    assert_allclose(solver.bodies()[load].centroid[0] - start, x, atol=2e-3)
    physics_contact.run(solver, 0.5)
    assert_allclose(solver.bodies()[plate].centroid, (x, 0.5, 14), atol=1e-6)
    assert np.linalg.norm(solver.bodies()[load].velocity) < 1e-3


def test_a_hand_lifts_and_turns_a_box(place):
    solver, where = physics_contact.started(place)
    top = where["stack"].start + 4
    start = solver.bodies()[top].centroid
    corner = start + SIDE / 2
    for k in range(90):
        a = 0.5 * np.pi * min(k / 60, 1.0)
        hand = Hand(corner + [0, 0.3 * min(k / 60, 1.0), 0], (np.cos(a / 2), 0, np.sin(a / 2), 0), True, 0.06)
        solver.step(FRAME, [hand])
    box = solver.bodies()[top]
    assert box.held
    assert_allclose(box.centroid, corner + [-0.05, 0.25, 0.05], atol=5e-3)
    assert_allclose(solver.hand_forces()[0], [0, 9.81, 0], atol=0.1)
    physics_contact.run(solver, 1.0)
    assert solver.bodies()[top].centroid[1] < start[1] + 0.2  # let go


def test_a_hand_turns_a_heavy_box_slowly(place):
    """100 kg: by what the torque of a hand gives in a twentieth of a second, and not at once by the radian it turns."""
    solver, where = physics_contact.started(place)
    b = where["heavy_on_light"].stop - 1
    corner = solver.bodies()[b].centroid + SIDE / 2
    for k in range(5):
        a = 1.0 if k > 1 else 0.0
        solver.step(FRAME, [Hand(corner, (np.cos(a / 2), 0, np.sin(a / 2), 0), True, 0.06)])
    assert solver.bodies()[b].held
    x = solver.x.to_numpy()[solver.vertex_offset[b] :]
    edge = x[4] - x[0]  # along x at the start
    assert np.abs(np.arctan2(-edge[2], edge[0])) < 0.2


def test_transform_mode_moves_a_box(place):
    solver, where = physics_contact.started(place)
    top = where["stack"].start + 4
    corner = solver.bodies()[top].centroid + SIDE / 2
    solver.interaction = "transform"
    for k in range(3):
        solver.step(FRAME, [Hand(corner + [0.1 * k, 0.2 * k, 0], (1, 0, 0, 0), True, 0.06)])
    solver.interaction = "physics"
    moved = solver.bodies()[top].centroid
    assert_allclose(moved, corner - SIDE / 2 + [0.2, 0.4, 0], atol=1e-5)
    solver.step(FRAME)
    assert_allclose(solver.bodies()[top].centroid, moved, atol=2e-3)  # it begins to fall from there


def test_contact_forces_carry_the_weights(place):
    solver, where = physics_contact.started(place)
    physics_contact.run(solver, 1.0)
    forces = solver.contact_forces()[where["stack"]]
    assert_allclose(forces, np.tile([0, 9.81, 0], (5, 1)), atol=0.04)  # 1 kg each, whatever stands on it
    for k, box in enumerate(solver.bodies()[where["aligned"]]):  # no corner is pushed off sideways at an edge
        assert_allclose(box.centroid, (0, (k + 0.5) * SIDE, 22), atol=1e-4)
    group = where["sliding"].start * (MAX_BODIES + 1) + WORLD
    assert 4 <= solver.contacts.rigid_search.size[group] <= 8  # between its corners a box needs no contacts


def test_a_stack_at_rest_takes_one_pass_over_its_contacts(ti_cpu):
    boxes = [RigidBody.box("box", (SIDE,) * 3, density=500.0, position=(0, (k + 0.5) * SIDE, 0)) for k in range(3)]
    solver = Solver(boxes, [Plane((0, 0, 0), (0, 1, 0), 0.5)], sleep=False, substep=5e-4)
    table, needed = solver.contacts.constraints, []
    for _ in range(40):
        solver.step(FRAME)
        needed.append(table.changed.to_numpy().sum())
    assert table.passes == 4 and max(needed) > 0 and needed[-10:] == [0] * 10


def test_a_box_that_starts_asleep_stays_until_something_reaches_it(ti_cpu):
    still, falling = ((0.0, 1.0, 0.0), True), ((0.0, 1.15, 0.0), False)
    boxes = [RigidBody.box("box", (SIDE,) * 3, density=500.0, position=p, asleep=a) for p, a in (still, falling)]
    solver = Solver(boxes, [Plane((0, 0, 0), (0, 1, 0), 0.5)])
    solver.step(FRAME)
    assert solver.bodies()[0].centroid[1] > 0.99999 and solver.stats["asleep"] == 1
    for _ in range(20):
        solver.step(FRAME)
    assert solver.stats["asleep"] == 0 and solver.bodies()[0].centroid[1] < 0.95


def test_the_contacts_between_two_boxes_are_at_the_corners_of_what_touches(place):
    """Those left out lie within the hull of the others."""
    solver, where = physics_contact.started(place)
    physics_contact.run(solver, 0.5)
    f, samples = solver.contacts.rigid_search, solver.contacts.samples
    shape, entry = f.shape.to_numpy(), f.entry.to_numpy()
    at = f.position.to_numpy()[:, [0, 2]]
    body = np.tile(samples.body.to_numpy(), SLOTS)
    for lower in range(where["stack"].start, where["stack"].stop - 1):
        group = lower * (MAX_BODIES + 1) + lower + 1
        kept = entry[f.group_begin[group] : f.group_begin[group] + f.size[group]]
        pairs = np.stack([body, shape - MAX_SHAPES], 1)
        found = np.flatnonzero((np.sort(pairs, axis=1) == (lower, lower + 1)).all(1))
        assert set(kept) < set(found) and len(kept) < len(found) / 3
        sides = ConvexHull(at[kept]).equations
        assert (at[found] @ sides[:, :2].T + sides[:, 2]).max() < 2e-5


def test_a_snapshot_is_gone_on_from(place):
    solver, where = physics_contact.started(place)
    physics_contact.run(solver, 0.25)
    kept, ends = solver.snapshot(), []
    for _ in range(2):
        solver.restore(kept)
        physics_contact.run(solver, 0.25)
        ends.append(solver.x.to_numpy())
    assert np.array_equal(*ends)
    physics_contact.started(place)
    physics_contact.run(solver, 0.5)
    bounced = where["bouncing"].stop - 2  # the liveliest box has met the floor in between
    assert_allclose(solver.bodies()[bounced].centroid, ends[0][solver.vertex_offset[bounced] :][:8].mean(0), atol=1e-3)


def test_runs_repeat_bit_for_bit(place):
    solver, _ = place
    ends = []
    for _ in range(2):
        physics_contact.started(place)
        physics_contact.run(solver, 0.7)
        ends.append(solver.x.to_numpy())
    assert np.array_equal(*ends)


def test_what_cannot_be_is_said(place):
    solver, where = place
    with pytest.raises(BadInput, match="only a kinematic rigid body"):
        solver.kinematic.drive(where["stack"].start, (0, 0, 0))
    with pytest.raises(BadInput, match="span no convex piece"):
        RigidBody.convex("flat", np.eye(3), density=1000.0)
    with pytest.raises(BadInput, match="restitution"):
        RigidBody.box("rubber", (1, 1, 1), density=1000.0, restitution=1.5).check()
