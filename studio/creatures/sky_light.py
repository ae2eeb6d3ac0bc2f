"""Soft daylight on a body: sky, a brighter spot in it, light from the ground, and what the body hides of them."""

from __future__ import annotations

import numpy as np

from core.distance_grid import DistanceGrid
from core.program import batches, in_threads
from studio.creatures.implicit import unit

NODES = 72  # of the distance grid on the longest side
DIRECTIONS = 24
STEPS = 5  # along each direction
REACH = (0.02, 0.5)  # first and last step over the body's extent
CONE = 2.5  # distance over path below which a direction counts as hidden in part: cones of about 45 degrees
KEY, KEY_STRENGTH = (0.35, 0.8, 0.5), 0.9  # direction and radiance of the bright spot
BATCH = 16384  # points at a time in each thread


def distance_grid(distance, low, high) -> DistanceGrid:
    """Grid of a function that gives signed distances (N,) at points (N, 3), over the box [m]."""
    low, high = np.asarray(low, float), np.asarray(high, float)
    spacing = float((high - low).max()) / (NODES - 1)
    shape = np.ceil((high - low) / spacing).astype(int) + 1
    grid = DistanceGrid(np.zeros(shape, np.float32), low, spacing)
    points = grid.nodes().reshape(-1, 3)
    return DistanceGrid(distance(points).reshape(shape).astype(np.float32), low, spacing)


def irradiance(grid: DistanceGrid, points: np.ndarray, normals: np.ndarray, from_below: float) -> np.ndarray:
    """Light (N,) at points of the body in `grid`; 1 where a face looks up and nothing hides the sky.

    from_below  radiance of the ground over that of the sky
    """
    i = np.arange(DIRECTIONS) + 0.5  # Fibonacci sphere
    y, a = 1 - 2 * i / DIRECTIONS, np.pi * (1 + 5**0.5) * i
    directions = np.stack([np.sqrt(1 - y * y) * np.cos(a), y, np.sqrt(1 - y * y) * np.sin(a)], 1)
    radiance = from_below + (1 - from_below) * np.clip(0.5 + 0.7 * y, 0, 1)
    radiance += KEY_STRENGTH * (1 - from_below) * np.clip(directions @ unit(np.array(KEY)), 0, 1) ** 6
    upward = np.clip(directions[:, 1], 0, None)
    full = (radiance * upward).sum()
    extent = float((grid.upper - grid.origin).max())
    lengths = extent * np.geomspace(*REACH, STEPS)
    total = np.zeros(len(points))

    def light_up(s: slice) -> None:
        p, n = points[s] + 0.004 * extent * normals[s], normals[s]
        for direction, light in zip(directions, radiance, strict=True):
            facing = np.clip(n @ direction, 0, None)
            front = np.flatnonzero(facing > 0)
            visible = np.ones(len(front))
            for t in lengths:
                clear = grid.sample_extended(p[front] + t * direction)
                visible = np.minimum(visible, np.clip(CONE * clear / t, 0, 1))
            total[s.start + front] += light * facing[front] * visible

    in_threads(light_up, batches(len(points), BATCH))
    return total / full
