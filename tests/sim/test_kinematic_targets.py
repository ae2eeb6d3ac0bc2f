"""Soft bodies with rigid ones in one solver, also asleep, kinematic baskets and plates, and driven vertices."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from bench.physics import box, torus
from bench.physics_contact import run
from core.errors import BadInput
from core.material import Material
from core.vocabulary import Hand, Plane
from sim.bodies import RigidBody, SoftBody
from sim.solver import Solver

FRAME = 1 / 60
SOFT = Material(young=3e4, poisson=0.3, density=500.0, friction=0.6, damping=4.0)
FLOOR = Plane((0, 0, 0), (0, 1, 0), 0.6)
SIDE = 0.1
BRICK = (0.08, 0.08, 0.16)


def cube(name, position, side=SIDE, cells=2, **options):
    x, tets, surface = box((side,) * 3, (cells,) * 3)
    return SoftBody(name, x - side / 2, tets, surface, SOFT, position=position, **options)


def basket(center):
    """A bottom and four walls, kinematic, 0.3 m wide."""
    t, w, h = 0.02, 0.3, 0.15
    plates = [((w, t, w), (0, 0, 0))]
    plates += [((t, h, w), (s * w / 2, h / 2, 0)) for s in (-1, 1)] + [
        ((w, h, t), (0, h / 2, s * w / 2)) for s in (-1, 1)
    ]
    return [
        RigidBody.box(f"basket {k}", size, density=500.0, position=tuple(np.add(center, place)), kinematic=True)
        for k, (size, place) in enumerate(plates)
    ]


@pytest.fixture(scope="module")
def place(ti_cpu):
    """Scenes that stand far apart, and where each one's bodies are."""
    ring = SoftBody("ring", *torus(0.12, 0.03, 20, 2), SOFT, position=(4, 0.031, 0))
    x, tets, surface = box((0.4, 0.05, 0.05), (6, 1, 1))
    root = np.flatnonzero(x[:, 0] < 1e-9)
    scenes = {
        "tower": [
            *(RigidBody.box(f"brick {k}", BRICK, density=400.0, position=(0, 0.04 + 0.08 * k, 0)) for k in range(4)),
            cube("ball", (-0.4, 0.22, 0), velocity=(5.0, 0.5, 0), cells=3),
        ],
        "collision": [
            cube("soft", (8, 2, 0)),
            RigidBody.box("hard", (0.1, 0.08, 0.12), density=700.0, position=(8.16, 2.02, 0.01), velocity=(-3, 0, 0)),
        ],
        "ring": [ring, RigidBody.box("load", (0.3, 0.04, 0.12), density=500.0, position=(4, 0.085, 0))],
        "basket": [*basket((12, 0.5, 0)), cube("toy", (12, 0.57, 0)), cube("other", (12.02, 0.68, 0.02))],
        "plate": [
            RigidBody.box("plate", (1.0, 0.05, 0.4), density=500.0, position=(16, 0.5, 0), kinematic=True),
            cube("rider", (16, 0.575 + 1e-4, 0)),
        ],
        "cantilever": [SoftBody("cantilever", x, tets, surface, SOFT, position=(20, 1, 0), pinned=root)],
    }  # fmt: skip
    where, bodies = {}, []
    for name, new in scenes.items():
        where[name] = slice(len(bodies), len(bodies) + len(new))
        bodies += new
    return Solver(bodies, [FLOOR], hands=2), where, root


def started(place, gravity=(0.0, -9.81, 0.0)):
    solver, where, _ = place
    solver.gravity = gravity
    solver.reset()
    return solver, where


def momentum(solver, bodies):
    """Linear momentum, and angular momentum about the origin, of some bodies [SI], from all their vertices."""
    p, L, m = np.zeros(3), np.zeros(3), solver.rigid_bodies
    x, v, mass = (f.to_numpy().astype(np.float64) for f in (solver.x, solver.v, solver.state.mass))
    for b in range(bodies.start, bodies.stop):
        mine = slice(solver.vertex_offset[b], solver.vertex_offset[b + 1])
        q = mass[mine, None] * v[mine]
        p += q.sum(0)
        if solver.body_models[b].body.rigid:
            at = m.x.to_numpy()[b].astype(np.float64)
            L += np.cross(at, q.sum(0)) + m.angular_momentum.to_numpy()[b]
        else:
            L += np.cross(x[mine], q).sum(0)
    return p, L


