"""Soft bodies on the floor: what rocks comes to rest at its material's rate; what rolls, tips over or flies goes on."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from bench.physics import box, torus
from bench.physics_contact import energies, run
from core.material import Material
from core.tetmesh import boundary_surface
from core.vocabulary import Plane
from sim.bodies import SoftBody
from sim.model import Capacity, models_of
from sim.solver import Solver

FRAME = 1 / 60
PLUSH = Material.named("plush")
FLOOR = Plane((0, 0, 0), (0, 1, 0), 0.5)
CAPACITY = Capacity(vertices=1000, tets=3000, triangles=2000, samples=4000, nodes=600_000, bodies=3)


def figure():
    """A trunk of 9 x 12 x 9 cm on four feet of 3 cm, a cell thick, at the corners of its base."""
    x, tets, _ = box((0.12, 0.15, 0.12), (4, 5, 4))
    centers = x[tets].mean(1)
    at_corner = (np.abs(centers - 0.06)[:, [0, 2]] > 0.03).all(1)
    tets = tets[(centers[:, 1] > 0.03) | at_corner]
    used, tets = np.unique(tets, return_inverse=True)
    tets = tets.reshape(-1, 4)
    return x[used] - [0.06, 0, 0.06], tets, boundary_surface(tets)


def ball(radius: float, cells: int):
    """A cube mapped to a ball about the origin."""
    x, tets, surface = box((2.0,) * 3, (cells,) * 3)
    x = x - 1.0
    x *= radius * np.abs(x).max(1, keepdims=True) / np.maximum(np.linalg.norm(x, axis=1, keepdims=True), 1e-12)
    return x, tets, surface


FIGURE, CUBE, BALL = figure(), box((0.1,) * 3, (2, 2, 2)), ball(0.08, 6)


def body(mesh, material=PLUSH, turn=(0.0, 0.0, 0.0), **options) -> SoftBody:
    rotation = Rotation.from_rotvec(turn)
    x = rotation.apply(mesh[0])
    position = np.array(options.pop("position", (0.0, 0.0, 0.0))) - [0, x[:, 1].min(), 0]
    quaternion = tuple(np.roll(rotation.as_quat(), 1).tolist())
    return SoftBody("body", *mesh, material, quaternion, tuple(position.tolist()), **options)


@pytest.fixture(scope="module")
def world(ti_cpu) -> Solver:
    return Solver([body(CUBE)], [FLOOR], hands=0, self_contact=False, capacity=CAPACITY)


def put(solver: Solver, *bodies: SoftBody) -> Solver:
    solver.reset(models_of(bodies))
    return solver


def seconds_until_asleep(solver: Solver, most: float) -> list[float]:
    """Times at which the bodies fell asleep for good [s]; inf if it did not within `most`."""
    when = np.full(len(solver.body_models), np.inf)
    for k in range(round(most / FRAME)):
        solver.step(FRAME)
        asleep = solver.snapshot()["asleep"]
        when[~asleep] = np.inf
        when[asleep & np.isinf(when)] = k * FRAME
        if asleep.all():
            break
    return when.tolist()


def test_what_is_dropped_sleeps_within_seconds(world):
    put(
        world,
        body(FIGURE, position=(0, 0.05, 0), turn=(0.1, 0, 0.15)),
        body(CUBE, position=(0.6, 0.1, 0), turn=(0, 0, np.pi / 4)),
        body(torus(0.08, 0.016, 16, 2), Material.named("silicone"), position=(1.2, 0.1, 0), turn=(0.5, 0, 0.3)),
    )
    assert max(seconds_until_asleep(world, 8.0)) < 8.0


@pytest.fixture(scope="module")
def standing(world) -> np.ndarray:
    """Vertices [m] of the figure on its feet at rest."""
    put(world, body(FIGURE, replace(PLUSH, damping=20.0)))
    run(world, 2.0)
    assert np.abs(world.snapshot()["v"]).max() < 0.01
    return world.snapshot()["x"].astype(np.float64)


def rocking_rate(world: Solver, x: np.ndarray, damping: float) -> float:
    """Rate [1/s] at which the energy of the figure dies out after a push of 0.15 m/s at its top, to the side."""
    put(world, body(FIGURE, replace(PLUSH, damping=damping)))
    world.restore({"x": x, "v": x[:, 1:2] * [1.0, 0.0, 0.0]})
    kinetic = []
    for _ in range(90):
        world.step(FRAME)
        kinetic.append(energies(world)["kinetic"])
    k = np.array(kinetic)
    peaks = 1 + np.flatnonzero((k[1:-1] > k[:-2]) & (k[1:-1] >= k[2:]))
    assert len(peaks) > 8
    return -np.polyfit(peaks * FRAME, np.log(k[peaks]), 1)[0]


def test_what_stands_on_its_feet_rocks_at_the_rate_of_its_material(world, standing):
    """A part of the motion is not rotation about the feet: they shear and shorten."""
    rate = {c: rocking_rate(world, standing, c) for c in (0.0, 2.0, 4.0)}
    assert rate[0.0] < 0.2
    assert 0.6 * 2.0 < rate[2.0] - rate[0.0] < 2.0 and 0.6 * 4.0 < rate[4.0] - rate[0.0] < 4.0


def test_rocking_dies_out_as_fast_where_a_frame_is_one_launch(world, standing, monkeypatch):
    """As on CUDA: a search for contacts comes before each launch, and must not take away the force that brakes."""
    monkeypatch.setattr(type(world.integrator), "max_substeps", 64)
    assert 0.6 * 2.0 < rocking_rate(world, standing, 2.0) < 2.2


def test_what_rolls_is_hardly_braked(world):
    """By 0.1 a / 1.4 R of its weight: a is 1 cm, so that it lags 4 cm behind after a second, and inner friction."""
    way = []
    for c in (0.0, 2.0):
        put(world, body(BALL, Material(5e4, 0.3, 300.0, 0.8, damping=c)))
        run(world, 0.3)
        x = world.snapshot()["x"].astype(np.float64)
        world.restore({"x": x, "v": np.cross([0, 0, -1 / 0.08], x)})
        run(world, 1.0)
        way.append(world.bodies()[0].centroid[0])
    assert way[0] > 0.94 and 0.03 < way[0] - way[1] < 0.055


def test_what_tips_over_an_edge_falls_as_fast(world):
    heights = []
    for c in (0.0, 2.0):
        put(world, body(CUBE, Material(5e4, 0.3, 300.0, 0.8, damping=c), turn=(0, 0, np.pi / 4 - 0.1)))
        run(world, 0.2)
        heights.append(world.bodies()[0].centroid[1])
    assert heights[0] < 0.066
    assert_allclose(heights[1], heights[0], atol=5e-4)


def test_what_leaves_the_floor_spins_on(world):
    """As what starts in the air does. It leaves it as soon as the forces of its rest are of the past."""
    put(world, body(CUBE))
    run(world, 0.3)
    x = world.snapshot()["x"].astype(np.float64)
    assert world.contact_forces()[0, 1] > 0.0
    spins = []
    for height in (0.001, 1.0):
        world.restore({"x": x + [0, height, 0], "v": np.cross([0, 5.0, 0], x) + [0, 2.0, 0]})
        run(world, 0.35)
        q = world.snapshot()
        spins.append(world.body_models[0].mass @ np.cross(q["x"] - x, q["v"].astype(np.float64))[:, 1])
    assert_allclose(spins[0], spins[1], rtol=1e-4)


def test_forces_of_a_body_are_not_left_to_those_that_take_its_vertices(world):
    """The first body stands on vertices that then belong to the second, of which they are inner ones."""
    put(world, body(FIGURE), body(BALL, position=(0.5, 1.0, 0)))
    run(world, 0.2)
    world.remove(0)
    assert_allclose(world.contact_forces(), 0.0)
    run(world, 0.1)
    assert_allclose(world.contact_forces(), 0.0)
