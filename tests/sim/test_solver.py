"""The solver's own duties: what it refuses, that runs repeat, damping, snapshots, picking, rigid editing."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from bench.physics import box, vibration_energy
from core.errors import BadInput
from core.material import Material
from sim.bodies import SoftBody
from sim.solver import MAX_FRAME_DT, Solver

pytestmark = pytest.mark.usefixtures("ti_cpu")

RUBBER = Material(young=5e4, poisson=0.4, density=1100.0, damping=2.0)
X, TETS, SURFACE = box((0.2, 0.04, 0.1), (4, 1, 2))
PLATE = SoftBody("plate", X - [0.1, 0.02, 0.05], TETS, SURFACE, RUBBER)  # flat along y
HALF_TURN_Z = (np.cos(np.pi / 4), 0.0, 0.0, np.sin(np.pi / 4))  # a quarter turn: y -> -x


@pytest.fixture(scope="module")
def two(ti_cpu) -> Solver:
    """Two plates without contact: one at the origin, one turned, at x = 1 m, moving."""
    other = replace(PLATE, name="other", rotation=HALF_TURN_Z, position=(1.0, 2.0, 3.0), velocity=(0.0, 0.0, 0.5))
    return Solver([PLATE, other], contacts=False)


@pytest.fixture
def solver(two) -> Solver:
    two.interaction = "physics"
    two.gravity = (0.0, -9.81, 0.0)
    two.reset()
    return two


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"vertices": PLATE.vertices * np.nan}, "finite"),
        ({"vertices": PLATE.vertices[:, :2]}, "shape"),
        ({"vertices": PLATE.vertices * [1, 0, 1]}, "flat or inverted"),
        ({"vertices": PLATE.vertices * [1, -1, 1]}, "flat or inverted"),
        ({"vertices": np.concatenate([PLATE.vertices, [[0, 0, 0]]])}, "no tetrahedron"),
        ({"tets": TETS + 1}, "outside"),
        ({"tets": TETS[:0]}, "tets must be"),
        ({"surface": SURFACE[:, :2]}, "surface must be"),
        ({"material": replace(RUBBER, poisson=0.5)}, "poisson"),
        ({"material": replace(RUBBER, young=0.0)}, "young"),
        ({"material": replace(RUBBER, young=1e13)}, "too stiff"),  # than diamond
        ({"material": replace(RUBBER, density=float("nan"))}, "density"),
    ],
)
def test_what_cannot_be_simulated_is_refused_by_name(change, says):
    with pytest.raises(BadInput, match=says) as error:
        Solver([replace(PLATE, **change)], contacts=False)
    assert "plate" in str(error.value) and "\n" not in str(error.value)


def test_bad_options_are_refused():
    for options in (
        {"collision_passes": 0},
        {"interaction": "magic"},
        {"integrator": "magic"},
        {"substep": 1.0},
        {"substep": 1 / 600, "integrator": "xpbd"},
    ):
        with pytest.raises(BadInput):
            Solver([PLATE], contacts=False, **options)
    with pytest.raises(BadInput):
        Solver([])


def test_the_substep_follows_the_rule_and_divides_the_frame(solver):
    solver.step(1 / 60)
    stats = solver.stats
    assert stats["substeps"] * stats["dt"] == pytest.approx(1 / 60)
    assert 0.5 * stats["stability_limit"] < stats["stability"] <= stats["stability_limit"]
    solver.step(10.0)
    assert solver.stats["substeps"] * solver.stats["dt"] == pytest.approx(MAX_FRAME_DT)
    before = solver.snapshot()
    solver.step(0.0)
    assert_array_equal(before["x"], solver.snapshot()["x"])


def test_the_integrator_follows_the_stiffness_and_is_reported(solver):
    """A material that becomes stiff goes by VBD, and back, each from the motion as it is."""
    for young, integrator in ((5e4, "xpbd"), (1e8, "vbd"), (5e4, "xpbd")):
        solver.set_material(0, replace(RUBBER, young=young))
        solver.step(1 / 60)
        stats = solver.stats
        assert (stats["integrator"], stats["collision_passes"]) == (integrator, 1)
        assert stats["iterations"] == (1 if integrator == "xpbd" else 2)
        assert (stats["stability"] > stats["stability_limit"]) == (integrator == "vbd")
    assert_allclose(solver.bodies()[0].velocity, [0, -9.81 / 20, 0], atol=1e-4)
    solver.set_material(0, RUBBER)


def test_bodies_start_where_they_are_put_and_fall_rigidly(solver):
    assert_allclose(solver.bodies()[1].axis, [-1, 0, 0], atol=1e-5)
    assert_allclose(solver.bodies()[1].velocity, [0, 0, 0.5], atol=1e-6)
    for _ in range(12):
        solver.step(1 / 60)
    first, other = solver.bodies()
    assert (first.name, other.name, first.held) == ("plate", "other", False)
    assert_allclose(first.velocity, [0, -9.81 * 0.2, 0], atol=1e-4)
    assert_allclose(other.velocity, [0, -9.81 * 0.2, 0.5], atol=1e-4)
    assert_allclose(other.centroid, [1, 2 - 0.5 * 9.81 * 0.04, 3.1], atol=2e-3)
    assert_allclose(other.high - other.low, [0.04, 0.2, 0.1], atol=1e-4)
    assert_allclose(np.abs(first.axis), [0, 1, 0], atol=1e-4)


def shaken(solver: Solver) -> dict:
    """A start with deformation and spin."""
    start = solver.snapshot()
    rng = np.random.default_rng(7)
    x = start["x"] + rng.normal(0, 1e-3, start["x"].shape)
    return {"x": x, "v": np.cross([1.0, 5.0, 2.0], x - x.mean(0)) + rng.normal(0, 0.1, x.shape)}


def test_a_run_repeats_bit_for_bit_and_resumes_from_a_snapshot(solver):
    start = shaken(solver)

    def run(frames):
        for _ in range(frames):
            solver.step(1 / 60)
        return solver.snapshot()

    solver.restore(start)
    run(5)
    middle, end = solver.snapshot(), run(5)
    solver.restore(start)
    again = run(10)
    solver.restore(middle)
    resumed = run(5)
    for name in end:
        assert_array_equal(end[name], again[name])
        assert_array_equal(end[name], resumed[name])
    assert np.abs(end["x"] - middle["x"]).max() > 1e-2


def test_damping_stops_the_shaking_and_keeps_the_rigid_motion(solver):
    """Linear and angular momentum stay; what is left after a second is rigid."""
    solver.gravity = (0.0, 0.0, 0.0)
    n, m = len(X), PLATE.masses()

    def momenta(q):
        x, v = q["x"][n:].astype(np.float64), q["v"][n:].astype(np.float64)
        r = x - m @ x / m.sum()
        return m @ v, m @ np.cross(r, v), r, v

    start = solver.snapshot()
    rng = np.random.default_rng(8)
    v = np.cross([0.0, 0.0, 1.0], start["x"] - [1, 2, 3]) + [0.1, 0, 0] + rng.normal(0, 0.05, start["x"].shape)
    solver.restore({"x": start["x"], "v": v})
    p0, L0, _, _ = momenta(solver.snapshot())
    for _ in range(120):
        solver.step(1 / 60)
    p, L, r, v = momenta(solver.snapshot())
    assert_allclose(p, p0, atol=1e-5 * np.abs(p0).max())
    assert_allclose(L, L0, atol=0.02 * np.abs(L0).max())
    inertia = (m[:, None, None] * (np.eye(3) * (r**2).sum(1)[:, None, None] - r[:, :, None] * r[:, None])).sum(0)
    rigid = p / m.sum() + np.cross(np.linalg.solve(inertia, L), r)
    assert np.sqrt(m @ ((v - rigid) ** 2).sum(1) / m.sum()) < 0.005


def test_what_is_not_rigid_in_a_motion_dies_out_at_the_rate_of_the_material(two):
    """v - rigid falls as exp(-c t), where there is hardly any stiffness to turn it round; the rigid motion stays."""
    rate, m, n = 6.0, PLATE.masses(), len(X)
    two.gravity = (0.0, 0.0, 0.0)
    two.set_material(0, replace(RUBBER, young=1.0, damping=rate))
    two.reset()
    start, squeeze = two.snapshot(), (X - m @ X / m.sum()) * [0.4, -0.3, 0.2]
    rigid = np.array([0.1, 0.0, -0.2])
    v = start["v"].astype(np.float64)
    v[:n] = squeeze + rigid
    two.restore({"x": start["x"], "v": v})
    for _ in range(6):
        two.step(1 / 60)
    after = two.snapshot()["v"][:n]
    two.set_material(0, RUBBER)
    assert_allclose(m @ after / m.sum(), rigid, atol=1e-4)
    left = ((after - rigid) * squeeze).sum() / (squeeze**2).sum()
    assert left == pytest.approx(np.exp(-rate * 0.1), rel=0.05)


def test_the_energy_of_an_undamped_body_stays_bounded_where_its_sweeps_do_not_converge():
    """A stiff bar in VBD, dt sqrt(max kappa) = 6: if the stress lagged there, too, its energy would grow fourfold."""
    x, tets, surface = box((0.3, 0.1, 0.1), (6, 2, 2))
    body = SoftBody("bar", x, tets, surface, Material(1e8, 0.3, 1000.0, damping=0.0))
    v = np.cos(np.pi * x[:, :1] / 0.3) * [0.3, 0.2, 0.0] + np.cross([0, 0, 1.0], x)
    solver = Solver([body], contacts=False, integrator="vbd", gravity=(0, 0, 0))
    solver.restore({"x": x, "v": v})
    first = body.masses() @ (v**2).sum(1) / 2
    for _ in range(8):
        solver.step(1 / 20)
        assert vibration_energy(solver)[0] < 1.01 * first


def test_pick_finds_the_nearest_surface(solver):
    assert solver.pick((0.013, 1.0, 0.007), (0, -2, 0)) == (pytest.approx(0.98, abs=1e-5), 0)
    assert solver.pick((0.013, -1.0, 0.007), (0, 1, 0)) == (pytest.approx(0.98, abs=1e-5), 0)
    assert solver.pick((1.0 - 1.0, 2.003, 3.007), (1, 0, 0)) == (pytest.approx(0.98, abs=1e-5), 1)
    assert solver.pick((5.0, 5.0, 5.0), (0, 1, 0)) is None


def test_moved_tells_of_slow_motion_too(solver):
    start = solver.snapshot()
    solver.observe()
    for k in (1, 2, 3):  # 1.1e-5 m after three steps of 2.2e-6 m along each axis
        solver.restore({"x": start["x"] + np.float32(2.2e-6) * k, "v": start["v"] * 0})
        assert solver.observe().moved == (k == 3)


def test_a_state_that_is_not_finite_is_reported(solver):
    assert solver.stats["finite"]
    solver.x[3] = [0.0, float("nan"), 0.0]
    assert not solver.stats["finite"]
    with pytest.raises(BadInput):
        solver.restore({"x": solver.snapshot()["x"], "v": solver.snapshot()["v"]})
    solver.reset()
    assert solver.stats["finite"]


def test_prescribed_vertices_move_on_at_their_velocity_and_lead_the_damping():
    x, tets, surface = box((0.2, 0.1, 0.1), (2, 1, 1))
    left = np.flatnonzero(x[:, 0] < 1e-9)
    body = SoftBody("led", x, tets, surface, Material(2e4, 0.3, 1000.0, damping=20.0), position=(0, 1, 0), pinned=left)
    solver = Solver([body], gravity=(0, 0, 0), contacts=False)
    v = np.zeros((len(x), 3))
    v[left] = [0.3, 0.0, 0.1]
    solver.restore({"x": body.start(), "v": v})
    for _ in range(60):
        solver.step(1 / 60)
    moved = solver.x.to_numpy()[: len(x)] - body.start()
    assert np.allclose(moved[left], [0.3, 0.0, 0.1], atol=1e-6)
    assert np.allclose(moved, [0.3, 0.0, 0.1], atol=2e-4)  # the rest is led along, and damping does not hold it back
