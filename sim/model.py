"""All bodies joined into the flat arrays that the device holds (NumPy only)."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import numpy as np

from core.errors import BadInput
from sim.body_model import BodyModel, RestShape
from sim.capacity import Sizes, offsets, stacked
from sim.elastic.time_step import lame

MAX_STEP = 0.5  # edge lengths in a substep of XPBD; a faster vertex has lost its elements (5e4 Pa: at 30-100 m/s)


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
            "retardation": [m.retardation_time for m in material],
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
