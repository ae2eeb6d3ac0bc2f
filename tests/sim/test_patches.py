"""Patches of vertices, of XPBD and by colour of VBD: their tables, and their sums against the plain loops."""

import numpy as np
import pytest
import taichi as ti
from numpy.testing import assert_allclose

from bench.physics import box
from core.errors import BadInput
from core.material import Material
from sim.bodies import SoftBody
from sim.elastic.patches import (
    MAX_LOCAL,
    MAX_SLOTS,
    OWN,
    PLACES,
    POINTS,
    RESIDENT,
    SHARED_WORDS,
    WORDS,
    ColorPatches,
    Patches,
    compact_order,
    divide,
    divide_by_color,
)
from sim.elastic.vbd import VBDSubsteps, color_vertices
from sim.model import BodyModel, Model, RestShape
from sim.solver import Solver

pytestmark = pytest.mark.usefixtures("ti_cpu")


def bodies(young: float, other_young: float) -> list[SoftBody]:
    x, tets, surface = box((0.3, 0.1, 0.1), (6, 2, 2))
    soft, hard = Material(young, 0.3, 1000.0), Material(other_young, 0.45, 500.0)
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
    given = bodies(2e4, 5e4)
    solver = Solver(given, contacts=False)
    patches = Patches(solver.state, solver.elasticity, 3)
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


def test_the_sums_are_those_of_the_plain_loops():
    """Slightly deformed, stretched, and inverted."""
    given = bodies(2e6, 5e7)
    solver = Solver(given, contacts=False, integrator="vbd")
    patches = ColorPatches(solver.state, solver.elasticity, 3)
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
    patches, first = ColorPatches(solver.state, solver.elasticity, 2), BodyModel.of(body, [])
    for factor in (1.0, 1.5):
        model = Model([first, first.scaled(factor)])
        solver.elasticity.load(model)
        patches.load(model)
        inverse = np.concatenate([s.inverse for s in model.shapes]).reshape(-1, 9)
        slots = 4 * len(inverse)
        tet = patches.tet.to_numpy()[:slots]
        got = np.stack([g.to_numpy()[:slots] for g in patches.gradient], axis=1)
        assert_allclose(got, inverse[tet], rtol=1e-6, atol=1e-6)
        assert sorted(tet) == sorted(np.repeat(np.arange(len(inverse)), 4))
