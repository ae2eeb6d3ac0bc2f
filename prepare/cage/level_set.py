"""From solid cells to a smooth signed distance: closed pieces without holes (VR-GS, Sec. 4.2)."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import gaussian_filter, label, map_coordinates

from core.distance_grid import DistanceGrid
from core.errors import BadInput
from prepare.cage.distance_transform import distance
from prepare.cage.morphology import within_two

SMOOTHING = 1.2  # cells; hides the staircase of the cells
DRIFT = (-0.6, 0.3)  # cells; how far smoothing may move the surface out and in, so that thin parts survive
GRID_NODES = 56  # of the contact grid on the longest side: half a centimetre on a toy
GRID_MOST = 160  # and on that of several pieces together, however far apart
GRID_MARGIN = 3  # nodes around the shape


def distance_cells(solid: np.ndarray) -> np.ndarray:
    """Signed distance [cells] to the boundary between solid and empty cells, negative inside."""
    inner = distance(~solid, reach=max(solid.shape))  # next to nothing is far inside
    return np.where(solid, 0.5 - inner, distance(solid) - 0.5)


def level_sets(solid: np.ndarray, least: float = 1.0) -> np.ndarray:
    """Signed distance [cells] of each piece of the solid cells, closed and smoothed, (P, X, Y, Z) float32.

    least  pieces with so large a share of the largest one's cells, that first; 1: it alone
    Taichi must be running. Raises BadInput where there is no solid cell.
    """
    if not solid.any():
        raise BadInput("nothing is opaque enough to be solid; there is no surface")
    closed = without_holes(solid | ~within_two(~within_two(solid)))  # dents narrower than 4 cells are noise
    numbers, count = label(closed)
    if count == 1:
        return smoothed(closed)[None]
    sizes = np.bincount(numbers[closed], minlength=count + 1)
    order = np.argsort(-sizes, kind="stable")
    kept = [k for k in order if sizes[k] >= least * sizes[order[0]]] if least < 1 else order[:1]
    return np.stack([smoothed(numbers == k) for k in kept])


def without_holes(solid: np.ndarray) -> np.ndarray:
    """The solid cells, and what they enclose."""
    numbers, count = label(~solid)
    open_ = np.zeros(count + 1, bool)
    for axis in range(3):
        for end in (0, -1):
            open_[np.unique(np.take(numbers, end, axis))] = True
    open_[0] = True  # number 0 are the solid cells
    return solid if open_.all() else solid | ~open_[numbers]


def smoothed(closed: np.ndarray) -> np.ndarray:
    """Signed distance [cells] to the cells `closed`, without their staircase."""
    exact = distance_cells(closed)
    smooth = gaussian_filter(exact, SMOOTHING, mode="nearest")
    return np.clip(smooth, exact + DRIFT[0], exact + DRIFT[1]).astype(np.float32)


def level_set(solid: np.ndarray) -> np.ndarray:
    """Signed distance [cells], (X, Y, Z) float32, of the largest piece of the solid cells, closed and smoothed."""
    return level_sets(solid)[0]


def volume_of(phi: np.ndarray) -> float:
    """Volume [cells] of the shape where the signed distance phi [cells] is negative: nodes near zero count in part."""
    return float((0.5 - phi).clip(0, 1).sum(dtype=np.float64))


def contact_grid(shapes: list[tuple[np.ndarray, np.ndarray, float]]) -> DistanceGrid:
    """The signed distance [m] of all shapes resampled for contact: float16, GRID_NODES on the largest one's side.

    shapes  of each phi [m] (X, Y, Z), origin [m], spacing [m]: node (i, j, k) lies at origin + spacing (i, j, k)
    """
    boxes = []
    for phi, origin, spacing in shapes:
        solid = np.argwhere(phi < 0)
        boxes.append((origin + spacing * (solid.min(0) - 1), origin + spacing * (solid.max(0) + 1)))
    step = max((high - low).max() for low, high in boxes) / (GRID_NODES - 1 - 2 * GRID_MARGIN)
    low, high = np.min([b[0] for b in boxes], axis=0), np.max([b[1] for b in boxes], axis=0)
    step = max(step, (high - low).max() / (GRID_MOST - 1 - 2 * GRID_MARGIN))
    nodes = np.ceil((high - low) / step).astype(int) + 1 + 2 * GRID_MARGIN
    start = (low + high) / 2 - (nodes - 1) * step / 2
    points = start[:, None, None, None] + step * np.indices(nodes)
    values = np.full(nodes, np.inf)
    for phi, origin, spacing in shapes:
        u = (points - origin[:, None, None, None]) / spacing
        inner = u.clip(0, np.array(phi.shape)[:, None, None, None] - 1.0)
        there = map_coordinates(phi, inner, order=1) + spacing * np.linalg.norm(u - inner, axis=0)
        values = np.minimum(values, there)
    return DistanceGrid(values.astype(np.float16), start, float(step))
