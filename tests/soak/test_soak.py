"""An episode of the soak with few soft bodies that bear their own weight, and its checks; `make soak` plays more."""

from itertools import pairwise

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from bench.physics import BAR, bar, strain_energy
from bench.physics_contact import FRAME, energies
from core.vocabulary import Hand
from sim.hands.grasp import MAX_HAND_FORCE, THROW_WINDOW
from sim.model import BodyModel
from sim.solver import Solver
from tests.soak.soak import EnergyAudit, Failure, Works, inverted, soak, work
from tests.soak.soak_acts import MAX_BODIES, Hands, Ranges, generator, population

RANGES = Ranges(young=(1e2, 1e5), density=(100.0, 1e4), max_bodies=3, max_load=0.5)


def test_two_episodes_of_anything(ti_cpu):
    assert soak(0, 0.3, RANGES) == []


@pytest.mark.long
def test_two_minutes_of_anything(ti_cpu):
    assert soak(0, 2.0, RANGES) == []


def test_an_episode_is_the_same_each_time(ti_cpu):
    first, again = (population(generator(5, 3), Ranges()) for _ in range(2))
    assert 1 <= len(first) <= MAX_BODIES
    for a, b in zip(first, again, strict=True):
        assert_array_equal(a.start(), b.start())
        assert a.material == b.material
    other = population(generator(5, 4), Ranges())
    assert len(other) != len(first) or other[0].material != first[0].material


def test_hands_work_no_more_than_their_force_along_their_way():
    still, moved = Hand(grip=True), Hand(position=(0.0, 0.3, 0.4), grip=True)
    assert work(still, still) == 0
    assert_allclose(work(still, moved), MAX_HAND_FORCE * 0.5)
    assert work(Hand(), moved) == 0  # the grasp begins
    assert work(still, Hand(position=(1.0, 0.0, 0.0))) == 0


def test_a_throw_works_no_more_than_its_hand_did_just_before():
    works = Works()
    path = [Hand(position=(0.01 * k, 0.0, 0.0), grip=True) for k in range(10)]
    for before, now in pairwise(path):
        assert_allclose(works.of(before, now), MAX_HAND_FORCE * 0.01)
    assert_allclose(works.of(path[-1], Hand()), MAX_HAND_FORCE * np.ceil(THROW_WINDOW / FRAME) * 0.01)
    assert works.of(Hand(), Hand()) == 0


def test_hands_find_something_to_do():
    hands, grips = Hands(generator(0, 0)), 0
    for frame in range(600):
        grips += sum(h.grip for h in hands.at(frame / 60, [BAR]))
    assert 300 < grips < 1200


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


def test_what_was_lost_must_not_come_back(solver):
    solver.reset()
    start = solver.snapshot()
    x, v = start["x"].astype(np.float64), np.tile([1.0, 0.0, 0.0], (len(start["x"]), 1))
    solver.restore({"x": x, "v": v})
    audit = EnergyAudit(solver)
    audit.check()
    solver.restore({"x": x, "v": 0 * v})
    audit.check()
    solver.restore({"x": x, "v": v})
    with pytest.raises(Failure, match="gained"):
        audit.check()
    audit.add_work(0.6 * solver.body_models[0].mass.sum())
    audit.check()
    with pytest.raises(Failure, match="gained"):
        solver.restore({"x": x, "v": 1.3 * v})
        audit.check()


def test_what_far_stretched_tets_store_counts_when_it_comes_back_as_motion(solver):
    solver.reset()
    assert solver.stats["integrator"] == "xpbd"
    x = solver.snapshot()["x"].astype(np.float64)
    audit = EnergyAudit(solver)
    solver.restore({"x": x * [1.9, 1.0, 1.0] - [0.95, 0.0, 0.0], "v": 0 * x})
    assert energies(solver)["far"] == pytest.approx(energies(solver)["elastic"])
    audit.check()
    solver.restore({"x": x, "v": 0 * x + [1.0, 0.0, 0.0]})
    with pytest.raises(Failure, match="gained"):
        audit.check()


def test_a_body_that_an_edit_put_into_a_wall_has_time_to_come_out(solver):
    solver.reset()
    audit, q = EnergyAudit(solver), solver.snapshot()
    x = q["x"].astype(np.float64) - [0.0, 0.7, 0.0]
    solver.restore({"x": x, "v": np.zeros_like(x)})
    audit.edited("duplicate 0")
    audit.check()
    for _ in range(120):
        audit.stepped()
    with pytest.raises(Failure, match="behind floor or wall"):
        audit.check()


def test_energy_and_inversion_are_those_of_the_shape():
    part = BodyModel.of(bar("bar", 1e5, 0.0, 0.0), [])
    assert abs(strain_energy(part, BAR)) < 1e-9
    assert_allclose(strain_energy(part, BAR * [1.001, 1, 1]), 0.5 * 1e5 * 0.001**2 * 0.04, rtol=5e-3)
    assert inverted({"x": BAR, "bodies": (part,)}) == []
    assert inverted({"x": BAR * [-1, 1, 1], "bodies": (part,)}) == [0]
