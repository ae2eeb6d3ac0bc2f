"""Baked light: daylight through the openings, sun, lamps, and what walls and things throw back.

Irradiance is sampled with rays against the meshes of all parts. Light that arrives by way of
other surfaces is gathered over the hemisphere and looked up in a coarse set of points whose own
exchange of light has been solved before (radiosity; Goral et al. 1984).
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_matrix
from scipy.spatial import cKDTree

from studio.dining_room.layout import EYE
from studio.light_sources import SUN, SUN_IRRADIANCE, SUN_SPREAD, Lamp, Opening, outside
from studio.shapes import Part
from studio.surface_sampling import Cover

LIFT = 1.5e-3  # [m] ray origins above the surface
SIDE = 0.02  # [m] look-up points are moved off the surface, so that the two sides of a board stay apart
BATCH = 1_000_000  # rays at a time
BURIED = 0.92  # share of such rays; the rest may slip through faces that touch
BOUNCES = 5
NEAR = 0.012  # [m] where nearly every ray ends this soon (or within a Gaussian's width), nobody can look


class Room:
    """Rays, lights and the solved exchange of light between the surfaces of `parts`; `rng` draws the rays."""

    def __init__(self, parts: list[Part], openings: list[Opening], lamps: list[Lamp], rng: np.random.Generator):
        import open3d as o3d

        self._tensor = o3d.core.Tensor
        self._scene = o3d.t.geometry.RaycastingScene()
        self.rng, self._openings, self._lamps = rng, openings, lamps
        emission, sheet = [], []
        for part in parts:
            if not part.casts:
                continue
            mesh = part.world
            self._scene.add_triangles(
                self._tensor(mesh.vertices.astype(np.float32)), self._tensor(mesh.faces.astype(np.uint32))
            )
            mean = part.albedo(mesh.vertices, mesh.vertices * 0).mean(0)
            emission.append(np.zeros(3) if part.emission is None else np.asarray(part.emission) * mean)
            sheet.append(part.through is not None)
        self._emission, self._sheet = np.array(emission + [np.zeros(3)]), np.array(sheet + [False])
        self._tree, self._radiosity = None, None

    def irradiance(self, cover: Cover, parts: list[Part], rays: int) -> tuple[np.ndarray, np.ndarray]:
        """Irradiance (N, 3) from everywhere, and mask (N,) of points that something covers up.

        Thin sheets get the mean of their two sides, weighted by what shines through. Needs `solve` before.
        """
        through = np.array([np.nan if p.through is None else p.through for p in parts])[cover.part]
        near = cover.sigma.max(1).clip(NEAR, 5 * NEAR)
        front, hidden = self._arriving(cover.points, cover.normals, rays, near)
        sheet = np.flatnonzero(np.isfinite(through))
        if len(sheet):
            back, _ = self._arriving(cover.points[sheet], -cover.normals[sheet], rays, near[sheet])
            t = through[sheet, None]
            facing = (((np.asarray(EYE) - cover.points[sheet]) * cover.normals[sheet]).sum(1) > 0)[:, None]
            here, there = np.where(facing, front[sheet], back), np.where(facing, back, front[sheet])
            front[sheet] = (1 - t) * here + t * there
            hidden[sheet] = False
        return front, hidden

    def thin(self, points: np.ndarray, normals: np.ndarray, depth: np.ndarray) -> np.ndarray:
        """Whether there is another surface within `depth` (N,) [m] behind each point."""
        t, _, normal = self._cast(points - 1e-4 * normals, -normals)
        return (t < depth) & ((normal * normals).sum(1) < 0)

    def solve(self, cover: Cover, parts: list[Part], albedo: np.ndarray, rays: int = 96) -> None:
        """Exchange of light between the points of a coarse cover with albedos (N, 3)."""
        through = np.array([np.nan if p.through is None else p.through for p in parts])[cover.part]
        sheet = np.isfinite(through)
        points = np.concatenate([cover.points, cover.points[sheet]])
        normals = np.concatenate([cover.normals, -cover.normals[sheet]])
        albedo = np.concatenate([albedo, albedo[sheet]])
        self._tree = cKDTree(points + SIDE * normals)
        direct = self._direct(points, normals)
        n = len(points)
        transport, glow, _ = self._gather(points, normals, rays, np.full(n, NEAR))
        first = direct + glow
        total = first
        for _ in range(BOUNCES):
            total = first + transport @ (albedo * total / np.pi)
        if sheet.any():  # what lies on the other side shines through
            there, back = np.flatnonzero(sheet), np.arange(len(cover), n)
            t = through[sheet][:, None]
            total[there], total[back] = (
                (1 - t) * total[there] + t * total[back],
                (1 - t) * total[back] + t * total[there],
            )
        self._radiosity = albedo * total / np.pi

    def mirrored(self, points: np.ndarray, normals: np.ndarray, eye, spread: np.ndarray, rays: int) -> np.ndarray:
        """Mean radiance (N, 3) that arrives at each point about the mirrored direction towards `eye`.

        `eye` is one point (3,) or one per point; `spread` (N,) [rad] is the width of the lobe.
        """
        view = np.asarray(eye) - points
        view /= np.linalg.norm(view, axis=1, keepdims=True)
        mirror = 2 * (view * normals).sum(1, keepdims=True) * normals - view
        total = np.zeros((len(points), 3))
        for _ in range(rays):
            d = mirror + np.tan(spread)[:, None] * self.rng.normal(size=mirror.shape) * 0.7
            d /= np.linalg.norm(d, axis=1, keepdims=True)
            below = (d * normals).sum(1, keepdims=True)
            d -= 2 * np.minimum(below, 0) * normals
            total += self.radiance(points + LIFT * normals, d)
        return total / rays

    def radiance(self, origins: np.ndarray, directions: np.ndarray) -> np.ndarray:
        """Radiance (N, 3) that arrives at `origins` against `directions`."""
        total = np.zeros((len(origins), 3))
        for i in range(0, len(origins), BATCH):
            o, d = origins[i : i + BATCH], directions[i : i + BATCH]
            t, geometry, normal = self._cast(o, d)
            hit = np.isfinite(t)
            part = np.zeros((len(o), 3))
            part[~hit] = outside(d[~hit])
            part[hit] = self._emission[geometry[hit]]
            valid = hit & ((normal * d).sum(1) < 0)
            near = self._tree.query((o + t[:, None] * d + SIDE * normal)[valid], workers=2)[1]
            part[valid] += self._radiosity[near]
            total[i : i + BATCH] = part
        return total

    def _arriving(self, points, normals, rays, near) -> tuple[np.ndarray, np.ndarray]:
        total, hidden = self._direct(points, normals), np.zeros(len(points), bool)
        step = max(BATCH // rays, 1)
        for i in range(0, len(points), step):
            s = slice(i, i + step)
            transport, glow, short = self._gather(points[s], normals[s], rays, near[s])
            total[s] += transport @ self._radiosity + glow
            hidden[s] = short > BURIED
        return total, hidden

    def _gather(self, points, normals, rays, near) -> tuple[csr_matrix, np.ndarray, np.ndarray]:
        """Irradiance = matrix @ radiosity of the look-up points + glow; and the share of very short rays.

        Cosine-distributed rays weigh alike: each carries pi / rays.
        """
        n = len(points)
        k = np.arange(rays)
        u = (k[None] + self.rng.random((n, rays))) / rays  # stratified in elevation, golden angle in azimuth
        angle = 2 * np.pi * ((k * 0.6180339887 + self.rng.random((n, 1))) % 1)
        t1, t2 = _frame(normals)
        r = np.sqrt(u)
        d = (r * np.cos(angle))[..., None] * t1[:, None] + (r * np.sin(angle))[..., None] * t2[:, None]
        d = (d + np.sqrt(1 - u)[..., None] * normals[:, None]).reshape(-1, 3)
        o = np.repeat(points + LIFT * normals, rays, 0)
        t, geometry, normal = self._cast(o, d)
        hit = np.isfinite(t)
        behind = hit & ((normal * d).sum(1) >= 0)
        glow = np.where(hit[:, None], self._emission[geometry], 0).reshape(n, rays, 3).sum(1) * (np.pi / rays)
        valid = np.flatnonzero(hit & ~behind)
        source = self._tree.query(o[valid] + t[valid, None] * d[valid] + SIDE * normal[valid], workers=2)[1]
        matrix = csr_matrix((np.full(len(valid), np.pi / rays), (valid // rays, source)), (n, self._tree.n))
        return matrix, glow, (behind | (t < np.repeat(near, rays))).reshape(n, rays).mean(1)

    def _direct(self, points, normals, samples: int = 5) -> np.ndarray:
        """Irradiance from openings (`samples` squared points each), sun and lamps."""
        total = np.zeros((len(points), 3))
        origins = points + LIFT * normals
        for opening in self._openings:
            face = np.cross(opening.a, opening.b)
            for i in range(samples**2):
                u = (i % samples + self.rng.random((len(points), 1))) / samples
                v = (i // samples + self.rng.random((len(points), 1))) / samples
                d = opening.corner + u * opening.a + v * opening.b - origins
                square = (d * d).sum(1, keepdims=True)
                d /= np.sqrt(square)
                weight = (normals * d).sum(1).clip(0) * np.abs(d @ face) / np.maximum(square[:, 0], 0.01)
                self._add(total, origins, d, np.inf, weight[:, None] * outside(d) / samples**2)
        for _ in range(8):
            d = -SUN + SUN_SPREAD * self.rng.normal(size=points.shape)
            d /= np.linalg.norm(d, axis=1, keepdims=True)
            self._add(total, origins, d, np.inf, (normals * d).sum(1).clip(0)[:, None] * SUN_IRRADIANCE / 8)
        for lamp in self._lamps:
            for _ in range(10):
                d = lamp.centre + lamp.radius * _ball(self.rng, len(points)) - origins
                far = np.linalg.norm(d, axis=1)
                d /= far[:, None]
                weight = (normals * d).sum(1).clip(0) / np.maximum(far, 0.05) ** 2
                self._add(total, origins, d, far, weight[:, None] * lamp.intensity / 10)
        return total

    def _add(self, total, origins, directions, far, light) -> None:
        """Add `light` where nothing blocks the ray."""
        useful = np.flatnonzero(light.max(1) > 1e-6)
        far = np.broadcast_to(far, (len(origins),))
        for i in range(0, len(useful), BATCH):
            s = useful[i : i + BATCH]
            length = np.minimum(far[s], 1e3)[:, None]
            rays = np.concatenate([origins[s], directions[s] * length], 1).astype(np.float32)
            free = ~self._scene.test_occlusions(self._tensor(rays), tnear=0.0, tfar=0.999).numpy()
            total[s[free]] += light[s[free]]

    def _cast(self, origins, directions) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Distance (inf: nothing), part and normal of what rays hit; a sheet turns its normal to the ray."""
        answer = self._scene.cast_rays(self._tensor(np.concatenate([origins, directions], 1).astype(np.float32)))
        t = answer["t_hit"].numpy().astype(float)
        geometry = answer["geometry_ids"].numpy().astype(np.int64)
        geometry[~np.isfinite(t)] = len(self._emission) - 1
        normal = answer["primitive_normals"].numpy().astype(float)
        flip = self._sheet[geometry] & ((normal * directions).sum(1) > 0)
        normal[flip] *= -1
        return t, geometry, normal


def _frame(normals: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Two unit vectors across each normal."""
    axis = np.where(np.abs(normals[:, :1]) > 0.7, (0.0, 1.0, 0.0), (1.0, 0.0, 0.0))
    t = np.cross(normals, axis)
    t /= np.linalg.norm(t, axis=1, keepdims=True)
    return t, np.cross(normals, t)


def _ball(rng: np.random.Generator, count: int) -> np.ndarray:
    d = rng.normal(size=(count, 3))
    return d / np.linalg.norm(d, axis=1, keepdims=True)
