"""Rigid bodies: impacts that take more than a substep, through others or into what does not give way; a round foot."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from bench.physics import box
from core.distance_grid import DistanceGrid
from core.material import Material
from core.vocabulary import Plane
from sim.bodies import RigidBody, SoftBody
from sim.model import MAX_BODIES
from sim.rigid.rigid_broad_phase import WORLD
from sim.solver import Solver

SIDE = 0.1
FOOT_SIDES = 48
ROD = np.concatenate([np.diag([0.15, 0.03, 0.05]), -np.diag([0.15, 0.03, 0.05])])


def cube(x: float, low: float, restitution: float = 0.8, **options) -> RigidBody:
    """A cube with its lower face at this height [m]."""
    position = (x, low + SIDE / 2, 0.0)
    return RigidBody.box("cube", (SIDE,) * 3, density=1000.0, position=position, restitution=restitution, **options)


def slider_and_load() -> list[RigidBody | SoftBody]:
    """A rigid box with a stiff elastic one on it, whose vertices lie over its edges."""
    x, tets, surface = box((0.2, SIDE, SIDE), (4, 2, 2))
    load = SoftBody("load", x, tets, surface, Material(5e6, 0.3, 1000.0, friction=0.3), position=(6.05, SIDE, 0.0))
    position = (6.1, SIDE / 2, SIDE / 2)
    return [RigidBody.box("slider", (0.2, SIDE, SIDE), density=1000.0, friction=0.3, position=position), load]


def rods() -> list[RigidBody]:
    """Three that come down on one end, tilted and spinning, just above the floor and without friction."""
    found = []
    for k, (slope, roll, e) in enumerate(((40, 0, 0.0), (25, 30, 0.5), (55, 70, 0.8))):
        turn = Rotation.from_euler("zx", (slope, roll), degrees=True)
        low = turn.apply(ROD)[:, 1].min()
        found.append(
            RigidBody.convex(
                "rod", ROD, density=800.0, restitution=e, friction=0.0, position=(8 + k, 1e-4 - low, 0.0),
                rotation=tuple(turn.as_quat(scalar_first=True)), velocity=(0.1, -1.0, 0.2), angular_velocity=(1, 2, -1),
            )
        )  # fmt: skip
    return found


def met() -> list[RigidBody]:
    """Two equal cubes of different restitution, one of which flies into the other."""
    return [cube(12, 1.0, 0.2), cube(12.12, 1.0, 0.7, velocity=(-2.0, 0.0, 0.0))]


@pytest.fixture(scope="module", params=["xpbd", "vbd"])
def run(ti_cpu, request) -> tuple[np.ndarray, Solver]:
    """Heights of all centres [m] in 1.5 s, (frames, bodies), and the solver after that."""
    on_two = [cube(0, 0.0), cube(0, SIDE), cube(0, 0.75)]
    wedged = [cube(2, 1e-4, velocity=(0.0, -2.0, 0.0)), cube(2, SIDE + 5e-4, kinematic=True)]
    angle = 2 * np.pi * np.arange(FOOT_SIDES) / FOOT_SIDES
    rim = SIDE * np.stack([np.cos(angle), 0 * angle, np.sin(angle)], axis=1)
    foot = RigidBody.convex("foot", np.concatenate([rim, rim + (0, SIDE, 0)]), density=1000.0, position=(4, 0, 0))
    sliding = slider_and_load() if request.param == "vbd" else []
    options = {"hands": 0, "sleep": False, "integrator": request.param}
    solver = Solver([*on_two, *wedged, foot, *sliding, *rods(), *met()], [Plane((0, 0, 0), (0, 1, 0), 0.5)], **options)
    seen = []
    for frame in range(90):
        if sliding and frame == 89:
            q, begin = solver.snapshot(), solver.vertex_offset
            q["v"][begin[6] : begin[7], 0] = 0.5
            solver.restore({"x": q["x"], "v": q["v"]})
        solver.step(1 / 60)
        seen.append([b.centroid[1] for b in solver.bodies()])
    return np.array(seen), solver


@pytest.fixture
def heights(run) -> np.ndarray:
    return run[0]


def test_what_falls_on_two_others_rebounds_from_the_floor_beneath_them(heights):
    """The floor's push comes through the two after some substeps: cut short after 4, it lifts the cube 10 cm less."""
    top = heights[:, 2]
    landed = round(60 * np.sqrt(2 * (0.75 - 2 * SIDE) / 9.81)) + 1
    assert top[landed] < 0.35
    assert 0.68 < top[landed:].max() < 0.8


def test_what_is_wedged_in_does_not_push_on(heights):
    """A cube that a plate leaves half a millimetre cannot rebound: after 16 substeps of trying it is 1 mm inside."""
    assert heights[:, 3].max() < SIDE / 2 + 5e-4 + 1e-4


