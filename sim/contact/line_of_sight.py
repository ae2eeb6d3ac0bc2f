"""Line of sight among static shapes, on the host: what hides a point from an eye, and what lies below a point."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from core.rotation import matrices_from_quaternions
from core.vocabulary import Box, Capsule, Plane
from sim.contact.static_shapes import Shape, grid_box

STEP, MAX_STEPS = 0.005, 300  # [m] between the points of a line that are looked at; longer lines have longer steps
TOLERANCE, GRID_TOLERANCE = 0.004, 0.35  # [m] and [voxels] under a surface that hide nothing: shapes are not exact
MAX_FALL = 2.0  # [m] below a point in which its ground is looked for
GROUND_RADIUS, GROUND_ANGLES = 0.25, np.arange(9) * (2 * np.pi / 9)  # [m], [rad] of the places around it


class LineOfSight:
    """Static shapes as obstacles to sight."""

    def __init__(self, shapes: Sequence[Shape]):
        self._shapes = list(shapes)
        bounds = [bounding_box(shape) for shape in self._shapes]
        self._low = np.array([low for low, _ in bounds]).reshape(-1, 3)
        self._high = np.array([high for _, high in bounds]).reshape(-1, 3)

    def hides(self, origin, direction, distance: float) -> bool:
        """True if an obstacle lies between an eye and a point at `distance` [m] along a ray.

        What the eye itself is in does not count.
        """
        origin, direction = np.asarray(origin, np.float64), np.asarray(direction, np.float64)
        points = line(origin, origin + distance * direction / np.linalg.norm(direction))
        inside = self._inside(points)
        if inside.all():
            return False
        return bool(inside[np.argmin(inside) :].any())

    def ground(self, point) -> float | None:
        """Height [m] of what lies below a point, table or floor; None if nothing is near.

        It is that below most places around: what stands there, and may be what one looks at, is no ground.
        """
        x, y, z = np.asarray(point, np.float64)
        around = [(x + GROUND_RADIUS * np.cos(a), y, z + GROUND_RADIUS * np.sin(a)) for a in GROUND_ANGLES]
        lines = np.stack([line(np.array(p), np.subtract(p, [0.0, MAX_FALL, 0.0])) for p in around])
        inside = self._inside(lines.reshape(-1, 3)).reshape(lines.shape[:2])
        hit = inside.any(1) & ~inside[:, 0]
        heights = lines[0, np.argmax(inside[hit], axis=1), 1]
        return float(np.median(heights)) if len(heights) else None

    def _inside(self, points: np.ndarray) -> np.ndarray:
        """Mask of the points (N, 3) that are under a surface by more than the tolerance, (N,) bool."""
        low, high = points.min(0), points.max(0)
        inside = np.zeros(len(points), bool)
        for k in np.flatnonzero(((self._low <= high) & (self._high >= low)).all(1)):
            inside |= within(self._shapes[k], points)
        return inside


def line(start: np.ndarray, end: np.ndarray) -> np.ndarray:
    """Points (N, 3) from start to end."""
    count = min(int(np.linalg.norm(end - start) / STEP) + 2, MAX_STEPS)
    return start + np.linspace(0.0, 1.0, count)[:, None] * (end - start)


def bounding_box(shape: Shape) -> tuple[np.ndarray, np.ndarray]:
    """Corners of a box around a shape [m]; infinite of a plane."""
    if isinstance(shape, Plane):
        return np.full(3, -np.inf), np.full(3, np.inf)
    if isinstance(shape, Capsule):
        return np.minimum(shape.a, shape.b) - shape.radius, np.maximum(shape.a, shape.b) + shape.radius
    if isinstance(shape, Box):
        return np.subtract(shape.center, shape.half_size), np.add(shape.center, shape.half_size)
    return grid_box(shape, matrices_from_quaternions(np.asarray(shape.rotation, np.float64)[None])[0])


def within(shape: Shape, points: np.ndarray) -> np.ndarray:
    """Mask of the points (N, 3) under the surface of a shape by more than its tolerance, (N,) bool."""
    if isinstance(shape, Plane):
        normal = np.asarray(shape.normal, np.float64)
        return (points - shape.point) @ (normal / np.linalg.norm(normal)) < -TOLERANCE
    if isinstance(shape, Capsule):
        axis = np.subtract(shape.b, shape.a)
        along = np.clip((points - shape.a) @ axis / max(axis @ axis, 1e-12), 0.0, 1.0)
        return np.linalg.norm(points - shape.a - along[:, None] * axis, axis=1) < shape.radius - TOLERANCE
    if isinstance(shape, Box):
        return (np.abs(points - shape.center) < np.asarray(shape.half_size) - TOLERANCE).all(1)
    rotation = matrices_from_quaternions(np.asarray(shape.rotation, np.float64)[None])[0]
    local = (points - shape.position) @ rotation / shape.scale
    grid, result = shape.grid, np.zeros(len(points), bool)
    known = ((local >= grid.origin) & (local <= grid.upper)).all(1)
    tolerance = max(TOLERANCE / shape.scale, GRID_TOLERANCE * grid.spacing)
    result[known] = interpolate(grid, local[known]) < -tolerance
    return result


def interpolate(grid, points: np.ndarray) -> np.ndarray:
    """Trilinear distance [m] at points (N, 3) within a grid, which reads the cells that they are in alone."""
    cells = (points - grid.origin) / grid.spacing
    first = np.minimum(cells.astype(np.int64), np.array(grid.shape) - 2)
    f = cells - first
    total = np.zeros(len(points))
    for corner in np.ndindex(2, 2, 2):
        weight = np.prod(np.where(corner, f, 1.0 - f), axis=1)
        total += weight * grid.values[tuple((first + corner).T)]
    return total
