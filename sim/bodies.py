"""Bodies as the solver is given them, soft and rigid, and the mass properties of rigid ones (NumPy only)."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from itertools import permutations, product
from typing import ClassVar

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from core.distance_grid import DistanceGrid
from core.errors import BadInput
from core.material import Material
from core.rotation import matrices_from_quaternions
from core.tetmesh import positively_oriented, tet_volumes
from core.vocabulary import IDENTITY, Quat, Vec3

# Volume / (longest edge)^3 of a tet, 0.12 of a regular one; below this its rest inverse is noise in fp32
MIN_RELATIVE_VOLUME = 1e-4
BOX_TOLERANCE = 1e-4  # relative: what float32 leaves of a box


@dataclass(frozen=True)
class MeshBody:
    """The part that soft and rigid bodies share; they also have a `material`, a `rotation` and a `position`.

    vertices  rest positions in the body frame, already scaled [m], (V, 3)
    tets      (T, 4) with det[x1-x0, x2-x0, x3-x0] > 0;   surface  (S, 3) outward
    """

    name: str
    vertices: np.ndarray
    tets: np.ndarray
    surface: np.ndarray

    def start(self) -> np.ndarray:
        """Initial positions in the world [m], (V, 3) float64."""
        R = matrices_from_quaternions(self.rotation)
        return np.asarray(self.vertices, np.float64) @ R.T + np.asarray(self.position, np.float64)

    def masses(self) -> np.ndarray:
        """A quarter of each tet's mass on each of its corners [kg], (V,)."""
        volumes = tet_volumes(self.vertices, self.tets)
        quarters = np.repeat(self.material.density * volumes / 4, 4)
        return np.bincount(np.asarray(self.tets).ravel(), quarters, minlength=len(self.vertices))

    def check(self) -> None:
        """Raise BadInput, naming body and defect, for anything the solver cannot simulate."""
        x, tets = np.asarray(self.vertices, np.float64), np.asarray(self.tets)
        if x.ndim != 2 or x.shape[1] != 3 or not np.isfinite(x).all():
            raise BadInput(f"{self.name}: vertices must be finite and of shape (V, 3), not {x.shape}")
        for what, index, k in (("tets", tets, 4), ("surface", np.asarray(self.surface), 3)):
            if index.ndim != 2 or index.shape[1] != k or len(index) == 0:
                raise BadInput(f"{self.name}: {what} must be of shape (n, {k}), not {index.shape}")
            if index.min() < 0 or index.max() >= len(x):
                raise BadInput(f"{self.name}: {what} refer to vertices outside 0..{len(x) - 1}")
        self.material.check(self.name)
        unused = np.setdiff1d(np.arange(len(x)), tets)
        if len(unused):
            raise BadInput(f"{self.name}: vertex {unused[0]} ({len(unused)} in all) belongs to no tetrahedron")
        volumes = tet_volumes(x, tets)
        edges = x[tets][:, [0, 0, 0, 1, 1, 2]] - x[tets][:, [1, 2, 3, 2, 3, 3]]
        longest = np.sqrt((edges**2).sum(-1).max(1))
        flat = np.flatnonzero(volumes < MIN_RELATIVE_VOLUME * longest**3)
        if len(flat):
            t = flat[0]
            raise BadInput(
                f"{self.name}: tetrahedron {t} ({len(flat)} in all) is flat or inverted at rest"
                f" (volume {volumes[t]:.3g} m^3, longest edge {longest[t]:.3g} m)"
            )


