"""Bodies that start inside one another, a wall or the floor come out gently, whatever their stiffness."""

from dataclasses import replace

import numpy as np
import pytest

from bench.physics import box
from bench.physics_contact import FRAME, SIDE, run
from core.material import Material
from core.vocabulary import Capsule, Plane
from sim.bodies import SoftBody
from sim.solver import Solver

DEPTH = 0.04  # [m]
STIFFNESSES = (1e4, 1e5 / 6, 1e6, 1e8)  # [Pa]
POLE = (0.1, 0.4, 0.1)  # [m]


@pytest.fixture(scope="module", params=["xpbd", "vbd"])
def solver(request, ti_cpu):
    """Two cubes DEPTH inside one another, one in a wall, and a pole in the floor. A rigid one: `kept` of bench."""
    cube, pole = box((SIDE,) * 3, (2, 2, 2)), box(POLE, (2, 8, 2))
    m, away = Material(1e4, 0.3, 1000.0, friction=0.5), (SIDE - DEPTH) / 2

    def soft(name, position):
        return SoftBody(name, cube[0] - SIDE / 2, *cube[1:], m, position=position)

    bodies = [soft("left", (-away, 7, 0)), soft("right", (away, 7.003, 0.002))]
    bodies += [soft("in the wall", (-3 + SIDE / 2 - DEPTH, 9, 0)), SoftBody("pole", *pole, m, position=(2, -0.03, 0))]
    walls = [Plane((0, 0, 0), (0, 1, 0)), Plane((-3, 0, 0), (1, 0, 0))]
    return Solver(bodies, walls, integrator=request.param, hands=0, sleep=False)


def start(solver, young: float, gravity: float) -> None:
    for b, model in enumerate(solver.body_models):
        solver.set_material(b, replace(model.body.material, young=young))
    solver.gravity = (0.0, -gravity, 0.0)
    solver.reset()


@pytest.mark.parametrize("young", STIFFNESSES)
def test_bodies_that_start_inside_part_slowly_and_keep_momentum(solver, young):
    """40 m/s in XPBD and 12 in VBD at 1e8 Pa, if what recovers pushes as hard as what collides."""
    start(solver, young, 0.0)
    for _ in range(60):
        solver.step(FRAME)
        v = np.array([b.velocity for b in solver.bodies()])
        assert np.linalg.norm([v[0] - v[1], v[2]], axis=1).max() < 0.5
    left, right, walled, _ = solver.bodies()
    assert right.centroid[0] - left.centroid[0] > SIDE - 1e-3 and walled.low[0] > -3 - 1e-3
    assert np.linalg.norm(v[0] + v[1]) < 0.01 * np.linalg.norm(v[0])


@pytest.mark.parametrize("young", STIFFNESSES[2:])
def test_a_pole_that_starts_in_the_floor_comes_out_against_its_weight(solver, young):
    """The lowest of its vertices carry a few percent of its mass; it comes out, and friction is back."""
    start(solver, young, 9.81)
    for _ in range(60):
        solver.step(FRAME)
        assert np.linalg.norm(solver.bodies()[3].velocity) < 0.5
    assert solver.bodies()[3].low[1] > -1e-3
    solver.gravity = (1.0, -9.81, 0.0)
    run(solver, 0.5)
    assert abs(solver.bodies()[3].low[0] - 2.0) < 0.01


def test_a_thin_capsule_pushes_as_hard_as_ever(ti_cpu):
    """Of 240 rings thrown around a peg one slipped off, where a sample of the stretched ring was met 1 mm deep."""
    block = SoftBody("block", *box((SIDE,) * 3, (2, 2, 2)), Material(1e5, 0.3, 1000.0))
    rod = Capsule((SIDE / 2, SIDE - 0.02, -1.0), (SIDE / 2, SIDE - 0.02, 1.0), 0.02)
    solver = Solver([block], [rod], hands=0, sleep=False, gravity=(0.0, 0.0, 0.0))
    run(solver, 4 * FRAME)
    assert np.linalg.norm(solver.bodies()[0].velocity) > 0.5
