"""VBD: colours, local solves and sweeps against float64 twins, and stiff bodies in motion."""

from dataclasses import replace

import numpy as np
import pytest
import taichi as ti
from numpy.testing import assert_allclose, assert_array_equal

from bench.physics import (
    BAR,
    DOWN,
    LEFT,
    RIGHT,
    TETS,
    G,
    bar,
    box,
    fem_solve,
    fem_stiffness,
    positions,
    strain_energy,
    torus,
)
from bench.physics_contact import run
from core.material import Material
from core.tetmesh import tet_volumes
from core.vocabulary import Hand, Plane
from sim.bodies import SoftBody
from sim.elastic.modal_correction import ModalCorrection
from sim.elastic.vbd import color_ranges, color_vertices
from sim.model import Capacity, Model, models_of
from sim.solver import Solver
from sim.time_step import lame

DT = 1 / 60


def test_no_tet_has_two_vertices_of_one_colour():
    for cells in ((10, 2, 2), (5, 5, 5)):
        _, tets, _ = box((1, 1, 1), cells)
        n = tets.max() + 1
        movable = np.arange(n) % 7 != 0
        color = color_vertices(tets, movable)
        assert_array_equal(color >= 0, movable)
        corners = np.sort(np.where(color[tets] >= 0, color[tets], -1 - np.arange(4)), axis=1)
        assert (np.diff(corners, axis=1) > 0).all()
        assert color.max() < 12
        order, begin = color_ranges(color)
        assert_array_equal(np.sort(order), np.flatnonzero(movable))
        for c in range(color.max() + 1):
            assert (color[order[begin[c] : begin[c + 1]]] == c).all()


class Twin:
    """Float64 twin of one body's substep problem."""

    def __init__(self, body: SoftBody, dt: float):
        self.mass, self.dt = body.masses(), dt
        self.mu, self.lam = lame(body.material)
        self.tets = np.asarray(body.tets)
        x = np.asarray(body.vertices, np.float64)[self.tets]
        D = np.swapaxes(x[:, 1:] - x[:, :1], 1, 2)
        self.inverse, self.volume = np.linalg.inv(D), np.linalg.det(D) / 6
        self.gradient = np.concatenate([-self.inverse.sum(1, keepdims=True), self.inverse], axis=1)

    def strain(self, y, t):
        p = y[self.tets[t]]
        F = np.swapaxes(p[..., 1:, :] - p[..., :1, :], -1, -2) @ self.inverse[t]
        f1, f2, f3 = np.moveaxis(F, -1, 0)
        return F, np.stack([np.cross(f2, f3), np.cross(f3, f1), np.cross(f1, f2)], -1), np.linalg.det(F)

    def energy(self, y, target):
        F, _, J = self.strain(y, slice(None))
        I1 = (F**2).sum((1, 2))
        psi = self.mu / 2 * (I1 - 3 + np.maximum(1 - I1, 0) ** 2) - self.mu * (J - 1) + self.lam / 2 * (J - 1) ** 2
        return self.volume @ psi + self.mass @ ((y - target) ** 2).sum(1) / (2 * self.dt**2)

    def descend(self, y, target, i):
        """Position of vertex i of the least energy, exact where no tet is collapsing."""
        t, k = np.nonzero(self.tets == i)
        F, cof, J = self.strain(y, t)
        I1 = (F**2).sum((1, 2))
        P = (self.mu * (1 - 2 * np.maximum(1 - I1, 0)))[:, None, None] * F
        P += (self.lam * (J - 1) - self.mu)[:, None, None] * cof
        b, stiff = self.gradient[t, k], self.mass[i] / self.dt**2
        c = np.einsum("tij,tj->ti", cof, b)
        f = stiff * (target[i] - y[i]) - np.einsum("t,tij,tj->i", self.volume[t], P, b)
        H = (stiff + self.mu * self.volume[t] @ (b**2).sum(1)) * np.eye(3)
        H += self.lam * np.einsum("t,ti,tj->ij", self.volume[t], c, c)
        return y[i] + np.linalg.solve(H, f)


