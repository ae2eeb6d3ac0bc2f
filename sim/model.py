"""All bodies joined into the flat arrays that the device holds, and the capacity of its fields (NumPy only)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from core.errors import BadInput
from sim.body_model import BodyModel, RestShape
from sim.elastic.time_step import lame

MAX_STEP = 0.5  # edge lengths; a vertex that crosses more in a substep has lost its elements (5e4 Pa: at 30-100 m/s)
MAX_BODIES = 64  # per-body fields are tiny; one size for all scenes keeps compiled kernels in the cache


@dataclass(frozen=True)
class Sizes:
    """Numbers of elements (the fields' capacities are larger)."""

    vertices: int
    tets: int
    triangles: int
    bodies: int


@dataclass(frozen=True)
class Capacity:
    """Capacity of the solver's fields, which cannot grow: the first bodies `factor` times, and at least these totals.

    samples: points of contact; nodes: of the bodies' distance grids, each different one counted once. Kernels are
    compiled once, for what fits: contact among bodies, if more than one does; rigid bodies, if `rigid` or if there is
    one at first.
    """

    vertices: int = 0
    tets: int = 0
    triangles: int = 0
    samples: int = 0
    nodes: int = 0
    bodies: int = 0
    factor: float = 1.0
    rigid: bool = False

    @classmethod
    def of(cls, capacity: Capacity | float | None) -> Capacity:
        """Take a factor as a capacity for MAX_BODIES bodies, None as no more than the first bodies need."""
        if isinstance(capacity, Capacity):
            return capacity
        return cls() if capacity is None else cls(bodies=MAX_BODIES, factor=float(capacity))

    def sized(self, what: str, need: int) -> int:
        """Capacity for `what`, of which `need` are there at first."""
        return max(1, int(np.ceil(need * self.factor)), getattr(self, what))

    @property
    def grows(self) -> bool:
        """True if more may come than is there at first."""
        return self != Capacity()


class CapacityError(BadInput):
    """Raised where the fields are too small for what they should hold."""


def fit(what: str, need: int, capacity: int) -> None:
    """Raise CapacityError if `need` things do not fit."""
    if need > capacity:
        raise CapacityError(f"no room for {need} {what}: the capacity is {capacity}")


class Model:
    """Bodies in the order of their indices; vertex_begin, tet_begin, triangle_begin (B+1,) are the offsets of each."""

    def __init__(self, bodies: Sequence[BodyModel]):
        self.bodies = tuple(bodies)
        shapes = self.shapes
        self.vertex_begin = offsets([len(s.vertices) for s in shapes])
        self.tet_begin = offsets([len(s.tets) for s in shapes])
        self.triangle_begin = offsets([len(s.surface) for s in shapes])
        counts = (int(e[-1]) for e in (self.vertex_begin, self.tet_begin, self.triangle_begin))
        self.sizes = Sizes(*counts, bodies=len(self.bodies))

    def index(self, i: int) -> int:
        """Check the index of a body; raise BadInput if there is none."""
        return body_index(i, len(self.bodies))

    @property
    def rigid(self) -> bool:
        """True if any body is rigid."""
        return any(s.rigid for s in self.shapes)

    @property
    def soft(self) -> bool:
        """True if any body deforms."""
        return not all(s.rigid for s in self.shapes)

    @property
    def shapes(self) -> list[RestShape]:
        return [p.shape for p in self.bodies]

    @cached_property
    def tets(self) -> np.ndarray:
        return stacked([s.tets + o for s, o in zip(self.shapes, self.vertex_begin, strict=False)], 4)

    @cached_property
    def kappas(self) -> np.ndarray:
        """The largest kappa of each body [1/s^2], (B,)."""
        return np.array([p.kappa.max(initial=0.0) for p in self.bodies])

    @cached_property
    def crossing(self) -> float:
        """The shortest time [s] in which a pressure wave crosses a body."""
        return min((p.crossing for p in self.bodies), default=np.inf)

    def columns(self) -> dict[str, np.ndarray]:
        """The values of State's fields of these names."""
        bodies, shapes, sizes = self.bodies, self.shapes, self.sizes
        material = [p.material for p in bodies]
        index = np.arange(sizes.bodies)
        faces = [s.surface + o for s, o in zip(shapes, self.vertex_begin, strict=False)]
        return {
            "rest": stacked([s.vertices for s in shapes], 3),
            "inv_mass": stacked([p.inv_mass for p in bodies]),
            "mass": stacked([p.mass for p in bodies]),
            "tets": self.tets,
            "triangles": stacked(faces, 3),
            "body_of_vertex": np.repeat(index, np.diff(self.vertex_begin)),
            "body_of_tet": np.repeat(index, np.diff(self.tet_begin)),
            "body_of_triangle": np.repeat(index, np.diff(self.triangle_begin)),
            "vertex_begin": self.vertex_begin,
            "tet_begin": self.tet_begin,
            "triangle_begin": self.triangle_begin,
            "mu": [lame(m)[0] for m in material],
            "lam": [lame(m)[1] for m in material],
            "kappa": self.kappas,
            "max_step": [MAX_STEP * s.edge for s in shapes],
            "damping": [m.damping for m in material],
            "friction": [m.friction for m in material],
            "sliding_friction": [m.sliding_friction for m in material],
            "density": [m.density for m in material],
            "body_mass": [p.mass.sum() for p in bodies],
            "prescribed_mass": [p.mass[p.inv_mass == 0.0].sum() for p in bodies],
            "vertex_count": sizes.vertices,
            "tet_count": sizes.tets,
            "triangle_count": sizes.triangles,
            "body_count": sizes.bodies,
        }


def body_index(i: int, count: int) -> int:
    """Check index i among `count` bodies; raise BadInput if it is out of range."""
    if not 0 <= i < count:
        raise BadInput(f"there is no body {i}, of {count}")
    return int(i)


def offsets(counts: list[int]) -> np.ndarray:
    """Begin of each run of `counts` elements, and the end of the last, (n+1,)."""
    return np.concatenate([[0], np.cumsum(counts, dtype=np.int64)]).astype(np.int64)


def stacked(arrays: list[np.ndarray], width: int | None = None) -> np.ndarray:
    """Concatenate arrays (n, width) or (n,), also none."""
    return np.concatenate([np.zeros(0 if width is None else (0, width), int), *arrays])
