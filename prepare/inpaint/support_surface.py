"""Support surfaces of an object: the planes that it stands on or leans against, and their smooth relief."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.interpolate import RBFInterpolator
from scipy.ndimage import binary_dilation
from scipy.spatial import cKDTree

from prepare.inpaint.hole_views import SOLID, TRACE, HoleView, Surroundings

POINTS, POINTS_MIN = 6000, 50  # sampled on the background around the object, from all views
OBJECT_POINTS = 2000  # sampled on the object
TRIALS = 400  # RANSAC planes through three points
REFITS = 8  # of the best plane
NEAR = 1.7  # radii from the object's middle: the rim on which planes are fitted
CONTACT = 0.08  # radii from the object at which a point's weight is a quarter
FLAT = 0.06  # radii: largest distance of a plane's points from it
SHARE = 0.08  # of all points' weight that a plane needs
PARALLEL = 0.85  # cosine between a point's normal and its plane's
NEIGHBOURS = 32  # points from which a normal is estimated
PART_SHARE = 0.06, 0.5  # least and most of an object that may be a part of its support
HALO = 2  # [px] around the object in which its colour leaks into the background
RELIEF_POINTS, RELIEF_POINTS_MIN = 300, 20
SMOOTHING = 0.1  # of the thin-plate spline, with the hole's size as the unit


@dataclass(frozen=True)
class SupportSurface:
    """A plane with a smooth relief. Its frame: origin [m] (3,), rows of `axes` (3, 3) along it and towards the object.

    spread  standard deviation [m] of the points it was found from, by their median
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
    return points, normals_of(points)


def unproject(view: HoleView, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Points (N, 3) [m] of the background at the middles of pixels."""
    c, z = view.camera, view.depth[y, x].astype(np.float64)
    p = np.stack([(x + 0.5 - c.cx) / c.fx * z, (y + 0.5 - c.cy) / c.fy * z, z], axis=1)
    return (p - c.world_to_camera[:3, 3]) @ c.world_to_camera[:3, :3]


def support_surfaces(
    views: list[HoleView], removed_means: np.ndarray, ball: Surroundings, rng: np.random.Generator
) -> list[SupportSurface]:
    """Planes at the object that have it, and most cameras, on one side; the one it touches first, [] if there is none.

    Points count by how near they are to the object: it stands on the slab at its feet, not on the larger ground below.
    """
    points, normals = rim_points(views, ball, rng)
    near = _nearness(points, removed_means, ball)
    eyes = np.array([v.camera.position for v in views])
    found, total = [], near.sum()
    while len(points) >= POINTS_MIN:
        plane = _supporting_plane(points, normals, near, removed_means, eyes, ball, rng)
        if plane is None:
            break
        origin, normal, spread = plane
        along = np.abs(normals @ normal) > PARALLEL
        on = along & (np.abs((points - origin) @ normal) < FLAT * ball.radius)
        if near[on].sum() < SHARE * total:
            break
        found.append(SupportSurface(ball.centre - normal * (normal @ (ball.centre - origin)), _frame(normal), spread))
        points, normals, near = points[~along], normals[~along], near[~along]  # parallel ones: the same with noise
    return found


def _nearness(points: np.ndarray, others: np.ndarray, ball: Surroundings) -> np.ndarray:
    """Weights (N,) of points by how near they are to others; a quarter at CONTACT, and soon nothing beyond."""
    return (1.0 + (cKDTree(others).query(points)[0] / (CONTACT * ball.radius)) ** 2) ** -2.0


def part_of_surface(
    means: np.ndarray, surface: SupportSurface, ball: Surroundings, like: np.ndarray | bool = True
) -> np.ndarray:
    """Mask (N,) of an object's Gaussians that lie in the surface that it stands on: its masks took them along.

    None if most of it lies there, as it is flat itself, or little does, as that is its own underside. `like`: those of
    the surface's colours (N,); flat feet have others.
    """
    points = means.astype(np.float64)
    lying = np.abs(surface.local(points)[:, 2]) < FLAT * ball.radius
    lying &= np.abs(normals_of(points) @ surface.axes[2]) > PARALLEL
    part = lying & like
    return part & (PART_SHARE[0] < part.mean() and lying.mean() < PART_SHARE[1])


def normals_of(points: np.ndarray) -> np.ndarray:
    """Unit normals (N, 3), of either sign, of the neighbourhoods of points (N, 3)."""
    own = points[cKDTree(points).query(points, k=min(NEIGHBOURS, len(points)))[1]]
    own -= own.mean(axis=1, keepdims=True)
    return np.linalg.eigh(np.einsum("nki,nkj->nij", own, own))[1][:, :, 0]


def _supporting_plane(points, own_normals, near, object_points, eyes, ball: Surroundings, rng):
    """Origin, normal towards the object, and spread of the plane that explains most; None if no plane carries it.

    Sample consensus with a truncated square (MSAC), of planes through three points and planes like these that the
    object touches; a plane counts by the share of the object's contact at it, too. Then weighted least squares,
    to the object's points as well: its masks may have taken along most of the surface that it stands on.
    """
    flat = FLAT * ball.radius
    some = object_points[:: max(1, len(object_points) // OBJECT_POINTS)]
    beside = _nearness(some, points, ball)
    corners = points[rng.choice(len(points), (TRIALS, 3), p=near / near.sum())]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(normals, axis=1)
    wide = length > 1e-3 * ball.radius**2
    normals, origins = normals[wide] / length[wide, None], corners[wide, 0]
    normals *= np.sign(((ball.centre - origins) * normals).sum(axis=1))[:, None]
    lowest = np.percentile(some @ normals.T, 3, axis=0)
    offsets = np.concatenate([(origins * normals).sum(axis=1), lowest])
    normals, lowest = np.concatenate([normals, normals]), np.concatenate([lowest, lowest]) - offsets
    facing = (eyes @ normals.T > offsets).mean(axis=0)
    carries = (lowest >= 0.0) & (facing > SOLID)
    own = (1.0 - ((points @ normals.T - offsets) / flat) ** 2).clip(0.0) * (np.abs(own_normals @ normals.T) > PARALLEL)
    touching = beside @ (1.0 - ((some @ normals.T - offsets) / flat) ** 2).clip(0.0) / beside.sum()
    score = np.where(carries, (near @ own) * touching, 0.0)
    if not score.size or not score.max():
        return None
    best = int(score.argmax())
    normal, origin = normals[best], normals[best] * offsets[best]
    both, both_normals = np.concatenate([points, some]), np.concatenate([own_normals, normals_of(some)])
    nearness = np.sqrt(np.concatenate([near, beside]))  # of a wider base
    for _ in range(REFITS):
        along = np.abs(both_normals @ normal) > PARALLEL
        weights = nearness * along * (1.0 - ((both - origin) @ normal / flat) ** 2).clip(0.0)
        if (weights[: len(points)] > 0).sum() < 10:
            return None
        origin = np.average(both, axis=0, weights=weights)
        found = np.linalg.eigh(np.cov((both - origin).T, aweights=weights))[1][:, 0]
        normal = found * np.sign(found @ normal)
    off = np.abs((points - origin) @ normal)[np.abs(own_normals @ normal) > PARALLEL]
    return origin, normal, 1.48 * float(np.median(off[off < flat]))


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