@pytest.fixture(scope="module")
def lump(ti_cpu):
    """A small body in VBD, its substep's kernels at hand, and its twin."""
    x, tets, surface = box((0.2, 0.1, 0.1), (3, 2, 2))
    body = SoftBody("lump", x, tets, surface, Material(1e6, 0.4, 1000.0), pinned=np.array([0]))
    solver = Solver([body], contacts=False, integrator="vbd")
    solver.step(DT)
    dt = solver.stats["dt"]
    solver.state.begin_frame(dt, DT, 64, *solver.state.gravity.to_numpy().tolist())
    return solver, Twin(body, dt), x


def put(field, values):
    """Fill the front of a field."""
    whole = np.zeros((field.shape[0], *values.shape[1:]), np.float32)
    whole[: len(values)] = values
    field.from_numpy(whole)


def disturb(lump, size):
    """Put the lump in the middle of a substep: strained by `size` of its cells; increments and target."""
    solver, twin, x = lump
    rng = np.random.default_rng(5)
    start = x + size * 0.05 * rng.normal(size=x.shape)
    solver.restore({"x": start, "v": np.zeros_like(x)})
    dx = 1e-4 * rng.normal(size=x.shape)
    target = dx + 1e-4 * rng.normal(size=x.shape)
    s = solver.integrator
    put(solver.state.dx, dx)
    put(s.descent.target, target)
    assert_array_equal(solver.state.x.to_numpy()[: len(x)], start.astype(np.float32))
    x32 = start.astype(np.float32).astype(np.float64)
    return s, twin, x32, x32 + dx, x32 + target


@pytest.mark.parametrize("size", [0.05, 0.7], ids=["strained", "inverted"])
def test_a_sweep_minimises_each_vertex_and_lowers_the_energy_each_time(lump, size):
    if ti.cfg.arch == ti.cuda:
        pytest.skip("the sweeps are not kernels of their own on CUDA")
    s, twin, x, y, target = disturb(lump, size)
    if size > 0.5:
        assert (twin.strain(y, slice(None))[2] < 0).any()
    energies, order, sweep = [twin.energy(y, target)], s.order.to_numpy(), s.kernels[1]
    for k in range(4):
        for c in range(s.colors):
            sweep(c)
        got = x + s.state.dx.to_numpy()[: len(x)]
        if k == 0 and size < 0.5:
            moved = y.copy()
            for i in order[: s.color_begin.to_numpy()[s.colors]]:
                moved[i] = twin.descend(moved, target, i)
            assert_allclose(got, moved, atol=1e-4 * np.abs(moved - y).max())
        energies.append(twin.energy(got, target))
    assert (np.diff(energies) < 0).all()
    assert_array_equal(got[0].astype(np.float32), y[0].astype(np.float32))


@pytest.mark.parametrize("size", [0.01, 0.05, 0.7])
def test_the_modal_correction_lowers_the_energy_too(lump, size):
    """By its plain loops, which VBD on CUDA replaces by a persistent kernel."""
    s, twin, x, y, target = disturb(lump, size)
    solver = lump[0]
    modal = ModalCorrection(solver.state, solver.elasticity, solver._blocks, s.descent)
    modal.load(Model(solver.body_models))
    for kernel in modal.kernels():
        kernel()
    got = x + s.state.dx.to_numpy()[: len(x)]
    assert np.abs(got - y).max() > 1e-6
    assert twin.energy(got, target) < twin.energy(y, target)


NAMES = ("hanging", "cantilever", "bending", "free", "mirrored", "random")


@pytest.fixture(scope="module")
def bars(ti_cpu):
    """Bars 3 m apart without contact: two pinned stiff ones, one that bends, and three free ones."""
    places = [{"position": (3.0 * k, 0, 0)} for k in range(len(NAMES))]
    for k in range(3):
        places[k] |= {"pinned": LEFT}
    places[0] |= {"rotation": DOWN}
    young, damping = (1e8, 4e8, 1e6, 1e8, 1e5, 1e8), (20, 20, 5, 0, 10, 10)
    bodies = [bar(n, E, 0.3, c, **at) for n, E, c, at in zip(NAMES, young, damping, places, strict=True)]
    return Solver(bodies, contacts=False)


