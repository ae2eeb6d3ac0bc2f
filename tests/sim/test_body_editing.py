"""Bodies that come, go, grow and change while the solver runs: same kernels, same memory, right physics, exact undo."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from taichi.lang import impl
from taichi.lang.kernel_impl import Kernel

from bench.physics import box
from core.errors import BadInput
from core.material import Material
from core.vocabulary import Box, Hand
from sim.bodies import SoftBody
from sim.contact.contact_samples import root_spacing
from sim.contact.static_shapes import DistanceGrids, grid_of, rest_grid
from sim.model import BodyModel, Capacity, RestShape
from sim.solver import Solver

DT = 1 / 60
JELLY = Material(young=3e4, poisson=0.3, density=1000.0, friction=0.6, damping=8.0)
TABLE = Box((0, -0.05, 0), (2.0, 0.05, 2.0))
MOTION = ("x", "v", "x_lo", "v_lo")
ROOM = Capacity(vertices=1000, tets=3000, triangles=1500, samples=1500, nodes=1_500_000, bodies=12)


def cube(name="cube", side=0.06, cells=2, **start):
    x, tets, surface = box((side,) * 3, (cells,) * 3)
    return SoftBody(name, x - side / 2, tets, surface, JELLY, **start)


CUBE = cube(position=(0.0, 0.1, 0.0))
FINE = cube("fine", 0.06, 3, position=(0.3, 0.1, 0.0))


@pytest.fixture(scope="module")
def shared_solver(ti_cpu) -> Solver:
    return Solver([CUBE, FINE], [TABLE], capacity=ROOM)


@pytest.fixture(scope="module")
def beginning(shared_solver):
    return shared_solver.snapshot()


@pytest.fixture
def solver(shared_solver, beginning):
    shared_solver.restore(beginning)
    return shared_solver


def run(solver, frames, *hands):
    for _ in range(frames):
        solver.step(DT, hands)


def motions(solver):
    q = solver.snapshot()
    return [
        {n: q[n][a:b] for n in MOTION} for a, b in zip(solver.vertex_offset, solver.vertex_offset[1:], strict=False)
    ]


def equal(a, b):
    for name in MOTION:
        assert_array_equal(a[name], b[name])


def edit_everything(solver):
    """One of each change, and steps between them."""
    i = solver.add(cube("new", position=(-0.3, 0.2, 0.0)))
    k = solver.duplicate(0, (0.0, 0.2, 0.3))
    run(solver, 1, Hand((0.3, 0.13, 0.0), grip=True))
    solver.rescale(k, 1.5)
    solver.set_material(i, replace(JELLY, young=6e4))
    run(solver, 1, Hand((0.3, 0.14, 0.0), grip=True))
    solver.remove(i)
    solver.remove(k - 1)


@pytest.mark.long
def test_two_hundred_edits_compile_and_allocate_nothing(solver, monkeypatch):
    edit_everything(solver)
    compiled, materialize = [], Kernel.materialize

    def counted(self, key=None, args=None, arg_features=None):
        if key not in self.compiled_kernels:
            compiled.append(self.func.__name__)
        materialize(self, key, args, arg_features)

    monkeypatch.setattr(Kernel, "materialize", counted)
    trees, graphs = impl.get_runtime().prog.get_snode_tree_size(), len(getattr(solver.integrator, "graphs", ()))
    solver.reset()
    start = motions(solver)
    for k in range(200):
        i = solver.add(cube("new", 0.05 + 0.01 * (k % 3), position=(-0.3, 0.2, 0.0)))
        assert i == 2
        if k % 20 == 0:
            edit_everything(solver)
        solver.remove(i)
        assert len(solver.body_models) == 2
    assert compiled == []
    assert impl.get_runtime().prog.get_snode_tree_size() == trees
    assert len(getattr(solver.integrator, "graphs", ())) <= max(graphs, 16)
    solver.reset()
    for a, b in zip(start, motions(solver), strict=True):
        equal(a, b)


def test_only_new_meshes_are_measured(solver, monkeypatch):
    """Data derived from a mesh is kept with it: a copy and its neighbours compute no samples, grids or slots again."""
    derived = []
    once = RestShape.once

    def watched(self, derive, *arguments):
        if (derive, *arguments) not in self._kept:
            derived.append(derive.__name__)
        return once(self, derive, *arguments)

    monkeypatch.setattr(RestShape, "once", watched)
    solver.duplicate(1, (0.7, 0.0, 0.0))
    solver.add(replace(FINE, vertices=FINE.vertices.copy(), position=(1.0, 0.1, 1.0)))
    solver.set_material(1, replace(JELLY, young=5e4))
    solver.remove(0)
    assert derived == []
    solver.add(cube("other", 0.07, position=(-0.3, 0.2, 0.0)))
    assert set(derived) >= {"points_of", "grid_of", "slots_of"}


def test_those_that_stay_go_on_as_if_nothing_had_happened(solver):
    run(solver, 3)
    middle = solver.snapshot()
    run(solver, 5)
    expected = motions(solver)
    solver.restore(middle)
    solver.add(cube("new", position=(-0.3, 0.2, 0.0)))
    solver.remove(0)
    run(solver, 5)
    equal(motions(solver)[0], expected[1])


def test_a_copy_behaves_as_its_original(solver):
    """Deformed and spinning, out of reach of all else."""
    q = solver.snapshot()
    rng = np.random.default_rng(1)
    x = q["x"] + rng.normal(0, 2e-3, q["x"].shape) + [0, 1.0, 0]
    solver.restore({**q, "x": x, "v": np.cross([1.0, 5.0, 2.0], x - x.mean(0)), "x_lo": 0 * x, "v_lo": 0 * x})
    aside = (1.0, 0.0, 0.0)
    k = solver.duplicate(1, aside)
    q = motions(solver)
    assert_allclose(q[k]["x"] - q[1]["x"], [aside] * len(q[k]["x"]), atol=1e-6)
    run(solver, 12)
    q = motions(solver)
    assert_allclose(q[k]["x"] - q[1]["x"], np.broadcast_to(aside, q[k]["x"].shape), atol=2e-5)
    assert_allclose(q[k]["v"], q[1]["v"], atol=5e-3)
    states = solver.bodies()
    assert states[k].name == states[1].name and not states[k].held


def test_a_copy_is_put_beside_its_original_and_starts_there(solver):
    k = solver.duplicate(0, (1.0, 1.9, 3.0))
    expected = replace(CUBE, position=(1.0, 2.0, 3.0))
    assert_allclose(motions(solver)[k]["x"], expected.start(), atol=1e-6)
    solver.reset()
    assert_allclose(motions(solver)[k]["x"], expected.start(), atol=1e-6)


def test_scaling_multiplies_masses_and_grid_and_leaves_free_fall(solver):
    run(solver, 3)
    before, grid = solver.bodies()[0], solver.body_models[0].shape.once(grid_of)
    solver.rescale(0, 2.0)
    part = solver.body_models[0]
    assert_allclose(part.mass.sum(), 8 * 0.06**3 * 1000)
    assert_allclose(part.shape.once(grid_of).values, 2 * grid.values)
    after = solver.bodies()[0]
    assert_allclose(after.centroid, before.centroid, atol=1e-6)
    assert_allclose(after.velocity, before.velocity, atol=1e-6)
    assert_allclose(after.high - after.low, 2 * (before.high - before.low), rtol=1e-4)
    solver.rescale(0, 0.5)
    assert part.shape.root is solver.body_models[0].shape  # not merely as large as it was
    solver.rescale(0, 2.0, about=(0.0, 1.0, 0.0))
    assert_allclose(solver.bodies()[0].centroid, 2 * before.centroid - [0.0, 1.0, 0.0], atol=1e-5)
    v = solver.bodies()[0].velocity[1]
    run(solver, 3)
    assert_allclose(solver.bodies()[0].velocity[1], v - 9.81 * 3 * DT, rtol=1e-4)
    stats = solver.stats
    assert stats["stability"] <= stats["stability_limit"] and stats["finite"]


def test_a_scaled_body_hangs_four_times_as_far_and_rests_on_its_own_skin(ti_cpu):
    """Sag of a bar under its weight: rho g L^2 / 2E, nu = 0; the substep follows from the mesh and the material."""
    x, tets, surface = box((0.3, 0.1, 0.1), (6, 2, 2))
    top = np.flatnonzero(x[:, 0] < 1e-9)
    material = Material(young=2e5, poisson=0.0, density=1000.0, damping=30.0)
    down = (np.sqrt(0.5), 0.0, 0.0, -np.sqrt(0.5))
    bar = SoftBody("bar", x, tets, surface, material, rotation=down, pinned=top)
    solver = Solver([bar], contacts=False)
    for young, factor in ((2e5, 1.0), (2e5, 2.0), (4e5, 1.0)):
        solver.rescale(0, factor)
        solver.set_material(0, replace(material, young=young))
        for _ in range(25):
            solver.step(1 / 20)
        length = solver.bodies()[0].high[1] - solver.bodies()[0].low[1]
        rest = np.ptp(solver.body_models[0].shape.vertices[:, 0])
        assert length - rest == pytest.approx(1000 * 9.81 * rest**2 / (2 * young), rel=0.02)


def test_a_body_keeps_its_samples_until_it_is_much_larger_and_their_depth_grows_with_it(solver):
    grid = rest_grid(FINE.vertices, FINE.tets, FINE.surface, nodes=12)
    k, samples = solver.add(replace(FINE, sdf=replace(grid, values=grid.values + 0.001))), solver.contacts.samples
    ids, weights, skin = samples.host_ids, samples.host_weights, samples.skin.to_numpy()
    assert skin.max() == pytest.approx(0.001, rel=1e-3)
    solver.rescale(k, 1.4)
    assert_array_equal(samples.host_ids, ids)
    assert_array_equal(samples.host_weights, weights)
    assert_allclose(samples.skin.to_numpy(), 1.4 * skin, rtol=1e-6)
    for factor, same in ((0.3, 1.0), (1.4, 1.0), (1.5, 0.5), (2.8, 0.5), (3.0, 0.25)):
        assert root_spacing(BodyModel.of(FINE, []).shape.scaled(factor), 1.0) == same


def test_undo_is_exact(solver):
    run(solver, 4, Hand((0.0, 0.12, 0.0), grip=True))
    before = solver.snapshot()

    def go_on():
        run(solver, 4, Hand((0.02, 0.15, 0.0), grip=True))
        return solver.snapshot()

    solver.restore(before)
    expected = go_on()
    for edit in (
        lambda: solver.remove(0),
        lambda: solver.duplicate(1, (0.1, 0.0, 0.0)),
        lambda: solver.rescale(0, 1.3),
        lambda: solver.set_material(1, replace(JELLY, density=500.0)),
        lambda: edit_everything(solver),
    ):
        solver.restore(before)
        edit()
        run(solver, 2)
        solver.restore(before)
        equal(solver.snapshot(), before)
        assert [b.held for b in solver.bodies()] == [True, False]
        equal(go_on(), expected)


def test_a_held_body_that_is_removed_leaves_the_hand_and_others_stay_held(solver):
    first, second = Hand((0.0, 0.13, 0.0), grip=True), Hand((0.3, 0.13, 0.0), grip=True)
    run(solver, 2, first, second)
    assert [b.held for b in solver.bodies()] == [True, True]
    solver.remove(0)
    assert [b.held for b in solver.bodies()] == [True]
    low = solver.bodies()[0].low[1]
    run(solver, 20, first, replace(second, position=(0.3, 0.2, 0.0)))
    assert [b.held for b in solver.bodies()] == [True]
    assert solver.bodies()[0].low[1] > low + 0.05
    assert_allclose(solver.hand_forces()[0], 0)
    assert solver.hand_forces()[1][1] > 0


def test_a_held_body_that_grows_is_not_pulled_for_it(solver):
    solver.gravity = (0.0, 0.0, 0.0)
    try:
        hand = Hand((0.0, 0.13, 0.0), grip=True)
        run(solver, 5, hand)
        solver.rescale(0, 1.4)
        run(solver, 1, hand)
        assert np.linalg.norm(solver.hand_forces()[0]) < 0.02
        assert np.abs(solver.bodies()[0].velocity).max() < 1e-3
    finally:
        solver.gravity = (0.0, -9.81, 0.0)


def test_a_body_that_was_added_meets_the_others(solver):
    run(solver, 40)
    solver.add(cube("top", position=(0.0, 0.13, 0.0)))
    run(solver, 60)
    low, top = solver.bodies()[0], solver.bodies()[2]
    assert 0.055 < top.low[1] < 0.065 and low.low[1] > -1e-3


def test_nothing_left(solver):
    solver.remove(1)
    solver.remove(0)
    run(solver, 2, Hand((0.0, 0.1, 0.0), grip=True))
    assert solver.bodies() == [] and solver.pick((0, 1, 0), (0, -1, 0)) is None
    stats = solver.stats
    assert stats["vertices"] == 0 and stats["finite"]
    empty = solver.snapshot()
    assert solver.add(CUBE) == 0
    run(solver, 2)
    assert_allclose(solver.bodies()[0].velocity[1], -9.81 * 2 * DT, rtol=1e-4)
    solver.restore(empty)
    assert solver.bodies() == []


def test_what_does_not_fit_is_refused_and_changes_nothing(solver):
    run(solver, 2)
    before = solver.snapshot()
    for edit, what in (
        (lambda: solver.add(cube("big", 0.1, 12)), "no room for .* vertices"),
        (lambda: solver.rescale(0, 20.0), "no room for .* samples"),
        (lambda: solver.set_material(0, replace(JELLY, young=-1.0)), "young"),
        (lambda: solver.set_material(0, replace(JELLY, young=1e14)), "too stiff"),
        (lambda: solver.rescale(1, 0.0), "scaled"),
        (lambda: solver.remove(2), "no body 2"),
        (lambda: solver.add(replace(CUBE, tets=CUBE.tets[:, [0, 2, 1, 3]])), "inverted"),
    ):
        with pytest.raises(BadInput, match=what):
            edit()
        equal(solver.snapshot(), before)
        assert solver.snapshot()["bodies"] == before["bodies"]


def test_without_room_for_several_a_second_body_is_refused(ti_cpu):
    """Contact between bodies is enabled when the kernels are compiled."""
    lonely = Solver([CUBE], [TABLE], hands=0)
    assert not lonely.contacts.deformable.needed
    with pytest.raises(BadInput, match="bodies"):
        lonely.add(cube("single", cells=1))


def test_a_script_of_edits_repeats_bit_for_bit_in_another_solver(solver):
    other = Solver([CUBE, FINE], [TABLE], capacity=ROOM)
    for s in (solver, other):
        edit_everything(s)
        run(s, 20)
        edit_everything(s)
        s.restore(s.snapshot())
        run(s, 5)
    equal(solver.snapshot(), other.snapshot())


def test_grids_fill_gaps_that_others_left(ti_cpu):
    x, tets, surface = box((0.1,) * 3, (1,) * 3)
    small, large = (rest_grid(x, tets, surface, nodes=n) for n in (12, 20))
    grids = DistanceGrids([small, small, large, large])
    assert grids.size < 2 * (small.values.size + large.values.size)  # each counts once
    for wanted in ([small, large, small], [large], [large, small], [small], []):
        grids.load(wanted)
        values = grids.values.to_numpy()
        for k, grid in enumerate(wanted):
            begin = grids.begin[k]
            assert_array_equal(values[begin : begin + grid.values.size], grid.values.ravel())
    other = replace(large, values=large.values + 1)
    with pytest.raises(BadInput):
        grids.check_capacity([small, large, other])


def test_a_scaled_shape_has_what_follows_from_its_own_vertices():
    scaled = BodyModel.of(FINE, []).shape.scaled(1.7)
    measured = RestShape(scaled.vertices, scaled.tets, scaled.surface, None)
    for name in ("inverse", "volumes", "vertex_volumes", "edge"):
        assert_allclose(getattr(scaled, name), getattr(measured, name), rtol=1e-9, atol=1e-12, err_msg=name)