@dataclass(frozen=True)
class SoftBody(MeshBody):
    """One elastic body at rest, and where it starts.

    rotation, position, velocity   x = R(rotation) rest + position, all vertices at `velocity` [m/s]
    sdf       signed distance of the rest shape in the body frame [m], or None
    motion    positions [m] and velocities [m/s] at the start, in place of `vertices` and 0, (2, V, 3), or None
    pinned    indices of vertices that do not move (inverse mass 0), or None
    asleep    starts asleep: nothing moves it until something reaches it
    self_contact   "parts": only disconnected parts of its cage meet, as legs and a skirt. Where a limb meets the trunk,
                   driven vertices, which nothing stops, would crush what they meet. False: it passes through itself
    """

    material: Material
    rotation: Quat = IDENTITY
    position: Vec3 = (0.0, 0.0, 0.0)
    velocity: Vec3 = (0.0, 0.0, 0.0)
    sdf: DistanceGrid | None = None
    motion: np.ndarray | None = None
    pinned: np.ndarray | None = None
    self_contact: bool | str = True
    asleep: bool = False
    rigid: ClassVar[bool] = False

    def of_material(self, material: Material) -> SoftBody:
        """The same body of another material; BadInput if no body can be of it."""
        material.check(self.name)
        return replace(self, material=material)

    def start(self) -> np.ndarray:
        if self.motion is None:
            return super().start()
        return replace(self, vertices=self.motion[0], motion=None).start()

    def start_velocities(self) -> np.ndarray:
        """Initial velocities [m/s], (V, 3) float64."""
        own = np.zeros((len(self.vertices), 3)) if self.motion is None else self.motion[1]
        return own @ matrices_from_quaternions(self.rotation).T + np.asarray(self.velocity, np.float64)


@dataclass(frozen=True)
class RigidBody(MeshBody):
    """Description of one rigid body and its start; the mass is that of its tets.

    density [kg/m^3], friction coefficient (static; kinetic_friction None: the same), restitution 0..1
    rotation, position       x = R(rotation) rest + position
    velocity [m/s]           of the centre of mass;   angular_velocity [rad/s] in the world
    sdf                      signed distance in the body frame [m]; None: it is made from the cage
    asleep                   starts asleep: nothing moves it until something reaches it
    kinematic                moves only as it is driven (sim/kinematic_targets.py), whatever pushes it
    boxed                    it is exactly the box that its vertices span, about the body frame's origin
    """

    density: float
    friction: float = 0.5
    kinetic_friction: float | None = None
    restitution: float = 0.0
    rotation: Quat = IDENTITY
    position: Vec3 = (0.0, 0.0, 0.0)
    velocity: Vec3 = (0.0, 0.0, 0.0)
    angular_velocity: Vec3 = (0.0, 0.0, 0.0)
    sdf: DistanceGrid | None = None
    asleep: bool = False
    kinematic: bool = False
    boxed: bool = False
    rigid: ClassVar[bool] = True
    pinned: ClassVar[None] = None

    @classmethod
    def box(cls, name: str, size: Vec3, *, density: float, **options) -> RigidBody:
        """A box of full edge lengths `size` [m] about the origin of its frame; `options` as the fields above."""
        size = np.asarray(size, np.float64)
        if size.shape != (3,) or not (np.isfinite(size) & (size > 0)).all():
            raise BadInput(f"{name}: a box needs three positive edge lengths, not {size.tolist()}")
        x = (np.array(list(product((0, 1), repeat=3))) - 0.5) * size
        tets = np.array([[0, 4 >> a, (4 >> a) | (4 >> b), 7] for a, b, _ in permutations(range(3))])
        return cls(name, x, positively_oriented(x, tets), hull(name, x)[1], density, boxed=True, **options)

    @classmethod
    def convex(cls, name: str, points: np.ndarray, *, density: float, **options) -> RigidBody:
        """The convex hull of points (n, 3) [m]; its tets are the fan of its triangles around their centroid."""
        x, surface = hull(name, points)
        tets = np.concatenate([surface, np.full((len(surface), 1), len(x))], axis=1)
        x = np.concatenate([x, x.mean(0, keepdims=True)])
        return cls(name, x, positively_oriented(x, tets), surface, density, **options)

    @classmethod
    def from_soft(cls, soft: SoftBody, **options) -> RigidBody:
        """A soft body's shape, place, density and friction; `options` replace fields."""
        m = soft.material
        options.setdefault("boxed", fills_its_box(soft.vertices, soft.tets))
        return replace(
            cls(
                soft.name, soft.vertices, soft.tets, soft.surface, m.density, m.friction, m.kinetic_friction,
                rotation=soft.rotation, position=soft.position, velocity=soft.velocity, sdf=soft.sdf,
                asleep=soft.asleep,
            ),
            **options,
        )  # fmt: skip

    @property
    def material(self) -> Material:
        """Density and friction as a Material, whose moduli have no meaning."""
        return Material(1.0, 0.0, self.density, self.friction, 0.0, self.kinetic_friction)

    def of_material(self, material: Material) -> RigidBody:
        """The same body with another density and friction."""
        body = replace(
            self, density=material.density, friction=material.friction, kinetic_friction=material.kinetic_friction
        )
        body.check()
        return body

    def start_velocities(self) -> np.ndarray:
        """Initial velocities [m/s], (V, 3) float64."""
        R = matrices_from_quaternions((np.asarray(self.rotation, np.float64) / np.linalg.norm(self.rotation))[None])[0]
        r = (np.asarray(self.vertices, np.float64) - self.inertia[1]) @ R.T
        return np.asarray(self.velocity, np.float64) + np.cross(np.asarray(self.angular_velocity, np.float64), r)

    @cached_property
    def inertia(self) -> tuple[float, np.ndarray, np.ndarray]:
        """Mass [kg], centre of mass [m] and inertia about it [kg m^2], in the body frame."""
        return solid_inertia(self.vertices, self.tets, self.density)

    def check(self) -> None:
        """As of any body; and the restitution must be in range."""
        super().check()
        if not 0 <= self.restitution <= 1:
            raise BadInput(f"{self.name}: restitution must be between 0 and 1, not {self.restitution}")


