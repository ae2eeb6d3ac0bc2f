"""Quality of a tetrahedral mesh: dihedral angles, and where the surface is no closed manifold."""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from core.tetmesh import TET_EDGES, cross_columns, edge_vectors, vertex_set_keys


def dihedral_cosines(vertices: np.ndarray, tets: np.ndarray) -> np.ndarray:
    """Cosines of the six dihedral angles of each tet, (6, T), by pairs of the faces opposite corners 0 to 3."""
    a, b, c = edge_vectors(vertices, tets)
    normals = [cross_columns(c, b), cross_columns(a, c), cross_columns(b, a)]
    normals.insert(0, -(normals[0] + normals[1] + normals[2]))  # a closed surface
    normals = [n / np.maximum(np.sqrt(np.einsum("it,it->t", n, n)), 1e-300) for n in normals]
    return -np.stack([np.einsum("it,it->t", normals[i], normals[j]) for i, j in TET_EDGES]).clip(-1, 1)


def dihedral_angles(vertices: np.ndarray, tets: np.ndarray) -> np.ndarray:
    """The six dihedral angles [degrees] of each tet, (T, 6)."""
    return np.degrees(np.arccos(dihedral_cosines(vertices, tets))).T


def smallest_angle(vertices: np.ndarray, tets: np.ndarray) -> float:
    """The smallest of all dihedral angles [degrees]."""
    return float(np.degrees(np.arccos(dihedral_cosines(vertices, tets).max())))


def non_manifold_vertices(surface: np.ndarray) -> np.ndarray:
    """Vertices where a closed surface (S, 3) is no 2-manifold.

    These are the ends of edges that bound other than two faces, and vertices whose faces form more than one fan.
    """
    surface = np.asarray(surface)
    if not len(surface):
        return np.zeros(0, np.int64)
    tail = surface.reshape(-1)  # corner c = 3 f + k lies at the tail of edge c
    head = np.roll(surface, -1, axis=1).reshape(-1)
    edges = np.stack([tail, head], 1)
    _, edge, count = np.unique(vertex_set_keys(edges), return_inverse=True, return_counts=True)
    edge = edge.reshape(-1)
    irregular = edges[count[edge] != 2].reshape(-1)

    # Around each vertex: the two faces of a regular edge share the corners at both of its ends.
    order = np.argsort(edge, kind="stable")
    order = order[count[edge[order]] == 2].reshape(-1, 2)
    corner = np.arange(len(tail))
    following = corner - corner % 3 + (corner + 1) % 3  # the corner at the head of edge c
    a, b = order[:, 0], order[:, 1]
    opposed = tail[a] == head[b]  # a consistently oriented surface runs an edge in both directions
    links = np.stack(
        [
            np.concatenate([a, following[a]]),
            np.concatenate([np.where(opposed, following[b], b), np.where(opposed, b, following[b])]),
        ]
    )
    n = len(tail)
    _, fan = connected_components(coo_matrix((np.ones(links.shape[1], bool), tuple(links)), (n, n)), directed=False)
    fans = np.sort(tail.astype(np.int64) * n + fan)
    fan_count = np.bincount(fans[np.flatnonzero(np.diff(fans, prepend=-1))] // n)
    return np.unique(np.concatenate([irregular, np.flatnonzero(fan_count > 1)]))


def euler_characteristic(surface: np.ndarray) -> int:
    """V - E + F: 2 a sphere, 0 a torus; 2 (components - handles) in general."""
    edges = np.sort(vertex_set_keys(np.asarray(surface)[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)))
    return len(np.unique(surface)) - int((np.diff(edges, prepend=-1) != 0).sum()) + len(surface)
