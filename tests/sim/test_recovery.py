"""A body that is not finite is put back where it was; the others do not notice, and it may be edited again."""

import numpy as np
import pytest

from bench.physics import box
from core.material import Material
from core.tetmesh import tet_volumes
from core.vocabulary import Plane
from sim.bodies import SoftBody
from sim.model import Capacity
from sim.solver import Solver

DT = 1 / 60
SIZE = 0.1


def two(young: float) -> Solver:
    x, tets, surface = box((SIZE, SIZE, SIZE), (2, 2, 2))
    m = Material(young, 0.3, 500.0)
    bodies = [SoftBody(n, x, tets, surface, m, position=(k, 0.0, 0.0)) for k, n in enumerate("ab")]
    return Solver(bodies, [Plane((0, 0, 0), (0, 1, 0))], capacity=Capacity(factor=2.0))


@pytest.mark.parametrize("young, path", [(5e4, "xpbd"), pytest.param(1e8, "vbd", marks=pytest.mark.long)])
def test_a_body_that_is_not_finite_goes_back_and_rests(ti_cpu, young, path):
    solver, runs = two(young), []
    assert solver.stats["integrator"] == path
    for wrong in ("none", "velocity", "position"):
        solver.reset()
        for _ in range(20):
            solver.step(DT)
        before = solver.snapshot()["x"].astype(np.float64)
        field = {"velocity": solver.v, "position": solver.x}.get(wrong)
        count = solver.stats["recovered"]
        if field is not None:
            field[3] = [0.0, float("nan"), float("inf")]
        solver.step(DT)
        q = solver.snapshot()
        assert np.isfinite(q["x"]).all() and np.isfinite(q["v"]).all() and solver.stats["finite"]
        assert solver.stats["recovered"] == count + (field is not None)
        assert np.abs(q["x"] - before)[: solver.vertex_offset[1]].max() < 1e-3  # it is where it was
        for _ in range(60):
            solver.step(DT)
        assert solver.stats["recovered"] == count + (field is not None)  # once is enough
        q = solver.snapshot()
        runs.append(q["x"][solver.vertex_offset[1] :])
        volumes = tet_volumes(q["x"][: solver.vertex_offset[1]].astype(np.float64), q["bodies"][0].shape.tets)
        assert volumes.sum() == pytest.approx(SIZE**3, rel=0.05) and volumes.min() > 0
        assert np.abs(q["v"]).max() < 0.05
    assert np.abs(runs[1] - runs[0]).max() < 1e-4 and np.abs(runs[2] - runs[0]).max() < 1e-4  # contacts began anew
    solver.remove(0)
    solver.step(DT)
    assert solver.stats["finite"] and len(solver.bodies()) == 1
