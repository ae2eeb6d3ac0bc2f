"""Blue noise: points on surfaces that are evenly, but not regularly, apart."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree


def blue_noise(points: np.ndarray, normals: np.ndarray, radius: float, taken: tuple | None) -> np.ndarray:
    """Mask of points such that no two on the same side of a sheet are nearer than `radius` [m].

    Points come in random order; a point is kept if it precedes its undecided neighbours and if none of the
    points (with normals) already `taken` is near.
    """
    undecided = np.ones(len(points), bool)
    if taken is not None and len(taken[0]) and len(points):
        near = cKDTree(taken[0]).query(points, k=4, distance_upper_bound=radius)[1]
        there = near < len(taken[0])
        side = (taken[1][np.where(there, near, 0)] * normals[:, None]).sum(2) > 0.2
        undecided &= ~(there & side).any(1)
    candidates = np.flatnonzero(undecided)
    pairs = candidates[cKDTree(points[candidates]).query_pairs(radius, output_type="ndarray")]
    pairs = pairs[(normals[pairs[:, 0]] * normals[pairs[:, 1]]).sum(1) > 0.2]
    keep = np.zeros(len(points), bool)
    while undecided.any():
        pairs = pairs[undecided[pairs].all(1)]
        later = np.zeros(len(points), bool)
        later[pairs.max(1)] = True
        chosen = undecided & ~later
        keep |= chosen
        undecided &= ~chosen
        undecided[pairs[chosen[pairs[:, 0]], 1]] = False
        undecided[pairs[chosen[pairs[:, 1]], 0]] = False
    return keep
