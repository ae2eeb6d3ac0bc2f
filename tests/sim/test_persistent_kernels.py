"""Persistent kernels against the plain loops; on the CPU they are one thread."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from bench.physics import box
from core.material import Material
from core.vocabulary import Plane
from sim.bodies import RigidBody, SoftBody
from sim.elastic.patches import PLACES, RESIDENT
from sim.elastic.vbd import VBDSubsteps
from sim.elastic.vbd_persistent import PersistentVBD
from sim.elastic.xpbd import PersistentXPBD, XPBDSubsteps
from sim.model import BodyModel, Model
from sim.solver import Solver

pytestmark = pytest.mark.usefixtures("ti_cpu")


def xpbd_forms(s: Solver):
    pairs = [c for c in (s.contacts, s.rigid_bodies) if c is not None]
    yield PersistentXPBD(s.state, s.elasticity, pairs, s.rigid_bodies)
    yield XPBDSubsteps(s.state, s.elasticity, pairs, s.rigid_bodies)


def vbd_forms(s: Solver):
    pairs = [c for c in (s.contacts, s.rigid_bodies) if c is not None]
    for kind in (PersistentVBD, VBDSubsteps):
        yield kind(s.state, s.elasticity, pairs, s.rigid_bodies, s._blocks)


KINDS = [  # forms, Young's modulus [Pa], cells, options, and tolerances [m] after a 180th of a second, and at the end
    (xpbd_forms, 5e4, (6, 3, 3), {"substep": 1e-4}, (2e-6, 5e-5), False),
    pytest.param(xpbd_forms, 5e4, (6, 3, 3), {"substep": 1e-4}, (5e-6, 3e-4), True, marks=pytest.mark.long),
    (vbd_forms, 5e6, (4, 2, 2), {"integrator": "vbd"}, (4e-5, 3e-4), False),
    pytest.param(vbd_forms, 5e6, (4, 2, 2), {"integrator": "vbd"}, (4e-5, 3e-4), True, marks=pytest.mark.long),
]


@pytest.mark.parametrize(
    "forms, young, cells, options, tolerances, rigid", KINDS, ids=["xpbd", "xpbd-rigid", "vbd", "vbd-rigid"]
)
def test_the_persistent_kernel_agrees_with_the_loops(forms, young, cells, options, tolerances, rigid):
    """Two blocks on a floor, one on the other, sliding; rigid: the lower one does not deform.

    Rounding differs, and contact makes more of that in time. At last the upper block sleeps, and stays to the bit.
    """
    moved = []
    x, tets, surface = box((0.2, 0.1, 0.1), cells)
    material, n = Material(young, 0.3, 1000.0, friction=0.3), len(x)
    lower = SoftBody("lower", x, tets, surface, material, velocity=(0.5, 0.0, 0.0))
    if rigid:
        at = {"position": x.mean(0), "velocity": lower.velocity}
        lower = RigidBody.box("lower", np.ptp(x, axis=0), density=1000.0, friction=0.3, **at)
        n = len(lower.vertices)
    upper = SoftBody("upper", x, tets, surface, material, position=(0.045, 0.1, 0.01))
    solver = Solver([lower, upper], [Plane((0, 0, 0), (0, 1, 0))], **options)
    for integrator in forms(solver):
        solver.integrator = integrator
        solver.integrator.max_substeps = 16  # damping acts between launches
        solver.integrator.load(Model([BodyModel.of(b, []) for b in (lower, upper)]))
        solver.reset()
        for _ in range(3):
            solver.step(1 / 180)
            moved.append(solver.snapshot()["x"])
        solver.state.asleep[1] = 1
        solver.integrator.run(4)
        moved.append(solver.snapshot()["x"])
        assert (moved[-1][n:] == moved[-2][n:]).all() and (moved[-1][:n] != moved[-2][:n]).any()
    assert np.abs(moved[2] - np.concatenate([lower.start(), upper.start()])).max() > 0.005
    assert_allclose(moved[0], moved[4], rtol=0, atol=tolerances[0])
    assert_allclose(moved[3], moved[7], rtol=0, atol=tolerances[1])


def test_blocks_that_wait_for_others_to_end_are_noticed():
    """At a barrier they would hang. No multiprocessor holds 64 blocks of 256 threads; the CPU has one block."""
    x, tets, surface = box((0.1, 0.1, 0.1), (2, 2, 2))
    solver = Solver([SoftBody("block", x, tets, surface, Material(5e6, 0.3, 1000.0))], contacts=False)
    parts = solver.state, solver.elasticity, [], None, solver._blocks
    most, one = (PersistentVBD(*parts, per_multiprocessor=n) for n in (64, 1))
    assert one.fits() and most.fits() != one.grid.on_cuda


def test_several_patches_a_block_move_as_one():
    """More vertices than one block's shared memory holds, strained, without contact."""
    x, tets, surface = box((0.1, 0.1, 0.1), (10, 10, 10))
    body = SoftBody("block", x, tets, surface, Material(2e4, 0.3, 1000.0, damping=0.0))  # its stress lags
    start = x + 1e-3 * np.random.default_rng(0).normal(size=x.shape)
    solver, moved = Solver([body], contacts=False, integrator="vbd"), []
    persistent = PersistentVBD(solver.state, solver.elasticity, [], None, solver._blocks)
    persistent.load(Model([BodyModel.of(body, [])]))
    assert len(x) > PLACES and (persistent.patches.count[None] > RESIDENT or persistent.grid.on_cuda)
    for form in (persistent, solver.integrator):
        solver.restore({"x": start, "v": np.zeros_like(x)})
        solver.state.begin_frame(1e-3, 1e-2, 3, 0.0, -9.81, 0.0)
        solver.damping.run(0.0)
        form.run(3)
        moved.append(solver.snapshot()["x"])
    assert np.abs(moved[0] - start).max() > 1e-3
    assert_allclose(moved[0], moved[1], rtol=0, atol=1e-5)


def test_persistent_kernels_load_and_run_without_bodies():
    """As they do when the last body is removed, and before the first one comes."""
    x, tets, surface = box((0.1, 0.1, 0.1), (1, 1, 1))
    solver = Solver([SoftBody("block", x, tets, surface, Material(1e5, 0.3, 1000.0))], contacts=False)
    vbd = PersistentVBD(solver.state, solver.elasticity, [], None, solver._blocks)
    for form in (vbd, PersistentXPBD(solver.state, solver.elasticity, [], None)):
        for bodies in ([], [solver.body_models[0]], []):
            model = Model(bodies)
            solver.state.load(model)
            solver.elasticity.load(model)
            form.load(model)
            form.run(1)
        assert form.patches.own_end.to_numpy()[: form.patches.count[None]].max(initial=0) == 0