def test_a_round_foot_stands_on_a_few_of_its_corners(run):
    """Contacts of a pair of bodies are solved one after another, so that each costs time."""
    heights, solver = run
    f = solver.contacts.rigid_search
    group = 5 * (MAX_BODIES + 1) + WORLD
    begin, size = f.group_begin[group], f.size[group]
    at = f.position.to_numpy()[f.entry.to_numpy()[begin : begin + size]] - solver.bodies()[5].centroid
    angle = np.linspace(0, 2 * np.pi, 100)
    support = (at[:, [0, 2]] @ np.stack([np.cos(angle), np.sin(angle)])).max(0)
    assert size <= FOOT_SIDES / 2 and support.min() > 0.97 * SIDE
    assert np.ptp(heights[:, 5]) < 1e-4


@pytest.mark.parametrize("run", ["vbd"], indirect=True)
def test_what_slides_under_an_elastic_load_is_braked_by_no_more_than_friction(run):
    """Substeps of 1e-4 s leave 0.32 of 0.5 m/s after a frame; where each pass pushed elastic vertices anew, 0.25.

    The first substeps after a restore brake too much, as a load does not take up all of the impulses at once.
    """
    slider, load = run[1].bodies()[6:8]
    assert 0.26 < slider.velocity[0] < 0.36 and 0.03 < load.velocity[0] < 0.085  # Coulomb: 0.082


def test_impacts_follow_newtons_law(run):
    """Moves the solver on, after the tests that look at the first fall.

    At a lever arm r and inverse inertia I^-1:   p = (1 + e) speed / (1/m + (r x n) I^-1 (r x n)),   dv = p n / m,
    dL = p r x n;   of two equal cubes the second leaves with (1 - e) / 2 of its speed, e the larger of their two.
    """
    solver, n = run[1], np.array([0.0, 1.0, 0.0])
    solver.reset()
    solver.gravity = (0.0, 0.0, 0.0)
    solver.step(1 / 240)
    m, first = solver.rigid_bodies, len(solver.bodies()) - 5
    for b, rod in enumerate(rods(), first):
        mass, center, inertia = rod.inertia
        R = Rotation.from_quat(rod.rotation, scalar_first=True).as_matrix()
        inertia, arms = R @ inertia @ R.T, (rod.vertices - center) @ R.T
        r = arms[arms[:, 1].argmin()]
        lever = np.cross(r, n)
        speed = -(rod.velocity + np.cross(rod.angular_velocity, r)) @ n
        p = (1 + rod.restitution) * speed / (1 / mass + lever @ np.linalg.solve(inertia, lever))
        gained = m.v.to_numpy()[b] - rod.velocity
        assert_allclose(mass * gained, p * n, atol=0.02 * p)
        L = m.angular_momentum.to_numpy()[b] - inertia @ rod.angular_velocity
        assert_allclose(L, p * lever, atol=0.02 * p * np.linalg.norm(r))
    for _ in range(3):
        solver.step(1 / 60)
    one, other = solver.bodies()[-2:]
    assert_allclose([one.velocity, other.velocity], [[-1.7, 0, 0], [-0.3, 0, 0]], atol=0.02)


def test_a_flat_foot_stands_on_its_corners_where_its_cage_is_vaulted(ti_cpu):
    """The cage's bottom is up to 2 mm above the flat one that the distance grid holds; the body leans a little."""
    x, tets, surface = box((0.4, SIDE, 0.4), (6, 1, 6))
    x = x - [0.2, 0.0, 0.2]
    low = x[:, 1] < 1e-9
    x[low, 1] = 0.002 * (1 - (x[low][:, [0, 2]] ** 2).sum(1) / 0.08)
    spacing, origin = 0.02, np.array([-0.3, -0.1, -0.3])
    at = origin + spacing * np.stack(np.meshgrid(*(np.arange(n) for n in (31, 16, 31)), indexing="ij"), axis=-1)
    q = np.abs(at - [0.0, SIDE / 2, 0.0]) - [0.2, SIDE / 2, 0.2]
    distance = np.linalg.norm(np.maximum(q, 0.0), axis=-1) + np.minimum(q.max(-1), 0.0)
    sdf = DistanceGrid(distance.astype(np.float32), origin, spacing)
    lean = (np.cos(1e-4), 0.0, 0.0, np.sin(1e-4))
    body = RigidBody("foot", x, tets, surface, 1000.0, sdf=sdf, rotation=lean, position=(0.0, 4e-5, 0.0))
    solver = Solver([body], [Plane((0, 0, 0), (0, 1, 0), 0.5)], sleep=False)
    solver.step(1e-3)
    f = solver.contacts.rigid_search
    kept = f.entry.to_numpy()[: f.size[WORLD]]
    touching = f.position.to_numpy()[kept[f.gap.to_numpy()[kept] < 2e-4]]
    assert len(touching) == 4 and (np.abs(np.abs(touching[:, [0, 2]]) - 0.2) < 1e-3).all()
