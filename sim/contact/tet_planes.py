"""Tetrahedra in space: their faces' planes, and what lies across each face."""

import numpy as np
import taichi as ti

from sim.body_model import RestShape


@ti.func
def outward(e1, e2, e3):
    """Unit normals of a tet's faces, each opposite its corner; e1, e2, e3 are its edges from corner 0."""
    n1, n2, n3 = -e2.cross(e3).normalized(), -e3.cross(e1).normalized(), -e1.cross(e2).normalized()
    return (e2 - e1).cross(e3 - e1).normalized(), n1, n2, n3


@ti.func
def beyond(r, e1, n0, n1, n2, n3):
    """How far r, from corner 0, is beyond the worst face: 0 inside, at most the distance outside."""
    return ti.max(n0.dot(r - e1), n1.dot(r), n2.dot(r), n3.dot(r), 0.0)


def neighbors_of(shape: RestShape) -> np.ndarray:
    return neighbors(shape.tets)


def neighbors(tets: np.ndarray) -> np.ndarray:
    """Tet across the face opposite each corner, -1 at the surface, (T, 4) int32."""
    faces = np.sort(tets[:, [[1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 1, 2]]].reshape(-1, 3), axis=1)
    order = np.lexsort(faces.T)
    same = (faces[order[1:]] == faces[order[:-1]]).all(1)
    result = np.full(4 * len(tets), -1, np.int32)
    a, b = order[:-1][same], order[1:][same]
    result[a], result[b] = b // 4, a // 4
    return result.reshape(-1, 4)
