"""Which faces of tetrahedra, or edges of triangles, are the same: by one number each, sorted once."""

from __future__ import annotations

import numpy as np

# Faces of a tetrahedron of positive volume, seen counter-clockwise from outside; row k lies opposite corner k.
OUTWARD = np.array([[1, 2, 3], [0, 3, 2], [0, 1, 3], [0, 2, 1]])

BITS = 21  # of a vertex's number in a key of 63: two million vertices


def keys_of(rows: np.ndarray) -> np.ndarray:
    """The same number (M,) int64 for rows (M, 2) or (M, 3) of the same vertices: these sort faster than rows do."""
    columns = np.ascontiguousarray(np.asarray(rows, np.int64).T)
    low, high = columns.min(0), columns.max(0)
    if high.max(initial=0) >= 1 << BITS:
        return np.unique(np.sort(columns.T, axis=1), axis=0, return_inverse=True)[1].reshape(-1)
    if len(columns) == 2:
        return (low << BITS) | high
    return (low << 2 * BITS) | (columns.sum(0) - low - high) << BITS | high


def alone(keys: np.ndarray) -> np.ndarray:
    """Indices, rising, of the keys (M,) that occur once."""
    order = np.argsort(keys)  # not stable, which is several times faster: equal keys are all the same here
    differs = np.ones(len(keys) + 1, bool)
    differs[1:-1] = keys[order[1:]] != keys[order[:-1]]
    return np.sort(order[differs[1:] & differs[:-1]])


def faces_of(tets: np.ndarray) -> np.ndarray:
    """The four faces of each tet (T, 4), outward, (4 T, 3): face 4 t + k lies opposite corner k."""
    return np.asarray(tets).take(OUTWARD, axis=1).reshape(-1, 3)


def cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Cross products of rows (M, 3), written out: np.cross moves axes about first."""
    (x, y, z), (u, v, w) = a.T, b.T
    return np.stack([y * w - z * v, z * u - x * w, x * v - y * u], 1)
