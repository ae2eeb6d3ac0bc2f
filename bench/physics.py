"""Rows of the physics table that need no contact, and CUDA against the CPU, measured through the public Solver.

Bar: 1 x 0.2 x 0.2 m, 10 x 2 x 2 cells, density 1000 kg/m^3. Every measurement returns rows
{"check", "relation", "reference", "measured", "tolerance", "pass"}, where relation is "=", within a tolerance, or "<="
or ">=" for a bound; Taichi must be initialised.
"""

from collections.abc import Iterable
from dataclasses import replace
from itertools import pairwise
from multiprocessing import get_context

import numpy as np
import scipy.linalg as sl
import scipy.sparse as sp
import scipy.sparse.linalg as spla
import taichi as ti

from core.material import RAYLEIGH_FREQUENCY, Material
from core.runtime import start_taichi
from core.tetmesh import boundary_surface, positively_oriented, tet_volumes
from core.tetmesh import box_mesh as box
from core.vocabulary import Plane
from prepare.fit.linear_elasticity import fem_stiffness
from sim.bodies import SoftBody
from sim.elastic.energy import CRUSHED_DJ, STRETCHED_I1
from sim.model import models_of
from sim.solver import Solver

DENSITY, G = 1000.0, 9.81
BAR, TETS, SURFACE = box((1.0, 0.2, 0.2), (10, 2, 2), mirror=False)
BAR = BAR - [0.0, 0.1, 0.1]
LEFT, RIGHT = np.flatnonzero(BAR[:, 0] < 1e-9), np.flatnonzero(BAR[:, 0] > 1 - 1e-9)
AGREEMENT_SUBSTEPS = 128  # a whole number of launches on both devices; 100 become 105 shorter ones on the CPU
BENT_BAR_LENGTH = 0.3  # [m]
MOST_APART = 1e-5  # of that length: a hundred float32 roundings in a different order
MOST_APART_CONTACTS = 1e-3  # roundings decide which contacts stick: starts 3e-8 m apart end 1.3e-4 m apart
# Bars that swing: size [m], cells, stretch, angle [rad] by which the end is turned
SWINGS = (
    ("stretched bar's", (0.2, 0.08, 0.08), (12, 5, 5), 1.07, 0.6),
    ("bent bar's", (0.3, 0.06, 0.06), (16, 4, 4), 1.05, 1.0),
)
DOWN = (np.sqrt(0.5), 0.0, 0.0, -np.sqrt(0.5))  # turns +x to -y


def row(check: str, reference: float, measured: float, tolerance: float, *, error: float | None = None) -> dict:
    """A row of the table; `error` is relative to the reference unless given."""
    error = abs(measured / reference - 1) if error is None else error
    return {
        "check": check,
        "relation": "=",
        "reference": float(reference),
        "measured": float(measured),
        "tolerance": tolerance,
        "pass": bool(error <= tolerance),
    }


def at_most(check: str, bound: float, measured: float) -> dict:
    """A row of the table that passes up to a bound."""
    return {**row(check, bound, measured, 0.0, error=max(measured - bound, 0.0)), "relation": "<="}


def at_least(check: str, bound: float, measured: float) -> dict:
    """A row of the table that passes from a bound on."""
    return {**row(check, bound, measured, 0.0, error=max(bound - measured, 0.0)), "relation": ">="}


def bar(name: str, young: float, poisson: float, damping: float, **place) -> SoftBody:
    """The bar, made of `material`."""
    return SoftBody(name, BAR, TETS, SURFACE, Material(young, poisson, DENSITY, damping=damping), **place)


def positions(solver: Solver) -> list[np.ndarray]:
    """Positions [m] of each body in float64, the float32 remainders included."""
    q, o = solver.snapshot(), solver.vertex_offset
    x = q["x"].astype(np.float64) + q["x_lo"]
    return [x[a:b] for a, b in pairwise(o)]


