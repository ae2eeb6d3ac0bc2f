"""Which way is up, by shape: floor and ceiling are a pair of parallel planes, furniture is level; a cup is open above.

Normals are those of the Gaussians' discs and have no sign.
"""

from __future__ import annotations

import numpy as np

from assets.gaussians import Gaussians
from core.rotation import matrices_from_quaternions

NARROWING = np.cos(np.radians([35, 25, 16, 10, 6, 4, 4]))  # how far normals may lean from an axis, ever less
LEVEL_COS = np.cos(np.radians(25.0))  # a Gaussian's normal may lean so far and still belong to a level plane
BINS = 300  # of the scene's height, for the search of the floor
LOWER = 0.45  # of the scene's height, in which the floor is: above are tables and the ceiling
BELOW = 2.0  # weight of what lies under a floor: nothing should
OTHER = 0.3  # weight of the smaller plane of a pair: a ceiling may be missing, or not seen
FURNITURE = 1.5  # weight of what is level between the two
HEAVY = 0.5  # weight of what is level between floor and ceiling and lies in the lower half


def normals_and_areas(g: Gaussians) -> tuple[np.ndarray, np.ndarray]:
    """Shortest axis (N, 3) of each Gaussian and the area pi s1 s2 of its disc (N,)."""
    scales = np.exp(g.log_scales.astype(np.float64))
    order = np.argsort(scales, 1)
    axes = matrices_from_quaternions(g.quats)
    n = np.take_along_axis(axes, order[:, None, :1], 2)[..., 0]
    s = np.take_along_axis(scales, order, 1)
    return n, np.pi * s[:, 1] * s[:, 2]


def refine_direction(axis: np.ndarray, normals: np.ndarray, areas: np.ndarray) -> np.ndarray:
    """The direction near `axis` (3,) about which the most area has its normals; their signs do not count."""
    for least in NARROWING:
        mine = np.abs(normals @ axis) > least
        if areas[mine].sum() <= 0:
            return axis
        n = normals[mine]
        found = np.linalg.eigh((areas[mine, None] * n).T @ n)[1][:, -1]
        axis = found * np.sign(found @ axis)
    return axis


def floor_of(heights: np.ndarray, level: np.ndarray, areas: np.ndarray) -> tuple[float, float, float]:
    """Height of the largest level plane in the lower half, its share of all area, and the share below it.

    heights (N,), level (N,) bool: whether the normal is about vertical, areas (N,).
    """
    low, high = weighted_percentile(heights, areas, (0.2, 99.8))
    step = max((high - low) / BINS, 1e-9)
    bins = np.floor((heights - low) / step).clip(-1, BINS).astype(int) + 1
    weight = np.bincount(bins[level], areas[level], BINS + 2)
    smooth = np.convolve(weight, np.ones(5), "same")
    first = int(smooth[: round(LOWER * BINS)].argmax())
    near = level & (np.abs(bins - first) <= 4)
    if not areas[near].sum():
        return float(low), 0.0, 0.0
    floor = weighted_percentile(heights[near], areas[near], (50,))[0]
    below = areas[heights < floor - 6 * step].sum() / areas.sum()
    return float(floor), float(smooth[first] / areas.sum()), float(below)


def weighted_percentile(values: np.ndarray, weights: np.ndarray, percents) -> np.ndarray:
    """Percentiles (K,) of values (N,) that count by their weights (N,)."""
    order = np.argsort(values, kind="stable")
    total = weights[order].cumsum()
    at = np.searchsorted(total, np.asarray(percents) / 100 * total[-1])
    return values[order][at.clip(0, len(values) - 1)]


def plane_votes(points: np.ndarray, normals: np.ndarray, areas: np.ndarray) -> dict[str, float]:
    """How much speaks for each axis of the file, "+x" to "-z", to point up in a scene; larger is more likely.

    The vertical is the axis with the largest planes at its ends, of which a missing ceiling leaves one, and with the
    most level area between them: tables and seats are level, what stands on a wall is not. Of its two ends the floor is
    that with the larger plane, with nothing behind it, and with the furniture.

    points (N, 3) in the file's frame, normals (N, 3) of any sign, areas (N,) weights
    """
    votes = {}
    for axis in range(3):
        direction = refine_direction(np.eye(3)[axis], normals, areas)
        heights, level = points @ direction, np.abs(normals @ direction) > LEVEL_COS
        ends = [floor_of(sign * heights, level, areas) for sign in (1, -1)]
        low, high = ends[0][0], -ends[1][0]
        clear = 0.04 * max(high - low, 1e-9)
        between = level & (heights > low + clear) & (heights < high - clear)
        share = areas[between].sum() / areas.sum()
        at = (areas[between] @ (heights[between] - low)) / max((high - low) * areas[between].sum(), 1e-12)
        planes = sorted(max(0.0, e[1] - BELOW * e[2]) for e in ends)
        upright = planes[1] + OTHER * planes[0] + FURNITURE * share
        for sign, (_, plane, below) in zip((1, -1), ends, strict=True):
            middle = at if sign > 0 else 1 - at
            floor = plane - BELOW * below + HEAVY * (0.5 - middle) * bool(between.any())
            votes[f"{'+' if sign > 0 else '-'}{'xyz'[axis]}"] = upright, floor
    # The axis first, then its end: an end's vote decides between the two of one axis alone.
    best = {k[1]: max(votes[f"+{k[1]}"][1], votes[f"-{k[1]}"][1]) for k in votes}
    return {k: upright + min(0.0, floor - best[k[1]]) for k, (upright, floor) in votes.items()}