def fills_its_box(vertices: np.ndarray, tets: np.ndarray) -> bool:
    """True if a cage is the whole box that its vertices span, and this lies about the origin of its frame."""
    high = np.max(vertices, axis=0).astype(np.float64)
    centred = np.allclose(np.min(vertices, axis=0), -high, atol=BOX_TOLERANCE * high.max())
    return bool(centred and tet_volumes(vertices, tets).sum() > (1 - BOX_TOLERANCE) * np.prod(2 * high))


def hull(name: str, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Corners (V, 3) and outward triangles (S, 3) of the convex hull of points."""
    points = np.asarray(points, np.float64)
    try:
        h = ConvexHull(points)
    except (QhullError, ValueError) as error:
        raise BadInput(f"{name}: {len(points)} points span no convex piece") from error
    corners = np.sort(h.vertices)
    triangles = np.searchsorted(corners, h.simplices)
    x = points[corners]
    normal = np.cross(x[triangles[:, 1]] - x[triangles[:, 0]], x[triangles[:, 2]] - x[triangles[:, 0]])
    inward = (normal * h.equations[:, :3]).sum(1) < 0
    triangles[inward] = triangles[inward][:, [0, 2, 1]]
    return x, triangles


def solid_inertia(vertices: np.ndarray, tets: np.ndarray, density: float) -> tuple[float, np.ndarray, np.ndarray]:
    """Mass [kg], centre of mass [m] (3,), inertia about it [kg m^2] (3, 3), of homogeneous tets.

    Second moments of a tet of volume V and corners x_k: V/20 (sum_k x_k x_k^T + (sum_k x_k)(sum_k x_k)^T).
    """
    corners = np.asarray(vertices, np.float64)[np.asarray(tets)]
    about = corners.reshape(-1, 3).mean(0)  # sums about a point of the body hardly cancel
    corners = corners - about
    volume = np.linalg.det(corners[:, 1:] - corners[:, :1]) / 6
    mass = density * volume.sum()
    center = (volume[:, None] * corners.mean(1)).sum(0) / volume.sum()
    total = corners.sum(1)
    second = np.einsum("tki,tkj->tij", corners, corners) + np.einsum("ti,tj->tij", total, total)
    moments = density * (volume[:, None, None] * second).sum(0) / 20 - mass * np.outer(center, center)
    return mass, center + about, np.trace(moments) * np.eye(3) - moments