def free_fall() -> list[dict]:
    """Free fall at several heights: at dt = 1e-4, dt^2 g is below one float32 unit in the last place of a position."""
    heights, duration = (0.3, 1.5, 3.0, 6.0), 0.5
    x, tets, surface = box((0.1, 0.1, 0.1), (1, 1, 1))
    material = Material(1e5, 0.3, DENSITY, damping=0.0)
    bodies = [SoftBody(f"{h} m", x, tets, surface, material, position=(h, h, h)) for h in heights]
    solver = Solver(bodies, substep=1e-4, contacts=False)
    frames = 30
    for _ in range(frames):
        solver.step(duration / frames)
    rows = []
    for h, state in zip(heights, solver.bodies(), strict=True):
        rows.append(row(f"free fall at {h} m, speed [m/s]", G * duration, -state.velocity[1], 1e-4))
        fallen = h + 0.05 - state.centroid[1]
        exact = 0.5 * G * duration * (duration + solver.stats["dt"])  # of the symplectic step
        rows.append(row(f"free fall at {h} m, distance [m]", exact, fallen, 1e-4))
    return rows


def statics() -> list[dict]:
    """Hanging bars, uniaxial stress, cantilever and twist, against formulas and linear FEM on the same mesh."""
    young, angle = 1e7, 0.02
    poissons = (0.0, 0.3, 0.45)
    bodies = [
        bar(f"nu={nu}", young, nu, 200.0, rotation=DOWN, position=(3 * k, 0, 0), pinned=LEFT)
        for k, nu in enumerate(poissons)
    ]
    bodies.append(bar("cantilever", 4 * young, 0.3, 60.0, position=(0, 0, 3), pinned=LEFT))
    bodies.append(bar("twist", young, 0.3, 200.0, position=(0, 0, 6), pinned=np.r_[LEFT, RIGHT]))
    solver = Solver(bodies, contacts=False, integrator="xpbd")
    start = [b.start() for b in bodies]
    c, s = np.cos(angle), np.sin(angle)
    twisted = [x.copy() for x in start]
    twisted[4][RIGHT] = BAR[RIGHT] @ np.array([[1, 0, 0], [0, c, -s], [0, s, c]]).T + [0, 0, 6]
    solver.restore({"x": np.concatenate(twisted), "v": np.zeros((5 * len(BAR), 3))})
    for _ in range(12):
        solver.step(1 / 20)
    x = positions(solver)
    tip = [-(x[k][RIGHT] - start[k][RIGHT])[:, 1].mean() for k in range(4)]

    rows, weight = [], bodies[0].masses()[:, None] * [0.0, -G, 0.0]
    for k, b in enumerate(bodies[:4]):
        K = fem_stiffness(start[k], TETS, b.material.young, b.material.poisson)
        reference = -fem_solve(K, weight, LEFT)[RIGHT, 1].mean()
        if k == 0:
            reference = DENSITY * G / (2 * young)
        name = "cantilever, sag [m]" if k == 3 else f"hanging bar, nu = {poissons[k]} [m]"
        rows.append(row(name, reference, tip[k], 0.02 if k == 3 else 0.01))

    middle = np.abs(BAR[TETS].mean(1)[:, 0] - 0.5) < 0.1  # the stress is rho g (L - x), uniaxial far from the ends
    before, after = (tet_volumes(p, TETS)[middle].sum() for p in (start[1], x[1]))
    rows.append(row("uniaxial stress, dV/V", 0.4 * DENSITY * G * 0.5 / young, after / before - 1, 0.03))

    K = fem_stiffness(BAR, TETS, young, 0.3)
    turned = np.zeros((len(BAR), 3))
    turned[RIGHT] = angle * np.cross([1, 0, 0], BAR[RIGHT])
    pinned = np.r_[LEFT, RIGHT]
    u = fem_solve(K, np.zeros_like(BAR), pinned, turned[pinned])
    reference = np.cross(BAR[RIGHT], (K @ u.ravel()).reshape(-1, 3)[RIGHT]).sum(0)[0]
    force = elastic_forces(BAR, TETS, young, 0.3)(x[4] - [0, 0, 6])
    measured = -np.cross(x[4][RIGHT] - [0, 0, 6], force[RIGHT]).sum(0)[0]
    rows.append(row("twist, torque [N m]", reference, measured, 0.02))
    return rows


