"""Bodies that a pressure wave crosses many times in a usual substep: light, stiff, nearly incompressible."""

import numpy as np
import pytest

from scenes.scene import Material, Plane
from sim.body import SoftBody
from sim.parts import Part
from sim.solver import Solver
from sim.stability import CROSSINGS, DESCENT_SUBSTEPS, SHORTEST, bearable, choose_plan, wave_speed
from tests.meshes import box
from tests.torus import torus

HEIGHT = 0.12  # [m]
FRAME = 1 / 60


def test_what_is_light_and_stiff_gets_shorter_substeps_or_is_softer():
    usual = FRAME / DESCENT_SUBSTEPS
    assert choose_plan(1e12, frame_dt=FRAME, crossing=usual).substep == usual
    assert choose_plan(1e12, frame_dt=FRAME, crossing=usual / 20).substep == pytest.approx(CROSSINGS * usual / 20)
    wood = Material(1e8, 0.3, 500.0)
    assert bearable(wood, 0.2) is wood
    straw = bearable(Material(1e8, 0.49, 10.0), 0.06)
    assert straw.young < 1e8 and straw.density == 10.0
    assert wave_speed(straw) * SHORTEST == pytest.approx(CROSSINGS * 0.06)
    assert wave_speed(Material(1e6, 0.0, 1000.0)) == pytest.approx(np.sqrt(1e6 / 1000))  # then lambda_L + 2 mu = E


def test_it_does_not_jump_from_the_floor(ti_cpu):
    """With 64 substeps a frame a contact stored many times the body's energy, and three of four were thrown higher."""
    shapes = [torus(0.03, 0.01, around=12, across=1), box((0.08, 0.02, 0.02), (4, 1, 1))]
    rng = np.random.default_rng(2)
    bodies = []
    for k in range(12):
        x, tets, surface = shapes[k % 2]
        q = rng.normal(size=4)
        place = {"position": (0.2 * (k % 4), HEIGHT, 0.2 * (k // 4)), "rotation": tuple(q / np.linalg.norm(q))}
        material = Material(1e8, 0.49, (10.0, 100.0)[k % 4 // 2], 0.5)
        bodies.append(SoftBody(f"body {k}", x - x.mean(0), tets, surface, material, **place))
    solver = Solver(bodies, [Plane((0, 0, 0), (0, 1, 0))])
    assert solver.stats["path"] == "descent" and solver.stats["dt"] == pytest.approx(SHORTEST, rel=0.05)
    mass, owner = solver.state.mass.to_numpy(), np.repeat(range(12), [len(b.vertices) for b in bodies])
    dropped = 9.81 * HEIGHT * np.bincount(owner, mass[: len(owner)])
    for _ in range(30):
        solver.step(FRAME)
        v = solver.snapshot()["v"].astype(np.float64)
        kinetic = np.bincount(owner, 0.5 * mass[: len(v)] * (v**2).sum(1))
        assert (kinetic < 1.5 * dropped).all()
    assert (solver.snapshot()["x"][:, 1] < 3 * HEIGHT).all()


def test_a_part_tells_how_it_is_simulated():
    x, tets, surface = box((0.06, 0.06, 0.06), (1, 1, 1))
    part = Part.of(SoftBody("straw", x, tets, surface, Material(1e8, 0.49, 10.0)), [])
    assert part.material.young < part.body.material.young
    assert part.crossing == pytest.approx(SHORTEST / CROSSINGS)
    assert part.scaled(10.0).material.young == 1e8  # ten times as long to cross