def test_a_whole_body_moves_to_where_its_momentum_is_right(ti_cpu):
    """With vertices that static shapes hold in any way, also such that friction couples directions: a twin's 6 x 6."""
    if ti.cfg.arch == ti.cuda:
        pytest.skip("the steps are not kernels of their own on CUDA")
    x, tets, surface = box((0.2, 0.1, 0.1), (3, 2, 2))
    solver = Solver([SoftBody("lump", x, tets, surface, Material(1e6, 0.4, 1000.0))], integrator="vbd", hands=0)
    solver.step(DT)
    s, rng, n = solver.integrator, np.random.default_rng(6), len(x)
    h2, d, held = solver.stats["dt"] ** 2, solver.integrator.descent, np.arange(n) % 5 == 0
    mass, x32 = solver.body_models[0].mass, solver.state.x.to_numpy()[:n].astype(np.float64)
    dx, target = 1e-4 * rng.normal(size=(2, n, 3))
    force = held[:, None] * rng.normal(size=(n, 3))
    K = held[:, None, None] * np.einsum("nij,nkj->nik", *rng.normal(size=(2, n, 3, 3))) * mass.mean() / h2
    follows = held[:, None, None] * 0.3 * rng.normal(size=(n, 3, 3))
    for field, value in ((d.target, target), (d.reaction, force), (d.contact_matrix, K), (d.held, follows)):
        put(field, value)
    put(solver.state.dx, dx)
    s.whole.kernel()()
    r = x32 - mass @ x32 / mass.sum()
    J = np.concatenate([np.broadcast_to(np.eye(3), (n, 3, 3)), -np.cross(r[:, None], np.eye(3)).swapaxes(1, 2)], 2)
    moved = mass[:, None, None] * (np.eye(3) - follows) + h2 * K
    motion = np.linalg.solve(
        np.einsum("nia,nij,njb->ab", J, moved, J), np.einsum("nia,ni->a", J, mass[:, None] * (target - dx) + h2 * force)
    )
    u = J @ motion
    assert_allclose(solver.state.dx.to_numpy()[:n], dx + u - (follows @ u[..., None])[..., 0], atol=1e-3 * abs(u).max())
    got = d.reaction.to_numpy()[:n]
    assert_allclose(got, force - (K @ u[..., None])[..., 0], atol=1e-3 * np.abs(got).max())


def test_stiff_statics_are_those_of_linear_elements(bars):
    """Hanging and bent by their weight, 1e8 and 4e8 Pa: few sweeps a substep, but at rest nothing is missing."""
    bars.reset()
    bars.gravity = (0.0, -G, 0.0)
    run(bars, 1.0)
    stats, x = bars.stats, positions(bars)
    assert stats["integrator"] == "vbd" and stats["substeps"] <= 100 and stats["finite"]
    assert stats["stability"] > 10 * stats["stability_limit"]
    for k in range(2):
        body = bars.body_models[k].body
        start = body.start()
        K = fem_stiffness(start, TETS, body.material.young, body.material.poisson)
        sag = fem_solve(K, body.masses()[:, None] * [0.0, -G, 0.0], LEFT)[RIGHT, 1].mean()
        assert (x[k] - start)[RIGHT, 1].mean() == pytest.approx(sag, rel=0.01), NAMES[k]


def test_both_integrators_move_a_bar_alike(bars):
    """A bar of 1e6 Pa that swings down: within 1% of its length after half a second, and later at rest."""
    body = replace(bars.body_models[2].body, position=(0.0, 0.0, 0.0))
    xpbd = Solver([body], contacts=False, integrator="xpbd")
    assert xpbd.stats["integrator"] == "xpbd"
    bars.reset()
    bars.gravity = (0.0, -G, 0.0)
    for frames in (6, 12, 12, 60):
        for _ in range(frames):
            bars.step(DT)
            xpbd.step(DT)
        a, b = positions(bars)[2] - [6.0, 0.0, 0.0], positions(xpbd)[0]
        assert np.abs(a - b).max() < 0.01, frames
    assert np.abs(b - BAR).max() > 0.02
    assert np.abs(a - b).max() < 2e-4