def elastic_forces(vertices: np.ndarray, tets: np.ndarray, young: float, poisson: float):
    """Function of positions x (V, 3) that gives the forces [N] on a body of this rest shape, in float64.

    The energy is that of sim/elastic/energy.py without its last term, which is 0 unless a tet is crushed.
    """
    mu = young / (2 * (1 + poisson))
    lam = mu + young * poisson / ((1 + poisson) * (1 - 2 * poisson))
    D = np.swapaxes(vertices[tets[:, 1:]] - vertices[tets[:, :1]], 1, 2)
    B, T = np.linalg.inv(D), len(tets)
    g = np.concatenate([-B.sum(1, keepdims=True), B], axis=1)  # (T, 4, 3) gradients of the shape functions
    where, shape = (np.repeat(np.arange(T), 4), tets.ravel()), (T, len(vertices))
    gradient = sp.vstack([sp.csr_matrix((g[..., k].ravel(), where), shape) for k in range(3)]).tocsr()
    back = (gradient.T @ sp.diags(np.tile(np.linalg.det(D) / 6, 3))).tocsr()

    def forces(x: np.ndarray) -> np.ndarray:
        F = (gradient @ x).reshape(3, T, 3)  # columns
        cofactor = np.cross(F[[1, 2, 0]], F[[2, 0, 1]])
        J = (F[0] * cofactor[0]).sum(1)
        return -back @ (mu * F + (lam * (J - 1) - mu)[:, None] * cofactor).reshape(3 * T, 3)

    return forces


def fem_solve(K: sp.csr_matrix, force: np.ndarray, fixed: np.ndarray, displacement=0.0) -> np.ndarray:
    """Displacements (V, 3) under nodal forces (V, 3), with the vertices `fixed` displaced as given."""
    u = np.zeros_like(force, np.float64)
    u[fixed] = displacement
    held = np.zeros(force.shape, bool)
    held[fixed] = True
    free = np.flatnonzero(~held.ravel())
    load = force.ravel() - K @ u.ravel()
    flat = u.ravel()
    flat[free] += spla.spsolve(K[free][:, free].tocsc(), load[free])
    return flat.reshape(-1, 3)


def vibration() -> list[dict]:
    """Frequency of the first longitudinal mode of the free, falling bar, nu = 0: f = sqrt(E/rho) / 2L."""
    young = 1e6
    b = bar("bar", young, 0.0, 0.0)
    solver = Solver([b], contacts=False)
    mode = np.cos(np.pi * BAR[:, 0])
    solver.restore({"x": BAR, "v": 0.05 * mode[:, None] * [1.0, 0.0, 0.0]})
    frame, amplitude = 1 / 240, []
    for _ in range(72):
        solver.step(frame)
        amplitude.append((b.masses() * mode) @ (positions(solver)[0] - BAR)[:, 0])
    a, t = np.array(amplitude), frame * np.arange(1, 73)
    k = np.flatnonzero(np.sign(a[1:]) != np.sign(a[:-1]))
    crossings = t[k] - a[k] * frame / (a[k + 1] - a[k])
    frequency = (len(crossings) - 1) / 2 / (crossings[-1] - crossings[0])
    return [row("longitudinal vibration [Hz]", np.sqrt(young / DENSITY) / 2, frequency, 0.02)]


def spinning_bar() -> list[dict]:
    """Angular and linear momentum of a free spinning bar."""
    omega, duration = 10.0, 1.0
    b = bar("bar", 1e6, 0.3, 0.0, position=(1, 1, 1))
    m = b.masses()
    solver = Solver([b], gravity=(0, 0, 0), contacts=False)
    center = np.average(b.start(), axis=0, weights=m)
    v = np.cross([0, 0, omega], b.start() - center) + [0.3, -0.2, 0.1]
    solver.restore({"x": b.start(), "v": v})

    def momenta():
        q = solver.snapshot()
        x, u = positions(solver)[0], q["v"].astype(np.float64) + q["v_lo"]
        p = m @ u
        r = x - np.average(x, axis=0, weights=m)
        return p, m @ np.cross(r, u - p / m.sum())[:, 2]

    p0, L0 = momenta()
    for _ in range(20):
        solver.step(duration / 20)
    p, L = momenta()
    scale = m @ np.linalg.norm(v, axis=1)
    drift = np.abs(p - p0).max() / scale
    return [
        row("spin, L / L0", 1.0, L / L0, 1e-4),
        at_most("spin, drift of momentum / sum m |v|", 1e-6, drift),
    ]