CORE = 4.0  # times the median distance from the middle: a backdrop lies farther
MAP = 16, 48  # columns on the longer side of the map of a floor: so many that each holds
HELD = 30  # points
COVERED = 0.7  # of what a scene stands on is floor, seen or under furniture
CONTENT = 0.03, 0.8  # least and most share of the map's inner part over which something stands


def scene_votes(g: Gaussians) -> dict[str, float] | None:
    """`plane_votes` of a room, a garden, a thing on a ground plate; None for a body by itself.

    A scene has a plane under nearly all of it, and things between that and its upper end, away from the walls: a box or
    a cup has nothing inside.
    """
    points = g.means.astype(np.float64)
    middle = np.median(points, axis=0)
    away = np.linalg.norm(points - middle, axis=1)
    core = (away < CORE * np.median(away)) & (g.opacities > 0.3)
    if core.sum() < 100:
        return None
    points = points[core]
    normals, areas = normals_and_areas(g.select(core))
    votes = plane_votes(points, normals, np.minimum(areas, np.percentile(areas, 99)))
    up = max(votes, key=votes.get)
    direction = refine_direction(np.eye(3)["xyz".index(up[1])] * (1 if up[0] == "+" else -1), normals, areas)
    heights = points @ direction
    low, high = np.percentile(heights, [1, 99])
    slab = 0.06 * (high - low)
    across = np.linalg.svd(direction[None])[2][1:]  # two directions in the plane
    flat = points @ across.T
    side = int(np.clip(np.sqrt(len(points) / HELD), *MAP))
    corner, end = np.percentile(flat, [0.5, 99.5], axis=0)
    column = np.floor((flat - corner) / max((end - corner).max(), 1e-12) * side).astype(int)
    within = ((column >= 0) & (column <= side)).all(1)

    def seen(mask: np.ndarray) -> np.ndarray:
        grid = np.zeros((side + 1, side + 1), bool)
        grid[tuple(column[within & mask].T)] = True
        return grid

    under, all_of_it = seen(heights < low + slab), seen(np.ones(len(points), bool))
    inner = all_of_it.copy()
    for _ in range(side // 12):  # columns from the rim: walls lean, and are thick
        inner[1:-1, 1:-1] &= inner[:-2, 1:-1] & inner[2:, 1:-1] & inner[1:-1, :-2] & inner[1:-1, 2:]
        inner[[0, -1]] = inner[:, [0, -1]] = False
    between = seen((heights > low + 2 * slab) & (heights < high - 2 * slab)) & inner
    content = between.sum() / max(inner.sum(), 1)
    return votes if under.sum() > COVERED * all_of_it.sum() and CONTENT[0] < content < CONTENT[1] else None


DEEP = 0.2  # of the extent: so far under its rim a hollow is one
SECTORS, SLABS = 24, 6  # in which its wall is looked at
GAP = 0.025  # of the extent, between the inner and the outer face of a wall


def hollow_columns(points: np.ndarray, top: np.ndarray, axis: int, sign: int, longest: float) -> np.ndarray:
    """Mask (C,) of the columns over a hollow that was looked into along an axis: a cup's inside.

    Its wall has two faces. A body whose underside nobody saw is hollow from below, too, but its wall has one.

    points (N, 3); top (C, 3) the first point of each column as seen from the end `sign` of `axis`
    """
    others = [i for i in range(3) if i != axis]
    height, rim = sign * top[:, axis], np.percentile(sign * top[:, axis], 95)
    deep = height < rim - DEEP * longest
    none = np.zeros(len(top), bool)
    if deep.mean() < 0.05:
        return none
    centre, floor = np.median(top[deep][:, others], axis=0), np.median(height[deep])
    away = points[:, others] - centre
    sector = ((np.arctan2(*away.T) / (2 * np.pi) + 0.5) * SECTORS).astype(int).clip(0, SECTORS - 1)
    slab = np.floor(((sign * points[:, axis] - floor) / (rim - floor) - 0.2) / 0.7 * SLABS).astype(int)
    r = np.hypot(*away.T)
    inside = (slab >= 0) & (slab < SLABS)
    order = np.lexsort([r[inside], sector[inside] * SLABS + slab[inside]])
    place, r = (sector[inside] * SLABS + slab[inside])[order], r[inside][order]
    double = 0
    for k in range(SECTORS * SLABS):
        own = r[np.searchsorted(place, k) : np.searchsorted(place, k, side="right")]
        wide = np.flatnonzero(np.diff(own) > GAP * longest)
        double += any(0.2 * len(own) <= i + 1 <= 0.8 * len(own) for i in wide)
    return deep if double > 0.6 * SECTORS * SLABS else none
