"""Plastic flow: the return mapping against a float64 twin, its limits, and bodies that keep what was made of them."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from bench.physics import BAR, SURFACE, TETS, bent, box, flow_twin, positions, tet_energies, vibration_energy
from core.errors import BadInput
from core.material import Material
from core.vocabulary import Plane
from sim.bodies import SoftBody
from sim.elastic.vbd_persistent import PersistentVBD
from sim.elastic.xpbd import PersistentXPBD
from sim.model import Capacity, Model, motion_in_float32
from sim.solver import Solver
from sim.state import MOTION
from sim.time_step import stiffness_bounds

pytestmark = pytest.mark.usefixtures("ti_cpu")

CLAY = Material.named("clay")
Y = CLAY.yield_strain
CUBE = box((0.1, 0.1, 0.1), (3, 3, 3))
FRAME = 1 / 60


def cube(material: Material = CLAY, **place) -> SoftBody:
    return SoftBody("cube", *CUBE, material, **place)


def gradients(x: np.ndarray, inverse: np.ndarray) -> np.ndarray:
    corners = x[CUBE[1]]
    return np.swapaxes(corners[:, 1:] - corners[:, :1], 1, 2) @ inverse


def put_pressed(solver: Solver, ratio: float) -> None:
    """Put the first body at a height `ratio` times as large, at rest, with the rest shapes as they are."""
    x = solver.body_models[0].shape.vertices * [ratio**-0.5, ratio, ratio**-0.5]
    x = np.concatenate([x, *(m.body.start() for m in solver.body_models[1:])])
    solver.restore({**solver.snapshot(), **dict(zip(MOTION, motion_in_float32(x, 0 * x), strict=True))})


def press(solver: Solver, ratio: float) -> np.ndarray:
    """Press the first body, let it flow there, and return D_m^-1 of its tets."""
    put_pressed(solver, ratio)
    solver.plastic_flow.run(solver.integrator.patches)
    return solver.rest_inverses()[0]


def test_a_flow_is_the_twins_and_gains_no_energy():
    """Tets at random, most beyond the yield strain, some inverted or crushed: those stay."""
    solver = Solver([cube()], gravity=(0, 0, 0), contacts=False)
    model, yielded = solver.body_models[0], 0
    for strain in (0.1, 0.3, 1.5):
        x = CUBE[0] + strain * 0.02 * np.random.default_rng(0).normal(size=CUBE[0].shape)
        solver.restore({"x": x, "v": 0 * x})
        solver.plastic_flow.run(solver.integrator.patches)
        made, now = model.shape.inverse, solver.rest_inverses()[0].astype(np.float64)
        F = gradients(positions(solver)[0], made)
        J = np.linalg.det(F)
        expected = np.array(
            [B @ np.linalg.inv(flow_twin([f], Y)) if j > 0.5 else B for B, f, j in zip(made, F, J, strict=True)]
        )
        stiff = stiffness_bounds(expected, model.shape.volumes, 1 / model.mass[CUBE[1]], CLAY) > model.kappa
        assert_allclose(now, np.where(stiff[:, None, None], made, expected), atol=2e-5 * np.abs(expected).max())
        assert_allclose(6 * model.shape.volumes * np.linalg.det(now), 1.0, atol=2e-6)
        before, after = tet_energies(model, x)[0], tet_energies(model, x, now)[0]
        assert (after <= before + 1e-6 * before.max()).all()
        changed = np.abs(now - made).max((1, 2)) > 1e-3 * np.abs(made).max()
        assert (after[changed] < before[changed]).all()
        yielded += changed.sum()
        again = solver.rest_inverses()[0]
        solver.plastic_flow.run(solver.integrator.patches)
        assert_allclose(solver.rest_inverses()[0], again, atol=1e-5 * np.abs(again).max())  # it is on the surface
    assert yielded > 100 and stiff.any() and (J < 0).any()


def test_no_strain_below_the_quick_test_has_reached_the_yield_strain():
    """tr C J^(-2/3) > exp(-2 Y) + 2 exp(Y), in any direction."""
    e = np.random.default_rng(1).normal(size=(10_000, 3))
    e -= e.mean(1, keepdims=True)
    for Y in (1e-3, 0.05, 1.0):
        on_surface = e * Y / np.sqrt(2 / 3 * (e**2).sum(1, keepdims=True))
        assert np.exp(2 * on_surface).sum(1).min() >= np.exp(-2 * Y) + 2 * np.exp(Y) - 1e-12


@pytest.mark.parametrize("integrator", ["xpbd", "vbd"])
def test_a_lump_that_falls_stays_where_it_falls(integrator):
    """With one flow a frame, which is longer than the impact, VBD's comes back at 0.82 instead of 0.46 m/s."""
    lump, floor = cube(position=(0, 0.05, 0), velocity=(0, -4, 0)), Plane((0, 0, 0), (0, 1, 0))
    solver = Solver([lump], [floor], integrator=integrator)
    fastest = 0.0
    for _ in range(30):
        solver.step(FRAME)
        fastest = max(fastest, solver.bodies()[0].velocity[1])
    assert fastest < 0.55
    height = np.ptp(positions(solver)[0][:, 1])
    assert height < 0.095
    for _ in range(120):
        solver.step(FRAME)
    assert solver.stats["asleep"] == 1 and abs(np.ptp(positions(solver)[0][:, 1]) - height) < 2e-4


