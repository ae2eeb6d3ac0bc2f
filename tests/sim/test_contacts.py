"""Bodies against static shapes, through the solver: rest, friction, rings on pegs."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from bench.sample_meshes import box, torus
from core.material import Material
from scenes.scene import Box, Capsule, Hand, Plane
from sim.contact.signed_distance import rest_grid
from sim.contact.static_shapes import StaticGrid
from sim.soft_body import SoftBody
from sim.solver import Solver

SOFT = Material(young=3e4, poisson=0.3, density=1000.0, friction=0.5, damping=6.0)
RUBBER = Material(young=3e4, poisson=0.4, density=1100.0, friction=0.6)
FLOOR = Plane((0, 0, 0), (0, 1, 0))
DT = 1 / 60


def cube(material=SOFT, cells=2, side=0.08, **start):
    x, tets, surface = box((side,) * 3, (cells,) * 3)
    return SoftBody("cube", x - side / 2, tets, surface, material, **start)


def ring(radius=0.08, tube=0.016, around=24, **start):
    return SoftBody("ring", *torus(radius, tube, around, 2), RUBBER, **start)


def run(solver, seconds):
    for _ in range(round(seconds / DT)):
        solver.step(DT, [])


def speed(solver):
    n = solver.state.sizes.vertices
    return np.linalg.norm(solver.v.to_numpy()[:n], axis=1)


def block_grid():
    """A block of 0.4 x 0.2 x 0.4 m under y = 0, as a distance grid."""
    x, tets, surface = box((0.4, 0.2, 0.4), (2, 2, 2))
    return rest_grid(x - np.array([0.2, 0.2, 0.2]), tets, surface, nodes=40)


def test_dropped_cubes_come_to_rest_on_every_kind_of_shape(ti_cpu):
    """One cube a shape; all tops are at y = 0, but for the plane."""
    grid = block_grid()
    turned = (np.cos(0.4), 0, np.sin(0.4), 0)
    shapes = [
        Plane((0, -1, 0), (0, 1, 0)),
        Box((1, -0.1, 0), (0.2, 0.1, 0.2)),
        StaticGrid(grid, position=(2, 0, 0)),
        StaticGrid(grid, turned, (3, 0, 0), 1.3),
        Capsule((4, -0.5, -1), (4, -0.5, 1), 0.5, friction=1.0),
    ]
    tops = np.array([-1.0, 0, 0, 0, 0])
    cubes = [cube(position=(k + 0.003, tops[k] + 0.07, 0), rotation=(0.9998, 0, 0, 0.02)) for k in range(5)]
    solver = Solver(cubes, shapes, hands=0)
    run(solver, 2.5)
    low = np.array([b.low[1] for b in solver.bodies()]) - tops
    on_capsule = solver.x.to_numpy()[solver.vertex_offset[4] : solver.vertex_offset[5]] - (4, -0.5, 0)
    low[4] = np.hypot(on_capsule[:, 0], on_capsule[:, 1]).min() - 0.5
    high = np.array([b.high[1] for b in solver.bodies()]) - tops
    assert (low > -1e-3).all() and (low < 1e-4).all(), low
    assert (high > 0.07).all(), high
    assert speed(solver).max() < 2e-2  # the cube on the capsule rocks
    x = solver.x.to_numpy()
    run(solver, 0.5)
    assert np.abs(solver.x.to_numpy() - x).max() < 2e-3  # no creep; the last of the rocking
    assert speed(solver).max() < 1.5e-2


def test_of_too_many_shapes_the_nearest_count(ti_cpu):
    """Twelve floors, 0.5 mm apart, the uppermost last."""
    floors = [Plane((0, 5e-4 * (k - 11), 0), (0, 1, 0)) for k in range(12)]
    solver = Solver([cube(position=(0, 0.0405, 0))], floors, hands=0)
    run(solver, 0.3)
    assert solver.bodies()[0].low[1] > -1e-4


def test_what_cannot_carry_itself_stays_above_the_floor_with_all_it_is(ti_cpu):
    """While a hand holds it. Its inner vertex once sank by 5 m/s, held by a hundred pascals alone."""
    mud = Material(young=100.0, poisson=0.3, density=10000.0, friction=0.5)
    solver = Solver([cube(mud, side=0.16, position=(0, 0.09, 0))], [FLOOR], hands=1)
    for k in range(40):
        solver.step(DT, [Hand((0, 0.09 + 0.1 * np.sin(k / 10), 0.08), grip=True)])
    x = solver.x.to_numpy()[:27]
    assert x[:, 1].min() > -1e-3 and x[13, 1] < 0.01  # the middle one lies on the floor, as soft as it is


@pytest.fixture(scope="module")
def floor_solver(ti_cpu):
    """A stiff cube on a floor, friction 0.4."""
    stiff = Material(young=1e5, poisson=0.3, density=1000.0, friction=0.4, damping=30.0)
    return Solver([cube(stiff, position=(0, 0.04, 0))], [Plane((0, 0, 0), (0, 1, 0), 0.4)], hands=0)


def lean(solver, angle):
    """Start anew with the floor as a slope that falls by `angle` [rad] along +x."""
    solver.reset()
    solver.gravity = (9.81 * np.sin(angle), -9.81 * np.cos(angle), 0.0)


def test_energy_does_not_grow_at_rest(floor_solver):
    lean(floor_solver, 0.0)
    run(floor_solver, 2)
    before = (speed(floor_solver) ** 2).sum()
    run(floor_solver, 4)
    assert (speed(floor_solver) ** 2).sum() <= max(before, 1e-10)
    assert speed(floor_solver).max() < 5e-6
    weight = 0.08**3 * 1000 * 9.81
    assert_allclose(floor_solver.contact_forces(), [[0, weight, 0]], atol=0.02 * weight)


def test_a_sliding_cube_slows_down_by_mu_g(floor_solver):
    lean(floor_solver, 0.0)
    start = floor_solver.snapshot()
    floor_solver.restore({"x": start["x"], "v": np.zeros_like(start["x"]) + (1.5, 0, 0)})
    run(floor_solver, 0.3)
    assert_allclose(floor_solver.bodies()[0].velocity[0], 1.5 - 0.4 * 9.81 * 0.3, rtol=0.02)
    run(floor_solver, 0.6)
    assert np.abs(floor_solver.bodies()[0].velocity[0]) < 1e-2  # it swings on its base


def test_a_cube_holds_on_a_slope_one_degree_below_the_friction_angle(floor_solver):
    lean(floor_solver, np.arctan(0.4) - np.radians(1))
    run(floor_solver, 0.5)
    before = floor_solver.bodies()[0].centroid
    run(floor_solver, 2)
    assert np.linalg.norm(floor_solver.bodies()[0].centroid - before) < 1e-4


def test_a_cube_slides_on_a_slope_one_degree_above_the_friction_angle(floor_solver):
    angle = np.arctan(0.4) + np.radians(1)
    lean(floor_solver, angle)
    run(floor_solver, 0.5)
    before = floor_solver.bodies()[0].velocity[0]
    run(floor_solver, 1)
    gained = floor_solver.bodies()[0].velocity[0] - before
    assert_allclose(gained, 9.81 * (np.sin(angle) - 0.4 * np.cos(angle)), rtol=0.1)


def linked(state, peg=(0.0, 0.0), radius=0.08):
    """True if the peg (a vertical line) passes through the ring's disc."""
    n, c = state.axis, state.centroid
    foot = np.array([peg[0], 0, peg[1]])
    height = (c - foot) @ n / n[1] if abs(n[1]) > 0.05 else np.inf
    crossing = foot + np.array([0, height, 0])
    return np.linalg.norm(crossing - c) < radius


