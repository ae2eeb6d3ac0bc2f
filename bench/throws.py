"""Rings thrown about on pegs: how many stay linked. Taichi must be initialised."""

import numpy as np

from bench.torus import torus
from core.material import Material
from scenes.scene import Capsule, Plane
from sim.soft_body import SoftBody
from sim.solver import Solver

DT = 1 / 60
RUBBER = Material(young=3e4, poisson=0.4, density=1100.0, friction=0.6)
HEIGHT, PEG = 0.4, 0.01  # [m] pegs stand between a floor and a ceiling, so that only what passes through gets loose
APART = 1.0  # [m] between pegs
RING, TUBE = 0.08, 0.016  # [m] as the rings of the ring toss
MOST = 16  # rings in one solver


def linked_throws(
    count: int = 100, speed: float = 5.0, *, around: int = 24, across: int = 2, seconds: float = 1.0, seed: int = 0
) -> int:
    """How many of `count` rings stay on their pegs of 2 cm, thrown from there at up to `speed` [m/s], with a spin.

    The ring's cage has `around` x `across`^2 cells.
    """
    rng, kept = np.random.default_rng(seed), 0
    rings = min(MOST, count)
    x, tets, surface = torus(RING, TUBE, around, across)
    feet = [(APART * (k % 4), 0.0, APART * (k // 4)) for k in range(rings)]
    bodies = [SoftBody(f"ring{k}", x, tets, surface, RUBBER, position=foot) for k, foot in enumerate(feet)]
    pegs = [Capsule(foot, (foot[0], HEIGHT, foot[2]), PEG) for foot in feet]
    walls = [Plane((0, 0, 0), (0, 1, 0)), Plane((0, HEIGHT, 0), (0, -1, 0))]
    solver = Solver(bodies, [*pegs, *walls], hands=0)
    for first in range(0, count, rings):
        starts = [thrown(rng, x, foot, speed) for foot in feet]
        solver.restore({name: np.concatenate([s[k] for s in starts]) for k, name in enumerate(("x", "v"))})
        on = np.ones(rings, bool)
        for _ in range(round(seconds / DT)):
            solver.step(DT, [])
            now = solver.snapshot()["x"].astype(np.float64).reshape(rings, -1, 3)
            on &= [abs(winding(p - foot, around)) == 1 for p, foot in zip(now, feet, strict=True)]
        kept += int(on[: count - first].sum())
    return kept


def thrown(rng, x, foot, speed) -> tuple[np.ndarray, np.ndarray]:
    """Positions and velocities (V, 3) of a ring about its peg, turned and moved but not touching it."""
    while True:
        axis, angle = rng.normal(size=3), rng.uniform(0, 1.0)
        p = x @ rotation(axis, angle).T + rng.uniform(-0.5, 0.5, 3) * RING * (1, 0, 1)
        p[:, 1] += HEIGHT / 2 + rng.uniform(-0.5, 0.5) * HEIGHT / 2
        clear = np.hypot(p[:, 0], p[:, 2]).min() > PEG + 0.3 * TUBE and p[:, 1].min() > 0 and p[:, 1].max() < HEIGHT
        if clear and encloses(x, p):
            break
    direction = rng.normal(size=3)
    spin = rng.normal(size=3)
    spin *= rng.uniform(0, speed / 2) / RING / np.linalg.norm(spin)
    v = rng.uniform(0.3, 1.0) * speed * direction / np.linalg.norm(direction)
    return p + foot, v + np.cross(spin, p - p.mean(0))


def encloses(x, p) -> bool:
    """Whether the ring p, at rest x, goes around the y axis."""
    order = np.argsort(np.arctan2(x[:, 2], x[:, 0]))
    return abs(turns(p[order])) == 1


def winding(p, around: int) -> int:
    """How often the centre line of a ring of `around` sections goes around the y axis."""
    return turns(p.reshape(around, -1, 3).mean(1))


def turns(line) -> int:
    angle = np.arctan2(line[:, 2], line[:, 0])
    step = np.diff(np.append(angle, angle[0]))
    return round(((step + np.pi) % (2 * np.pi) - np.pi).sum() / (2 * np.pi))


def rotation(axis, angle) -> np.ndarray:
    x, y, z = axis / np.linalg.norm(axis)
    K = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * K + (1 - np.cos(angle)) * K @ K
