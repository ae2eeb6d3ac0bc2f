"""Kernels keep within their fields, which Taichi checks when it is asked to."""

import pytest

from core.vocabulary import Capsule, Hand, Touch
from sim.solver import Solver
from tests.sim.test_fingers import DT, TABLE, R, bodies
from tests.support.runtime import runtime


@pytest.mark.long
def test_contacts_of_fingers_read_nothing_outside_of_their_fields():
    with runtime("cpu", debug=True, offline_cache=False):
        peg = Capsule((0, 0, 0.4), (0, 1, 0.4), 0.02)  # with its samples the hash has room for more than there are
        solver = Solver(bodies(), [TABLE, peg], fingers=True)
        solver.reset()
        finger = Touch((0.0, 0.03, 0.0), (0.0, 0.13, 0.0), R)
        for _ in range(3):
            solver.step(DT, [Hand(touch=(finger,))])
        assert solver.observe().moved