@pytest.fixture(scope="module")
def peg_solver(ti_cpu):
    """A ring above a peg of 2 cm, turned a little and not above its centre."""
    peg = Capsule((0, 0, 0), (0, 0.3, 0), 0.02)
    turned = (np.cos(0.15), np.sin(0.15), 0, 0)
    return Solver([ring(position=(0.03, 0.38, 0.02), rotation=turned)], [FLOOR, peg], hands=0)


def test_a_ring_dropped_over_a_peg_stays_linked(peg_solver):
    peg_solver.reset()
    run(peg_solver, 3)
    state = peg_solver.bodies()[0]
    assert linked(state)
    assert state.low[1] > -1e-3 and state.high[1] < 0.1
    assert speed(peg_solver).max() < 0.02


def test_rings_thrown_at_a_peg_stay_linked(peg_solver):
    """Eight throws at 5 m/s; the peg stands in the hole at the start, and that is all the freedom it has."""
    start = torus(0.08, 0.016, 24, 2)[0] + (0, 0.15, 0)
    rng = np.random.default_rng(3)
    for _ in range(8):
        direction = rng.normal(size=3) * (1, 0.4, 1)
        direction[1] = -abs(direction[1])
        velocity = 5 * direction / np.linalg.norm(direction)
        peg_solver.restore({"x": start, "v": np.zeros_like(start) + velocity})
        run(peg_solver, 0.6)
        state = peg_solver.bodies()[0]
        assert linked(state), (velocity, state)
        assert state.low[1] > -2e-3 and peg_solver.stats["finite"]


def test_a_repeated_throw_agrees_bit_for_bit(peg_solver):
    ends = []
    for _ in range(2):
        peg_solver.reset()
        run(peg_solver, 0.7)
        ends.append(peg_solver.x.to_numpy())
    assert (ends[0] == ends[1]).all()


def test_a_peg_thinner_than_the_samples_holds_a_ring(ti_cpu):
    """A ring with samples 4 mm apart hangs on a wire of 2 mm radius."""
    wire = Capsule((-0.3, 0, 0), (0.3, 0, 0), 0.002)
    x, tets, surface = torus(0.08, 0.016, 24, 2)
    upright = (np.sqrt(0.5), 0, 0, np.sqrt(0.5))  # its hole looks along the wire
    body = SoftBody("ring", x, tets, surface, RUBBER, rotation=upright, position=(0, -0.0625, 0))
    solver = Solver([body], [wire], hands=0)
    run(solver, 2)
    state = solver.bodies()[0]
    assert state.high[1] > 0.02 and -0.3 < state.low[1] < -0.1