def test_a_stiff_body_falls_and_spins_as_a_whole(bars):
    """1e8 Pa: its momentum and its spin stay, of which the implicit step alone would take 4%."""
    omega, k = 10.0, 3
    bars.gravity = (0.0, 0.0, 0.0)
    start, m = np.concatenate([p.body.start() for p in bars.body_models]), bars.body_models[k].body.masses()
    mine = slice(bars.vertex_offset[k], bars.vertex_offset[k + 1])
    v = np.zeros_like(start)
    center = np.average(start[mine], axis=0, weights=m)
    v[mine] = np.cross([0, 0, omega], start[mine] - center) + [0.3, -0.2, 0.1]
    bars.restore({"x": start, "v": v})
    run(bars, 0.5)
    q = bars.snapshot()
    x, u = positions(bars)[k], (q["v"].astype(np.float64) + q["v_lo"])[mine]
    scale = m @ np.linalg.norm(v[mine], axis=1)
    assert np.abs(m @ u - m.sum() * np.array([0.3, -0.2, 0.1])).max() < 1e-5 * scale

    def spin(x, u):
        r = x - np.average(x, axis=0, weights=m)
        return m @ np.cross(r, u - m @ u / m.sum())[:, 2]

    assert_allclose(spin(x, u), spin(start[mine], v[mine]), rtol=1e-4)
    bars.gravity = (0.0, -G, 0.0)
    bars.reset()
    run(bars, 0.2)
    assert_allclose(bars.bodies()[k].velocity, [0, -G * 0.2, 0], atol=1e-3 * G * 0.2)


def test_a_fine_mesh_flies_as_fast_as_it_is_thrown(ti_cpu):
    """Its vertices cross more than one of its tets in a substep: 8 m/s are 5.6 mm, of tets of 4 mm."""
    x, tets, surface = box((0.016, 0.016, 0.016), (4, 4, 4))
    body = SoftBody("cube", x, tets, surface, Material(3e4, 0.35, 900.0), velocity=(8.0, 0.0, 0.0))
    solver = Solver([body], contacts=False, integrator="vbd")
    run(solver, 2 * DT)
    assert_allclose(solver.bodies()[0].velocity, (8.0, -2 * DT * G, 0.0), atol=0.01)


def test_a_mirrored_and_a_random_start_recover(bars):
    bars.gravity = (0.0, 0.0, 0.0)
    x, rng = [m.body.start() for m in bars.body_models], np.random.default_rng(0)
    x[4] = BAR * [-1, 1, 1] + [12, 0, 0]
    x[5] = rng.uniform(BAR.min(0), BAR.max(0), BAR.shape) + [15, 0, 0]
    x = np.concatenate(x)
    bars.restore({"x": x, "v": np.zeros_like(x)})
    run(bars, 2.0)
    for k in (4, 5):
        volumes = tet_volumes(positions(bars)[k], TETS)
        assert (volumes > 0).all(), NAMES[k]
        assert volumes.sum() == pytest.approx(tet_volumes(BAR, TETS).sum(), rel=0.005)


@pytest.mark.parametrize("integrator, young", [("xpbd", 5e4), ("vbd", 1e7)])
def test_runs_on_several_threads_repeat_bit_for_bit(ti_cpu, integrator, young):
    """A large body that a hand pulls: its springs follow the hand from substep to substep."""
    x, tets, surface = box((0.3, 0.2, 0.2), (16, 12, 12))
    big = SoftBody("big", x, tets, surface, Material(young, 0.3, 1000.0), pinned=np.arange(169))
    solver = Solver([big], integrator=integrator, self_contact=False, hands=1)
    assert not solver.state.serial
    runs = []
    for _ in range(2):
        solver.reset()
        for k in range(4):
            solver.step(DT, [Hand((0.3 + 0.01 * k, 0.1 + 0.02 * k, 0.1), grip=True, reach=0.1)])
        runs.append(solver.snapshot())
    assert np.abs(runs[0]["x"] - x).max() > 1e-4
    for name in ("x", "v", "x_lo", "v_lo"):
        assert_array_equal(runs[0][name], runs[1][name])


def test_a_body_that_springs_back_in_flight_neither_drifts_nor_turns(ti_cpu):
    """From 0.7 of its height. Modes are orthogonal to a rotation only at rest: it once turned by 7 mrad/s."""
    x, tets, surface = box((0.1, 0.1, 0.1), (3, 3, 3))
    solver = Solver(
        [SoftBody("cube", x, tets, surface, Material(3e5, 0.45, 1700.0))], gravity=(0, 0, 0), integrator="vbd"
    )
    solver.restore({"x": x * [0.7**-0.5, 0.7, 0.7**-0.5], "v": 0 * x})
    m = solver.body_models[0].mass[:, None]
    for _ in range(20):
        solver.step(DT)
    q = solver.snapshot()
    r = q["x"].astype(np.float64) - np.average(q["x"], 0, m[:, 0])
    assert np.ptp(r[:, 1]) > 0.098
    assert np.linalg.norm((m * q["v"]).sum(0)) < 1e-6 * m.sum()
    assert np.linalg.norm((m * np.cross(r, q["v"])).sum(0)) < 1e-5 * (m * r**2).sum()


