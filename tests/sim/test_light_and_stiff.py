"""Bodies that a pressure wave crosses many times in a usual substep: light, stiff, nearly incompressible."""

import numpy as np
import pytest

from bench.sample_meshes import box, torus
from core.material import Material
from scenes.scene import Plane
from sim.body_model import BodyModel
from sim.elastic.time_step import (
    MIN_VBD_SUBSTEP,
    VBD_SUBSTEPS,
    WAVE_CROSSINGS,
    choose_integration,
    clamp_stiffness,
    wave_speed,
)
from sim.soft_body import SoftBody
from sim.solver import Solver

HEIGHT, SPEED = 0.12, 5.0  # [m], [m/s]
FRAME = 1 / 60


def test_what_is_light_and_stiff_gets_shorter_substeps_or_is_softer():
    usual = FRAME / VBD_SUBSTEPS
    assert choose_integration(1e12, frame_dt=FRAME, crossing=usual).substep == usual
    assert choose_integration(1e12, frame_dt=FRAME, crossing=usual / 20).substep == pytest.approx(
        WAVE_CROSSINGS * usual / 20
    )
    wood = Material(1e8, 0.3, 500.0)
    assert clamp_stiffness(wood, 0.2) is wood
    straw = clamp_stiffness(Material(1e8, 0.49, 10.0), 0.06)
    assert straw.young < 1e8 and straw.density == 10.0
    assert wave_speed(straw) * MIN_VBD_SUBSTEP == pytest.approx(WAVE_CROSSINGS * 0.06)
    assert wave_speed(Material(1e6, 0.0, 1000.0)) == pytest.approx(np.sqrt(1e6 / 1000))  # then lambda_L + 2 mu = E


def test_it_does_not_jump_from_the_floor(ti_cpu):
    """Thrown at 5 m/s. Contacts stored 34 times the energy of a plate, and threw it."""
    shapes = [
        torus(0.03, 0.01, around=12, across=1),
        box((0.08, 0.02, 0.02), (4, 1, 1)),
        box((0.08, 0.024, 0.08), (3, 1, 3)),
        box((0.08, 0.08, 0.08), (2, 2, 2)),
    ]
    materials = [Material(1e8, 0.49, 10.0, 1.0), Material(4e7, 0.29, 21.0, 0.225)]
    rng = np.random.default_rng(2)
    bodies = []
    for k in range(16):
        x, tets, surface = shapes[k % 4]
        q, v = rng.normal(size=4), rng.normal(size=3)
        v *= SPEED / np.linalg.norm(v)
        place = {"position": (2.0 * (k % 4), HEIGHT, 2.0 * (k // 4)), "rotation": tuple(q / np.linalg.norm(q))}
        place["velocity"] = (v[0], -abs(v[1]), v[2])
        bodies.append(SoftBody(f"body {k}", x - x.mean(0), tets, surface, materials[k // 8], **place))
    solver = Solver(bodies, [Plane((0, 0, 0), (0, 1, 0))])
    assert solver.stats["integrator"] == "vbd" and solver.stats["dt"] == pytest.approx(MIN_VBD_SUBSTEP, rel=0.05)
    mass, owner = solver.state.mass.to_numpy(), np.repeat(range(16), [len(b.vertices) for b in bodies])
    weight = np.bincount(owner, mass[: len(owner)])
    for _ in range(20):
        solver.step(FRAME)
        v = solver.snapshot()["v"].astype(np.float64)
        kinetic = np.bincount(owner, 0.5 * mass[: len(v)] * (v**2).sum(1))
        assert (kinetic < 1.1 * weight * (SPEED**2 / 2 + 9.81 * HEIGHT)).all()


def test_a_part_tells_how_it_is_simulated():
    x, tets, surface = box((0.06, 0.06, 0.06), (1, 1, 1))
    part = BodyModel.of(SoftBody("straw", x, tets, surface, Material(1e8, 0.49, 10.0)), [])
    assert part.material.young < part.body.material.young
    assert part.crossing == pytest.approx(MIN_VBD_SUBSTEP / WAVE_CROSSINGS)
    assert part.scaled(10.0).material.young == 1e8  # ten times as long to cross
