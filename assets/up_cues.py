"""Cues of which axis of a file points up: measures of shape and looks, in [-1, 1] or so, of each of the six axes.

Things stand stably, and on something: the floor, of which a part is in the picture, or an underside that no photograph
shows. Light comes from above. Most things, and all rooms, are alike left and right but not above and below. Floors,
ceilings, tables and seats are level.
"""

from __future__ import annotations

import numpy as np

from assets.gaussians import Gaussians
from assets.level_planes import (
    AXES,
    axis_name,
    hollow_columns,
    normals_and_areas,
    refine_direction,
)
from assets.up_axis import robust_bounds
from core.rotation import rotation_between
from core.spherical_harmonics import C0

SAMPLE = 8000  # Gaussians that are looked at
CORE_RADIUS = 4.0  # median distances from the middle: a backdrop lies farther
LEAN_MAX = np.cos(np.radians(25.0))  # of level planes against the file's axis; beyond, they are other planes
LEVEL = np.cos(np.radians(20.0))  # least cosine of normals of level surfaces to the vertical
SHARP = np.cos(np.radians(8.0))  # of very level ones
VIEW_PIXELS = 64  # on the longest side of the six views
LUMA = np.array([0.299, 0.587, 0.114])  # BT.601
FOOT_HEIGHT = 0.05  # of the extent: the part that the object stands on
LAYER_THICKNESS = 0.06  # of the extent: surfaces this close, seen from above and below, are one layer
MAP_CELLS = 24  # on the longest side of the maps of what stands where
MIRROR_CELLS = 20  # on the longest side of the grid in which mirror images are compared
MIRROR_PLANES = 8  # vertical planes that are tried
RESTING_POINTS = 2000  # that are looked at for poses of rest
NEAR, AROUND = np.cos(np.radians(25.0)), np.cos(np.radians([35.0, 50.0]))  # of a pose of rest: its lean, and its rim


def sphere_directions(count: int) -> np.ndarray:
    """Unit vectors (count, 3) spread evenly (Fibonacci lattice)."""
    k = np.arange(count) + 0.5
    z, a = 1 - 2 * k / count, np.pi * (1 + 5**0.5) * k
    r = np.sqrt(1 - z * z)
    return np.stack([r * np.cos(a), r * np.sin(a), z], 1)


DIRECTIONS = sphere_directions(600)


def outermost_points(points: np.ndarray, axis: int, low: np.ndarray, longest: float) -> tuple[np.ndarray, np.ndarray]:
    """Index of the lowest and of the highest point along `axis` in each column that holds any, (C,) each."""
    others = [i for i in range(3) if i != axis]
    pixel = np.floor((points[:, others] - low[others]) / longest * VIEW_PIXELS).astype(np.int64)
    flat = pixel[:, 0] * (4 * VIEW_PIXELS) + pixel[:, 1]
    order = np.lexsort([points[:, axis], flat])
    edge = np.flatnonzero(np.diff(flat[order])) + 1
    return order[np.r_[0, edge]], order[np.r_[edge - 1, len(order) - 1]]


def surface_centre(points: np.ndarray, longest: float) -> np.ndarray:
    """Centre (3,) of the surface that points (N, 3) lie on, independent of their density."""
    cell = np.floor(points / longest * VIEW_PIXELS).clip(-(1 << 20), (1 << 20) - 1).astype(np.int64) + (1 << 20)
    key = np.sort(cell[:, 0] << 42 | cell[:, 1] << 21 | cell[:, 2])  # faster than rows
    key = key[np.flatnonzero(np.diff(key, prepend=-1))]
    cells = np.stack([key >> 42, key >> 21 & (1 << 21) - 1, key & (1 << 21) - 1], 1) - (1 << 20)
    return cells.mean(0) * longest / VIEW_PIXELS


