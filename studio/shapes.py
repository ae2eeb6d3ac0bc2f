"""Triangle meshes of simple shapes, and the surfaces of a model: mesh, colour and optical properties."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from core.mesh_sampling import Mesh

Colour = Callable[[np.ndarray, np.ndarray], np.ndarray]  # (points, normals) in the surface's own frame -> albedo


@dataclass(frozen=True)
class Surface:
    """A mesh with the properties that sampling and lighting need.

    colour          linear albedo (N, 3) at points in the surface's own frame (before `rotation` and `position`)
    spacing         distance between neighbouring Gaussians [m] at 1.5 m from the player
    grain           direction (own frame) along which Gaussians are elongated by the factor `stretch`
    gloss           mirror reflectance at normal incidence; `roughness` [rad] is the width of its lobe
    translucency    fraction of light that a thin sheet transmits; a sheet is seen from both sides. None: opaque
    emission        emitted linear radiance, or None
    width           factor on the standard deviations; plain surfaces close better with wide Gaussians
    uniform         keep `spacing` at any distance from the player
    blocks_light    casts shadows and reflects light; False for the bulb and the garden
    leaves          the mesh is of `leaf_mesh`: as shipped every leaf becomes one Gaussian, whatever the spacing
    """

    name: str
    mesh: Mesh
    colour: Colour
    spacing: float
    grain: tuple[float, float, float] | None = None
    stretch: float = 1.0
    gloss: float = 0.0
    roughness: float = 0.3
    translucency: float | None = None
    emission: tuple[float, float, float] | None = None
    rotation: np.ndarray = field(default_factory=lambda: np.eye(3))
    position: tuple[float, float, float] = (0.0, 0.0, 0.0)
    width: float = 1.0
    uniform: bool = False
    blocks_light: bool = True
    leaves: bool = False
    object_id: int = 0

    def placed(self, rotation=None, position=(0.0, 0.0, 0.0)) -> Surface:
        """The surface after a further rigid motion; its texture moves with it."""
        rotation = np.eye(3) if rotation is None else np.asarray(rotation)
        position = tuple(rotation @ np.asarray(self.position) + np.asarray(position))
        return replace(self, rotation=rotation @ self.rotation, position=position)

    @property
    def world(self) -> Mesh:
        """Mesh in the world frame."""
        return self.mesh.moved(self.rotation, self.position)

    def albedo(self, points: np.ndarray, normals: np.ndarray) -> np.ndarray:
        """Linear albedo (N, 3) at world points (N, 3) with world normals (N, 3)."""
        return self.colour((points - np.asarray(self.position)) @ self.rotation, normals @ self.rotation)


def rotation_about(axis: str, degrees: float) -> np.ndarray:
    """Rotation matrix (3, 3) about x, y or z."""
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    i, j = {"x": (1, 2), "y": (2, 0), "z": (0, 1)}[axis]
    m = np.eye(3)
    m[i, i], m[i, j], m[j, i], m[j, j] = c, -s, s, c
    return m


def join(*meshes: Mesh) -> Mesh:
    """Concatenation of meshes."""
    starts = np.cumsum([0] + [len(m.vertices) for m in meshes[:-1]])
    return Mesh(
        np.concatenate([m.vertices for m in meshes]),
        np.concatenate([m.faces + s for m, s in zip(meshes, starts, strict=True)]),
    )


def box(low, high) -> Mesh:
    """Axis-aligned box between two corners."""
    low, high = np.asarray(low, float), np.asarray(high, float)
    bits = np.array([[i & 1, i >> 1 & 1, i >> 2 & 1] for i in range(8)])
    quads = [(0, 4, 6, 2), (1, 3, 7, 5), (0, 1, 5, 4), (2, 6, 7, 3), (0, 2, 3, 1), (4, 5, 7, 6)]
    return Mesh(low + bits * (high - low), _split(quads))


def beveled_box(size, bevel: float) -> Mesh:
    """Box centred on the origin with edges beveled at 45 degrees over `bevel` [m]."""
    import trimesh

    h = 0.5 * np.asarray(size, float)
    corners = np.array([[i & 1, i >> 1 & 1, i >> 2 & 1] for i in range(8)]) * 2.0 - 1.0
    points = np.concatenate([corners * (h - bevel * (np.arange(3) != k)) for k in range(3)])
    hull = trimesh.convex.convex_hull(points)
    return Mesh(np.asarray(hull.vertices), np.asarray(hull.faces))


def quad(corner, along, across) -> Mesh:
    """Parallelogram with normal `along` x `across`."""
    corner, a, b = np.asarray(corner, float), np.asarray(along, float), np.asarray(across, float)
    return Mesh(np.array([corner, corner + a, corner + a + b, corner + b]), _split([(0, 1, 2, 3)]))


def leaf_mesh(centres, along, across) -> Mesh:
    """Many rectangles, four vertices each: centres (N, 3), and edges `along` and `across`, (N, 3) each [m]."""
    centres, a, b = (np.asarray(x, float) for x in (centres, along, across))
    corners = [centres + 0.5 * (i * a + j * b) for i, j in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
    quads = np.arange(4 * len(centres)).reshape(-1, 4)
    return Mesh(np.stack(corners, 1).reshape(-1, 3), _split(quads))


def grid_mesh(points: np.ndarray, close_u: bool = False, close_v: bool = False) -> Mesh:
    """Mesh of a grid of points (U, V, 3) with normal d/du x d/dv; either direction may be closed."""
    n, m = points.shape[:2]
    ids = np.arange(n * m).reshape(n, m)
    ids = np.concatenate([ids, ids[:1]], 0) if close_u else ids
    ids = np.concatenate([ids, ids[:, :1]], 1) if close_v else ids
    quads = np.stack([ids[:-1, :-1], ids[1:, :-1], ids[1:, 1:], ids[:-1, 1:]], -1).reshape(-1, 4)
    return welded(Mesh(points.reshape(-1, 3).astype(float), _split(quads)))


def welded(mesh: Mesh) -> Mesh:
    """The mesh with coincident vertices merged and degenerate triangles (the poles of a lathe) removed."""
    v, inverse = np.unique(np.round(mesh.vertices, 7), axis=0, return_inverse=True)
    f = inverse.reshape(-1)[mesh.faces]
    return Mesh(v, f[(f[:, 0] != f[:, 1]) & (f[:, 1] != f[:, 2]) & (f[:, 2] != f[:, 0])])


def lathe(profile, segments: int = 48, closed: bool = False) -> Mesh:
    """Solid of revolution about y. `profile` (K, 2) holds (radius, y), from the bottom outside to the top.

    A `closed` profile runs on from its end to its begin, as a torus's does.
    """
    profile = np.asarray(profile, float)
    angle = 2 * np.pi * np.arange(segments) / segments
    r, y = profile[:, 0], profile[:, 1]
    points = np.stack(
        [r[:, None] * np.cos(angle), np.broadcast_to(y[:, None], (len(r), segments)), -r[:, None] * np.sin(angle)], -1
    )
    return grid_mesh(points.transpose(1, 0, 2), close_u=True, close_v=closed)


def smooth_curve(profile, count: int = 60) -> np.ndarray:
    """Monotone cubic curve of `count` points through the given points (K, D), with centripetal parameters."""
    from scipy.interpolate import PchipInterpolator

    profile = np.asarray(profile, float)
    t = np.concatenate([[0], np.cumsum(np.sqrt(np.linalg.norm(np.diff(profile, axis=0), axis=1)))])
    return PchipInterpolator(t, profile)(np.linspace(0, t[-1], count))


def tube(path, radii, segments: int = 14, flat: float = 1.0, up=(0.0, 1.0, 0.0)) -> Mesh:
    """Tube along `path` (K, 3) with `radii` (K,), closed at both ends; `flat` scales it along `up`."""
    path, radii = np.asarray(path, float), np.broadcast_to(np.asarray(radii, float), (len(path),))
    tangent = np.gradient(path, axis=0)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    side = np.cross(tangent, np.asarray(up, float))
    side[np.linalg.norm(side, axis=1) < 1e-6] = (1.0, 0.0, 0.0)
    side -= (side * tangent).sum(1, keepdims=True) * tangent
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    over = np.cross(side, tangent)
    angle = 2 * np.pi * np.arange(segments) / segments
    ring = side[:, None] * np.cos(angle)[:, None] + flat * over[:, None] * np.sin(angle)[:, None]
    points = path[:, None] + radii[:, None, None] * ring
    points = np.concatenate([path[:1, None].repeat(segments, 1), points, path[-1:, None].repeat(segments, 1)])
    return grid_mesh(points.transpose(1, 0, 2)[::-1], close_u=True)


def superellipsoid(size, power: float = 0.5, count: int = 32) -> Mesh:
    """Superellipsoid of the given size (3,) centred on the origin: power 1 is an ellipsoid, towards 0 a box.

    `count` latitudes, twice as many longitudes.
    """

    def signed_power(t):
        return np.sign(t) * np.abs(t) ** power

    lon = np.linspace(-np.pi, np.pi, 2 * count, endpoint=False)
    lat = np.linspace(-np.pi / 2, np.pi / 2, count)
    x = signed_power(np.cos(lat))[None] * signed_power(np.cos(lon))[:, None]
    z = -signed_power(np.cos(lat))[None] * signed_power(np.sin(lon))[:, None]
    y = np.broadcast_to(signed_power(np.sin(lat))[None], x.shape)
    return grid_mesh(np.stack([x, y, z], -1) * (0.5 * np.asarray(size)), close_u=True)


def _split(quads) -> np.ndarray:
    quads = np.asarray(quads)
    return np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
