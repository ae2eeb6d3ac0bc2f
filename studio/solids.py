"""Exact signed distances [m] to simple solids, negative inside: the collision geometry of modelled assets."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise

import numpy as np

from core.distance_grid import DistanceGrid

Solid = Callable[[np.ndarray], np.ndarray]  # points (N, 3) -> signed distances (N,)


def sphere(centre, radius: float) -> Solid:
    """Sphere."""
    return lambda p: np.linalg.norm(p - np.asarray(centre), axis=1) - radius


def cuboid(low, high) -> Solid:
    """Axis-aligned box between two corners."""
    middle, half = 0.5 * (np.asarray(low) + high), 0.5 * (np.asarray(high) - low)

    def distance(p):
        q = np.abs(p - middle) - half
        return np.linalg.norm(np.maximum(q, 0), axis=1) + np.minimum(q.max(1), 0)

    return distance


def torus(major: float, tube: float) -> Solid:
    """Torus about the y axis."""
    return lambda p: np.hypot(np.hypot(p[:, 0], p[:, 2]) - major, p[:, 1]) - tube


def revolved(profile) -> Solid:
    """Solid of revolution about y; `profile` (K, 2) of (radius, y) runs from bottom to top."""
    profile = np.asarray(profile, float)
    profile = np.concatenate([[(0.0, profile[0, 1])], profile, [(0.0, profile[-1, 1])]])

    def distance(p):
        q = np.stack([np.hypot(p[:, 0], p[:, 2]), p[:, 1]], 1)
        nearest, inside = np.full(len(q), np.inf), np.zeros(len(q), bool)
        for a, b in pairwise(profile):
            d = b - a
            t = (((q - a) @ d) / max(d @ d, 1e-20)).clip(0, 1)
            if a[0] > 0 or b[0] > 0:  # the segment on the axis itself is no surface
                nearest = np.minimum(nearest, np.linalg.norm(q - a - t[:, None] * d, axis=1))
            crosses = (a[1] > q[:, 1]) != (b[1] > q[:, 1])
            with np.errstate(divide="ignore", invalid="ignore"):
                inside ^= crosses & (q[:, 0] < a[0] + (q[:, 1] - a[1]) / d[1] * d[0])
        return np.where(inside, -nearest, nearest)

    return distance


def placed(solid: Solid, rotation=None, position=(0.0, 0.0, 0.0)) -> Solid:
    """The solid after x -> rotation @ x + position."""
    rotation = np.eye(3) if rotation is None else np.asarray(rotation)
    return lambda p: solid((p - np.asarray(position)) @ rotation)


def sample_distance_grid(solids: list[Solid], low, high, spacing: float) -> DistanceGrid:
    """Signed distance to the union of solids at grid nodes from `low` to at least `high`, float16."""
    low = np.asarray(low, float)
    count = np.ceil((np.asarray(high) - low) / spacing - 1e-6).astype(int) + 1
    nodes = low + spacing * np.stack(np.meshgrid(*(np.arange(n) for n in count), indexing="ij"), -1).reshape(-1, 3)
    values = np.min([s(nodes) for s in solids], axis=0).reshape(count)
    return DistanceGrid(values.astype(np.float16), low, float(spacing))
