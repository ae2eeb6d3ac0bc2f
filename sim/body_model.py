"""Constants that the solver derives from bodies on the host, once a mesh and once a body (NumPy only)."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from core.distance_grid import DistanceGrid, same_grid
from core.material import Material
from core.tetmesh import tet_volumes
from sim.elastic.time_step import clamp_stiffness, stiffness_bounds, wave_speed
from sim.soft_body import SoftBody

if TYPE_CHECKING:
    from sim.rigid.rigid_body import RigidBody


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
        kind = {"rigid": root.rigid, "boxed": root.boxed}
        return RestShape(root.vertices * factor, root.solid, root.surface, sdf, **kind, root=root, factor=factor)

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
        """Material as it is simulated: not stiffer than the integrator bears (sim/elastic/time_step.py)."""
        return self.body.material if self.body.rigid else clamp_stiffness(self.body.material, self.shape.length)

    @cached_property
    def crossing(self) -> float:
        """Time [s] in which a pressure wave crosses the body; infinite for a rigid one."""
        return np.inf if self.body.rigid else self.shape.length / wave_speed(self.material)

    @cached_property
    def kappa(self) -> np.ndarray:
        """Stiffness bound of each tet [1/s^2], (T,)."""
        s = self.shape
        return stiffness_bounds(s.inverse, s.volumes, self.inv_mass[s.tets], self.material)

    @cached_property
    def start(self) -> np.ndarray:
        """x, x_lo, v, v_lo at the beginning, (4, V, 3) float32; pinned vertices stand still."""
        v = self.body.start_velocities()
        return motion(self.body.start(), v if self.body.rigid else np.where(self.inv_mass[:, None] > 0.0, v, 0.0))

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
        shift = old - np.average(body.start(), axis=0, weights=self.mass)
        return BodyModel(replace(body, position=tuple((np.asarray(body.position) + shift).tolist())), shape)


def motion(x: np.ndarray, v: np.ndarray) -> np.ndarray:
    """x, x_lo, v, v_lo (4, V, 3) float32 of float64 positions and velocities."""
    high = [np.asarray(a, np.float64).astype(np.float32) for a in (x, v)]
    return np.stack([high[0], x - high[0], high[1], v - high[1]]).astype(np.float32)


def models_of(bodies: Iterable[SoftBody | RigidBody]) -> list[BodyModel]:
    """Check bodies; those with the same mesh share a shape."""
    models: list[BodyModel] = []
    for b in bodies:
        models.append(BodyModel.of(b, models))
    return models