def resting_heights(points: np.ndarray) -> tuple[np.ndarray, float]:
    """Height (D,) of the surface's centre over the lowest point with each of the directions (D, 3) upwards, and the
    extent. A pose in which a thing rests is a minimum of it (Goldberg et al. 1999)."""
    low, high = robust_bounds(points)
    longest = float((high - low).max())
    some = points[:: max(1, len(points) // RESTING_POINTS)]
    k = int(0.005 * len(some))
    lowest = np.partition(DIRECTIONS @ some.T, k, axis=1)[:, k]
    return DIRECTIONS @ surface_centre(points, longest) - lowest, longest


def up_cues(gaussians: Gaussians) -> dict[str, dict[str, float]]:
    """Cues for each axis, "+x" to "-z", to point up, by name.

    bright           how much brighter the topmost Gaussians are than the undermost
    open             how high those columns lie that hold a single layer: an underside is missing
    low              how low the middle of the surface lies
    foot             how much wider the lowest slice is than the highest
    stable           how far the centre must rise, in extents, for the thing to tip out of the nearest pose of rest
    unlike           how little it resembles its image mirrored at a level plane
    askew            how little it resembles its images mirrored at upright planes
    shelves, sharp   share of the surface that is level between its ends, and that is very level
    """
    some = gaussians.select(np.arange(0, len(gaussians), max(1, -(-len(gaussians) // SAMPLE))))
    core = core_of(some)
    points = core.means.astype(np.float64)
    normals, areas = normals_and_areas(core)
    areas = np.minimum(areas, np.percentile(areas, 99.0))
    areas /= max(areas.sum(), 1e-30)
    luma = np.clip(0.5 + C0 * core.sh[:, 0], 0, 1) @ LUMA
    heights, longest = resting_heights(points)
    found = {}
    for axis in range(3):
        along = np.eye(3)[axis]
        direction = refine_direction(along, normals, areas)
        turn = rotation_between(direction if direction @ along > LEAN_MAX else along, (0.0, 1.0, 0.0))
        level = np.abs(normals @ turn[1])
        odd, even = _cues_along(points @ turn.T, level, areas, luma)
        for sign in (1, -1):
            up = axis_name(axis, sign)
            found[up] = {name: sign * value for name, value in odd.items()} | even
            found[up]["stable"] = _stability(sign * along, heights, longest)
    return {up: found[up] for up in AXES}


def _stability(up: np.ndarray, heights: np.ndarray, longest: float) -> float:
    """Height by which the centre must rise to leave the pose of rest nearest to `up` (3,), in its extents.

    -0.2 to 0.2, negative where it falls by itself. So it does not matter how the frame leans.
    """
    cosine = DIRECTIONS @ up
    rim = heights[(cosine < AROUND[0]) & (cosine > AROUND[1])].min()
    return float(np.clip((rim - heights[cosine > NEAR].min()) / longest, -0.2, 0.2))


def core_of(gaussians: Gaussians) -> Gaussians:
    """The more opaque Gaussians, without a far backdrop."""
    g = gaussians.select(gaussians.opacities >= min(0.3, np.median(gaussians.opacities)))
    away = np.linalg.norm(g.means - np.median(g.means, axis=0), axis=1)
    near = away <= CORE_RADIUS * np.median(away)
    return g.select(near)


def _cues_along(p, level, areas, luma) -> tuple[dict[str, float], dict[str, float]]:
    """Cues of +y to point up: those that change sign for -y, and those that are the same.

    p (N, 3);   level (N,) cosine of normals to the vertical;   areas (N,), their sum is 1
    """
    low, high = robust_bounds(p)
    longest, extent = (high - low).max(), max(high[1] - low[1], 1e-12)
    h = (2 * (p[:, 1] - low[1]) / extent - 1).clip(-1, 1)  # -1 bottom, 1 top
    below, above = outermost_points(p, 1, low, longest)
    single = p[above, 1] - p[below, 1] < LAYER_THICKNESS * longest
    hollow = [hollow_columns(p, p[hit], 1, sign, longest) for sign, hit in ((1, above), (-1, below))]
    single &= ~(hollow[0] | hollow[1])  # a cup's floor is a single layer where its underside is missing
    slab = min(2 * FOOT_HEIGHT * longest / extent, 0.5)  # in units of h
    flat = level > LEVEL
    cell = np.floor((p[:, [0, 2]] - low[[0, 2]]) / longest * MAP_CELLS).astype(int).clip(-1, MAP_CELLS + 1)

    def seen(mask: np.ndarray) -> np.ndarray:
        grid = np.zeros((MAP_CELLS + 3, MAP_CELLS + 3), bool)
        grid[tuple(cell[mask].T)] = True
        return grid

    whole = max(seen(np.ones(len(p), bool)).sum(), 1)
    foot = [seen(s * h < slab - 1).sum() / whole for s in (1, -1)]
    centre = surface_centre(p, longest)
    odd = {
        "bright": luma[above].mean() - luma[below].mean(),
        "open": (single * (h[below] + h[above]) / 2).mean(),
        "low": -(2 * (centre[1] - low[1]) / extent - 1),
        "foot": foot[0] - foot[1],
    }
    unlike, askew = _mirror_images(p, low, longest)
    even = {
        "unlike": unlike,
        "askew": askew,
        "shelves": areas[flat & (np.abs(h) < 1 - 2 * slab)].sum(),
        "sharp": areas[level > SHARP].sum(),
    }
    return ({k: float(v) for k, v in odd.items()}, {k: float(v) for k, v in even.items()})


def _mirror_images(p: np.ndarray, low: np.ndarray, longest: float) -> tuple[float, float]:
    """Share of the points (N, 3) whose mirror image in the level plane through the middle is no point's neighbour; and
    the mean of that over vertical planes."""
    cells = np.floor((p - low) / longest * MIRROR_CELLS).astype(int)
    within = ((cells >= 0) & (cells <= MIRROR_CELLS)).all(1)
    filled = np.zeros((MIRROR_CELLS + 3,) * 3, bool)  # with a border
    filled[tuple((cells[within] + 1).T)] = True
    some = (np.argwhere(filled[1:-1, 1:-1, 1:-1]) + 0.5) / MIRROR_CELLS * longest + low
    near = filled.copy()
    for axis in range(3):
        near |= np.roll(filled, 1, axis) | np.roll(filled, -1, axis)
    middle = some.mean(0)

    def missing(normal) -> float:
        image = some - 2 * ((some - middle) @ normal)[:, None] * normal
        at = np.floor((image - low) / longest * MIRROR_CELLS).astype(int) + 1
        inside = ((at >= 0) & (at < len(near))).all(1)
        hit = np.zeros(len(some), bool)
        hit[inside] = near[tuple(at[inside].T)]
        return 1.0 - hit.mean()

    angles = np.pi / MIRROR_PLANES * np.arange(MIRROR_PLANES)
    askew = [missing(np.array([np.cos(a), 0.0, np.sin(a)])) for a in angles]
    return missing(np.array([0.0, 1.0, 0.0])), float(np.mean(askew))
