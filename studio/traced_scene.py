"""Surfaces as a photographer sees them: rays against their meshes, and soft light baked at their vertices."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from core.camera import Camera
from core.mesh_sampling import Mesh, face_normals
from core.program import open3d
from studio.baked_light import tangent_frame
from studio.finish import tone_map
from studio.light_sources import Opening
from studio.shapes import Surface
from studio.surface_sampling import smooth_normals, subdivided

ROOM_CELL, OBJECT_CELL = 9.0, 4.0  # longest edge of a lit mesh, over the spacing of the surface's Gaussians
RAYS = 64  # of a vertex, over the hemisphere
RAY_BATCH = 1_000_000
OFFSET = 2e-3  # [m] of ray origins above the surface
REACH = 0.5  # [m] within which things darken each other
NEAR_RADIANCE = 0.12  # of a surface that touches, over that of one farther away than REACH
AMBIENT, WINDOW = 0.62, np.array([5.2, 5.4, 5.8])  # radiance of a white wall, and of the sky in the window
WINDOW_SIDE = 4  # samples of the window along each side
EXPOSURE = 1.7


@dataclass(frozen=True)
class Shape:
    """A surface, the object that it belongs to (0: the room), and albedos (V, 3) at its vertices or None.

    Where vertices have albedos the surface's own colour is a factor on them. A `support` is lit as finely as what
    stands on it.
    """

    surface: Surface
    object_id: int = 0
    albedo: np.ndarray | None = None
    support: bool = False


@dataclass(frozen=True)
class Hits:
    """First hits of rays: the distance [m] (inf: none), the triangle, and barycentric coordinates (N, 3) in it."""

    distance: np.ndarray
    face: np.ndarray
    weights: np.ndarray


class TracedScene:
    """Meshes of all shapes with their light.

    opening  of the window, through which the sky shines
    fine     1: as for pictures to look at; smaller values make larger cells and fewer rays

    `faces` (F, 3) index `vertices` (V, 3) [m] and `normals`, of which a crease has one for either side.
    `owner` (F,) is the object of each face, `shape` (F,) the index of its shape.
    """

    def __init__(self, shapes: Sequence[Shape], opening: Opening, *, fine: float, rng: np.random.Generator):
        self._o3d = open3d("build --capture")
        self.shapes, self._opening, self._rng = list(shapes), opening, rng
        parts = [_split_at_creases(s, fine) for s in shapes]
        counts = np.cumsum([0] + [len(p[0]) for p in parts[:-1]])
        self.vertices, self.normals, self._albedo = (np.concatenate([p[k] for p in parts]) for k in (0, 1, 3))
        self.faces = np.concatenate([p[2] + c for p, c in zip(parts, counts, strict=True)])
        self.shape = np.repeat(np.arange(len(parts)), [len(p[2]) for p in parts])
        self.owner = np.array([s.object_id for s in shapes])[self.shape]
        self._scenes: dict[tuple[int, int], tuple] = {}
        self._tint = np.array([s.surface.albedo(*self._middle(k)).mean(0) for k, s in enumerate(shapes)])
        self._tint *= np.array([self._albedo[self.faces[self.shape == k, 0]].mean(0) for k in range(len(shapes))])
        self._bake(round(RAYS * fine))

    def hits(self, origins: np.ndarray, directions: np.ndarray, without: int = 0, *, only: int = 0) -> Hits:
        """First hits of rays (N, 3) with unit directions; `without` an object, or of `only` one (0: none)."""
        scene, index = self._scene(without, only)
        distance, face, weights = [], [], []
        for k in range(0, len(origins), RAY_BATCH):
            rays = np.concatenate([origins[k : k + RAY_BATCH], directions[k : k + RAY_BATCH]], 1).astype(np.float32)
            found = scene.cast_rays(self._o3d.core.Tensor(rays))
            t = found["t_hit"].numpy().astype(float)
            prim = np.where(np.isfinite(t), found["primitive_ids"].numpy().astype(np.int64), 0)
            uv = found["primitive_uvs"].numpy().astype(float)
            distance.append(t)
            face.append(index[prim])
            weights.append(np.column_stack([1.0 - uv.sum(1), uv]))
        return Hits(np.concatenate(distance), np.concatenate(face), np.concatenate(weights))

    def prepare(self, without: Sequence[int]) -> None:
        """Get ready for pictures without these objects, so that several threads may take them."""
        for k in (0, *without):
            self._scene(k, 0)
            self._light_without(k)

    def owner_of(self, hits: Hits) -> np.ndarray:
        """Object id (N,) at hits; 0: the room, or nothing."""
        return np.where(np.isfinite(hits.distance), self.owner[hits.face], 0)

    def albedo(self, hits: Hits) -> tuple[np.ndarray, np.ndarray]:
        """Albedo (N, 3) and emitted radiance (N, 3) at hits; black where there is none."""
        corners = self.faces[hits.face]
        points = np.einsum("nk,nkc->nc", hits.weights, self.vertices[corners])
        normals = np.einsum("nk,nkc->nc", hits.weights, self.normals[corners])
        color = np.einsum("nk,nkc->nc", hits.weights, self._albedo[corners])
        emitted, which = np.zeros_like(color), self.shape[hits.face]
        for k in np.unique(which):
            own, surface = which == k, self.shapes[k].surface
            color[own] *= surface.albedo(points[own], normals[own])
            emitted[own] = color[own] * (surface.emission or (0.0, 0.0, 0.0))
            color[own] *= float(surface.blocks_light)
        there = np.isfinite(hits.distance)[:, None]
        return color.clip(0, 1) * there, emitted * there

    def light(self, hits: Hits, without: int = 0) -> np.ndarray:
        """Irradiance over pi (N, 3) at hits, with the object `without` taken away."""
        return np.einsum("nk,nkc->nc", hits.weights, self._light_without(without)[self.faces[hits.face]])

    def _scene(self, without: int, only: int) -> tuple:
        """Ray-casting scene, and the face of each of its triangles."""
        if (without, only) not in self._scenes:
            index = np.flatnonzero((self.owner == only) if only else (self.owner != (without or -1)))
            scene, tensor = self._o3d.t.geometry.RaycastingScene(), self._o3d.core.Tensor
            scene.add_triangles(tensor(self.vertices.astype(np.float32)), tensor(self.faces[index].astype(np.uint32)))
            self._scenes[without, only] = (scene, index)
        return self._scenes[without, only]

    def _middle(self, k: int) -> tuple[np.ndarray, np.ndarray]:
        """Points on a shape and normals there, (N, 3) each."""
        f = self.faces[self.shape == k]
        f = f[:: max(1, len(f) // 500)]
        return self.vertices[f].mean(1), self.normals[f].mean(1)

    def _bake(self, rays: int) -> None:
        """Light of the vertices: what arrives over the hemisphere, and through the window.

        Rays that end on an object are kept: without it they go on.
        """
        f = self.faces
        count = np.bincount(f.ravel(), minlength=len(self.vertices)).clip(1)[:, None]
        inner = np.zeros_like(self.vertices)
        np.add.at(inner, f.ravel(), np.repeat(self.vertices[f].mean(1), 3, axis=0))
        points = 0.9 * self.vertices + 0.1 * inner / count + OFFSET * self.normals  # off the edges that faces share
        n = len(points)
        k = np.arange(rays)
        u = (k[None] + self._rng.random((n, rays))) / rays  # stratified in elevation, golden angle in azimuth
        angle = 2 * np.pi * ((k * 0.6180339887 + self._rng.random((n, 1))) % 1)
        t1, t2 = tangent_frame(self.normals)
        r = np.sqrt(u)
        d = (r * np.cos(angle))[..., None] * t1[:, None] + (r * np.sin(angle))[..., None] * t2[:, None]
        d = (d + np.sqrt(1 - u)[..., None] * self.normals[:, None]).reshape(-1, 3)
        vertex = np.repeat(np.arange(n), rays)
        hits = self.hits(points[vertex], d)
        around = _Rays(vertex, points, d, self._arriving(hits, d) / rays, self.owner_of(hits))
        i = np.arange(WINDOW_SIDE**2)
        a = ((i % WINDOW_SIDE)[None] + self._rng.random((n, len(i)))) / WINDOW_SIDE
        b = ((i // WINDOW_SIDE)[None] + self._rng.random((n, len(i)))) / WINDOW_SIDE
        way = self._opening.corner + a[..., None] * self._opening.a + b[..., None] * self._opening.b - points[:, None]
        way = way.reshape(-1, 3)
        far = np.linalg.norm(way, axis=1)
        way /= far[:, None]
        vertex = np.repeat(np.arange(n), len(i))
        cosine = (way * self.normals[vertex]).sum(1).clip(0) * np.abs(way @ np.cross(self._opening.a, self._opening.b))
        weight = cosine / np.maximum(far, 0.3) ** 2 / np.pi / len(i)
        use = weight > 1e-5
        vertex, way, far, weight = vertex[use], way[use], far[use], weight[use]
        hits = self.hits(points[vertex], way)
        clear = self._clear(hits, far)
        straight = _Rays(vertex, points, way, weight[:, None] * WINDOW * clear[:, None], self.owner_of(hits) * ~clear)
        total = np.zeros((n, 3))
        for part in (around, straight):
            np.add.at(total, part.vertex, part.radiance)
        self._light = {0: total}
        self._kept = (around.of_objects(), straight.of_objects(), far[straight.owner > 0], weight[straight.owner > 0])
        self._rays = rays

    def _light_without(self, without: int) -> np.ndarray:
        """Light of the vertices (V, 3) with an object taken away: its rays are cast again."""
        if without not in self._light:
            around, straight, far, weight = self._kept
            total = self._light[0].copy()
            own = np.flatnonzero(around.owner == without)
            d = around.directions[own]
            hits = self.hits(around.points[around.vertex[own]], d, without)
            change = self._arriving(hits, d) / self._rays - around.radiance[own]
            np.add.at(total, around.vertex[own], change)
            own = np.flatnonzero(straight.owner == without)
            hits = self.hits(straight.points[straight.vertex[own]], straight.directions[own], without)
            np.add.at(
                total,
                straight.vertex[own],
                (weight[own] * self._clear(hits, far[own]))[:, None] * WINDOW,
            )
            self._light[without] = total.clip(0)
        return self._light[without]

    def _arriving(self, hits: Hits, directions: np.ndarray) -> np.ndarray:
        """Radiance (N, 3) that arrives from hits: of the surfaces' mean colours, dim where they are near."""
        t = np.where(np.isfinite(hits.distance), hits.distance / REACH, 1.0).clip(0, 1)
        dim = NEAR_RADIANCE + (1 - NEAR_RADIANCE) * t * t * (3 - 2 * t)
        above = 0.8 + 0.2 * directions[:, 1]  # the ceiling is the brightest
        return AMBIENT * (0.35 + 0.65 * self._tint[self.shape[hits.face]]) * (dim * above)[:, None]

    def _clear(self, hits: Hits, far: np.ndarray) -> np.ndarray:
        """Mask (N,) of rays that reach the window."""
        blocks = np.array([s.surface.blocks_light for s in self.shapes])[self.shape[hits.face]]
        return ~blocks | (hits.distance > 0.98 * far)


