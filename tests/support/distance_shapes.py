"""Signed distances of shapes given by formulas, on points (..., 3), and their grids."""

import numpy as np

from core.distance_grid import DistanceGrid
from prepare.cage.stuffing import Lattice, graded_lattice


def sampled(distance, half_size: float = 2.3, spacing: float = 0.05) -> DistanceGrid:
    """A distance function on the nodes of a cube around the origin."""
    axis = np.arange(-half_size, half_size + spacing / 2, spacing)
    points = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), -1)
    return DistanceGrid(distance(points), np.full(3, -half_size), spacing)


def sphere(p, centre=(0, 0, 0), radius=1.0):
    return np.linalg.norm(p - np.asarray(centre), axis=-1) - radius


def torus(p, major=1.0, minor=0.25):
    return np.hypot(np.hypot(p[..., 0], p[..., 2]) - major, p[..., 1]) - minor


def box(p, half_size):
    q = np.abs(p) - half_size
    return np.linalg.norm(np.maximum(q, 0), axis=-1) + np.minimum(q.max(-1), 0)


def bumpy(p, seed):
    """A rough ball with handles and pinches."""
    rng = np.random.default_rng(seed)
    waves = sum(np.sin(p @ rng.normal(size=3) * 2.5 + rng.uniform(0, 6)) for _ in range(6))
    return np.maximum(0.2 * waves, sphere(p, radius=1.6))


def uniform_lattice(distance: DistanceGrid, cell: float) -> Lattice:
    """BCC lattice with cubes of width `cell` [m] around the region where a signed distance is negative."""
    solid = np.argwhere(distance.values < 0)
    origin, spacing = distance.origin, distance.spacing
    low, high = origin + spacing * (solid.min(0) - 1), origin + spacing * (solid.max(0) + 1)
    n = np.ceil((high - low) / cell).astype(int) + 3  # cells; one spare on each side
    return graded_lattice(np.broadcast_to(np.int8(0), n), 0, origin=(low + high) / 2 - n * cell / 2, unit=cell / 2)