def test_a_flow_ends_where_the_substep_would_not_bear_it():
    """Pressed to a twentieth of its height. Of the substep without FLOW_STIFFENING, the energy is fifty times as large
    after."""
    solver = Solver([cube()], gravity=(0, 0, 0), contacts=False, integrator="xpbd")
    model = solver.body_models[0]
    put_pressed(solver, 0.05)
    solver.plastic_flow.run(solver.integrator.patches)
    assert_allclose(solver.rest_inverses()[0], model.shape.inverse, rtol=1e-6)  # in one go it is elastic
    for ratio in np.geomspace(1, 0.05, 100):
        put_pressed(solver, ratio)
        solver.plastic_flow.run(solver.integrator.patches)
    flowed = solver.rest_inverses()[0].astype(np.float64)
    bounds = stiffness_bounds(flowed, model.shape.volumes, 1 / model.mass[CUBE[1]], CLAY)
    assert 0.8 < bounds.max() / model.kappa.max() < 1.0001
    Fp = np.linalg.inv(np.linalg.inv(model.shape.inverse) @ flowed)
    put_pressed(solver, 1.03 * np.median(np.linalg.svd(Fp, compute_uv=False)[:, 2]))
    first, energy = vibration_energy(solver)[0], []
    for _ in range(30):
        solver.step(FRAME)
        energy.append(vibration_energy(solver)[0])
    assert max(energy) < first and energy[-1] < 0.2 * first  # what is left is stress of rest shapes that do not fit


@pytest.mark.parametrize("integrator", ["xpbd", "vbd"])
def test_a_bar_that_was_curled_keeps_its_spin(integrator):
    """The modes of VBD are those of the straight bar, along which it steps all the same."""
    b = SoftBody("bar", BAR, TETS, SURFACE, Material(1e6, 0.3, 1000.0, damping=50.0, yield_strain=0.03))
    solver = Solver([b], gravity=(0, 0, 0), contacts=False, integrator=integrator)

    def put(x: np.ndarray, v: np.ndarray) -> None:
        solver.restore({**solver.snapshot(), **dict(zip(MOTION, motion_in_float32(x, v), strict=True))})

    def spin() -> np.ndarray:
        v = solver.snapshot()["v"].astype(np.float64)
        return b.masses() @ np.cross(positions(solver)[0] - np.average(positions(solver)[0], 0, b.masses()), v)

    for angle in np.linspace(0, 3.0, 40):
        put(bent(BAR, 1.0, 1.0, angle), 0 * BAR)
        solver.plastic_flow.run(solver.integrator.patches)
    for _ in range(60):
        solver.step(FRAME)
    x = positions(solver)[0]
    assert np.ptp(x[:, 0]) < 0.8, "it stays curled"
    solver.set_material(0, replace(b.material, damping=0.0))
    put(x, np.cross([1.5, 1.0, 5.0], x - np.average(x, 0, b.masses())))
    first = spin()
    for _ in range(60):
        solver.step(FRAME)
    assert np.linalg.norm(spin() - first) < 1e-3 * np.linalg.norm(first)


@pytest.mark.parametrize("form", [PersistentXPBD, PersistentVBD])
def test_a_persistent_kernel_takes_the_rest_shapes_that_have_flowed(form):
    solver = Solver([cube()], gravity=(0, 0, 0), contacts=False, integrator="vbd" if form is PersistentVBD else "xpbd")
    parts = solver.state, solver.elasticity, [], None
    solver.integrator = form(*parts, solver._blocks) if form is PersistentVBD else form(*parts)
    solver.integrator.load(Model(solver.body_models))
    press(solver, 0.7)
    solver.restore(solver.snapshot())
    for _ in range(30):
        solver.step(FRAME)
    map_to_now = np.linalg.lstsq(CUBE[0] - CUBE[0].mean(0), positions(solver)[0] - positions(solver)[0].mean(0))[0]
    assert_allclose(np.linalg.svd(map_to_now)[1][-1], 0.7 * np.exp(Y), rtol=4e-3)  # however it has turned


def test_edits_keep_what_was_made_of_a_body():
    elastic = cube(replace(CLAY, yield_strain=None), position=(0.3, 0, 0))
    solver = Solver([cube(), elastic], contacts=False, capacity=Capacity(factor=2.0))
    made = solver.body_models[0].shape.inverse
    flowed = press(solver, 0.7)
    assert np.abs(flowed - made).max() > 0.1 * np.abs(made).max()
    solver.duplicate(0, (0, 0.3, 0))
    solver.rescale(2, 2.0)
    solver.remove(1)
    first, copy = solver.rest_inverses()
    assert_array_equal(first, flowed)
    assert_allclose(copy, flowed / 2, rtol=1e-6)
    kept = solver.snapshot()
    solver.set_material(0, Material.named("rubber"))  # springs back, as it was made
    assert_array_equal(solver.rest_inverses()[0], made.astype(np.float32))
    assert_allclose(solver.rest_inverses()[1], copy)
    solver.restore(kept)
    assert_array_equal(solver.snapshot()["rest_inverse"], kept["rest_inverse"])
    solver.reset()
    assert_array_equal(solver.rest_inverses()[0], made.astype(np.float32))
    solver.remove(1)
    solver.set_material(0, Material.named("rubber"))
    assert solver.snapshot()["rest_inverse"] is None


def test_rest_shapes_that_no_flow_can_reach_are_refused():
    solver = Solver([cube()], contacts=False)
    kept = solver.snapshot()
    flat = np.diag([0.1, 100.0, 0.1])
    for rest in (kept["rest_inverse"][1:], np.nan * kept["rest_inverse"], 1.1 * kept["rest_inverse"],
                 kept["rest_inverse"] @ flat):  # fmt: skip
        with pytest.raises(BadInput, match="rest_inverse"):
            solver.restore({**kept, "rest_inverse": rest})
