"""Level planes and hollows: normals and areas of Gaussians, a floor, columns that open upwards.

Normals are those of the Gaussians' discs and have no sign.
"""

from __future__ import annotations

import numpy as np

from assets.gaussians import Gaussians
from core.rotation import matrices_from_quaternions

# The axes of a file that may point up, by name: "-y", "+y", ... and their directions, (3,).
AXES = {f"{sign}{'xyz'[axis]}": np.eye(3)[axis] * (1 if sign == "+" else -1) for axis in (1, 2, 0) for sign in "-+"}
NARROWING_COS = np.cos(np.radians([35, 25, 16, 10, 6, 4, 4]))  # largest angle of normals to the axis, step by step
LEVEL_COS = np.cos(np.radians(25.0))  # smallest cosine to the vertical of the normals of a level plane
HEIGHT_BINS = 300  # of the histogram in which the floor is searched
FLOOR_HEIGHT_MAX = 0.45  # of the scene's height: above are tables and the ceiling


def axis_name(axis: int, sign: int) -> str:
    """Name of the axis, 0 to 2, that points up with this sign."""
    return f"{'+' if sign > 0 else '-'}{'xyz'[axis]}"


def normals_and_areas(g: Gaussians) -> tuple[np.ndarray, np.ndarray]:
    """Shortest axis (N, 3) of each Gaussian and the area pi s1 s2 of its disc [m^2], (N,)."""
    scales = np.exp(g.log_scales.astype(np.float64))
    order = np.argsort(scales, 1)
    axes = matrices_from_quaternions(g.quats)
    n = np.take_along_axis(axes, order[:, None, :1], 2)[..., 0]
    s = np.take_along_axis(scales, order, 1)
    return n, np.pi * s[:, 1] * s[:, 2]


def refine_direction(axis: np.ndarray, normals: np.ndarray, areas: np.ndarray) -> np.ndarray:
    """Area-weighted mean direction (3,) of the normals near `axis` (3,), whatever their signs."""
    for cosine in NARROWING_COS:
        mine = np.abs(normals @ axis) > cosine
        if areas[mine].sum() <= 0:
            return axis
        n = normals[mine]
        found = np.linalg.eigh((areas[mine, None] * n).T @ n)[1][:, -1]
        axis = found * np.sign(found @ axis)
    return axis


def find_floor_plane(
    heights: np.ndarray, level: np.ndarray, areas: np.ndarray, size: float = 0.0
) -> tuple[float, float, float]:
    """Height of the largest level plane in the lower half, and the fractions of all area in it and below it.

    heights (N,), level (N,) bool: the normal is about vertical, areas (N,). A plane is thin by the range of the
    heights, or by the `size` of the scene if that is larger: the range of a bare floor's is no more than its roughness.
    """
    low, high = weighted_percentile(heights, areas, (0.2, 99.8))
    step = max(high - low, size, 1e-6) / HEIGHT_BINS
    bins = np.floor((heights - low) / step).clip(-1, HEIGHT_BINS).astype(int) + 1
    weight = np.bincount(bins[level], areas[level], HEIGHT_BINS + 2)
    smooth = np.convolve(weight, np.ones(5), "same")
    first = int(smooth[: max(round(FLOOR_HEIGHT_MAX * (high - low) / step), 1)].argmax())
    near = level & (np.abs(bins - first) <= 4)
    if not areas[near].sum():
        return float(low), 0.0, 0.0
    floor = weighted_percentile(heights[near], areas[near], (50,))[0]
    below = areas[heights < floor - 6 * step].sum() / areas.sum()
    return float(floor), float(smooth[first] / areas.sum()), float(below)


def weighted_percentile(values: np.ndarray, weights: np.ndarray, percents) -> np.ndarray:
    """Percentiles (K,) of values (N,) with weights (N,)."""
    order = np.argsort(values, kind="stable")
    total = weights[order].cumsum()
    at = np.searchsorted(total, np.asarray(percents) / 100 * total[-1])
    return values[order][at.clip(0, len(values) - 1)]


HOLLOW_DEPTH = 0.2  # of the extent, from the rim to the bottom
SECTORS, LAYERS = 24, 6  # around and along the axis, in which the wall is examined
WALL_GAP = 0.025  # of the extent, at least, between the inner and the outer face of a wall


def hollow_columns(points: np.ndarray, top: np.ndarray, axis: int, sign: int, longest: float) -> np.ndarray:
    """Mask (C,) of the columns over a hollow that opens along an axis, as the inside of a cup.

    Its wall has two faces. An object whose underside was not captured is hollow from below, too, but its wall has one.

    points (N, 3); top (C, 3) the first point of each column seen from the end `sign` of `axis`
    """
    others = [i for i in range(3) if i != axis]
    height, rim = sign * top[:, axis], np.percentile(sign * top[:, axis], 95)
    deep = height < rim - HOLLOW_DEPTH * longest
    none = np.zeros(len(top), bool)
    if deep.mean() < 0.05:
        return none
    centre, floor = np.median(top[deep][:, others], axis=0), np.median(height[deep])
    away = points[:, others] - centre
    sector = ((np.arctan2(*away.T) / (2 * np.pi) + 0.5) * SECTORS).astype(int).clip(0, SECTORS - 1)
    layer = np.floor(((sign * points[:, axis] - floor) / (rim - floor) - 0.2) / 0.7 * LAYERS).astype(int)
    r = np.hypot(*away.T)
    inside = (layer >= 0) & (layer < LAYERS)
    order = np.lexsort([r[inside], sector[inside] * LAYERS + layer[inside]])
    place, r = (sector[inside] * LAYERS + layer[inside])[order], r[inside][order]
    double_walled = 0
    for k in range(SECTORS * LAYERS):
        own = r[np.searchsorted(place, k) : np.searchsorted(place, k, side="right")]
        wide = np.flatnonzero(np.diff(own) > WALL_GAP * longest)
        double_walled += any(0.2 * len(own) <= i + 1 <= 0.8 * len(own) for i in wide)
    return deep if double_walled > 0.6 * SECTORS * LAYERS else none
