"""Planes of points on the host: weighted least squares, the direction of level surfaces, and the floor.

Normals are those of discs and have no sign; areas weigh them.
"""

from __future__ import annotations

import numpy as np

LEVEL_COS = np.cos(np.radians(25.0))  # smallest cosine to the vertical of the normals of a level plane
NARROWING_COS = np.cos(np.radians([35, 25, 16, 10, 6, 4, 4]))  # largest angle of normals to the axis, step by step
HEIGHT_BINS = 300  # of the histogram in which the floor is searched
FLOOR_HEIGHT_MAX = 0.45  # of the scene's height: above are tables and the ceiling


def fit_plane(points: np.ndarray, weights: np.ndarray, towards: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Plane of least weighted squares of the distances of points (N, 3): its centre (3,) and unit normal (3,), on the
    side of `towards` (3,)."""
    w = weights / weights.sum()
    centre = w @ points
    centred = points - centre
    normal = np.linalg.eigh((w[:, None] * centred).T @ centred)[1][:, 0]
    return centre, normal * np.sign(normal @ towards)


def mean_normal(axis: np.ndarray, normals: np.ndarray, areas: np.ndarray) -> np.ndarray:
    """Area-weighted mean direction (3,) of the normals near `axis` (3,), whatever their signs."""
    for cosine in NARROWING_COS:
        near = np.abs(normals @ axis) > cosine
        if areas[near].sum() <= 0:
            return axis
        n = normals[near]
        found = np.linalg.eigh((areas[near, None] * n).T @ n)[1][:, -1]
        axis = found * np.sign(found @ axis)
    return axis


def lowest_level_plane(
    heights: np.ndarray, level: np.ndarray, areas: np.ndarray, size: float = 0.0
) -> tuple[float, float]:
    """Height of the largest level plane in the lower half, and the fraction of all area in it.

    heights (N,), level (N,) bool: the normal is about vertical, areas (N,). A plane is thin by the range of the
    heights, or by the `size` of the scene if that is larger: the range of a bare floor's is no more than its roughness.
    """
    low, high = _span(heights, areas)
    step = max(high - low, size, 1e-6) / HEIGHT_BINS
    bins = np.floor((heights - low) / step).clip(-1, HEIGHT_BINS).astype(int) + 1
    weight = np.bincount(bins[level], areas[level], HEIGHT_BINS + 2)
    smooth = np.convolve(weight, np.ones(5), "same")
    first = int(smooth[: max(round(FLOOR_HEIGHT_MAX * (high - low) / step), 1)].argmax())
    near = level & (np.abs(bins - first) <= 4)
    if not areas[near].sum():
        return float(low), 0.0
    floor = np.percentile(heights[near], 50, weights=areas[near], method="inverted_cdf")
    return float(floor), float(smooth[first] / areas.sum())


def _span(heights: np.ndarray, areas: np.ndarray) -> np.ndarray:
    """The heights (2,) between which all but 0.2 % of the area lies on either side."""
    if not areas.any():  # discs too small to have an area
        return np.repeat(heights.min(), 2)
    return np.percentile(heights, (0.2, 99.8), weights=areas, method="inverted_cdf")


def largest_level_plane(heights: np.ndarray, level: np.ndarray, areas: np.ndarray, size: float) -> tuple[float, float]:
    """As `lowest_level_plane`, of all heights: the halves of the range are searched one after the other."""
    lower, upper = (lowest_level_plane(sign * heights, level, areas, size) for sign in (1, -1))
    return lower if lower[1] >= upper[1] else (-upper[0], upper[1])


def fit_level_plane(
    points: np.ndarray, normals: np.ndarray, areas: np.ndarray, height: float, up: np.ndarray
) -> tuple[float, np.ndarray]:
    """Height and unit normal (3,) of the plane through the level points near a height along `up` (3,).

    Least squares are repeated over ever nearer points (N, 3), whose normals (N, 3) lie along the plane's.
    """
    limit = 0.02 * np.ptp(_span(points @ up, areas))
    for _ in range(8):
        off = points @ up - height
        own = (np.abs(off) < limit) & (np.abs(normals @ up) > LEVEL_COS)
        if own.sum() < 10:
            break
        centre, up = fit_plane(points[own], areas[own], up)
        height = float(centre @ up)
        spread = np.sqrt(np.average(((points[own] - centre) @ up) ** 2, weights=areas[own]))
        limit = max(2.5 * spread, 0.3 * limit)
    return height, up
