"""Patches by colour: their tables, their sums against those of the plain loops; on CUDA, the persistent kernel."""

import numpy as np
import pytest
import taichi as ti
from numpy.testing import assert_allclose

from bench.sample_meshes import box
from core.errors import BadInput
from core.material import Material
from sim.elastic.patches import (
    OWN,
    PLACES,
    POINTS,
    RESIDENT,
    WORDS,
    ColorPatches,
    compact_order,
    divide_by_color,
    patch_begins,
)
from sim.elastic.vbd import VBDSubsteps, color_vertices
from sim.elastic.vbd_persistent import PersistentVBD
from sim.elastic.xpbd import PersistentXPBD
from sim.model import BodyModel, Model, RestShape, SoftBody
from sim.solver import Solver
from tests.support.persistent_kernels import assert_blocks_slide_alike

pytestmark = pytest.mark.usefixtures("ti_cpu")


@pytest.mark.parametrize("blocks", [6, 10, 40])
def test_each_vertex_has_its_tets_and_its_colour(blocks):
    """Two boxes of 343 vertices."""
    x, tets, surface = box((1.0, 1.0, 1.0), (6, 6, 6))
    order = compact_order(RestShape(x, tets, surface, None))
    order, tets = np.r_[order, order + len(x)], np.concatenate([tets, tets + len(x)])
    color = color_vertices(tets, np.arange(2 * len(x)) % 9 != 0)
    t = divide_by_color(tets, order, color, [0, len(x), 2 * len(x)], blocks, blocks)
    assert len(t["own_end"]) == blocks
    owned = []
    for patch in range(blocks):
        first, own_end, end = t["local_begin"][patch], t["own_end"][patch], t["local_begin"][patch + 1]
        local = t["local"][first:end]
        assert len(set(local)) == len(local) < PLACES
        assert len(set(local // len(x))) == 1  # of one body
        for c in range(t["colors"]):
            for begin, of in (t["own_begin"], local[: own_end - first]), (t["others_begin"], local[own_end - first :]):
                some = local[begin[patch, c] : begin[patch, c + 1]]
                assert (color[some] == c).all() and sorted(some) == sorted(of[color[of] == c])
        for k in range(first, own_end):
            slots = slice(t["slot_begin"][k], t["slot_begin"][k + 1])
            corners = tets[t["tet"][slots]]
            assert (corners[np.arange(len(corners)), t["corner"][slots]] == t["local"][k]).all()
            assert (local[t["corners"][slots]] == corners).all()
            assert len(corners) == (tets == t["local"][k]).sum()
        owned += local[: own_end - first].tolist()
    assert sorted(owned) == list(range(2 * len(x)))


def test_a_large_mesh_gets_several_patches_a_block():
    x, tets, surface = box((1.0, 1.0, 1.0), (10, 10, 10))
    order = compact_order(RestShape(x, tets, surface, None))
    color = color_vertices(tets, np.ones(len(x), bool))
    t = divide_by_color(tets, order, color, [0, len(x)], 4, 64)
    assert len(t["own_end"]) > 4 and np.diff(t["local_begin"]).max() < PLACES
    with pytest.raises(BadInput, match="1331 vertices"):
        divide_by_color(tets, order, color, [0, len(x)], 4, 4)


def test_patches_are_about_equal_and_of_one_body_each():
    assert patch_begins(np.array([0, 90, 100]), 10).tolist() == [0, 10, 20, 30, 40, 50, 60, 70, 80, 90, 100]
    assert np.diff(patch_begins(np.array([0, 300, 333, 1000]), 12)).max() <= 100
    assert patch_begins(np.array([0, 5, 9, 12]), 2) is None


def test_the_sums_are_those_of_the_plain_loops():
    """Slightly deformed, stretched, and inverted."""
    x, tets, surface = box((0.3, 0.1, 0.1), (6, 2, 2))
    left = np.flatnonzero(x[:, 0] < 1e-9)
    given = [
        SoftBody("soft", x, tets, surface, Material(2e6, 0.3, 1000.0), position=(0, 1, 0)),
        SoftBody("hard", 0.7 * x, tets, surface, Material(5e7, 0.45, 500.0), position=(0, 1, 1), pinned=left),
    ]
    solver = Solver(given, contacts=False, integrator="vbd")
    patches = ColorPatches(solver.state, 3)
    plain = VBDSubsteps(solver.state, solver.elasticity, [], None, solver._blocks)
    for part in (patches, plain):
        part.load(Model([BodyModel.of(b, []) for b in given]))
    patches_colors = patches.colors
    start = np.concatenate([b.start() for b in given])
    s, n, rng = solver.state, len(start), np.random.default_rng(1)
    f, H = ([ti.field(ti.f32, (n, k)) for _ in range(2)] for k in (3, 9))
    points, words = ti.field(ti.f64, POINTS), ti.field(ti.f32, WORDS)

    @ti.func
    def put(side: ti.template(), i, force, stiffness):
        for c in ti.static(range(9)):
            H[side][i, c] = stiffness[c // 3, c % 3]
        for c in ti.static(range(3)):
            f[side][i, c] = force[c]

    @ti.kernel
    def both():
        for i in range(n):
            force, stiffness = plain.local(i)
            put(0, i, force, stiffness)
        ti.loop_config(serialize=True)
        for patch in range(patches.count[None]):
            r = patch % RESIDENT
            patches.enter(patch, r, 0, 1, patches_colors, points, words)
            _begin, end = patches.color_range(OWN, r, patches_colors - 1, words)
            for at in range(r * PLACES, end):
                i = patches.vertex(at, words)
                b = s.body_of_vertex[i]
                force, stiffness = ti.Vector([0.0, 0.0, 0.0]), ti.Matrix.zero(ti.f32, 3, 3)
                for slot in range(patches.slot(at, words), patches.slot(at + 1, words)):
                    own, diagonal, c, _dJ, along = patches.terms(slot, r, s.mu[b], s.lam[b], points)
                    force += own
                    stiffness += diagonal * ti.Matrix.identity(ti.f32, 3) + along * c.outer_product(c)
                put(1, i, force, stiffness)

    for strain in (0.01, 0.3, 3.0):
        moved = start + strain * 0.05 * rng.normal(size=start.shape)
        solver.restore({"x": moved, "v": 0.1 * rng.normal(size=start.shape)})
        s.begin_frame(1e-3, 1e-2, 16, *solver.gravity)
        solver.damping.run(0.0)
        both()
        for pair in (f, H):
            expected, got = (a.to_numpy() for a in pair)
            assert np.abs(expected).max() > 1.0
            assert_allclose(got, expected, rtol=0, atol=1e-5 * np.abs(expected).max())


def test_a_scaled_body_keeps_its_patches_and_has_its_own_gradients():
    x, tets, surface = box((0.2, 0.1, 0.1), (3, 2, 2))
    body = SoftBody("block", x, tets, surface, Material(5e6, 0.3, 1000.0))
    solver = Solver([body, body], contacts=False)
    patches, first = ColorPatches(solver.state, 2), BodyModel.of(body, [])
    for factor in (1.0, 1.5):
        model = Model([first, first.scaled(factor)])
        patches.load(model)
        inverse = np.concatenate([s.inverse for s in model.shapes]).reshape(-1, 9)
        slots = 4 * len(inverse)
        tet = patches.tet.to_numpy()[:slots]
        got = np.stack([g.to_numpy()[:slots] for g in patches.gradient], axis=1)
        assert_allclose(got, inverse[tet], rtol=1e-6, atol=1e-6)
        assert sorted(tet) == sorted(np.repeat(np.arange(len(inverse)), 4))


def test_the_persistent_kernel_agrees_with_the_loops():
    """Rounding differs, and contact makes more of that in time. On the CPU the kernel is one thread."""

    def persistent(solver):
        return PersistentVBD(solver.state, solver.elasticity, [solver.contacts], None, solver._blocks)

    def plain(solver):
        return VBDSubsteps(solver.state, solver.elasticity, [solver.contacts], None, solver._blocks)

    assert_blocks_slide_alike([persistent, plain], 5e6, (4, 2, 2), (1e-5, 1e-4), integrator="vbd")


@pytest.mark.long
def test_the_persistent_kernel_agrees_with_the_loops_on_a_rigid_body():
    def form(kind):
        def make(solver):
            pairs, rigid = [solver.contacts, solver.rigid_bodies], solver.rigid_bodies
            return kind(solver.state, solver.elasticity, pairs, rigid, solver._blocks)

        return make

    forms = [form(PersistentVBD), form(VBDSubsteps)]
    assert_blocks_slide_alike(forms, 5e6, (4, 2, 2), (1e-5, 1e-4), rigid=True, integrator="vbd")


def test_blocks_that_wait_for_others_to_end_are_noticed(ti_cpu):
    """At a barrier they would hang. No multiprocessor holds 64 blocks of 256 threads; the CPU has one block."""
    x, tets, surface = box((0.1, 0.1, 0.1), (2, 2, 2))
    solver = Solver([SoftBody("block", x, tets, surface, Material(5e6, 0.3, 1000.0))], contacts=False)
    parts = solver.state, solver.elasticity, [], None, solver._blocks
    most, one = (PersistentVBD(*parts, per_multiprocessor=n) for n in (64, 1))
    assert one.fits() and most.fits() != one.grid.on_cuda


def test_several_patches_a_block_move_as_one(ti_cpu):
    """More vertices than one block's shared memory holds, strained, without contact."""
    x, tets, surface = box((0.1, 0.1, 0.1), (10, 10, 10))
    body = SoftBody("block", x, tets, surface, Material(5e6, 0.3, 1000.0))
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


def test_persistent_kernels_load_and_run_without_bodies(ti_cpu):
    """As they do when the last body is removed, and before the first one comes."""
    x, tets, surface = box((0.1, 0.1, 0.1), (1, 1, 1))
    solver = Solver([SoftBody("block", x, tets, surface, Material(1e5, 0.3, 1000.0))], contacts=False)
    vbd = PersistentVBD(solver.state, solver.elasticity, [], None, solver._blocks)
    for form in (vbd, PersistentXPBD(solver.state, [], None)):
        for bodies in ([], [solver.body_models[0]], []):
            model = Model(bodies)
            solver.state.load(model)
            form.load(model)
            form.run(1)
        assert form.patches.own_end.to_numpy()[: form.patches.count[None]].max(initial=0) == 0