def recovery() -> list[dict]:
    """Inverted tets and volume 3 s after a mirrored, a flattened, a random and a shrunken start."""
    poissons = {"mirrored": 0.3, "flat": 0.3, "random": 0.3, "shrunken": 0.0}
    names = tuple(poissons)
    bodies = [bar(n, 1e5, poissons[n], 10.0, position=(0, 0, 3 * k)) for k, n in enumerate(names)]
    solver = Solver(bodies, gravity=(0, 0, 0), contacts=False)
    rng = np.random.default_rng(0)
    starts = (BAR * [-1, 1, 1], BAR * [1, 0, 1], rng.uniform(BAR.min(0), BAR.max(0), BAR.shape), 0.2 * BAR)
    x = np.concatenate([s + [0, 0, 3 * k] for k, s in enumerate(starts)])
    solver.restore({"x": x, "v": np.zeros_like(x)})
    for _ in range(60):
        solver.step(1 / 20)
    rows, rest = [], tet_volumes(BAR, TETS).sum()
    for name, x in zip(names, positions(solver), strict=True):
        volumes = tet_volumes(x, TETS)
        inverted = int((volumes <= 0).sum())
        rows.append(row(f"{name} start, inverted tets", 0, inverted, 0, error=inverted))
        rows.append(row(f"{name} start, volume / rest volume", 1.0, volumes.sum() / rest, 0.005))
    return rows


def vibration_energy(solver: Solver) -> np.ndarray:
    """Kinetic and elastic energy of each body [J], (B,), both at the middle of the last substep.

    Velocities belong there: x' = x + dt v'. With the elastic energy at its end, the sum would swing by omega dt / 2.
    """
    q, o = solver.snapshot(), solver.vertex_offset
    v = q["v"].astype(np.float64) + q["v_lo"]
    x = q["x"].astype(np.float64) + q["x_lo"] - 0.5 * solver.stats["dt"] * v
    spans = zip(q["bodies"], pairwise(o), solver.rest_inverses(), strict=False)
    return np.array([0.5 * b.mass @ (v[i:j] ** 2).sum(1) + strain_energy(b, x[i:j], rest) for b, (i, j), rest in spans])


