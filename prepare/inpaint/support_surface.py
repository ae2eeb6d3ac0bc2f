"""Support surfaces of an object: the planes that it stands on or leans against, and their smooth relief."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.interpolate import RBFInterpolator
from scipy.ndimage import binary_dilation
from scipy.spatial import cKDTree

from prepare.inpaint.hole_views import SOLID, TRACE, HoleView, Surroundings

PLANES_MAX = 3  # a floor and two walls meeting in a corner
POINTS = 6000  # sampled on the background around the object, from all views
TRIALS = 400  # RANSAC planes through three points
NEAR = 1.7  # radii from the object's middle: the rim on which planes are fitted
FLAT = 0.03  # radii: largest distance of a plane's points from it
SHARE = 0.04, 0.08  # of all points that the largest plane needs, and further planes
PARALLEL = 0.85  # cosine between a point's normal and its plane's
NEIGHBOURS = 32  # points from which a normal is estimated
GAP = 0.3  # radii between the object and its support, at most
BENEATH = 0.12  # radii that the object may reach behind its support
HALO = 2  # [px] around the object in which its colour leaks into the background
RELIEF_POINTS, RELIEF_POINTS_MIN = 300, 20
SMOOTHING = 0.1  # of the thin-plate spline, with the hole's size as the unit


@dataclass(frozen=True)
class SupportSurface:
    """A plane with a smooth relief. Its frame: origin [m] (3,), rows of `axes` (3, 3) along it and towards the object.

    spread  root mean square distance [m] of the points it was found from
    """

    origin: np.ndarray
    axes: np.ndarray
    spread: float
    relief: Callable | None = field(default=None, repr=False)

    def heights(self, at: np.ndarray) -> np.ndarray:
        """Height [m] over the plane at places (..., 2) [m] of it."""
        if self.relief is None:
            return np.zeros(at.shape[:-1])
        return self.relief(at.reshape(-1, 2)).reshape(at.shape[:-1])

    def points(self, at: np.ndarray, heights: np.ndarray | None = None) -> np.ndarray:
        """Points [m] (..., 3) of the surface at places (..., 2)."""
        heights = self.heights(at) if heights is None else heights
        return self.origin + at @ self.axes[:2] + heights[..., None] * self.axes[2]

    def local(self, points: np.ndarray) -> np.ndarray:
        """Places and distances from the plane (..., 3) [m] of points."""
        return (points - self.origin) @ self.axes.T


def rim_points(views: list[HoleView], ball: Surroundings, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Points (N, 3) [m] of the background around the object that the cameras saw, and their normals (N, 3)."""
    found = [np.zeros((0, 3))]
    for view in views:
        seen = (view.alpha > 0.9) & ~binary_dilation(view.object_alpha > TRACE, iterations=HALO)
        y, x = np.nonzero(seen)
        at = unproject(view, x, y)
        near = np.flatnonzero(np.linalg.norm(at - ball.centre, axis=1) < NEAR * ball.radius)
        found.append(at[near[rng.permutation(len(near))[: max(50, 4 * POINTS // len(views))]]])
    points = np.concatenate(found)
    points = points[rng.permutation(len(points))[:POINTS]]
    if len(points) < NEIGHBOURS:
        return points, np.zeros_like(points)
    # Of neighbours from all views: between a picture's pixels, the noise of its depth is larger than the slope.
    own = points[cKDTree(points).query(points, k=NEIGHBOURS)[1]]
    own -= own.mean(axis=1, keepdims=True)
    return points, np.linalg.eigh(np.einsum("nki,nkj->nij", own, own))[1][:, :, 0]


def unproject(view: HoleView, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Points (N, 3) [m] of the background at the middles of pixels."""
    c, z = view.camera, view.depth[y, x].astype(np.float64)
    p = np.stack([(x + 0.5 - c.cx) / c.fx * z, (y + 0.5 - c.cy) / c.fy * z, z], axis=1)
    return (p - c.world_to_camera[:3, 3]) @ c.world_to_camera[:3, :3]


def support_surfaces(
    views: list[HoleView], removed_means: np.ndarray, ball: Surroundings, rng: np.random.Generator
) -> list[SupportSurface]:
    """Planes around the object with it and most cameras on one side, the largest first; [] if there is none."""
    points, normals = rim_points(views, ball, rng)
    left, turned = points, normals
    eyes = np.array([v.camera.position for v in views])
    found = []
    while len(found) < PLANES_MAX and len(left) >= max(50, SHARE[1] * len(points)):
        plane = _largest_plane(left, turned, removed_means, eyes, ball, rng)
        if plane is None:
            break
        origin, normal, spread = plane
        along = np.abs(turned @ normal) > PARALLEL
        on = along & (np.abs((left - origin) @ normal) < 2 * FLAT * ball.radius)
        if on.sum() < SHARE[min(len(found), 1)] * len(points):
            break
        found.append(SupportSurface(ball.centre - normal * (normal @ (ball.centre - origin)), _frame(normal), spread))
        left, turned = left[~along], turned[~along]  # a parallel one would be the same again, seen with noise
    return found


def _largest_plane(points, own_normals, object_points, eyes, ball: Surroundings, rng):
    """Origin, normal towards the object, and spread of the plane with most points; None if no plane carries it."""
    corners = points[rng.integers(0, len(points), (TRIALS, 3))]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(normals, axis=1)
    wide = length > 1e-3 * ball.radius**2
    normals, origins = normals[wide] / length[wide, None], corners[wide, 0]
    normals *= np.sign(((ball.centre - origins) * normals).sum(axis=1))[:, None]
    offsets = (origins * normals).sum(axis=1)
    lowest = np.percentile(object_points[:: max(1, len(object_points) // 2000)] @ normals.T, 3, axis=0) - offsets
    facing = (eyes @ normals.T > offsets).mean(axis=0)
    on = (np.abs(points @ normals.T - offsets) < FLAT * ball.radius) & (np.abs(own_normals @ normals.T) > PARALLEL)
    count = on.sum(axis=0)
    count[(lowest < -BENEATH * ball.radius) | (lowest > GAP * ball.radius) | (facing < SOLID)] = 0
    if not count.size or not count.max():
        return None
    best = int(count.argmax())
    normal, origin = normals[best], origins[best]
    for _ in range(4):
        own = points[_on_plane(points, own_normals, origin, normal, ball)]
        if len(own) < 10:
            return None
        origin = own.mean(axis=0)
        found = np.linalg.eigh(np.cov((own - origin).T))[1][:, 0]
        normal = found * np.sign(found @ normal)
    own = points[_on_plane(points, own_normals, origin, normal, ball)]
    return origin, normal, float(np.sqrt((((own - origin) @ normal) ** 2).mean()))


def _on_plane(points, normals, origin, normal, ball: Surroundings) -> np.ndarray:
    return (np.abs((points - origin) @ normal) < FLAT * ball.radius) & (np.abs(normals @ normal) > PARALLEL)


def _frame(normal: np.ndarray) -> np.ndarray:
    """Rotation (3, 3) whose last row is `normal`."""
    across = np.cross(normal, np.eye(3)[np.abs(normal).argmin()])
    across /= np.linalg.norm(across)
    return np.stack([across, np.cross(normal, across), normal])


def fit_relief(surface: SupportSurface, at: np.ndarray, heights: np.ndarray, unit: float) -> SupportSurface:
    """The surface with a thin plate through heights (N,) [m] at places (N, 2); `unit` [m] of the fit's smoothing."""
    chosen = np.unique(np.linspace(0, len(at) - 1, RELIEF_POINTS).round().astype(int))
    if len(chosen) < RELIEF_POINTS_MIN or np.linalg.matrix_rank(at[chosen] - at[chosen].mean(axis=0)) < 2:
        return surface
    plate = RBFInterpolator(at[chosen] / unit, heights[chosen] / unit, kernel="thin_plate_spline", smoothing=SMOOTHING)
    return replace(surface, relief=lambda places: unit * plate(places / unit))
