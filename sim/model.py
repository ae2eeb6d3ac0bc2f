"""All bodies joined into the flat arrays that the device holds, and how much the device has room for (NumPy only)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from core.errors import BadInput
from sim.body_model import BodyModel
from sim.elastic.time_step import lame

MAX_STEP = 0.5  # of an edge; a vertex that crosses more in a substep has lost its elements (5e4 Pa: at 30-100 m/s)
MAX_BODIES = 64  # per-body fields are tiny; one size for all scenes keeps compiled kernels in the cache


@dataclass(frozen=True)
class Sizes:
    """How many of each there are (the fields' capacities are larger)."""

    vertices: int
    tets: int
    triangles: int
    bodies: int


@dataclass(frozen=True)
class Capacity:
    """How much the solver's fields hold, which cannot grow: the first bodies `factor` times, and at least these totals.

    samples: points of contact; nodes: of the bodies' distance grids, each different one counted once. Kernels are
    compiled once, for what there is room for: contact among bodies, if for more than one; rigid bodies, if `rigid` or
    if there is one at first.
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
    def of(cls, room: Capacity | float | None) -> Capacity:
        """A factor as a Room for as many bodies as there can be; None: nothing but what rounding up leaves."""
        if isinstance(room, Capacity):
            return room
        return cls() if room is None else cls(bodies=MAX_BODIES, factor=float(room))

    def sized(self, what: str, need: int) -> int:
        """Room for `what`, of which `need` are there at first."""
        return max(1, int(np.ceil(need * self.factor)), getattr(self, what))

    @property
    def grows(self) -> bool:
        """Whether more may come than is there at first."""
        return self != Capacity()


class CapacityError(BadInput):
    """What the fields hold does not suffice."""


def fit(what: str, need: int, capacity: int) -> None:
    """NoRoom if `need` things do not fit."""
    if need > capacity:
        raise CapacityError(f"no room for {need} {what}: there is room for {capacity} (see Room)")


class Model:
    """Bodies in the order of their indices, with the offsets of each among all vertices, tets and triangles, (B+1,)."""

    def __init__(self, parts: list[BodyModel]):
        self.parts = list(parts)
        shapes = [p.shape for p in parts]
        self.vertex_begin = ends([len(s.vertices) for s in shapes])
        self.tet_begin = ends([len(s.tets) for s in shapes])
        self.triangle_begin = ends([len(s.surface) for s in shapes])
        counts = (int(e[-1]) for e in (self.vertex_begin, self.tet_begin, self.triangle_begin))
        self.sizes = Sizes(*counts, bodies=len(parts))

    @property
    def rigid(self) -> bool:
        """Whether any body is rigid."""
        return any(s.rigid for s in self.shapes)

    @property
    def soft(self) -> bool:
        """Whether any body deforms."""
        return not all(s.rigid for s in self.shapes)

    @property
    def shapes(self):
        return [p.shape for p in self.parts]

    @cached_property
    def tets(self) -> np.ndarray:
        return stacked([s.tets + o for s, o in zip(self.shapes, self.vertex_begin, strict=False)], 4)

    @cached_property
    def kappas(self) -> np.ndarray:
        """The largest kappa of each body [1/s^2], (B,)."""
        return np.array([p.kappa.max(initial=0.0) for p in self.parts])

    @cached_property
    def crossing(self) -> float:
        """The shortest time [s] in which a pressure wave crosses a body."""
        return min((p.crossing for p in self.parts), default=np.inf)

    def columns(self) -> dict[str, np.ndarray]:
        """The values of State's fields of these names."""
        parts, shapes, sizes = self.parts, self.shapes, self.sizes
        material = [p.material for p in parts]
        index = np.arange(sizes.bodies)
        faces = [s.surface + o for s, o in zip(shapes, self.vertex_begin, strict=False)]
        return {
            "rest": stacked([s.vertices for s in shapes], 3),
            "inv_mass": stacked([p.inv_mass for p in parts]),
            "mass": stacked([p.mass for p in parts]),
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
            "body_mass": [p.mass.sum() for p in parts],
            "prescribed_mass": [p.mass[p.inv_mass == 0.0].sum() for p in parts],
            "vertex_count": sizes.vertices,
            "tet_count": sizes.tets,
            "triangle_count": sizes.triangles,
            "body_count": sizes.bodies,
        }


def ends(counts: list[int]) -> np.ndarray:
    """0, and where each of the runs ends, (n+1,)."""
    return np.concatenate([[0], np.cumsum(counts, dtype=np.int64)]).astype(np.int64)


def stacked(arrays: list[np.ndarray], width: int | None = None) -> np.ndarray:
    """Arrays (n, width) or (n,) one after the other; also of none."""
    return np.concatenate([np.zeros(0 if width is None else (0, width), int), *arrays])
