"""What makes a tetrahedral mesh usable: volumes, dihedral angles, and a closed manifold surface."""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

# Faces of a tetrahedron of positive volume, seen counter-clockwise from outside; row k lies opposite corner k.
OUTWARD = np.array([[1, 2, 3], [0, 3, 2], [0, 1, 3], [0, 2, 1]])

BITS = 21  # of a vertex's number in a key of 63: two million vertices


def volumes(vertices: np.ndarray, tets: np.ndarray) -> np.ndarray:
    """Signed volumes [m^3], (T,): det[x1-x0, x2-x0, x3-x0] / 6."""
    x = np.asarray(vertices, np.float64)[tets]
    a, b, c = x[:, 1] - x[:, 0], x[:, 2] - x[:, 0], x[:, 3] - x[:, 0]
    return np.einsum("ti,ti->t", np.cross(a, b), c) / 6


def dihedral_angles(vertices: np.ndarray, tets: np.ndarray) -> np.ndarray:
    """The six dihedral angles [degrees] of each tet, (T, 6)."""
    x = np.asarray(vertices, np.float64)[tets][:, OUTWARD]
    normals = np.cross(x[:, :, 1] - x[:, :, 0], x[:, :, 2] - x[:, :, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=-1, keepdims=True), 1e-300)
    i, j = np.triu_indices(4, 1)
    return 180 - np.degrees(np.arccos(np.einsum("tki,tki->tk", normals[:, i], normals[:, j]).clip(-1, 1)))


def _keys(rows: np.ndarray) -> np.ndarray:
    """The same number for rows (M, 2) or (M, 3) of the same vertices: it sorts ten times faster than rows do."""
    rows = np.sort(rows, axis=1).astype(np.int64)
    if rows.max(initial=0) >= 1 << BITS:
        return np.unique(rows, axis=0, return_inverse=True)[1].reshape(-1)
    key = rows[:, 0]
    for column in rows.T[1:]:
        key = (key << BITS) | column
    return key


def boundary(tets: np.ndarray) -> np.ndarray:
    """Faces that belong to one tet only, outward for tets of positive volume, (S, 3)."""
    faces = np.asarray(tets)[:, OUTWARD].reshape(-1, 3)
    _, first, count = np.unique(_keys(faces), return_index=True, return_counts=True)
    return faces[np.sort(first[count == 1])].astype(np.int32)


def pieces(tets: np.ndarray) -> np.ndarray:
    """Piece of each tet, (T,); tets of a piece are connected through faces. Piece 0 has the most tets."""
    faces = _keys(np.asarray(tets)[:, OUTWARD].reshape(-1, 3))
    order = np.argsort(faces, kind="stable")
    same = faces[order[1:]] == faces[order[:-1]]
    a, b = order[1:][same] // 4, order[:-1][same] // 4
    n = len(tets)
    _, label = connected_components(coo_matrix((np.ones(len(a), bool), (a, b)), (n, n)), directed=False)
    rank = np.argsort(np.argsort(-np.bincount(label, minlength=1), kind="stable"), kind="stable")
    return rank[label]


def non_manifold_vertices(surface: np.ndarray) -> np.ndarray:
    """Vertices where a closed surface (S, 3) is no 2-manifold.

    These are the ends of edges that bound other than two faces, and vertices whose faces form
    more than one fan.
    """
    surface = np.asarray(surface)
    if not len(surface):
        return np.zeros(0, np.int64)
    tail = surface.reshape(-1)  # corner c = 3 f + k lies at the tail of edge c
    head = np.roll(surface, -1, axis=1).reshape(-1)
    edges = np.stack([tail, head], 1)
    _, edge, count = np.unique(_keys(edges), return_inverse=True, return_counts=True)
    edge = edge.reshape(-1)
    torn = edges[count[edge] != 2].reshape(-1)

    # Walk around each vertex: the two faces of a good edge share the corners at both of its ends.
    order = np.argsort(edge, kind="stable")
    order = order[count[edge[order]] == 2].reshape(-1, 2)
    corner = np.arange(len(tail))
    following = corner - corner % 3 + (corner + 1) % 3  # the corner at the head of edge c
    a, b = order[:, 0], order[:, 1]
    opposed = tail[a] == head[b]  # a consistently oriented surface runs an edge both ways
    links = np.stack(
        [
            np.concatenate([a, following[a]]),
            np.concatenate([np.where(opposed, following[b], b), np.where(opposed, b, following[b])]),
        ]
    )
    n = len(tail)
    _, fan = connected_components(coo_matrix((np.ones(links.shape[1], bool), tuple(links)), (n, n)), directed=False)
    fans = np.unique(np.stack([tail, fan], 1), axis=0)[:, 0]
    vertex, times = np.unique(fans, return_counts=True)
    return np.unique(np.concatenate([torn, vertex[times > 1]]))


def euler_characteristic(surface: np.ndarray) -> int:
    """V - E + F: 2 a sphere, 0 a torus; 2 (pieces - handles) in general."""
    edges = np.unique(np.sort(np.asarray(surface)[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1), axis=0)
    return len(np.unique(surface)) - len(edges) + len(surface)