@pytest.mark.long
def test_a_free_collision_of_soft_and_rigid_conserves_momentum(place):
    solver, where = started(place, (0.0, 0.0, 0.0))
    pair = where["collision"]
    p0, L0 = momentum(solver, pair)
    run(solver, 0.2)
    p, L = momentum(solver, pair)
    soft, hard = solver.bodies()[pair]
    assert soft.velocity[0] < -0.8 and hard.velocity[0] > -2.5  # they met
    assert_allclose(p, p0, atol=1e-4 * np.linalg.norm(p0))
    assert_allclose(L, L0, atol=2e-3 * np.linalg.norm(p0) * SIDE)


def test_a_soft_ball_knocks_over_a_stack_of_bricks_and_a_soft_ring_carries_one(place):
    solver, where = started(place)
    run(solver, 1.5)
    *bricks, ball = solver.bodies()[where["tower"]]
    assert max(b.centroid[1] for b in bricks) < 0.25  # the highest stood at 0.28
    assert max(b.centroid[0] for b in bricks) > 0.1
    assert min(b.low[1] for b in [*bricks, ball]) > -2e-3
    assert ball.velocity[0] < 3.0
    run(solver, 0.5)
    ring, load = solver.bodies()[where["ring"]]
    assert load.low[1] > 0.03 and ring.low[1] > -1e-3
    assert_allclose(load.centroid[[0, 2]], (4, 0), atol=5e-3)
    assert np.linalg.norm(load.velocity) < 2e-2  # the ring still swings a little
    at = [ring.centroid + [s * 0.12, 0, 0] for s in (-1, 1)]
    run(solver, FRAME, [Hand(tuple(p), grip=True, reach=0.05) for p in at])
    for k in range(60):  # lifted by two hands, the brick upon it comes along
        up = 0.25 * (k + 1) / 60
        solver.step(FRAME, [Hand(tuple(p + [0, up, 0]), grip=True, reach=0.05) for p in at])
    ring, lifted = solver.bodies()[where["ring"]]
    assert lifted.low[1] > load.low[1] + 0.15
    assert lifted.low[1] > ring.centroid[1] - 0.02


def test_a_lifted_basket_keeps_what_is_in_it(place):
    solver, where = started(place)
    pieces = range(where["basket"].start, where["basket"].start + 5)
    run(solver, 0.5)
    start = [solver.bodies()[b].centroid for b in pieces]
    for k in range(90):
        s = np.sin(0.5 * np.pi * min(k + 1, 60) / 60) ** 2
        for b, c in zip(pieces, start, strict=True):
            solver.kinematic.drive(b, c + np.array([0.4, 0.5, 0.2]) * s)
        solver.step(FRAME)
    bottom = solver.bodies()[pieces[0]].centroid
    assert_allclose(bottom, start[0] + [0.4, 0.5, 0.2], atol=1e-5)
    for toy in solver.bodies()[where["basket"]][5:]:
        assert (np.abs(toy.centroid - bottom)[[0, 2]] < 0.13).all()
        assert toy.low[1] > bottom[1] + 0.01 - 3e-3


def test_a_plate_carries_a_soft_cube_by_friction(place):
    solver, where = started(place)
    plate = where["plate"].start
    run(solver, 0.5)
    start, x = solver.bodies()[plate + 1].centroid[0], 0.0
    for k in range(60):
        x += min(k / 30, 1.0) * 0.4 * FRAME
        solver.kinematic.drive(plate, (16 + x, 0.5, 0))
        solver.step(FRAME)
    rider = solver.bodies()[plate + 1]
    assert_allclose(rider.velocity[0], 0.4, atol=0.04)
    assert_allclose(rider.centroid[0] - start, x, atol=0.01)