def energy_kept(substeps: int = 1_000_000, vbd_substeps: int = 100_000) -> list[dict]:
    """Least and largest energy of a spinning and vibrating body without damping, relative to the first."""
    x, tets, surface = box((0.3, 0.1, 0.1), (3, 1, 1))
    v = np.cos(np.pi * x[:, 0] / 0.3)[:, None] * [0.3, 0.2, 0.0] + np.cross([0, 0, 1.0], x)
    rows = []
    for integrator, young, count in (("xpbd", 1e5, substeps), ("vbd", 1e6, vbd_substeps)):
        b = SoftBody("bar", x, tets, surface, Material(young, 0.3, DENSITY, damping=0.0))
        solver = Solver([b], gravity=(0, 0, 0), contacts=False, integrator=integrator)
        solver.restore({"x": x, "v": v})
        frame, first, energy = 1 / 20, 0.5 * b.masses() @ (v**2).sum(1), []
        solver.step(frame)
        frames = -(-count // solver.stats["substeps"])
        for k in range(1, frames):
            solver.step(frame)
            if k % 10 == 0 or k == frames - 1:
                energy.append(vibration_energy(solver)[0] / first)
        name = f"{count:.0e} undamped substeps ({integrator}), energy"
        # nan, of a body that has exploded, passes neither
        most = 1.01 if integrator == "xpbd" else 1.05  # VBD's longer steps: the energy it keeps is not quite this one
        rows += [at_least(f"{name}, least", 0.95, np.min(energy)), at_most(f"{name}, most", most, np.max(energy))]
    return rows


def decay() -> list[dict]:
    """Rate at which the longitudinal vibration of a bar loses energy: c + w^2 ret, of a slow bar and of a fast one.

    c is the material's damping; ret, its retardation time, is at most a substep.
    """
    rows, seconds, frame = [], 1.0, 1 / 60
    mode = 0.05 * np.cos(np.pi * BAR[:, 0])[:, None] * [1.0, 0.0, 0.0]
    bodies = [bar("slow", 4e4, 0.0, 1.0), bar("fast", 1e6, 0.0, 0.2, position=(0, 0, 1))]
    for integrator in ("xpbd", "vbd"):
        solver = Solver(bodies, gravity=(0, 0, 0), contacts=False, integrator=integrator)
        solver.restore({"x": np.concatenate([b.start() for b in bodies]), "v": np.tile(mode, (2, 1))})
        energy = []
        for _ in range(round(seconds / frame)):
            solver.step(frame)
            energy.append(vibration_energy(solver))
        rates = -np.polyfit(frame * np.arange(len(energy)), np.log(energy), 1)[0]
        for b, rate in zip(bodies, rates, strict=True):
            w = np.pi * np.sqrt(b.material.young / DENSITY)
            ret = min(b.material.damping / RAYLEIGH_FREQUENCY**2, solver.stats["dt"])
            reference = b.material.damping + ret * w**2
            rows.append(row(f"decay of a {b.name} vibration ({integrator}) [1/s]", reference, rate, 0.05))
    return rows


def flow_twin(gradients: Iterable[np.ndarray], yield_strain: float) -> np.ndarray:
    """F_p (3, 3) after deformation gradients F: the return mapping of sim/elastic/plastic_flow.py.

    F_e = F F_p^-1,  e = dev log(F_e^T F_e) / 2,  |e| = sqrt(2/3 e:e) > Y:  F_p <- exp((1 - Y / |e|) e) F_p
    """
    Fp = np.eye(3)
    for F in gradients:
        Fe = F @ np.linalg.inv(Fp)
        squares, axes = np.linalg.eigh(Fe.T @ Fe)
        e = np.log(squares) / 2
        e -= e.mean()
        strain = np.sqrt(2 / 3 * e @ e)
        if strain > yield_strain:
            Fp = axes * np.exp((1 - yield_strain / strain) * e) @ axes.T @ Fp
    return Fp


def plastic_flow() -> list[dict]:
    """Bars of clay: pressed and sheared, held and let go, against the twin; and the energy of one that swings."""
    rows, frames, Y = [], 30, 0.05
    rate = np.array([[-0.3, 0.2, 0.0], [0.0, 0.2, 0.0], [0.0, 0.0, 0.1]])  # of log F, over the whole path
    free = SoftBody("bar", BAR, TETS, SURFACE, Material(3e5, 0.45, DENSITY, damping=30.0, yield_strain=Y))
    path = [sl.expm(s * rate) for s in np.linspace(0, 1, 1 + frames)]
    Fp = flow_twin((a + s * (b - a) for a, b in pairwise(path) for s in np.linspace(0.1, 1, 10)), Y)
    for integrator in ("xpbd", "vbd"):
        everything = np.arange(len(BAR))
        solver = Solver([replace(free, pinned=everything)], gravity=(0, 0, 0), contacts=False, integrator=integrator)
        for F in path[1:]:
            solver.kinematic.drive_vertices(0, everything, BAR @ F.T)
            solver.step(1 / 60)
        solver.restore({**solver.snapshot(), "bodies": models_of([free])})
        for _ in range(60):
            solver.step(1 / 60)
        F = np.linalg.lstsq(BAR - BAR.mean(0), positions(solver)[0], rcond=None)[0].T
        off = np.abs(F.T @ F - Fp.T @ Fp).max()
        name = f"clay pressed and let go ({integrator})"
        rows.append(row(f"{name}, length [m]", np.linalg.norm(Fp[:, 0]), np.linalg.norm(F[:, 0]), 1e-3))
        rows.append(at_most(f"{name}, off the twin", 1e-3, off))
        swinging = replace(free, material=replace(free.material, damping=0.0))
        solver = Solver([swinging], gravity=(0, 0, 0), contacts=False, integrator=integrator)
        solver.restore({"x": BAR, "v": 3.0 * np.cos(np.pi * BAR[:, 0])[:, None] * [1.0, 0.5, 0.0]})
        energy = []
        for _ in range(120):
            solver.step(1 / 180)
            energy.append(vibration_energy(solver)[0])
        gain = np.max(energy[1:] - np.minimum.accumulate(energy)[:-1]) / energy[0]
        rows.append(at_most(f"swinging clay ({integrator}), energy gained / first", 1e-3, gain))
        rows.append(at_most(f"swinging clay ({integrator}), energy left / first", 0.5, energy[-1] / energy[0]))
    return rows


def bent(x: np.ndarray, length: float, stretch: float, angle: float) -> np.ndarray:
    """A bar x (V, 3) from 0 to `length` [m] along x, stretched, and curled so that its end has turned by `angle`."""
    u = np.linspace(0, 1, 2001)
    middle = angle * ((u[:-1] + u[1:]) / 2) ** 2
    line = np.stack([np.cos(middle), np.sin(middle)], 1).cumsum(0) * stretch * length / 2000
    along, turned = x[:, 0] / length, angle * (x[:, 0] / length) ** 2
    center = [np.interp(along, u, np.r_[0, line[:, k]]) for k in range(2)]
    return np.stack([center[0] - np.sin(turned) * x[:, 1], center[1] + np.cos(turned) * x[:, 1], x[:, 2]], 1)


def swings(seconds: float = 1.0, step: float = 1 / 60_000) -> list[dict]:
    """Undamped bars, pinned at one end and let go bent and stretched, against a velocity Verlet of `step` [s].

    Root mean square of the vertices' distances from there, relative to that of their first displacement.
    """
    rows = []
    for name, size, cells, stretch, angle in SWINGS:
        x, tets, surface = box(size, cells)
        x = x - [0, size[1] / 2, size[2] / 2]
        pinned, start = np.flatnonzero(x[:, 0] == 0), bent(x, size[0], stretch, angle)
        b = SoftBody(name, x, tets, surface, Material(2e5, 0.3, DENSITY, damping=0.0), pinned=pinned)
        solvers = {k: Solver([b], gravity=(0, 0, 0), contacts=False, integrator=k) for k in ("xpbd", "vbd")}
        for solver in solvers.values():
            solver.restore({"x": start, "v": 0 * x})
        forces, inverse_mass = elastic_forces(x, tets, b.material.young, 0.3), 1 / b.masses()[:, None]
        inverse_mass[pinned] = 0.0
        true, v, a, frames = start.copy(), 0 * x, inverse_mass * forces(start), 0
        for end in (0.1, seconds):
            for _ in range(round((end - frames / 60) / step)):
                v += step / 2 * a
                true += step * v
                a = inverse_mass * forces(true)
                v += step / 2 * a
            for integrator, solver in solvers.items():
                for _ in range(round(60 * end) - frames):
                    solver.step(1 / 60)
                off = np.linalg.norm(positions(solver)[0] - true) / np.linalg.norm(start - x)
                rows.append(
                    at_most(f"{name} swing ({integrator}), off after {end:g} s", 0.1 if end == 1.0 else 0.12, off)
                )
            frames = round(60 * end)
    return rows


def cuda_and_cpu() -> list[dict]:
    """Largest difference of a vertex between the devices; without a CUDA GPU the rows are skipped."""
    rows = []
    for contacts in (False, True):
        check = f"CUDA and CPU, {AGREEMENT_SUBSTEPS} substeps{', contacts' if contacts else ''}, difference / size"
        most = MOST_APART_CONTACTS if contacts else MOST_APART
        if ti.cfg.arch == ti.cuda:
            apart = np.abs(agreement_positions(contacts) - positions_of_another_process(contacts)).max()
            rows.append(at_most(check, most, apart / BENT_BAR_LENGTH))
        else:
            skipped = {"measured": None, "pass": None, "note": "runs on a CUDA GPU only"}
            rows.append(at_most(check, most, 0.0) | skipped)
    return rows


def agreement_positions(contacts: bool) -> np.ndarray:
    """Positions [m] after AGREEMENT_SUBSTEPS substeps: a bent spinning bar, a sliding block and one on top of it."""
    jelly = Material(1e5, 0.4, 1000.0, friction=0.3, damping=0.0)  # damping acts every few substeps, by device
    bar, cube = box((BENT_BAR_LENGTH, 0.1, 0.1), (6, 2, 2)), box((0.1, 0.1, 0.1), (2, 2, 2))
    bodies = [
        SoftBody("bar", *bar, jelly, position=(0, 1, 0)),
        SoftBody("lower", *cube, jelly, position=(1, 0.0005, 0), velocity=(0.5, 0, 0)),
        SoftBody("upper", *cube, jelly, position=(1.03, 0.1005, 0.02), velocity=(0, -0.2, 0)),
    ]
    floor, frame = Plane((0, 0, 0), (0, 1, 0), friction=0.3), AGREEMENT_SUBSTEPS * 1e-4
    solver = Solver(bodies, [floor], substep=1e-4, frame_dt=frame, contacts=contacts, sleep=False)
    start = solver.snapshot()
    x, v = start["x"].astype(np.float64), start["v"].astype(np.float64)
    n = len(bar[0])
    v[:n] += np.cross([0.0, 0.0, 8.0], x[:n] - x[:n].mean(0))
    x[:n, 1] += 0.3 * (x[:n, 0] - BENT_BAR_LENGTH / 2) ** 2
    solver.restore({"x": x, "v": v})
    solver.step(frame)
    end = solver.snapshot()
    return end["x"].astype(np.float64) + end["x_lo"]


def agreement_positions_on_cpu(contacts: bool) -> np.ndarray:
    start_taichi("cpu")
    return agreement_positions(contacts)


def positions_of_another_process(contacts: bool) -> np.ndarray:
    """The result of `agreement_positions` on the CPU. Taichi runs on one kind of device per process."""
    with get_context("spawn").Pool(1) as pool:
        return pool.apply(agreement_positions_on_cpu, (contacts,))


def strain_energy(body, x: np.ndarray, rest_inverse: np.ndarray | None = None) -> float:
    """Elastic energy [J] of a body at x (V, 3)."""
    return float(tet_energies(body, x, rest_inverse)[0].sum())


def tet_energies(body, x: np.ndarray, rest_inverse: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
    """V (mu/2 (tr F^T F - 3) - mu (J - 1) + lam/2 (J - 1)^2) [J] of each tet of a body at x (V, 3), (T,) float64.

    Also whether the tet is so far from rest that a single sweep of XPBD shortens its step, (T,) bool.
    rest_inverse: D_m^-1 of the tets [1/m], (T, 3, 3); None: as they were made.
    """
    mu, lam = body.material.lame_parameters
    lam += mu
    corners, B = x[body.shape.tets], body.shape.inverse if rest_inverse is None else rest_inverse
    F = np.swapaxes(corners[:, 1:] - corners[:, :1], 1, 2) @ B
    I1, dJ = (F**2).sum((1, 2)), np.linalg.det(F) - 1
    density = mu / 2 * (I1 - 3) - mu * dJ + lam / 2 * dJ**2
    return body.shape.volumes * density, (I1 > STRETCHED_I1) | (dJ < CRUSHED_DJ)


def torus(radius: float = 0.08, tube: float = 0.015, around: int = 24, across: int = 2):
    """Vertices [m] (V, 3), tets (T, 4), surface (S, 3) of a ring about the y axis; `around` must be even.

    A long box of `around` x `across`^2 cells is bent into a circle and its square section mapped to a disc.
    """
    assert around % 2 == 0, "mirrored cells match at the seam only if their number is even"
    x, tets, _ = box((around, across, across), (around, across, across))
    last = int((across + 1) ** 2)  # vertices of one section; the section at x = around is the one at 0
    tets = tets % (around * last)
    x = x[: around * last]
    section = 2 * x[:, 1:] / across - 1
    largest = np.abs(section).max(1, keepdims=True)
    length = np.maximum(np.linalg.norm(section, axis=1, keepdims=True), 1e-12)
    disc = section * largest / length * tube  # squares about the centre become circles
    angle = 2 * np.pi * x[:, 0] / around
    away = radius + disc[:, 0]
    x = np.stack([away * np.cos(angle), disc[:, 1], away * np.sin(angle)], axis=1)
    tets = positively_oriented(x, tets)
    return x, tets, boundary_surface(tets)