@dataclass(frozen=True)
class _Rays:
    """Rays (R,) from vertices: the vertex's index, all vertices' points, directions, radiance, and what was hit."""

    vertex: np.ndarray
    points: np.ndarray
    directions: np.ndarray
    radiance: np.ndarray
    owner: np.ndarray

    def of_objects(self) -> _Rays:
        """Those that ended on an object."""
        own = self.owner > 0
        return _Rays(self.vertex[own], self.points, self.directions[own], self.radiance[own], self.owner[own])


def camera_rays(camera: Camera, dx: float = 0.0, dy: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """Origins and unit directions (H W, 3) through the pixels' centres, moved by (dx, dy) [px]."""
    y, x = np.mgrid[: camera.height, : camera.width] + 0.5
    d = np.stack([(x + dx - camera.cx) / camera.fx, (y + dy - camera.cy) / camera.fy, np.ones_like(x)], -1)
    d = d.reshape(-1, 3) @ camera.world_to_camera[:3, :3]
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    return np.broadcast_to(camera.position, d.shape), d


@dataclass(frozen=True)
class Picture:
    """A view: pixels (H, W, 3) uint8, object ids (H, W) uint8 and depth along the axis (H, W) [m] at pixel centres.

    alpha  (H, W), the share of a pixel's rays that hit anything
    """

    pixels: np.ndarray
    ids: np.ndarray
    depth: np.ndarray
    without: dict[int, np.ndarray]
    alpha: np.ndarray


def take_picture(scene: TracedScene, camera: Camera, side: int, without: Sequence[int] = ()) -> Picture:
    """A picture with `side` squared rays a pixel, and the same with each of the objects `without` taken away."""
    shape = (camera.height, camera.width)
    origins, d = camera_rays(camera)
    hits = scene.hits(origins, d)
    depth = hits.distance * (d @ camera.world_to_camera[2, :3])
    ids = scene.owner_of(hits).astype(np.uint8)
    origins, d = _fine_rays(camera, side)
    hits = scene.hits(origins, d)
    albedo, emitted = scene.albedo(hits)
    owner = scene.owner_of(hits)
    own = [np.flatnonzero(owner == k) for k in without]
    behind = [scene.hits(origins[o], d[o], k) for k, o in zip(without, own, strict=True)]
    ends = np.cumsum([len(o) for o in own])[:-1]
    base, glow = ([], []) if not own else (np.split(part, ends) for part in scene.albedo(join_hits(behind)))

    def mean(radiance: np.ndarray) -> np.ndarray:
        shown = tone_map(radiance, EXPOSURE).reshape(side**2, *shape, 3).mean(axis=0)
        return (255 * shown).round().astype(np.uint8)

    pictures = {}
    for k, o, seen, a, e in zip(without, own, behind, base, glow, strict=True):
        radiance = albedo * scene.light(hits, k) + emitted
        radiance[o] = a * scene.light(seen, k) + e
        pictures[k] = mean(radiance)
    alpha = np.isfinite(hits.distance).reshape(side**2, *shape).mean(axis=0)
    seen = mean(albedo * scene.light(hits) + emitted)
    return Picture(seen, ids.reshape(shape), depth.reshape(shape), pictures, alpha)


def take_alone(scene: TracedScene, camera: Camera, side: int, only: int) -> tuple[np.ndarray, np.ndarray]:
    """One object in the light of the scene, but with nothing before it or behind: its picture (H, W, 3) over black,
    0..255, and the share (H, W) of each pixel that it covers, 0..1."""
    hits = scene.hits(*_fine_rays(camera, side), only=only)
    albedo, emitted = scene.albedo(hits)
    parts = tone_map(albedo * scene.light(hits) + emitted, EXPOSURE), np.isfinite(hits.distance)[:, None]
    shown, alpha = (p.reshape(side**2, camera.height, camera.width, -1) for p in parts)
    return 255 * (shown * alpha).mean(axis=0), alpha[..., 0].mean(axis=0)


def _fine_rays(camera: Camera, side: int) -> tuple[np.ndarray, np.ndarray]:
    """Origins and directions (side^2 H W, 3) of `side` squared rays a pixel, picture by picture."""
    steps = (np.arange(side) + 0.5) / side - 0.5
    offsets = [(dx + dy / side, dy - dx / side) for dy in steps for dx in steps]  # sheared: edges meet all of them
    origins, d = zip(*(camera_rays(camera, *o) for o in offsets), strict=True)
    return np.concatenate(origins), np.concatenate(d)


def join_hits(parts: list[Hits]) -> Hits:
    """Concatenation of hits."""
    return Hits(*(np.concatenate([getattr(h, name) for h in parts]) for name in ("distance", "face", "weights")))


def _split_at_creases(shape: Shape, fine: float) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Vertices, normals (V, 3) each, faces (F, 3) and albedo factors (V, 3): one vertex for each side of a crease."""
    world, albedo = shape.surface.world, shape.albedo
    if albedo is None:
        cell = OBJECT_CELL if shape.object_id or shape.support else ROOM_CELL
        world = subdivided(world, cell / fine * shape.surface.spacing)
        albedo = np.ones((len(world.vertices), 3))
    v = world.vertices[world.faces]
    area = np.linalg.norm(np.cross(v[:, 1] - v[:, 0], v[:, 2] - v[:, 0]), axis=1)
    mesh = Mesh(world.vertices, world.faces[area > 1e-12])
    normals = smooth_normals(mesh, face_normals(mesh)).reshape(-1, 3)
    corner = mesh.faces.ravel()
    key = np.column_stack([corner, np.round(8 * normals).astype(np.int64)])
    _, first, index = np.unique(key, axis=0, return_index=True, return_inverse=True)
    chosen = corner[first]
    return mesh.vertices[chosen], normals[first], index.reshape(-1, 3), albedo[chosen]
