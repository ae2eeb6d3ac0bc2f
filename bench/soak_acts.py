"""Random populations, hand motions (grab, throw, squeeze, twist) and edits of the soak test.

All numbers come from a counter-based generator with one stream for each (seed, episode), so that any episode can be
repeated alone.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass, field

import numpy as np

from bench.sample_meshes import box, torus
from core.distance_grid import DistanceGrid
from core.material import Material
from scenes.scene import Hand
from sim.contact.rest_distance import rest_grid
from sim.soft_body import SoftBody

ARENA = 1.0  # [m] from the middle to each wall
MOST_BODIES = 40
SIZES = (0.06, 0.2)  # [m], largest extents of new bodies
NODES = 20  # of a distance grid along its longest side
EDITS = ("rescale", "duplicate", "remove", "add", "material")


@dataclass(frozen=True)
class Ranges:
    """Ranges of random bodies and of their number; the interface allows all of the defaults."""

    young: tuple[float, float] = (1e2, 1e8)  # [Pa]
    poisson: tuple[float, float] = (0.0, 0.49)
    density: tuple[float, float] = (10.0, 1e4)  # [kg/m^3]
    max_bodies: int = MOST_BODIES
    max_load: float = np.inf  # maximum of density * g * size / young; far above 1 a body is crushed by its own weight


def generator(seed: int, episode: int) -> np.random.Generator:
    """Random stream of one episode of one seed."""
    return np.random.Generator(np.random.Philox(key=seed, counter=[0, 0, 0, episode]))


def meshes() -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Meshes (vertices, tets, surface) of 27 to 72 vertices, of extent 1 m and centred on the origin."""
    found = [
        box((1.0, 1.0, 1.0), (2, 2, 2)),
        box((1.0, 0.25, 0.25), (6, 1, 1)),
        box((1.0, 0.3, 1.0), (3, 1, 3)),
        torus(0.4, 0.1, around=18, across=1),
    ]
    return [((x - (x.min(0) + x.max(0)) / 2) / np.ptp(x, axis=0).max(), tets, faces) for x, tets, faces in found]


MESHES = meshes()


def log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    """Log-uniform random number between `low` and `high`."""
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def material(rng: np.random.Generator, ranges: Ranges) -> Material:
    young, density = log_uniform(rng, *ranges.young), log_uniform(rng, *ranges.density)
    return Material(
        young=max(young, density * 9.81 * SIZES[1] / ranges.max_load),
        poisson=float(rng.uniform(*ranges.poisson)),
        density=density,
        friction=float(rng.uniform(0.0, 1.0)),
    )


def body(rng: np.random.Generator, ranges: Ranges, place: np.ndarray) -> SoftBody:
    """A random body (mesh, size, material, attitude) centred at `place` [m]."""
    mesh, size = int(rng.integers(len(MESHES))), log_uniform(rng, *SIZES)
    x, tets, faces = MESHES[mesh]
    q = rng.normal(size=4)
    return SoftBody(
        "body",
        x * size,
        tets,
        faces,
        material(rng, ranges),
        rotation=tuple((q / np.linalg.norm(q)).tolist()),
        position=tuple(place.tolist()),
        sdf=distances(mesh).scaled(size),
    )


@functools.cache
def distances(mesh: int) -> DistanceGrid:
    """Signed distance of a mesh of MESHES, coarse, as there are up to forty."""
    return rest_grid(*MESHES[mesh], nodes=NODES)


def population(rng: np.random.Generator, ranges: Ranges) -> list[SoftBody]:
    """Disjoint bodies in layers above the floor."""
    count = round(log_uniform(rng, 0.6, ranges.max_bodies + 0.4))
    pitch, row = 1.8 * SIZES[1], int(2 * ARENA / (1.8 * SIZES[1])) - 1  # a body may lie along its space diagonal
    cells = [(i, j, k) for j in range(3) for i in range(row) for k in range(row)]
    layer = row * row
    chosen = np.concatenate([rng.permutation(layer) + n * layer for n in range(3)])[: max(count, 1)]
    offset = np.array([-(row - 1) / 2, 0.7, -(row - 1) / 2])
    return [body(rng, ranges, (np.array(cells[c]) + offset) * pitch) for c in chosen]


