"""Elasticity gathered by the vertices against the two loops of the energy; on CUDA, the whole persistent kernel."""

import numpy as np
import pytest
import taichi as ti
from numpy.testing import assert_allclose

from bench.sample_meshes import box
from core.material import Material
from scenes.scene import Plane
from sim.body_model import BodyModel
from sim.elastic.vertex_gather import VertexGather
from sim.elastic.xpbd import XPBDSubsteps
from sim.model import Model
from sim.soft_body import SoftBody
from sim.solver import Solver

pytestmark = pytest.mark.usefixtures("ti_cpu")


def bodies() -> list[SoftBody]:
    x, tets, surface = box((0.3, 0.1, 0.1), (6, 2, 2))
    soft, hard = Material(2e4, 0.3, 1000.0), Material(5e4, 0.45, 500.0)
    left = np.flatnonzero(x[:, 0] < 1e-9)
    return [
        SoftBody("soft", x, tets, surface, soft, position=(0, 1, 0)),
        SoftBody("hard", 0.7 * x, tets, surface, hard, position=(0, 1, 1), pinned=left),
    ]


def test_the_sums_are_those_of_the_two_loops():
    """Slightly deformed, stretched, and inverted."""
    given = bodies()
    solver = Solver(given, contacts=False)
    gather = VertexGather(solver.state)
    gather.load(Model([BodyModel.of(b, []) for b in given]))
    rng = np.random.default_rng(1)
    start = np.concatenate([b.start() for b in given])
    s, e, n = solver.state, solver.elasticity, len(start)
    one, other = ti.Vector.field(3, ti.f32, n), ti.Vector.field(3, ti.f32, n)

    @ti.kernel
    def both():
        for i in range(n):
            gather.publish(i, 1)
        for t in range(s.T):
            if t < s.tet_count[None]:
                e.project_tet(t, True, True)
        for i in range(n):
            one[i] = e.correction(i)
            b = s.body_of_vertex[i]
            total = ti.Vector([0.0, 0.0, 0.0])
            for k in range(gather.begin[i], gather.begin[i + 1]):
                total += gather.correction(k, 1, gather.position[1, i], s.mu[b], s.lam[b])
            other[i] = s.inv_mass[i] * total

    for strain in (0.01, 0.3, 3.0):
        solver.restore({"x": start + strain * 0.05 * rng.normal(size=start.shape), "v": rng.normal(size=start.shape)})
        s.begin_frame(1e-4, 1e-2, 16, ti.Vector(solver.gravity))
        solver.damping.run(0.0)
        both()
        expected = one.to_numpy()
        assert np.abs(expected).max() > 1e-9
        assert_allclose(other.to_numpy(), expected, rtol=0, atol=1e-5 * np.abs(expected).max())
    # a tiny deformation: rounding in F = 1 + 1e-4 must not push a body as a whole
    free = slice(0, len(given[0].vertices))
    solver.restore({"x": start + 1e-5 * rng.normal(size=start.shape), "v": np.zeros_like(start)})
    s.begin_frame(1e-4, 1e-2, 16, ti.Vector(solver.gravity))
    solver.damping.run(0.0)
    both()
    push = s.mass.to_numpy()[free, None] * other.to_numpy()[free]
    assert np.abs(push.sum(0)).max() < 3e-7 * np.abs(push).sum()


def test_the_persistent_kernel_agrees_with_the_loops():
    """Two blocks on a floor, one on the other, sliding. Rounding differs, and contact makes more of that in time."""
    if ti.cfg.arch != ti.cuda:
        pytest.skip("the persistent kernel is for CUDA")
    moved = []
    for form in (None, XPBDSubsteps):
        x, tets, surface = box((0.2, 0.1, 0.1), (6, 3, 3))
        material = Material(5e4, 0.3, 1000.0, friction=0.3)
        lower = SoftBody("lower", x, tets, surface, material, velocity=(0.5, 0.0, 0.0))
        upper = SoftBody("upper", x, tets, surface, material, position=(0.05, 0.1, 0.0))
        solver = Solver([lower, upper], [Plane((0, 0, 0), (0, 1, 0))], substep=1e-4)
        if form:
            solver.integrator = form(solver.state, solver.elasticity, [solver.contacts], None, iterations=1)
        solver.integrator.max_substeps = 16  # damping acts between launches
        for _ in range(3):
            solver.step(1 / 180)
            moved.append(solver.snapshot()["x"])
    start = np.concatenate([lower.start(), upper.start()])
    assert np.abs(moved[2] - start).max() > 0.005
    assert_allclose(moved[0], moved[3], rtol=0, atol=2e-6)
    assert_allclose(moved[2], moved[5], rtol=0, atol=5e-5)