YOUNG, POISSON = (1e2, 1e3, 1e5, 1e8), (0.0, 0.3, 0.49)


@pytest.fixture(scope="module")
def floor(ti_cpu):
    """A solver with a floor, for any bodies: its kernels compile once."""
    capacity = Capacity(vertices=1000, tets=2500, triangles=2000, samples=4000, nodes=3_000_000, bodies=16)
    return Solver([], [Plane((0, 0, 0), (0, 1, 0))], capacity=capacity)


def holding(solver: Solver, bodies: list[SoftBody], gravity=(0.0, -G, 0.0)) -> Solver:
    """The solver with these bodies, at their starts."""
    solver.gravity = gravity
    solver.reset(models_of(bodies))
    return solver


def zoo() -> list[SoftBody]:
    """Cubes of all stiffnesses over a floor, one of 1e8 Pa a little tilted, and a pile of a soft and a stiff one."""
    x, tets, surface = box((0.1, 0.1, 0.1), (2, 2, 2))
    x = x - 0.05
    bodies = []
    for i, E in enumerate(YOUNG):
        for j, nu in enumerate(POISSON):
            material = Material(E, nu, 10.0 if E < 1e4 else 1000.0, damping=10.0)
            bodies.append(SoftBody(f"{E:g} {nu}", x, tets, surface, material, position=(0.3 * i, 0.08, 0.3 * j)))
    tilted = SoftBody("tilted", x, tets, surface, Material(1e8, 0.3, 1000.0), (0.98, 0.1, 0, 0.15), (2, 0.15, 0))
    stiff = SoftBody("stiff", x, tets, surface, Material(1e8, 0.3, 1000.0), position=(2, 0.05, 0.5))
    soft = SoftBody("soft", x, tets, surface, Material(1e5, 0.3, 1000.0), position=(2, 0.153, 0.5))
    return [*bodies, tilted, stiff, soft]


def test_all_stiffnesses_live_in_one_solver(ti_cpu):
    """Dropped from 3 cm: finite, on the floor, at rest, nothing inverted; the stiff ones keep their height."""
    solver = Solver(zoo(), [Plane((0, 0, 0), (0, 1, 0))])
    assert solver.stats["integrator"] == "vbd"
    for _ in range(4):
        run(solver, 0.5)
        solver.wake()  # it is the integrator that must keep them at rest
    assert solver.stats["finite"]
    tets, speeds = box((0.1, 0.1, 0.1), (2, 2, 2))[1], solver.v.to_numpy()
    for k, (model, state, x) in enumerate(zip(solver.body_models, solver.bodies(), positions(solver), strict=True)):
        body = model.body
        assert (tet_volumes(x, tets) > 0).all(), body.name
        assert state.low[1] > -1e-3, body.name
        v = speeds[solver.vertex_offset[k] : solver.vertex_offset[k + 1]]
        limit = 0.05 if body.material.young <= 1e5 else 0.02 if body.material.poisson > 0.45 else 1e-3
        assert np.linalg.norm(v, axis=1).max() < limit, body.name  # 0.02 m/s: 4 um to and fro in a substep
        if body.material.young == 1e8:
            assert state.high[1] - state.low[1] == pytest.approx(0.1, abs=1e-4), body.name
    assert solver.bodies()[-1].low[1] == pytest.approx(0.1, abs=2e-3)  # on the stiff one
    run(solver, 1.5)
    before = solver.snapshot()
    run(solver, 0.1)
    after, stiff = solver.snapshot(), np.array([m.body.material.young == 1e8 for m in solver.body_models])
    still = np.repeat(before["asleep"] & after["asleep"], np.diff(solver.vertex_offset))
    assert (before["asleep"] & stiff).sum() >= 3
    for name in ("x", "x_lo", "v"):
        np.testing.assert_array_equal(before[name][still], after[name][still])
    solver.gravity = (0.0, 5.0, 0.0)
    run(solver, 0.2)
    assert min(s.low[1] for s in solver.bodies()) > 0.05


