"""Patches of vertices: their tables, their sums against those of the plain loops; on CUDA, the persistent kernel."""

import numpy as np
import pytest
import taichi as ti
from numpy.testing import assert_allclose

from bench.sample_meshes import box
from core.material import Material
from sim.elastic.patches import MAX_LOCAL, MAX_SLOTS, SHARED_WORDS, Patches, compact_order, divide
from sim.elastic.xpbd import PersistentXPBD, XPBDSubsteps
from sim.model import BodyModel, Model, RestShape, SoftBody
from sim.solver import Solver
from tests.support.persistent_kernels import assert_blocks_slide_alike

pytestmark = pytest.mark.usefixtures("ti_cpu")


def bodies() -> list[SoftBody]:
    x, tets, surface = box((0.3, 0.1, 0.1), (6, 2, 2))
    soft, hard = Material(2e4, 0.3, 1000.0), Material(5e4, 0.45, 500.0)
    left = np.flatnonzero(x[:, 0] < 1e-9)
    return [
        SoftBody("soft", x, tets, surface, soft, position=(0, 1, 0)),
        SoftBody("hard", 0.7 * x, tets, surface, hard, position=(0, 1, 1), pinned=left),
    ]


@pytest.mark.parametrize("blocks", [1, 3, 40])
def test_each_corner_has_one_slot_in_the_patch_of_its_vertex(blocks):
    """Eight cells a side have more corners than one patch holds, so that one block gets several."""
    x, tets, surface = box((1.0, 1.0, 1.0), (8, 8, 8))
    order = compact_order(RestShape(x, tets, surface, None))
    assert sorted(order) == list(range(len(x)))
    table = divide(tets, order, blocks)
    patches = len(table["own_end"])
    assert patches % blocks == 0
    owned = []
    for patch in range(patches):
        first, own_end, end = table["local_begin"][patch], table["own_end"][patch], table["local_begin"][patch + 1]
        local, mine = table["local"][first:end], table["local"][first:own_end]
        assert len(set(local)) == len(local) <= MAX_LOCAL
        rows = np.arange(*table["tet_begin"][patch : patch + 2])
        corners, slot = tets[table["tet"][rows]], table["slot"][rows]
        assert (local[table["corner"][rows]] == corners).all()
        own = np.isin(corners, mine)
        assert own.any(1).all() and (own == (slot >= 0)).all()
        assert sorted(slot[own]) == list(range(own.sum())) and own.sum() <= MAX_SLOTS
        for k in range(first, own_end):
            at = (slot >= table["slot_begin"][k]) & (slot < table["slot_end"][k])
            assert (corners[at] == table["local"][k]).all() and at.sum() == (tets == table["local"][k]).sum()
        owned += mine.tolist()
    assert sorted(owned) == list(range(len(x)))


def test_patches_are_compact():
    """Tets that several patches project are wasted work: less than twice as many, for patches of 90 vertices."""
    x, tets, surface = box((1.0, 1.0, 1.0), (12, 12, 12))
    order = compact_order(RestShape(x, tets, surface, None))
    assert len(divide(tets, order, 24)["tet"]) < 2.0 * len(tets)


def test_the_sums_are_those_of_the_two_loops():
    """Slightly deformed, stretched, and inverted."""
    given = bodies()
    solver = Solver(given, contacts=False)
    patches = Patches(solver.state, 3)
    patches.load(Model([BodyModel.of(b, []) for b in given]))
    rng = np.random.default_rng(1)
    start = np.concatenate([b.start() for b in given])
    s, e, n = solver.state, solver.elasticity, len(start)
    one, other = ti.Vector.field(3, ti.f32, n), ti.Vector.field(3, ti.f32, n)
    shared = ti.field(ti.f32, SHARED_WORDS)

    @ti.kernel
    def both():
        for i in range(n):
            patches.publish(i, s.x[i], s.v[i], s.dx[i], 1)
        for t in range(s.T):
            if t < s.tet_count[None]:
                e.project_tet(t)
        for i in range(n):
            one[i] = e.correction(i)
        ti.loop_config(serialize=True)
        for patch in range(patches.count[None]):
            first = patches.local_begin[patch]
            for k in range(first, patches.local_begin[patch + 1]):
                patches.stage(k, first, 1, shared)
            for k in range(patches.tet_begin[patch], patches.tet_begin[patch + 1]):
                patches.project(k, 1, shared)
            for k in range(first, patches.own_end[patch]):
                i = patches.local[k]
                other[i] = s.inv_mass[i] * patches.gather(k, shared)

    for strain in (0.01, 0.3, 3.0):
        solver.restore({"x": start + strain * 0.05 * rng.normal(size=start.shape), "v": rng.normal(size=start.shape)})
        s.begin_frame(1e-4, 1e-2, 16, *solver.gravity)
        solver.damping.run(0.0)
        both()
        expected = one.to_numpy()
        assert np.abs(expected).max() > 1e-9
        assert_allclose(other.to_numpy(), expected, rtol=0, atol=1e-5 * np.abs(expected).max())
    # a tiny deformation: rounding in F = 1 + 1e-4 must not push a body as a whole
    free = slice(0, len(given[0].vertices))
    solver.restore({"x": start + 1e-5 * rng.normal(size=start.shape), "v": np.zeros_like(start)})
    s.begin_frame(1e-4, 1e-2, 16, *solver.gravity)
    solver.damping.run(0.0)
    both()
    push = s.mass.to_numpy()[free, None] * other.to_numpy()[free]
    assert np.abs(push.sum(0)).max() < 3e-7 * np.abs(push).sum()


def test_the_persistent_kernel_agrees_with_the_loops():
    """Rounding differs, and contact makes more of that in time. On the CPU the kernel is one thread."""

    def persistent(solver):
        return PersistentXPBD(solver.state, [solver.contacts], None)

    def plain(solver):
        return XPBDSubsteps(solver.state, solver.elasticity, [solver.contacts], None)

    assert_blocks_slide_alike([persistent, plain], 5e4, (6, 3, 3), (2e-6, 5e-5), substep=1e-4)


@pytest.mark.long
def test_the_persistent_kernel_agrees_with_the_loops_on_a_rigid_body():
    def persistent(solver):
        pairs = [solver.contacts, solver.rigid_bodies]
        return PersistentXPBD(solver.state, pairs, solver.rigid_bodies)

    def plain(solver):
        pairs = [solver.contacts, solver.rigid_bodies]
        return XPBDSubsteps(solver.state, solver.elasticity, pairs, solver.rigid_bodies)

    assert_blocks_slide_alike([persistent, plain], 5e4, (6, 3, 3), (5e-6, 3e-4), rigid=True, substep=1e-4)
