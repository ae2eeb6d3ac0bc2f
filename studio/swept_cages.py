"""Cages swept from polygons: prisms of three tets each, whose diagonals match from prism to prism."""

from __future__ import annotations

import numpy as np

from assets.asset import Cage
from core.tetmesh import boundary_surface, positively_oriented
from studio.revolved_cage import split_prism


def cage_of_prisms(vertices: np.ndarray, prisms) -> Cage:
    """Cage of prisms (bottom triangle 0 1 2, top 3 4 5) of vertices (V, 3) [m]."""
    tets = np.array([tet for prism in prisms for tet in split_prism(list(prism))], np.int32)
    tets = positively_oriented(vertices, tets).astype(np.int32)
    return Cage(vertices.astype(np.float32), tets, boundary_surface(tets))


def sheet_cage(inner: np.ndarray, outer: np.ndarray) -> Cage:
    """Cage between two grids of points (U, V, 3) [m], closed along the first axis: boxes of two prisms."""
    n, m = inner.shape[:2]
    ids = np.arange(2 * n * m).reshape(2, n, m)
    prisms = []
    for i in range(n):
        for j in range(m - 1):
            a, b, c, d = ids[:, i, j], ids[:, (i + 1) % n, j], ids[:, (i + 1) % n, j + 1], ids[:, i, j + 1]
            prisms += [(a[0], b[0], c[0], a[1], b[1], c[1]), (a[0], c[0], d[0], a[1], c[1], d[1])]
    return cage_of_prisms(np.concatenate([inner.reshape(-1, 3), outer.reshape(-1, 3)]), prisms)


def rod_cage(rings: np.ndarray, axis: np.ndarray) -> Cage:
    """Cage of rings of points (K, S, 3) [m] around points (K, 3) on an axis, open at both ends."""
    count, sides = rings.shape[:2]
    vertices = np.concatenate([axis[:, None], rings], 1)
    prisms = []
    for k in range(count - 1):
        here, there = k * (sides + 1), (k + 1) * (sides + 1)
        for s in range(sides):
            one, two = 1 + s, 1 + (s + 1) % sides
            prisms.append((here, here + one, here + two, there, there + one, there + two))
    return cage_of_prisms(vertices.reshape(-1, 3), prisms)
