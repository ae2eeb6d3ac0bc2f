"""Random bodies, hand motions and edits of a soak.

All numbers come from a counter-based generator, one stream per (seed, episode), so that any episode can be repeated
by itself.
"""

import functools
from dataclasses import dataclass, field

import numpy as np

from bench.physics import box, torus
from core.distance_grid import DistanceGrid
from core.material import Material
from core.vocabulary import Hand
from sim.bodies import SoftBody
from sim.contact.static_shapes import rest_grid

ARENA = 1.0  # [m] from the middle to each wall
MAX_BODIES = 40
BODY_SIZES = (0.06, 0.2)  # [m] smallest and largest extent of new bodies
GRID_NODES = 20  # of a distance grid along its longest side
EDITS = ("rescale", "duplicate", "remove", "add", "material")


@dataclass(frozen=True)
class Ranges:
    """Ranges of material and number of bodies; the interface allows all of the defaults."""

    young: tuple[float, float] = (1e2, 1e8)  # [Pa]
    poisson: tuple[float, float] = (0.0, 0.49)
    density: tuple[float, float] = (10.0, 1e4)  # [kg/m^3]
    max_bodies: int = MAX_BODIES
    max_load: float = np.inf  # density * g * size / young at most: far above 1 a body is crushed by its own weight


def generator(seed: int, episode: int) -> np.random.Generator:
    """Stream of random numbers of an episode."""
    return np.random.Generator(np.random.Philox(key=seed, counter=[0, 0, 0, episode]))


SHAPES = [
    box((1.0, 1.0, 1.0), (2, 2, 2)),
    box((1.0, 0.25, 0.25), (6, 1, 1)),
    box((1.0, 0.3, 1.0), (3, 1, 3)),
    torus(0.4, 0.1, around=18, across=1),
]
# Vertices, tets and surfaces of 27 to 72 vertices, largest extent 1 m, centred
MESHES = [((x - (x.min(0) + x.max(0)) / 2) / np.ptp(x, axis=0).max(), tets, faces) for x, tets, faces in SHAPES]


def log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    """Random number whose logarithm is uniform."""
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def material(rng: np.random.Generator, ranges: Ranges) -> Material:
    """Random material."""
    young, density = log_uniform(rng, *ranges.young), log_uniform(rng, *ranges.density)
    return Material(
        young=max(young, density * 9.81 * BODY_SIZES[1] / ranges.max_load),
        poisson=float(rng.uniform(*ranges.poisson)),
        density=density,
        friction=float(rng.uniform(0.0, 1.0)),
    )


def body(rng: np.random.Generator, ranges: Ranges, position: np.ndarray) -> SoftBody:
    """Body of random mesh, size, material and attitude, centred at `position` [m]."""
    mesh, size = int(rng.integers(len(MESHES))), log_uniform(rng, *BODY_SIZES)
    x, tets, faces = MESHES[mesh]
    q = rng.normal(size=4)
    return SoftBody(
        "body",
        x * size,
        tets,
        faces,
        material(rng, ranges),
        rotation=tuple((q / np.linalg.norm(q)).tolist()),
        position=tuple(position.tolist()),
        sdf=distances(mesh).scaled(size),
    )


@functools.cache
def distances(mesh: int) -> DistanceGrid:
    """Coarse distance grid of a mesh of MESHES."""
    return rest_grid(*MESHES[mesh], nodes=GRID_NODES)


def population(rng: np.random.Generator, ranges: Ranges) -> list[SoftBody]:
    """Bodies in layers above the floor, without overlaps."""
    count = round(log_uniform(rng, 0.6, ranges.max_bodies + 0.4))
    pitch = 1.8 * BODY_SIZES[1]  # a body may lie along its space diagonal
    row = int(2 * ARENA / pitch) - 1
    cells = [(i, j, k) for j in range(3) for i in range(row) for k in range(row)]
    layer = row * row
    chosen = np.concatenate([rng.permutation(layer) + n * layer for n in range(3)])[: max(count, 1)]
    offset = np.array([-(row - 1) / 2, 0.7, -(row - 1) / 2])
    return [body(rng, ranges, (np.array(cells[c]) + offset) * pitch) for c in chosen]