def test_rigid_bodies_sleep_to_the_bit_and_wake_for_a_drive_and_for_a_hit(place):
    solver, where = started(place)
    run(solver, 3.0)  # the ball comes to rest later
    bricks, plate = list(range(*where["tower"].indices(99)))[1:4], where["plate"].start
    resting = [*bricks, plate, plate + 1]
    before = solver.snapshot()
    assert before["asleep"][resting].all() and not before["asleep"].all()
    run(solver, 0.3)
    after = solver.snapshot()
    for b in resting:
        mine = slice(solver.vertex_offset[b], solver.vertex_offset[b + 1])
        for name in ("x", "x_lo", "v", "v_lo"):
            assert_array_equal(before[name][mine], after[name][mine])

    solver.kinematic.drive(plate, (16.001, 0.5, 0))
    solver.step(FRAME)
    asleep = solver.snapshot()["asleep"]
    assert asleep[bricks].all() and not asleep[[plate, plate + 1]].any()

    low = min(bricks, key=lambda b: solver.bodies()[b].low[1])
    ball, target = where["tower"].stop - 1, solver.bodies()[low].centroid
    start, velocities = solver.snapshot(), []
    mine = slice(solver.vertex_offset[ball], solver.vertex_offset[ball + 1])
    start["x"][mine] += (target + [0, 0.03, 0.3]).astype(np.float32) - start["x"][mine].mean(0)
    start["v"][mine] = [0, 0, -4.0]
    for sleeping in (True, False):
        solver.restore({**start, "asleep": start["asleep"] & sleeping})
        run(solver, 6 * FRAME)
        velocities.append(solver.bodies()[low].velocity)
    assert velocities[0][2] < -0.3
    assert_allclose(*velocities, atol=0.05)

    start["x"][mine] += (np.array([16.35, 0.6, 0]) - start["x"][mine].mean(0)).astype(np.float32)
    start["v"][mine] = 0.0
    solver.restore({**start, "asleep": before["asleep"]})  # the ball falls on the plate, which connects no bodies
    run(solver, 0.4)
    asleep = solver.snapshot()["asleep"]
    assert asleep[[plate, plate + 1]].all() and not asleep[ball]
    assert 0.56 < solver.bodies()[ball].centroid[1] < 0.58


def test_driven_vertices_move_evenly_and_shake_the_rest(place):
    solver, where = started(place, (0.0, 0.0, 0.0))
    body, root = where["cantilever"].start, place[2]
    first = solver.vertex_offset[body]
    rest = solver.x.to_numpy()[first + root].astype(np.float64)
    fastest = 0.0
    for k in range(60):
        y = 0.05 * np.sin(2 * np.pi * 2 * (k + 1) * FRAME)
        solver.kinematic.drive_vertices(body, root, rest + [0, y, 0])
        solver.step(FRAME)
        assert_allclose(solver.x.to_numpy()[first + root], rest + [0, y, 0], atol=1e-6)
        v = solver.v.to_numpy()[first : solver.vertex_offset[body + 1]]
        fastest = max(fastest, np.linalg.norm(v, axis=1).max())
        assert np.abs(v[root]).max() == 0.0  # between frames they stand still
    assert 0.3 < fastest < 4.0  # the root moves at up to 0.63 m/s; a jump in one substep would give 30
    rest[0, 1] += 0.001
    for i, x in zip(root, rest, strict=True):
        solver.kinematic.target[first + int(i)] = x.tolist()
    solver.kinematic.drive_surface(body)
    solver.step(FRAME)
    assert_allclose(solver.x.to_numpy()[first + root], rest, atol=1e-6)


def test_driven_vertices_arrive_to_the_last_bit_of_both_parts_of_their_positions(place):
    """20 m from the origin a float32 ends at 2 micrometres; what lies under it counts, where they come from too."""
    solver, where = started(place, (0.0, 0.0, 0.0))
    body, root = where["cantilever"].start, place[2]
    mine = solver.vertex_offset[body] + root
    rng, state = np.random.default_rng(0), solver.snapshot()
    x = state["x"].astype(np.float64)
    x[mine] += rng.uniform(-8e-7, 8e-7, (len(root), 3))
    solver.restore({"x": x, "v": state["v"]})
    for _ in range(2):
        target = (x[mine] + rng.uniform(-1e-4, 1e-4, (len(root), 3))).astype(np.float32)
        solver.kinematic.drive_vertices(body, root, target)
        solver.step(FRAME)
        after = solver.snapshot()
        assert_allclose(after["x"][mine].astype(np.float64) + after["x_lo"][mine], target, rtol=0, atol=2e-8)


def test_what_cannot_be_driven_is_said(place):
    solver, where, root = place
    body = where["cantilever"].start
    with pytest.raises(BadInput, match="only pinned vertices"):
        solver.kinematic.drive_vertices(body, [int(root.max()) + 1], np.zeros((1, 3)))
    with pytest.raises(BadInput, match="vertices must be finite"):
        solver.kinematic.drive_vertices(body, root, np.zeros((1, 3)))
    with pytest.raises(BadInput, match="only a kinematic"):
        solver.kinematic.drive(body, (0, 0, 0))
