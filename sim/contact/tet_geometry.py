"""Geometry of single tetrahedra: face planes, distance outside, rest coordinates of a point, neighbours."""

import numpy as np
import taichi as ti

MIN_VOLUME_RATIO = 1e-3  # of the rest volume; of a tet crushed flatter, normals are rounding, and soon overflow
MIN_WEIGHT = -0.01  # barycentric; below it a point moves on to the neighbouring tet, but not to and fro on a face
NO_TET = 2**62  # a key above those of all tets


@ti.func
def tet_edges(s: ti.template(), t):
    """Corner 0 of tet t of the state s, and the edges from it [m]."""
    a = s.tets[t]
    x0 = s.x[a[0]]
    return x0, s.x[a[1]] - x0, s.x[a[2]] - x0, s.x[a[3]] - x0


@ti.func
def face_normals(e1, e2, e3):
    """Outward unit normals of a tet's faces, each opposite its corner; e1, e2, e3 are its edges from corner 0."""
    n1, n2, n3 = -e2.cross(e3).normalized(), -e3.cross(e1).normalized(), -e1.cross(e2).normalized()
    return (e2 - e1).cross(e3 - e1).normalized(), n1, n2, n3


@ti.func
def distance_outside(r, e1, n0, n1, n2, n3):
    """Distance [m] of r, relative to corner 0, beyond the worst face plane: 0 inside, a lower bound outside."""
    return ti.max(n0.dot(r - e1), n1.dot(r), n2.dot(r), n3.dot(r), 0.0)


@ti.func
def worst_face(r, e1, n0, n1, n2, n3):
    """Unit normal of the face plane beyond which r, relative to corner 0, is farthest, or least inside."""
    worst, normal = n0.dot(r - e1), n0
    for n in ti.static((n1, n2, n3)):
        if n.dot(r) > worst:
            worst, normal = n.dot(r), n
    return normal


@ti.func
def tet_key(distance, t):
    """64-bit key that orders tets by distance [m], in steps of 1e-7 m, then by index: for an atomic minimum."""
    return (ti.cast(distance * 1e7, ti.i64) << 32) | ti.cast(t, ti.i64)


@ti.func
def tet_of_key(key):
    """Index of the tet of a key, -1 for NO_TET."""
    return -1 if key == ti.i64(NO_TET) else ti.cast(key & ti.i64(0x7FFFFFFF), ti.i32)


@ti.func
def rest_coordinates(s: ti.template(), t, x):
    """Barycentric and rest coordinates of the point x in tet t of the state s.

    Returns whether the tet has enough volume for them; the weights b (4,); the rest position X [m]; the gradients g_j
    of b_1..b_3 [1/m] and the rest edges E_j [m], by which `deformed_gradient` maps gradients.
    """
    a = s.tets[t]
    x0, X0 = s.x[a[0]], s.rest[a[0]]
    e1, e2, e3 = s.x[a[1]] - x0, s.x[a[2]] - x0, s.x[a[3]] - x0
    E1, E2, E3 = s.rest[a[1]] - X0, s.rest[a[2]] - X0, s.rest[a[3]] - X0
    det = e1.dot(e2.cross(e3))
    g1, g2, g3, X = E1, E2, E3, X0
    b = ti.Vector([1.0, 0.0, 0.0, 0.0])
    thick = det > MIN_VOLUME_RATIO * E1.dot(E2.cross(E3))
    if thick:
        g1, g2, g3 = e2.cross(e3) / det, e3.cross(e1) / det, e1.cross(e2) / det
        d = x - x0
        b1, b2, b3 = g1.dot(d), g2.dot(d), g3.dot(d)
        b = ti.Vector([1.0 - b1 - b2 - b3, b1, b2, b3])
        X = X0 + b1 * E1 + b2 * E2 + b3 * E3
    return thick, b, X, g1, g2, g3, E1, E2, E3


@ti.func
def deformed_gradient(N, g1, g2, g3, E1, E2, E3):
    """F^-T N = sum_j g_j (E_j . N): a gradient N in the rest shape, carried to the deformed one."""
    return g1 * E1.dot(N) + g2 * E2.dot(N) + g3 * E3.dot(N)


def tet_neighbors(tets: np.ndarray) -> np.ndarray:
    """Tet across the face opposite each corner, -1 at the surface, (T, 4) int32."""
    faces = np.sort(tets[:, [[1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 1, 2]]].reshape(-1, 3), axis=1)
    order = np.lexsort(faces.T)
    same = (faces[order[1:]] == faces[order[:-1]]).all(1)
    result = np.full(4 * len(tets), -1, np.int32)
    a, b = order[:-1][same], order[1:][same]
    result[a], result[b] = b // 4, a // 4
    return result.reshape(-1, 4)
