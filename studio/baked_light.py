"""Baked light: daylight through openings, sun, lamps and interreflection.

Irradiance is sampled with rays against the meshes of all surfaces. Indirect light is gathered over the hemisphere and
looked up in a coarse set of surfels whose radiosity has been solved before (Goral et al. 1984).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.sparse import csr_matrix, vstack
from scipy.spatial import cKDTree

from core.program import batches, in_threads, open3d
from studio.light_sources import LightSources
from studio.shapes import Surface
from studio.surface_sampling import Surfels, Viewer

RAY_OFFSET = 1.5e-3  # [m] of ray origins above the surface
LOOKUP_OFFSET = 0.02  # [m] of look-up points off the surface, which separates the two sides of a board
RAY_BATCH = 1 << 17  # rays at a time in each thread
COVERED_RAY_FRACTION = 0.92  # of short rays at a covered point; the rest may pass between faces that touch
BOUNCES = 5
SUN_RAYS = 8
SHORT_RAY = 0.012  # [m] rays that end sooner (or within a Gaussian's width) count as short


class BakedLight:
    """Ray casting against `surfaces`, their light sources, and the solved interreflection between them.

    `viewer` says which side of a thin sheet is seen.
    The radiosity is solved on `coarse` surfels with albedos `albedo` (N, 3); `rng` draws the rays for that.
    """

    def __init__(
        self,
        surfaces: list[Surface],
        sources: LightSources,
        viewer: Viewer,
        coarse: Surfels,
        albedo: np.ndarray,
        rng: np.random.Generator,
    ):
        o3d = open3d("baked light")
        self._tensor = o3d.core.Tensor
        self._scene = o3d.t.geometry.RaycastingScene()
        self._sources, self._viewer = sources, viewer
        emission, sheet = [], []
        for surface in surfaces:
            if not surface.blocks_light:
                continue
            mesh = surface.world
            self._scene.add_triangles(
                self._tensor(mesh.vertices.astype(np.float32)), self._tensor(mesh.faces.astype(np.uint32))
            )
            mean = surface.albedo(mesh.vertices, mesh.vertices * 0).mean(0)
            emission.append(np.zeros(3) if surface.emission is None else np.asarray(surface.emission) * mean)
            sheet.append(surface.translucency is not None)
        self._emission, self._sheet = np.array(emission + [np.zeros(3)]), np.array(sheet + [False])
        # the first rays build open3d's tree, which several threads must not do at once
        self._scene.test_occlusions(self._tensor(np.array([[0, 0, 0, 0, 1, 0]], np.float32)))
        self._tree, self._radiosity = self._solve_radiosity(coarse, surfaces, albedo, rng)

    def irradiance(
        self,
        surfels: Surfels,
        surfaces: list[Surface],
        rays: int,
        rng: np.random.Generator,
        progress: Callable[[float], None] = lambda fraction: None,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Irradiance (2, N, 3) of surfels of `surfaces`: direct, and gathered by `rays` rays each; and mask (N,) of
        covered surfels.

        Thin sheets get the mean of their two sides, weighted by their translucency. `progress` is told the fraction
        of all surfels that are lit.
        """
        translucency = _translucency(surfels, surfaces)
        near = surfels.sigma.max(1).clip(SHORT_RAY, 5 * SHORT_RAY)
        front, hidden = self._irradiance_from_front(surfels.points, surfels.normals, rays, near, rng, progress)
        sheet = np.flatnonzero(np.isfinite(translucency))
        if len(sheet):
            back, _ = self._irradiance_from_front(
                surfels.points[sheet], -surfels.normals[sheet], rays, near[sheet], rng
            )
            t = translucency[sheet, None]
            facing = (((np.asarray(self._viewer.eye) - surfels.points[sheet]) * surfels.normals[sheet]).sum(1) > 0)[
                :, None
            ]
            here, there = np.where(facing, front[:, sheet], back), np.where(facing, back, front[:, sheet])
            front[:, sheet] = (1 - t) * here + t * there
            hidden[sheet] = False
        return front, hidden

    def has_surface_behind(self, points: np.ndarray, normals: np.ndarray, depth: np.ndarray) -> np.ndarray:
        """Mask (N,) of points with another surface that faces away within `depth` (N,) [m] behind them."""
        t, _, normal = self._cast_rays(points - 1e-4 * normals, -normals)
        return (t < depth) & ((normal * normals).sum(1) < 0)

    def reflected(
        self, points: np.ndarray, normals: np.ndarray, eye, spread: np.ndarray, rays: int, rng: np.random.Generator
    ) -> np.ndarray:
        """Mean radiance (N, 3) incident at each point around the mirror direction towards `eye`.

        `eye` is one point (3,) or one per point; `spread` (N,) [rad] is the width of the lobe. What leaves a room at a
        joint, e.g. behind a skirting board, meets neither the sky nor darkness, which would be a bright or a black line
        there, but as deep in a corner what is around it: the radiance of its own place.
        """
        own = self._radiosity[self._tree.query(points + LOOKUP_OFFSET * normals)[1]]
        view = np.asarray(eye) - points
        view /= np.linalg.norm(view, axis=1, keepdims=True)
        mirror = 2 * (view * normals).sum(1, keepdims=True) * normals - view
        total = np.zeros((len(points), 3))
        for _ in range(rays):
            d = mirror + np.tan(spread)[:, None] * rng.normal(size=mirror.shape) * 0.7
            d /= np.linalg.norm(d, axis=1, keepdims=True)
            below = (d * normals).sum(1, keepdims=True)
            d -= 2 * np.minimum(below, 0) * normals
            total += self.radiance(points + RAY_OFFSET * normals, d, own)
        return total / rays

    def radiance(self, origins: np.ndarray, directions: np.ndarray, unknown: np.ndarray | float = 0.0) -> np.ndarray:
        """Radiance (N, 3) that arrives at `origins` (N, 3) from `directions` (N, 3); `unknown` (N, 3) where a ray meets
        nothing or the back of a surface."""
        unknown = np.broadcast_to(unknown, origins.shape)
        total = np.zeros((len(origins), 3))

        def look_up(s: slice) -> None:
            o, d = origins[s], directions[s]
            t, geometry, normal = self._cast_rays(o, d)
            hit = np.isfinite(t)
            incident = np.zeros((len(o), 3))
            incident[~hit] = self._sources.sky_beyond(o[~hit], d[~hit])
            incident[hit] = self._emission[geometry[hit]]
            valid = hit & ((normal * d).sum(1) < 0)
            at = o[valid] + t[valid, None] * d[valid] + LOOKUP_OFFSET * normal[valid]
            incident[valid] += self._radiosity[self._tree.query(at)[1]]
            lost = ~valid & ~incident.any(axis=1)
            incident[lost] = unknown[s][lost]
            total[s] = incident

        in_threads(look_up, batches(len(origins), RAY_BATCH))
        return total

    def _solve_radiosity(
        self, surfels: Surfels, surfaces, albedo: np.ndarray, rng: np.random.Generator, rays: int = 96
    ):
        """Search tree of the look-up points and their radiance (N, 3): radiosity with BOUNCES bounces."""
        translucency = _translucency(surfels, surfaces)
        sheet = np.isfinite(translucency)
        points = np.concatenate([surfels.points, surfels.points[sheet]])
        normals = np.concatenate([surfels.normals, -surfels.normals[sheet]])
        albedo = np.concatenate([albedo, albedo[sheet]])
        tree = cKDTree(points + LOOKUP_OFFSET * normals)
        direct = self._direct_light(points, normals, rng)
        n = len(points)
        near, jobs = np.full(n, SHORT_RAY), _jobs(n, rays, rng)
        parts = in_threads(lambda job: self._gather(points, normals, rays, near, tree, *job), jobs)
        transport, first = vstack([part[0] for part in parts]), direct + np.concatenate([part[1] for part in parts])
        total = first
        for _ in range(BOUNCES):
            total = first + transport @ (albedo * total / np.pi)
        if sheet.any():  # light of the other side is transmitted
            there, back = np.flatnonzero(sheet), np.arange(len(surfels), n)
            t = translucency[sheet][:, None]
            total[there], total[back] = (
                (1 - t) * total[there] + t * total[back],
                (1 - t) * total[back] + t * total[there],
            )
        return tree, albedo * total / np.pi

    def _irradiance_from_front(
        self, points, normals, rays, near, rng, progress=lambda fraction: None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Irradiance (2, N, 3) on the side of the normals, direct and gathered, and mask (N,) of points whose rays are
        nearly all short."""
        direct, gathered = self._direct_light(points, normals, rng), np.zeros((len(points), 3))
        hidden = np.zeros(len(points), bool)

        def light(job: tuple[slice, np.random.Generator]) -> None:
            s, own_rng = job
            transport, emitted, short = self._gather(points, normals, rays, near, self._tree, s, own_rng)
            gathered[s] = transport @ self._radiosity + emitted
            hidden[s] = short > COVERED_RAY_FRACTION
            progress(s.stop / len(points))

        in_threads(light, _jobs(len(points), rays, rng))
        return np.stack([direct, gathered]), hidden

    def _gather(self, points, normals, rays, near, tree, s: slice, rng) -> tuple[csr_matrix, np.ndarray, np.ndarray]:
        """Final gather at the points `s`: transport matrix (N, look-up points), emitted irradiance (N, 3), and
        fraction of short rays (N,).

        Irradiance = matrix @ radiosity + emitted. Cosine-distributed rays have equal weights of pi / rays.
        """
        points, normals, near = points[s], normals[s], near[s]
        n = len(points)
        k = np.arange(rays)
        u = (k[None] + rng.random((n, rays))) / rays  # stratified in elevation, golden angle in azimuth
        angle = 2 * np.pi * ((k * 0.6180339887 + rng.random((n, 1))) % 1)
        t1, t2 = tangent_frame(normals)
        r = np.sqrt(u)
        d = (r * np.cos(angle))[..., None] * t1[:, None] + (r * np.sin(angle))[..., None] * t2[:, None]
        d = (d + np.sqrt(1 - u)[..., None] * normals[:, None]).reshape(-1, 3)
        o = np.repeat(points + RAY_OFFSET * normals, rays, 0)
        t, geometry, normal = self._cast_rays(o, d)
        hit = np.isfinite(t)
        behind = hit & ((normal * d).sum(1) >= 0)
        emitted = np.where(hit[:, None], self._emission[geometry], 0)
        if self._sources.openings is None:
            emitted[~hit] = self._sources.sky(d[~hit])
        emitted = emitted.reshape(n, rays, 3).sum(1) * (np.pi / rays)
        valid = np.flatnonzero(hit & ~behind)
        source = tree.query(o[valid] + t[valid, None] * d[valid] + LOOKUP_OFFSET * normal[valid])[1]
        matrix = csr_matrix((np.full(len(valid), np.pi / rays), (valid // rays, source)), (n, tree.n))
        return matrix, emitted, (behind | (t < np.repeat(near, rays))).reshape(n, rays).mean(1)

    def _direct_light(self, points, normals, rng, samples: int = 5) -> np.ndarray:
        """Irradiance (N, 3) from openings (`samples` squared points each), sun and lamps."""

        def light(job: tuple[slice, np.random.Generator]) -> np.ndarray:
            return self._direct_light_at(points[job[0]], normals[job[0]], job[1], samples)

        return np.concatenate([np.zeros((0, 3)), *in_threads(light, _jobs(len(points), 1, rng))])

    def _direct_light_at(self, points, normals, rng, samples: int) -> np.ndarray:
        """Irradiance (N, 3) as `_direct_light`, of one batch."""
        total = np.zeros((len(points), 3))
        origins = points + RAY_OFFSET * normals
        for opening in self._sources.openings or ():
            face = np.cross(opening.a, opening.b)
            for i in range(samples**2):
                u = (i % samples + rng.random((len(points), 1))) / samples
                v = (i // samples + rng.random((len(points), 1))) / samples
                d = opening.corner + u * opening.a + v * opening.b - origins
                square = (d * d).sum(1, keepdims=True)
                d /= np.sqrt(square)
                weight = (normals * d).sum(1).clip(0) * np.abs(d @ face) / np.maximum(square[:, 0], 0.01)
                self._add_unoccluded(total, origins, d, np.inf, weight[:, None] * self._sources.sky(d) / samples**2)
        sun = self._sources.sun
        for _ in range(SUN_RAYS if sun is not None else 0):
            d = sun.spread * rng.normal(size=points.shape) - sun.direction
            d /= np.linalg.norm(d, axis=1, keepdims=True)
            light = (normals * d).sum(1).clip(0)[:, None] * sun.irradiance / SUN_RAYS
            self._add_unoccluded(total, origins, d, np.inf, light)
        for lamp in self._sources.lamps:
            for _ in range(10):
                d = lamp.centre + lamp.radius * _random_directions(rng, len(points)) - origins
                far = np.linalg.norm(d, axis=1)
                d /= far[:, None]
                weight = (normals * d).sum(1).clip(0) / np.maximum(far, 0.05) ** 2
                self._add_unoccluded(total, origins, d, far, weight[:, None] * lamp.towards(-d) / 10)
        return total

    def _add_unoccluded(self, total, origins, directions, far, light) -> None:
        """Add `light` (N, 3) to `total` where nothing blocks the ray up to the distance `far`."""
        lit = np.flatnonzero(light.max(1) > 1e-6)
        far = np.broadcast_to(far, (len(origins),))
        length = np.minimum(far[lit], 1e3)[:, None]
        rays = np.concatenate([origins[lit], directions[lit] * length], 1).astype(np.float32)
        unoccluded = lit[~self._scene.test_occlusions(self._tensor(rays), tnear=0.0, tfar=0.999).numpy()]
        total[unoccluded] += light[unoccluded]

    def _cast_rays(self, origins, directions) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Distance [m] (inf: no hit), surface index and normal of the first hits; sheets face the ray."""
        hits = self._scene.cast_rays(self._tensor(np.concatenate([origins, directions], 1).astype(np.float32)))
        t = hits["t_hit"].numpy().astype(float)
        geometry = hits["geometry_ids"].numpy().astype(np.int64)
        geometry[~np.isfinite(t)] = len(self._emission) - 1
        normal = hits["primitive_normals"].numpy().astype(float)
        flip = self._sheet[geometry] & ((normal * directions).sum(1) > 0)
        normal[flip] *= -1
        return t, geometry, normal


def _jobs(count: int, rays: int, rng: np.random.Generator) -> list[tuple[slice, np.random.Generator]]:
    """Batches of `count` points with `rays` rays each, and random numbers of their own."""
    parts = batches(count, max(RAY_BATCH // rays, 1))
    return list(zip(parts, rng.spawn(len(parts)), strict=True))


def _translucency(surfels: Surfels, surfaces: list[Surface]) -> np.ndarray:
    """Translucency (N,) of each surfel's surface; NaN where it is opaque."""
    return np.array([np.nan if s.translucency is None else s.translucency for s in surfaces])[surfels.surface]


def tangent_frame(normals: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Two unit tangents (N, 3) for each normal."""
    axis = np.where(np.abs(normals[:, :1]) > 0.7, (0.0, 1.0, 0.0), (1.0, 0.0, 0.0))
    t = np.cross(normals, axis)
    t /= np.linalg.norm(t, axis=1, keepdims=True)
    return t, np.cross(normals, t)


def _random_directions(rng: np.random.Generator, count: int) -> np.ndarray:
    """Uniform random unit vectors (count, 3)."""
    d = rng.normal(size=(count, 3))
    return d / np.linalg.norm(d, axis=1, keepdims=True)
