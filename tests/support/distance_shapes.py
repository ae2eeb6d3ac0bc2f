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


def ellipsoid(p, centre, radii):
    """Not a distance, but zero on the ellipsoid and of slope about one there."""
    q, r = p - np.asarray(centre), np.asarray(radii)
    k0, k1 = np.linalg.norm(q / r, axis=-1), np.linalg.norm(q / r**2, axis=-1)
    return k0 * (k0 - 1) / np.maximum(k1, 1e-9)


def ball(p):
    """24 cm across."""
    return sphere(p, radius=0.12)


def mug(p):
    """12 cm high, with walls of 1 cm and a handle."""
    r, y = np.hypot(p[..., 0], p[..., 2]), p[..., 1]
    outer = np.maximum(r - 0.045, np.abs(y) - 0.06)
    inner = np.maximum(r - 0.035, -0.048 - y)
    handle = np.maximum(torus((p - [0.052, 0.0, 0.0])[..., [0, 2, 1]], 0.03, 0.007), 0.04 - r)
    return np.minimum(np.maximum(outer, -inner), handle)


def ring(p):
    """A thin ring that lies on a board of 22 cm."""
    return np.minimum(torus(p - [0.0, 0.0145, 0.0], 0.07, 0.005), box(p, (0.11, 0.01, 0.11)))


def bunny(p):
    """A rabbit of 28 cm with thin ears."""
    body = np.minimum(ellipsoid(p, (0, 0, 0), (0.08, 0.075, 0.07)), ellipsoid(p, (0.05, 0.08, 0), (0.045,) * 3))
    ears = [ellipsoid(p, (0.04, 0.15, side * 0.025), (0.014, 0.055, 0.005)) for side in (-1, 1)]
    return np.minimum(body, np.minimum(*ears))


def capsule(p):
    """A slanted one of 10 cm by 24 cm."""
    a, b = np.array([-0.07, 0.0, 0.0]), np.array([0.07, 0.03, 0.0])
    t = np.clip((p - a) @ (b - a) / ((b - a) @ (b - a)), 0, 1)
    return np.linalg.norm(p - a - t[..., None] * (b - a), axis=-1) - 0.05


SHAPES = {  # signed distance, and half the side of a cube about the origin that holds the shape [m]
    "ball": (ball, 0.13),
    "mug": (mug, 0.1),
    "ring": (ring, 0.12),
    "bunny": (bunny, 0.22),
    "capsule": (capsule, 0.13),
}


def uniform_lattice(distance: DistanceGrid, cell: float) -> Lattice:
    """BCC lattice with cubes of width `cell` [m] around the region where a signed distance is negative."""
    solid = np.argwhere(distance.values < 0)
    origin, spacing = distance.origin, distance.spacing
    low, high = origin + spacing * (solid.min(0) - 1), origin + spacing * (solid.max(0) + 1)
    n = np.ceil((high - low) / cell).astype(int) + 3  # cells; one spare on each side
    return graded_lattice(np.broadcast_to(np.int8(0), n), 0, origin=(low + high) / 2 - n * cell / 2, unit=cell / 2)