@dataclass(frozen=True)
class Act:
    """Motion of one hand from `begin` to `end` [s]: it grasps at the first waypoint and releases at the last."""

    begin: float
    end: float
    waypoints: np.ndarray  # [m], (K, 3), at equal intervals
    axis: np.ndarray
    turn: float  # [rad] about the axis, in total

    def hand(self, time: float) -> Hand:
        """The hand at a time [s]."""
        f = np.clip((time - self.begin) / (self.end - self.begin), 0.0, 1.0)
        s = f * (len(self.waypoints) - 1)
        position = [np.interp(s, np.arange(len(self.waypoints)), column) for column in self.waypoints.T]
        half = 0.5 * self.turn * f
        q = np.concatenate([[np.cos(half)], np.sin(half) * self.axis])
        return Hand(tuple(map(float, position)), tuple(q.tolist()), self.begin < time < self.end, 0.04)


@dataclass
class Hands:
    """Two hands that start a random act whenever they are idle."""

    rng: np.random.Generator
    acts: list[Act | None] = field(default_factory=lambda: [None, None])
    idle_until: list[float] = field(default_factory=lambda: [0.0, 0.0])

    def at(self, time: float, bodies: list[np.ndarray]) -> list[Hand]:
        """The hands at a time [s]; bodies: vertex positions [m] of each, (V, 3)."""
        for h in (0, 1):
            if self.acts[h] is not None and time >= self.acts[h].end:
                self.acts[h], self.idle_until[h] = None, time + float(self.rng.exponential(0.3))
        idle = [self.acts[h] is None and time >= self.idle_until[h] for h in (0, 1)]
        if all(idle) and bodies and self.rng.random() < 0.5:
            self.acts = self._with_both(time, self._pick(bodies))
        elif any(idle) and bodies:
            self.acts[idle.index(True)] = self._throw(time, self._pick(bodies))
        return [a.hand(time) if a is not None else Hand() for a in self.acts]

    def _pick(self, bodies: list[np.ndarray]) -> np.ndarray:
        return bodies[self.rng.integers(len(bodies))]

    def _axis(self) -> np.ndarray:
        a = self.rng.normal(size=3)
        return a / np.linalg.norm(a)

    def _throw(self, time: float, x: np.ndarray) -> Act:
        """Move a body along random waypoints and release it in motion."""
        rng, first = self.rng, x[self.rng.integers(len(x))]
        waypoints = rng.uniform([-ARENA, 0.05, -ARENA], [ARENA, 1.2, ARENA], (int(rng.integers(1, 4)), 3)) * 0.8
        length = float(rng.uniform(0.3, 1.5))
        return Act(time, time + length, np.concatenate([[first], waypoints]), self._axis(), rng.normal() * np.pi)

    def _with_both(self, time: float, x: np.ndarray) -> list[Act]:
        """Squeeze, stretch or twist a body, by up to two turns, between the hands."""
        rng, along = self.rng, self._axis()
        ends = x[[np.argmin(x @ along), np.argmax(x @ along)]]
        middle, factor = ends.mean(0) + [0, 0.2, 0], log_uniform(rng, 0.05, 3.0)
        turn, length = float(rng.uniform(-4, 4) * np.pi), float(rng.uniform(0.5, 1.5))
        return [
            Act(time, time + length, np.stack([e, middle + factor * (e - ends.mean(0))]), along, side * turn / 2)
            for e, side in zip(ends, (-1, 1), strict=True)
        ]


def edit(rng: np.random.Generator, ranges: Ranges, solver) -> str:
    """Edit the moving bodies at random; returns a description."""
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
        solver.duplicate(i, above - solver.bodies()[i].centroid)
    elif kind == "remove":
        solver.remove(i)
    elif kind == "material":
        solver.set_material(i, material(rng, ranges))
    else:
        extent = float(np.ptp(solver.snapshot()["bodies"][i].shape.vertices, axis=0).max())
        solver.rescale(i, float(np.clip(log_uniform(rng, 0.5, 2.0), BODY_SIZES[0] / extent, BODY_SIZES[1] / extent)))
    return f"{kind} {i}"
