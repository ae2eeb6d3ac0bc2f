"""The same bodies in newton's SolverVBD and in this solver, on the CPU, and linear finite elements on the same mesh.

    python -m venv .dev/newton && .dev/newton/bin/pip install -r bench/peers/requirements-newton.txt
    python -m bench.peers.newton_peer [--mesh BODY.npz] [--newton PYTHON] [--only NAME]

Bodies hang from pinned vertices and come to rest under gravity. Both solvers have the same energy, so they agree
where the strain is large too; linear elements agree with both where it is small. BODY.npz holds V (V, 3) and
T (T, 4), any unit; it is scaled to 0.3 m. Newton runs in its own environment, in another process.
"""

import argparse
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter

import numpy as np

from bench import physics
from core.material import Material
from core.runtime import start_taichi
from core.tetmesh import boundary_surface, tet_volumes
from sim.bodies import SoftBody

ROOT = Path(__file__).resolve().parents[2]
SOFT = Material(1e6, 0.3, 1000.0, damping=0.0)
STOP_INTERVAL = 1 / 240  # [s] after each of which a body whose kinetic energy falls is stopped, in both solvers
LINEAR = 0.02  # displacement of the tip / size up to which linear elements are a reference


@dataclass(frozen=True)
class Case:
    """A body at rest, its pins and material."""

    name: str
    vertices: np.ndarray
    tets: np.ndarray
    pinned: np.ndarray
    tip: np.ndarray  # vertices whose mean displacement is compared
    material: Material
    duration: float  # [s]
    gravity: float = physics.G
    newton_iterations: int = 60  # required for the bending of a bar
    newton_dt: float = 1 / 240  # [s]


def cases(mesh: Path | None) -> list[Case]:
    turned = np.stack([physics.BAR[:, 1], -physics.BAR[:, 0], physics.BAR[:, 2]], 1)  # +x becomes -y
    bar = {"tets": physics.TETS, "pinned": physics.LEFT, "tip": physics.RIGHT}
    found = [
        Case("hanging bar", turned, material=SOFT, duration=0.6, **bar),
        Case("cantilever", physics.BAR, material=SOFT, gravity=physics.G / 10, duration=2.0, **bar),
    ]
    if mesh is not None:
        x, tets, top, low = hanging(mesh)
        body = {"vertices": x, "tets": tets, "pinned": top, "tip": low, "duration": 0.6}
        body |= {"newton_dt": 1 / 1200, "newton_iterations": 12}  # many sweeps of long steps do not converge on it
        for young in (1e5, 1e4):
            material = Material(young, 0.4, 1000.0, damping=0.0)
            found.append(Case(f"{mesh.stem}, E = {young:g}", material=material, **body))
    return found


def hanging(mesh: Path):
    """Vertices [m] of a mesh file, 0.3 m large, tets, and its highest and lowest vertices by +y."""
    try:
        with np.load(mesh) as data:
            x, tets = np.asarray(data["V"], np.float64), np.asarray(data["T"], np.int64)
    except (OSError, KeyError, ValueError) as e:
        sys.exit(f"{mesh}: not a mesh with V and T ({e})")
    x = (x - x.mean(0)) * 0.3 / np.ptp(x, axis=0).max()
    height = np.quantile(x[:, 1], (0.02, 0.95))
    return x, tets, np.flatnonzero(x[:, 1] >= height[1]), np.flatnonzero(x[:, 1] <= height[0])


def by_elements(c: Case) -> np.ndarray:
    """Positions [m] by linear elasticity."""
    K = physics.fem_stiffness(c.vertices, c.tets, c.material.young, c.material.poisson)
    mass = SoftBody(c.name, c.vertices, c.tets, np.zeros((1, 3), int), c.material).masses()
    return c.vertices + physics.fem_solve(K, mass[:, None] * [0.0, -c.gravity, 0.0], c.pinned)


