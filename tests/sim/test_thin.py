"""Nothing thin is passed: plates of 5 mm hit at 10 m/s, bodies thrown at each other, rings on a wire and on pegs."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from bench.physics import box, torus
from bench.physics_contact import linked_throws
from core.distance_grid import DistanceGrid
from core.material import Material
from core.vocabulary import Box, Capsule, Hand
from sim.bodies import SoftBody
from sim.contact.static_shapes import StaticGrid
from sim.solver import Solver
from tests.support.soft_world import vertices_of

RUBBER = Material(young=3e4, poisson=0.4, density=1100.0, friction=0.4)
THICK, SPEED, APART = 0.005, 10.0, 2.0
RING = torus(0.08, 0.016, 16, 2)
CUBE = box((0.08,) * 3, (2, 2, 2))
WIRE = 20.0  # [m] along x


def turned(axis, angle) -> np.ndarray:
    """Rotation matrix about an axis of any length."""
    return Rotation.from_rotvec(angle * np.asarray(axis) / np.linalg.norm(axis)).as_matrix()


def plate_grid(spacing=0.002) -> DistanceGrid:
    """A plate of 0.4 x 0.005 x 0.4 m about the origin."""
    half = np.array([0.2, THICK / 2, 0.2])
    low, shape = -half - 4 * spacing, np.ceil((2 * half + 8 * spacing) / spacing).astype(int) + 1
    p = np.abs(low + spacing * np.stack(np.meshgrid(*(np.arange(n) for n in shape), indexing="ij"), -1)) - half
    values = np.linalg.norm(np.maximum(p, 0), axis=-1) + np.minimum(p.max(-1), 0)
    return DistanceGrid(values.astype(np.float32), low, spacing)


@pytest.fixture(scope="module")
def plates(ti_cpu):
    """Two rings and two cubes, each above a plate of its own: a box, and a grid; at last a ring on a wire."""
    grid, bodies, shapes = plate_grid(), [], []
    for k, (mesh, gridded) in enumerate([(RING, False), (RING, True), (CUBE, False), (CUBE, True)]):
        x = mesh[0] - mesh[0].mean(0)
        bodies.append(SoftBody(f"body{k}", x, mesh[1], mesh[2], RUBBER, position=(APART * k, 0.3, 0)))
        place = (APART * k, 0.0, 0.0)
        shapes.append(StaticGrid(grid, position=place) if gridded else Box(place, (0.2, THICK / 2, 0.2)))
    shapes.append(Capsule((WIRE - 0.3, 0, 0), (WIRE + 0.3, 0, 0), 0.002))
    upright = (np.sqrt(0.5), 0, 0, np.sqrt(0.5))  # its hole looks along the wire
    bodies.append(
        SoftBody("hanging", *torus(0.08, 0.016, 24, 2), RUBBER, rotation=upright, position=(WIRE, -0.0625, 0))
    )
    return Solver(bodies, shapes, gravity=(0, 0, 0), hands=1)


@pytest.fixture(autouse=True)
def begin(request):
    if "plates" in request.fixturenames:
        plates = request.getfixturevalue("plates")
        plates.reset()
        plates.gravity = (0.0, 0.0, 0.0)


def cages(solver) -> list[SoftBody]:
    """The bodies above the plates."""
    return [m.body for m in solver.body_models[:4]]


def restart(solver, xs, vs=None) -> None:
    """Put the bodies above the plates at xs with velocities vs."""
    x, n = solver.snapshot()["x"].astype(np.float64), solver.vertex_offset[4]
    v = np.zeros_like(x)
    x[:n], v[:n] = np.concatenate(xs), 0.0 if vs is None else np.concatenate(vs)
    solver.restore({"x": x, "v": v})


def passed(solver) -> bool:
    """True if any vertex of a surface is under its plate, within the plate's outline.

    Hit faster than their waves of 5 m/s run, bodies are crushed, and a vertex inside may dive deeper for a moment.
    """
    outside = [p[np.unique(b.surface)] for p, b in zip(vertices_of(solver), cages(solver), strict=False)]
    return any(
        ((p[:, 1] < -THICK / 2) & (np.abs(p[:, 0] - APART * k) < 0.17) & (np.abs(p[:, 2]) < 0.17)).any()
        for k, p in enumerate(outside)
    )


@pytest.mark.parametrize("frame", [1 / 60, 1 / 30])
def test_a_plate_stops_what_comes_at_10_metres_a_second(plates, frame):
    """Any attitude and spin, up to 45 degrees from the normal."""
    rng = np.random.default_rng(round(1 / frame))
    for _ in range(3):
        xs, vs = [], []
        for k, b in enumerate(cages(plates)):
            x = np.asarray(b.vertices) @ turned(rng.normal(size=3), rng.uniform(0, np.pi)).T
            way = np.array([0.0, -1.0, 0.0]) + rng.uniform(0, 0.9) * np.array([1.0, 0, 0])
            way *= SPEED / np.linalg.norm(way)
            xs.append(x + (APART * k, 0.05 - x[:, 1].min() + rng.uniform(0, 0.1), 0))
            vs.append(way + np.cross(rng.normal(size=3) * 20, x))
            xs[-1] -= 0.1 * way / SPEED * (1, 0, 1)
        restart(plates, xs, vs)
        for _ in range(round(0.1 / frame)):
            plates.step(frame, [])
            assert not passed(plates)
        assert plates.stats["finite"]


def test_a_body_at_rest_that_a_hand_yanks_does_not_pass_a_plate(plates):
    """From rest, 5 cm away, to a hand's speed of 6 m/s in one frame."""
    xs = [np.asarray(b.vertices) + (APART * k, 0.1, 0) for k, b in enumerate(cages(plates))]
    restart(plates, xs)
    cube = 2 * APART
    for k in range(8):
        plates.step(1 / 60, [Hand((cube, 0.1 - 0.1 * k, 0), grip=True, reach=0.05)])
        assert not passed(plates)


