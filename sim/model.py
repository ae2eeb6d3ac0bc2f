"""Simulated bodies on the host, with the constants derived from them, and joined into flat arrays (NumPy).

RestShape and BodyModel hold what follows from the mesh and the material of a body, and Model joins all
bodies of a solver; Capacity says how many more the device's fields can take.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np

from core.distance_grid import DistanceGrid, same_grid
from core.errors import BadInput
from core.material import Material
from core.tetmesh import tet_volumes
from sim.bodies import RigidBody, SoftBody
from sim.time_step import clamp_stiffness, lame, stiffness_bounds, wave_speed

# Times the largest bound of a body's tets to which plastic flow may stiffen any of them. It costs XPBD twice as many
# substeps, and lets a tet be pressed to 0.3 of its height (sim/elastic/plastic_flow.py)
FLOW_STIFFENING = 4.0
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

    def sized(self, what: str, need: int) -> int:
        """Capacity for `what`, if `need` of them exist at first."""
        return max(1, int(np.ceil(need * self.factor)), getattr(self, what))

    @property
    def grows(self) -> bool:
        """True if more may come than is there at first."""
        return self != Capacity()


class CapacityError(BadInput):
    """Raised where the fields are too small for what they should hold."""


def fit(what: str, need: int, capacity: int) -> None:
    """Raise CapacityError if `need` elements do not fit."""
    if need > capacity:
        raise CapacityError(f"no room for {need} {what}: the capacity is {capacity}")


def offsets(counts: list[int]) -> np.ndarray:
    """Begin of each run of `counts` elements, and the end of the last, (n+1,)."""
    return np.concatenate([[0], np.cumsum(counts, dtype=np.int64)]).astype(np.int64)


def stacked(arrays: list[np.ndarray], width: int | None = None) -> np.ndarray:
    """Concatenate arrays (n, width) or (n,), also none."""
    return np.concatenate([np.zeros(0 if width is None else (0, width), int), *arrays])


class RestShape:
    """A mesh at rest in its body's frame [m], and everything that follows from the mesh alone.

    Bodies of the same mesh share one. `root` is the shape that this one is `factor` times as large as.
    `solid` are the tets that carry mass, and `tets` those of them that deform: none of a rigid body's. `boxed`: the
    shape is exactly the box that its vertices span, about the frame's origin.
    """

    def __init__(
        self,
        vertices,
        tets,
        surface,
        sdf: DistanceGrid | None,
        *,
        rigid: bool = False,
        boxed: bool = False,
        root: RestShape | None = None,
        factor: float = 1.0,
    ):
        self.vertices = np.asarray(vertices, np.float64)
        self.solid, self.surface, self.sdf = np.asarray(tets, np.int64), np.asarray(surface, np.int64), sdf
        self.rigid, self.boxed = rigid, boxed
        self.tets = self.solid[:0] if rigid else self.solid
        self.root, self.factor = self if root is None else root, factor
        self._kept: dict = {}

    @classmethod
    def of(cls, body: SoftBody | RigidBody) -> RestShape:
        boxed = body.rigid and body.boxed
        return cls(body.vertices, body.tets, body.surface, body.sdf, rigid=body.rigid, boxed=boxed)

    def fits(self, body: SoftBody | RigidBody) -> bool:
        """Return whether the body has this mesh."""
        if (self.rigid, self.boxed) != (body.rigid, body.rigid and body.boxed):
            return False
        pairs = [(self.vertices, body.vertices), (self.solid, body.tets), (self.surface, body.surface)]
        return all(np.array_equal(a, b) for a, b in pairs) and same_grid(self.sdf, body.sdf)

    def once(self, derive: Callable, *arguments):
        """derive(self, *arguments), which is computed at the first call only."""
        key = (derive, *arguments)
        if key not in self._kept:
            self._kept[key] = derive(self, *arguments)
        return self._kept[key]

    def scaled(self, factor: float) -> RestShape:
        """The same shape `factor` times as large; scaling there and back gives this one again."""
        root, factor = self.root, self.factor * factor
        if abs(factor - 1.0) < 1e-12:
            return root
        sdf = None if root.sdf is None else root.sdf.scaled(factor)
        x = root.vertices * factor
        return RestShape(x, root.solid, root.surface, sdf, rigid=root.rigid, boxed=root.boxed, root=root, factor=factor)

    @property
    def bytes(self) -> int:
        """Size in memory, roughly: distances take the most."""
        kept = sum(v.values.nbytes for v in self._kept.values() if isinstance(v, DistanceGrid))
        return 10 * self.vertices.nbytes + kept + (0 if self.sdf is None else self.sdf.values.nbytes)

    @cached_property
    def inverse(self) -> np.ndarray:
        """D_m^-1 of each tet [1/m], (T, 3, 3)."""
        if self.root is not self:
            return self.root.inverse / self.factor
        x = self.vertices[self.tets]
        return np.linalg.inv(np.swapaxes(x[:, 1:] - x[:, :1], 1, 2))

    @cached_property
    def volumes(self) -> np.ndarray:
        """Volume of each tet [m^3], (T,)."""
        if self.root is not self:
            return self.root.volumes * self.factor**3
        return tet_volumes(self.vertices, self.tets)

    @cached_property
    def vertex_volumes(self) -> np.ndarray:
        """Volume that each vertex stands for [m^3], (V,)."""
        if self.root is not self:
            return self.root.vertex_volumes * self.factor**3
        volumes = tet_volumes(self.vertices, self.solid)
        return np.bincount(self.solid.ravel(), np.repeat(volumes / 4, 4), minlength=len(self.vertices))

    @cached_property
    def length(self) -> float:
        """Largest extent [m]."""
        return float(np.ptp(self.vertices, axis=0).max())

    @cached_property
    def edge(self) -> float:
        """Median edge length of the tets [m]."""
        if self.root is not self:
            return self.root.edge * self.factor
        x = self.vertices[self.solid]
        return float(np.median(np.linalg.norm(x - np.roll(x, 1, axis=1), axis=-1)))

    @cached_property
    def center(self) -> np.ndarray:
        """Centre of mass [m], (3,)."""
        return np.average(self.vertices, axis=0, weights=self.vertex_volumes)

    @cached_property
    def flattest(self) -> np.ndarray:
        """Unit direction of the smallest spread of the mass, its largest component positive, (3,)."""
        if self.root is not self:
            return self.root.flattest
        r = self.vertices - self.center
        n = np.linalg.eigh((r * self.vertex_volumes[:, None]).T @ r)[1][:, 0]
        return n * np.sign(n[np.argmax(np.abs(n))])


class BodyModel:
    """A body of the solver, its shape, and the constants that follow from both and its material."""

    def __init__(self, body: SoftBody | RigidBody, shape: RestShape):
        self.body, self.shape = body, shape

    @classmethod
    def of(cls, body: SoftBody | RigidBody, others: list[BodyModel]) -> BodyModel:
        """Check a body; it shares the shape of another one with the same mesh."""
        shape = next((p.shape for p in others if p.shape.fits(body)), None)
        body.check()
        return cls(body, RestShape.of(body) if shape is None else shape)

    @cached_property
    def mass(self) -> np.ndarray:
        """Lumped masses [kg], (V,)."""
        return self.body.material.density * self.shape.vertex_volumes

    @cached_property
    def inv_mass(self) -> np.ndarray:
        """Inverse mass [1/kg], 0 where pinned, and of a rigid body, whose vertices follow it, (V,)."""
        w = np.zeros_like(self.mass) if self.body.rigid else 1 / self.mass
        if self.body.pinned is not None:
            w[np.asarray(self.body.pinned, np.int64)] = 0.0
        return w

    @cached_property
    def material(self) -> Material:
        """Material as it is simulated: not stiffer than the integrator bears (sim/time_step.py)."""
        return self.body.material if self.body.rigid else clamp_stiffness(self.body.material, self.shape.length)

    @cached_property
    def crossing_time(self) -> float:
        """Time [s] in which a pressure wave crosses the body; infinite for a rigid one."""
        return np.inf if self.body.rigid else self.shape.length / wave_speed(self.material)

    @cached_property
    def kappa(self) -> np.ndarray:
        """Stiffness bound of each tet [1/s^2], (T,); of a material that yields also after plastic flow."""
        s, yields = self.shape, self.material.yield_strain is not None
        inv_mass = 1 / self.mass if yields else self.inv_mass  # what is let go may flow no farther than what is pinned
        bounds = stiffness_bounds(s.inverse, s.volumes, inv_mass[s.tets], self.material)
        return np.full_like(bounds, FLOW_STIFFENING * bounds.max(initial=0.0)) if yields else bounds

    @cached_property
    def start(self) -> np.ndarray:
        """x, x_lo, v, v_lo at the beginning, (4, V, 3) float32; pinned vertices stand still."""
        v = self.body.start_velocities()
        return motion_in_float32(
            self.body.start(), v if self.body.rigid else np.where(self.inv_mass[:, None] > 0.0, v, 0.0)
        )

    def with_material(self, material: Material) -> BodyModel:
        return BodyModel(self.body.of_material(material), self.shape)

    def placed(self, rotation, position) -> BodyModel:
        """The same body with another start."""
        return BodyModel(replace(self.body, rotation=rotation, position=position), self.shape)

    def scaled(self, factor: float) -> BodyModel:
        """The body `factor` times as large, its start scaled about its centre of mass."""
        shape = self.shape.scaled(factor)
        old = np.average(self.body.start(), axis=0, weights=self.mass)
        body = replace(self.body, vertices=shape.vertices, sdf=shape.sdf)
        if not body.rigid and body.motion is not None:
            body = replace(body, motion=factor * body.motion)
        shift = old - np.average(body.start(), axis=0, weights=self.mass)
        return BodyModel(replace(body, position=tuple((np.asarray(body.position) + shift).tolist())), shape)


def motion_in_float32(x: np.ndarray, v: np.ndarray) -> np.ndarray:
    """x, x_lo, v, v_lo (4, V, 3) float32 of float64 positions and velocities."""
    high = [np.asarray(a, np.float64).astype(np.float32) for a in (x, v)]
    return np.stack([high[0], x - high[0], high[1], v - high[1]]).astype(np.float32)


def body_index(i: int, bodies: Sequence) -> int:
    """Check the index of a body; raise BadInput if there is none."""
    if not 0 <= i < len(bodies):
        raise BadInput(f"there is no body {i}, of {len(bodies)}")
    return int(i)


def models_of(bodies: Iterable[SoftBody | RigidBody]) -> list[BodyModel]:
    """Check bodies; those with the same mesh share a shape."""
    models: list[BodyModel] = []
    for b in bodies:
        models.append(BodyModel.of(b, models))
    return models


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
    def crossing_time(self) -> float:
        """The shortest time [s] in which a pressure wave crosses a body."""
        return min((p.crossing_time for p in self.bodies), default=np.inf)

    def split_tets(self, values: np.ndarray) -> list[np.ndarray]:
        """Those of each body of some values of all tets (T, ...)."""
        return [values[first:end] for first, end in pairwise(self.tet_begin)]

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