@dataclass(frozen=True)
class Act:
    """Motion of one hand from `begin` to `end` [s]: it grabs at the first waypoint and lets go at the last."""

    begin: float
    end: float
    waypoints: np.ndarray  # [m], (K, 3), at equal intervals
    axis: np.ndarray
    turn: float  # [rad] in all
    reach: float = 0.04

    def hand(self, time: float) -> Hand:
        f = np.clip((time - self.begin) / (self.end - self.begin), 0.0, 1.0)
        s = f * (len(self.waypoints) - 1)
        place = [np.interp(s, np.arange(len(self.waypoints)), column) for column in self.waypoints.T]
        half = 0.5 * self.turn * f
        q = np.concatenate([[np.cos(half)], np.sin(half) * self.axis])
        return Hand(tuple(map(float, place)), tuple(q.tolist()), self.begin < time < self.end, self.reach)


@dataclass
class Hands:
    """Two hands that start a random action when idle. Bodies are given as vertex positions, (V, 3) each."""

    rng: np.random.Generator
    acts: list[Act | None] = field(default_factory=lambda: [None, None])
    free_from: list[float] = field(default_factory=lambda: [0.0, 0.0])

    def at(self, time: float, bodies: list[np.ndarray]) -> list[Hand]:
        for h in (0, 1):
            if self.acts[h] is not None and time >= self.acts[h].end:
                self.acts[h], self.free_from[h] = None, time + float(self.rng.exponential(0.3))
        idle = [self.acts[h] is None and time >= self.free_from[h] for h in (0, 1)]
        if all(idle) and bodies and self.rng.random() < 0.5:
            self.acts = self._both(time, self._pick(bodies))
        elif any(idle) and bodies:
            self.acts[idle.index(True)] = self._carry(time, self._pick(bodies))
        return [a.hand(time) if a is not None else Hand() for a in self.acts]

    def _pick(self, bodies: list[np.ndarray]) -> np.ndarray:
        return bodies[self.rng.integers(len(bodies))]

    def _axis(self) -> np.ndarray:
        a = self.rng.normal(size=3)
        return a / np.linalg.norm(a)

    def _carry(self, time: float, x: np.ndarray) -> Act:
        """Carry a body along random waypoints, fast or slow, and let go in motion."""
        rng, first = self.rng, x[self.rng.integers(len(x))]
        waypoints = rng.uniform([-ARENA, 0.05, -ARENA], [ARENA, 1.2, ARENA], (int(rng.integers(1, 4)), 3)) * 0.8
        length = float(rng.uniform(0.3, 1.5))
        return Act(time, time + length, np.concatenate([[first], waypoints]), self._axis(), rng.normal() * np.pi)

    def _both(self, time: float, x: np.ndarray) -> list[Act]:
        """Squeeze, stretch or twist a body between both hands, by up to two turns."""
        rng, along = self.rng, self._axis()
        ends = x[[np.argmin(x @ along), np.argmax(x @ along)]]
        middle, factor = ends.mean(0) + [0, 0.2, 0], log_uniform(rng, 0.05, 3.0)
        turn, length = float(rng.uniform(-4, 4) * np.pi), float(rng.uniform(0.5, 1.5))
        return [
            Act(time, time + length, np.stack([e, middle + factor * (e - ends.mean(0))]), along, side * turn / 2)
            for e, side in zip(ends, (-1, 1), strict=True)
        ]


def edit(rng: np.random.Generator, ranges: Ranges, solver) -> str:
    """Apply a random edit to the moving bodies; returns its description."""
    bodies = solver.bodies()
    kind = EDITS[rng.integers(len(EDITS))]
    if not bodies or (kind == "remove" and len(bodies) == 1):
        kind = "add"
    if len(bodies) >= ranges.max_bodies and kind in ("add", "duplicate"):
        kind = "remove"
    i = int(rng.integers(max(len(bodies), 1)))
    above = np.append(rng.uniform(-0.7, 0.7, 2) * ARENA, 1.5)[[0, 2, 1]]
    if kind == "add":
        solver.add(body(rng, ranges, above))
    elif kind == "duplicate":
        solver.duplicate(i, position=tuple(above.tolist()))
    elif kind == "remove":
        solver.remove(i)
    elif kind == "material":
        solver.set_material(i, material(rng, ranges))
    else:
        extent = float(np.ptp(solver.snapshot()["bodies"][i].shape.vertices, axis=0).max())
        solver.rescale(i, float(np.clip(log_uniform(rng, 0.5, 2.0), SIZES[0] / extent, SIZES[1] / extent)))
    return f"{kind} {i}"