def by_newton(c: Case, python: Path) -> dict:
    """Result of bench/peers/newton_vbd.py, run in newton's environment."""
    mu, lam = c.material.lame_parameters
    with tempfile.TemporaryDirectory() as folder:
        case, out = Path(folder, "case.npz"), Path(folder, "out.npz")
        numbers = {"density": c.material.density, "mu": mu, "lam": lam}
        numbers |= {"gravity": c.gravity, "duration": c.duration, "dt": c.newton_dt, "iterations": c.newton_iterations}
        np.savez(case, vertices=c.vertices, tets=c.tets, pinned=c.pinned, **numbers)
        program = Path(__file__).with_name("newton_vbd.py")
        run = subprocess.run([python, program, case, out], capture_output=True, text=True)
        if run.returncode:
            sys.exit(run.stderr.strip().splitlines()[-1])
        with np.load(out) as data:
            return {key: data[key] for key in data}


def by_us(c: Case) -> dict:
    """Positions [m], the fastest vertex's speed [m/s], run time [s], and the solver's statistics."""
    from sim.solver import Solver

    body = SoftBody(c.name, c.vertices, c.tets, boundary_surface(c.tets), c.material, pinned=c.pinned)
    solver = Solver([body], contacts=False, gravity=(0.0, -c.gravity, 0.0))
    solver.step(STOP_INTERVAL)  # compiles
    solver.reset()
    masses, before, begin = body.masses(), 0.0, perf_counter()
    for _ in range(round(c.duration / STOP_INTERVAL)):
        solver.step(STOP_INTERVAL)
        velocities = solver.snapshot()["v"].astype(np.float64)
        energy = masses @ (velocities**2).sum(1)
        if energy < before:
            solver.restore({"x": physics.positions(solver)[0], "v": np.zeros_like(velocities)})
            energy = 0.0
        before = energy
    speed = np.linalg.norm(velocities, axis=1).max()
    seconds = perf_counter() - begin
    return {"positions": physics.positions(solver)[0], "speed": speed, "seconds": seconds, "stats": solver.stats}


def compare(c: Case, python: Path) -> None:
    """Print a case's lines: displacement of the tip, settled volume, remaining speed, run time."""
    ours, theirs, linear = by_us(c), by_newton(c, python), by_elements(c)
    sizes = f"{len(c.vertices)} vertices, {len(c.tets)} tets, {c.duration} s"
    s = ours["stats"]
    solvers = f"ours {s['integrator']}, dt {s['dt']:.3g} s; newton {theirs['version']}, dt {c.newton_dt:.3g} s"
    print(f"\n{c.name}: {sizes}; {solvers}")
    print(f"{'':28}{'linear FEM':>12}{'newton VBD':>12}{'ours':>12}{'ours / newton - 1':>20}")

    def line(name: str, measure) -> None:
        a, b, e = (measure(x) for x in (ours["positions"], theirs["positions"].astype(np.float64), linear))
        applies = np.linalg.norm((linear - c.vertices)[c.tip].mean(0)) < LINEAR * np.ptp(c.vertices, axis=0).max()
        print(f"{name:28}{f'{e:.6g}' if applies else '-':>12}{b:12.6g}{a:12.6g}{a / b - 1:20.3%}")

    line("tip displacement [m]", lambda x: np.linalg.norm((x - c.vertices)[c.tip].mean(0)))
    rest = tet_volumes(c.vertices, c.tets).sum()
    line("settled / rest volume", lambda x: tet_volumes(x, c.tets).sum() / rest)
    inverted = [int((tet_volumes(r["positions"], c.tets) <= 0).sum()) for r in (theirs, ours)]
    print(f"{'inverted tets':28}{'':12}{inverted[0]:12}{inverted[1]:12}")
    print(f"{'fastest vertex [m/s]':28}{'':12}{theirs['speed']:12.2g}{ours['speed']:12.2g}")
    print(f"{'run time [s]':28}{'':12}{theirs['seconds']:12.1f}{ours['seconds']:12.1f}", flush=True)


def main() -> None:
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--mesh", type=Path, metavar="BODY.npz", help="also hang a tetrahedral mesh")
    p.add_argument("--newton", type=Path, default=ROOT / ".dev" / "newton" / "bin" / "python", help="its Python")
    p.add_argument("--only", default="", metavar="NAME", help="cases whose name begins so")
    args = p.parse_args()
    if not args.newton.is_file():
        sys.exit(f"{args.newton}: no such interpreter; see the first lines of this program's --help")
    start_taichi("cpu")
    for c in cases(args.mesh):
        if c.name.startswith(args.only):
            compare(c, args.newton)


if __name__ == "__main__":
    main()