def test_what_is_struck_does_not_pass_a_plate(plates):
    """A cube at rest, 4 cm above a plate, by another one at 20 m/s; and a ring under the first, too."""
    rest = [np.asarray(b.vertices) for b in cages(plates)]
    place = 2 * APART
    for struck in ({3: (place, 0.08, 0.0)}, {3: (place, 0.1, 0.0), 0: (place + 0.07, 0.04, 0.0)}):
        xs = [x + (10 * APART, APART * k, 0) for k, x in enumerate(rest)]
        vs = [np.zeros_like(x) for x in rest]
        for k, at in struck.items():
            xs[k] = rest[k] + at
        xs[2], vs[2][:, 1] = rest[2] + (place, struck[3][1] + 0.09, 0), -2 * SPEED
        restart(plates, xs, vs)
        for _ in range(8):
            plates.step(1 / 60, [])
            assert all(vertices_of(plates)[k][:, 1].mean() > -0.01 for k in struck)


def test_bodies_thrown_at_each_other_do_not_pass(plates):
    """Cube and cube, ring and ring at 10 m/s, with no plate in the way; before they meet and after, one is above."""
    rest = [np.asarray(b.vertices) for b in cages(plates)]
    for a, b in ((2, 3), (0, 1)):
        xs = [x + (APART * k, 5.0, 0) for k, x in enumerate(rest)]
        vs = [np.zeros_like(x) for x in rest]
        tilt = turned((1, 0, 0), 0.2)
        xs[a], xs[b] = rest[a] @ tilt + (-3, 0.1, 0), rest[b] + (-3 + 0.01 * a, -0.1, 0)
        vs[a][:, 1] = -SPEED
        restart(plates, xs, vs)
        for _ in range(5):
            plates.step(1 / 60, [])
            now = vertices_of(plates)
            assert now[a][:, 1].mean() > now[b][:, 1].mean()


def test_a_wire_thinner_than_the_samples_holds_a_ring(plates):
    """A ring with samples 4 mm apart hangs on a wire of 2 mm radius."""
    plates.gravity = (0.0, -9.81, 0.0)
    for _ in range(90):
        plates.step(1 / 60, [])
    ring = plates.bodies()[4]
    assert ring.high[1] > 0.02 and -0.3 < ring.low[1] < -0.1


@pytest.mark.long
@pytest.mark.parametrize(("peg", "stretch"), [(0.02, 1.0), (0.04, 2.0), (0.08, 2.0)])
def test_rings_stay_on_their_pegs(ti_cpu, peg, stretch):
    assert linked_throws(15, peg=peg, stretch=stretch, seconds=0.5) == 15
