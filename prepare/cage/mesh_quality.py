"""What makes a tetrahedral mesh usable: volumes, dihedral angles, and a closed manifold surface."""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from core.tetmesh import alone, faces_of, keys_of

PAIRS = ((0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3))


def sides(vertices: np.ndarray, tets: np.ndarray) -> list[np.ndarray]:
    """The ways from each tet's first vertex to the other three: three arrays (3, T), coordinates first."""
    x = np.ascontiguousarray(np.asarray(vertices, np.float64).T)
    first, *others = np.ascontiguousarray(np.asarray(tets).T)
    origin = x.take(first, axis=1)  # `take` is four times as fast as an index
    return [x.take(other, axis=1) - origin for other in others]


def crossed(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Cross products of columns (3, T)."""
    return np.stack([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


def volumes(vertices: np.ndarray, tets: np.ndarray) -> np.ndarray:
    """Signed volumes [m^3], (T,): det[x1-x0, x2-x0, x3-x0] / 6."""
    a, b, c = sides(vertices, tets)
    return np.einsum("it,it->t", crossed(a, b), c) / 6


def cosines(vertices: np.ndarray, tets: np.ndarray) -> np.ndarray:
    """Cosines of the six dihedral angles of each tet, (6, T), by pairs of the faces opposite corners 0 to 3."""
    a, b, c = sides(vertices, tets)
    normals = [crossed(c, b), crossed(a, c), crossed(b, a)]
    normals.insert(0, -(normals[0] + normals[1] + normals[2]))  # a closed surface
    normals = [n / np.maximum(np.sqrt(np.einsum("it,it->t", n, n)), 1e-300) for n in normals]
    return -np.stack([np.einsum("it,it->t", normals[i], normals[j]) for i, j in PAIRS]).clip(-1, 1)


def dihedral_angles(vertices: np.ndarray, tets: np.ndarray) -> np.ndarray:
    """The six dihedral angles [degrees] of each tet, (T, 6)."""
    return np.degrees(np.arccos(cosines(vertices, tets))).T


def smallest_angle(vertices: np.ndarray, tets: np.ndarray) -> float:
    """The smallest of all dihedral angles [degrees]."""
    return float(np.degrees(np.arccos(cosines(vertices, tets).max())))


def boundary(tets: np.ndarray) -> np.ndarray:
    """Faces that belong to one tet only, outward for tets of positive volume, (S, 3)."""
    faces = faces_of(tets)
    return faces[alone(keys_of(faces))].astype(np.int32)


def pieces(tets: np.ndarray) -> np.ndarray:
    """Piece of each tet, (T,); tets of a piece are connected through faces. Piece 0 has the most tets."""
    faces = keys_of(faces_of(tets))
    order = np.argsort(faces)
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
    _, edge, count = np.unique(keys_of(edges), return_inverse=True, return_counts=True)
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
    fans = np.sort(tail.astype(np.int64) * n + fan)
    times = np.bincount(fans[np.flatnonzero(np.diff(fans, prepend=-1))] // n)
    return np.unique(np.concatenate([torn, np.flatnonzero(times > 1)]))


def euler_characteristic(surface: np.ndarray) -> int:
    """V - E + F: 2 a sphere, 0 a torus; 2 (pieces - handles) in general."""
    edges = np.sort(keys_of(np.asarray(surface)[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)))
    return len(np.unique(surface)) - int((np.diff(edges, prepend=-1) != 0).sum()) + len(surface)
