"""A pile of soft bodies that comes to rest. Taichi must be initialised."""

import numpy as np

from bench.sample_meshes import box
from bench.torus import torus
from core.material import Material
from scenes.scene import Plane
from sim.soft_body import SoftBody
from sim.solver import Solver

DT, G, SIDE = 1 / 60, 9.81, 0.08
RUBBER = Material(young=5e4, poisson=0.4, density=1100.0, friction=0.6, damping=4.0)


def pile() -> Solver:
    """Two stacks of two cubes, with a ring on top of the first, and a ring about the second that leans on nothing."""
    x, tets, surface = box((SIDE,) * 3, (2, 2, 2))
    ring = torus(0.08, 0.016, 16, 2)
    turned = (np.cos(0.2), 0, np.sin(0.2), 0)
    places = [(0, 0.041, 0), (0.005, 0.123, 0), (0.3, 0.041, 0), (0.3, 0.125, 0.01)]
    bodies = [
        SoftBody(f"cube{k}", x - SIDE / 2, tets, surface, RUBBER, turned if k % 2 else (1, 0, 0, 0), place)
        for k, place in enumerate(places)
    ]
    bodies += [SoftBody(f"ring{k}", *ring, RUBBER, position=p) for k, p in enumerate([(0, 0.19, 0.01), (0.6, 0.02, 0)])]
    bodies.append(SoftBody("ring2", *ring, RUBBER, position=(0.61, 0.06, 0.02)))
    return Solver(bodies, [Plane((0, 0, 0), (0, 1, 0))], hands=0)


def energy(solver) -> tuple[float, float]:
    """Kinetic energy, and kinetic with potential energy in gravity and in the tets [J]."""
    s, n = solver.state, solver.state.sizes.vertices
    q, m = solver.snapshot(), s.mass.to_numpy()[:n].astype(np.float64)
    x, v = q["x"].astype(np.float64) + q["carry"], q["v"].astype(np.float64)
    kinetic = 0.5 * m @ (v**2).sum(1)
    tets, rest = s.tets.to_numpy()[: s.sizes.tets], s.rest.to_numpy()[:n].astype(np.float64)
    D, E = (np.swapaxes(p[tets[:, 1:]] - p[tets[:, :1]], 1, 2) for p in (x, rest))
    F, volume, body = D @ np.linalg.inv(E), np.linalg.det(E) / 6, s.body_of_tet.to_numpy()[: len(tets)]
    mu, lam = s.mu.to_numpy()[body].astype(np.float64), s.lam.to_numpy()[body].astype(np.float64)
    grow = np.linalg.det(F) - 1
    density = 0.5 * mu * ((F**2).sum((1, 2)) - 3) - mu * grow + 0.5 * lam * grow**2
    return kinetic, kinetic + m @ x[:, 1] * G + volume @ density


def resting_pile(seconds: float = 60.0, settle: float = 1.0, *, verbose: bool = False) -> dict:
    """What a pile does after it has settled for `settle` [s] of `seconds`.

    gained [J]: the largest growth of the whole energy over its least value so far; kinetic_start, kinetic_end [J]: the
    largest kinetic energy in the first and in the last second; drift [m]: of any vertex in the last second.
    """
    solver = pile()
    frames, first = round(seconds / DT), round(settle / DT)
    least, gained, kinetics, before = np.inf, 0.0, [], None
    for k in range(frames):
        solver.step(DT, [])
        if k < first:
            continue
        kinetic, whole = energy(solver)
        least = min(least, whole)
        gained = max(gained, whole - least)
        kinetics.append(kinetic)
        if k == frames - 60:
            before = solver.snapshot()["x"]
        if verbose and k % 60 == 0:
            print(f"{k / 60:5.0f} s  kinetic {kinetic:.3e} J  energy {whole:.7f} J")
    drift = np.linalg.norm(solver.snapshot()["x"] - before, axis=1).max()
    return {
        "gained": gained,
        "kinetic_start": max(kinetics[:60]),
        "kinetic_end": max(kinetics[-60:]),
        "drift": float(drift),
    }
