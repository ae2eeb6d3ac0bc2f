"""An episode of the soak with few soft bodies that bear their own weight, and its checks; `make soak` plays more."""

import numpy as np
import pytest

from bench.physics import bar
from sim.solver import Solver
from tests.soak.soak import EnergyAudit, Failure, soak
from tests.soak.soak_acts import Ranges

RANGES = Ranges(young=(1e2, 1e5), density=(100.0, 1e4), max_bodies=3, max_load=0.5)


def test_two_episodes_of_anything(ti_cpu):
    assert soak(0, 0.3, RANGES) == []


@pytest.mark.long
def test_two_minutes_of_anything(ti_cpu):
    assert soak(0, 2.0, RANGES) == []


@pytest.fixture(scope="module")
def solver(ti_cpu):
    return Solver([bar("bar", 1e5, 0.3, 0.0, position=(0, 0.5, 0))], contacts=False)


def check_after(solver, change) -> None:
    """Check after positions and velocities changed without the audit's knowledge."""
    solver.reset()
    audit, q = EnergyAudit(solver), solver.snapshot()
    x, v = q["x"].astype(np.float64), q["v"].astype(np.float64)
    change(x, v)
    solver.restore({"x": x, "v": v})
    audit.check()


def test_unexplained_energy_and_depth_are_found(solver):
    check_after(solver, lambda x, v: None)
    with pytest.raises(Failure, match="gained"):
        check_after(solver, lambda x, v: v.__iadd__([1.0, 0.0, 0.0]))
    with pytest.raises(Failure, match="gained"):
        check_after(solver, lambda x, v: x.__imul__([0.9, 1.0, 1.0]))
    with pytest.raises(Failure, match="behind floor or wall"):
        check_after(solver, lambda x, v: x.__isub__([0.0, 0.7, 0.0]))