FOAM = Material(young=2.4e7, poisson=0.478, density=18.7, friction=0.12, damping=0.0)  # VBD, dt^2 kappa = 3e4
BAR_COUNT, SPEED = 12, 11.0


def test_light_stiff_bodies_that_graze_a_wall_gain_no_energy(floor):
    """They strike with one vertex and slide: the push on it alone would turn them by many radians a substep."""
    x, tets, surface = box((0.08, 0.02, 0.02), (6, 1, 1))
    rng = np.random.default_rng(0)
    turns = rng.normal(size=(BAR_COUNT, 4))
    bodies = []
    for k, q in enumerate(turns):
        rotation, place = tuple(q / np.linalg.norm(q)), (0, 0.09, 0.3 * k)
        bodies.append(SoftBody("foam", x, tets, surface, FOAM, rotation, place, self_contact=False))
    solver = holding(floor, bodies, gravity=(0.0, 0.0, 0.0))
    assert solver.stats["integrator"] == "vbd" and solver.stats["stability"] > 30
    q = solver.snapshot()
    solver.restore({"x": q["x"], "v": np.zeros_like(q["x"]) - [SPEED, 0.8, 0.0]})
    models, n = q["bodies"], len(x)
    begin, most = 0.5 * models[0].mass.sum() * (SPEED**2 + 0.8**2), 0.0
    for _ in range(12):
        solver.step(DT)
        q = solver.snapshot()
        assert q["x"][:, 1].min() > -1e-3
        now = []
        for k, model in enumerate(models):
            y, v = (q[name][k * n : (k + 1) * n].astype(np.float64) for name in ("x", "v"))
            now.append(0.5 * model.mass @ (v**2).sum(1) + strain_energy(model, y))
        most = max(most, *now)
    assert most < 3 * begin  # for a moment more than half of it may be strain that the sweeps have not taken out yet
    assert max(now) < begin  # without gravity, friction and the wall only take


@pytest.mark.parametrize("plates", [False, True])
def test_stiff_bodies_thrown_at_the_floor_gain_no_energy(floor, plates):
    """At 3 to 10 m/s, of all kinds, and light plates alone: contacts once stored 234 times the energy of such a one."""
    height = 0.12  # [m]
    shapes = [
        torus(0.03, 0.01, around=12, across=1),
        box((0.08, 0.02, 0.02), (4, 1, 1)),
        box((0.08, 0.024, 0.08), (3, 1, 3)),
        box((0.08, 0.005, 0.08), (4, 1, 4)),
    ]
    constants = [(1e8, 0.3, 1000.0, 0.5), (1e8, 0.49, 10.0, 1.0), (1e7, 0.45, 50.0, 0.8), (1e8, 0.4, 200.0, 0.3)]
    materials = [Material(*c) for c in constants]
    rng = np.random.default_rng(6 if plates else 102)
    speeds, bodies = rng.uniform(3, 10, 16), []
    for k in range(16):
        x, tets, surface = shapes[3 if plates else k % 4]
        q, v = rng.normal(size=4), rng.normal(size=3)
        v *= speeds[k] / np.linalg.norm(v)
        place = {"position": (2.0 * (k % 4), height, 2.0 * (k // 4)), "rotation": tuple(q / np.linalg.norm(q))}
        place |= {"velocity": (v[0], -abs(v[1]), v[2]), "self_contact": False}
        bodies.append(SoftBody(f"body {k}", x - x.mean(0), tets, surface, materials[1 if plates else k // 4], **place))
    solver = holding(floor, bodies)
    assert solver.stats["integrator"] == "vbd"
    models, o = solver.body_models, solver.vertex_offset
    begin = np.array([m.mass.sum() * (v**2 / 2 + G * 1.25 * height) for m, v in zip(models, speeds, strict=True)])
    for _ in range(25):
        solver.step(DT)
        q = solver.snapshot()
        x, v = q["x"].astype(np.float64), q["v"].astype(np.float64)
        for k, m in enumerate(models):
            mine = slice(o[k], o[k + 1])
            energy = m.mass @ ((v[mine] ** 2).sum(1) / 2 + G * x[mine, 1]) + strain_energy(m, x[mine])
            assert energy < 1.1 * begin[k], (k, energy / begin[k])
