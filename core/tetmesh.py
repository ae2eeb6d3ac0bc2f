"""Topology and volumes of tetrahedral meshes: faces, boundary surface, shared faces, connected components; and a box's
lattice."""

from __future__ import annotations

from itertools import permutations

import numpy as np

# Faces of a tetrahedron of positive volume, counter-clockwise seen from outside; row k lies opposite corner k.
TET_FACES = np.array([[1, 2, 3], [0, 3, 2], [0, 1, 3], [0, 2, 1]])
TET_EDGES = np.array([[0, 1], [0, 2], [0, 3], [1, 2], [1, 3], [2, 3]])

INDEX_BITS = 21  # of a vertex in a 63-bit key of three: up to two million vertices


def edge_vectors(vertices: np.ndarray, tets: np.ndarray) -> list[np.ndarray]:
    """Vectors [m] from each tet's first vertex to the other three: three arrays (3, T), coordinates first."""
    x = np.ascontiguousarray(np.asarray(vertices, np.float64).T)
    first, *others = np.ascontiguousarray(np.asarray(tets).T)
    origin = x.take(first, axis=1)  # `take` is four times as fast as an index
    return [x.take(other, axis=1) - origin for other in others]


def cross_columns(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Cross products of the columns of (3, T) arrays; several times as fast as `np.cross`."""
    return np.stack([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


def tet_volumes(vertices: np.ndarray, tets: np.ndarray) -> np.ndarray:
    """Signed volumes [m^3], (T,) float64: det[x1-x0, x2-x0, x3-x0] / 6."""
    a, b, c = edge_vectors(vertices, tets)
    return np.einsum("it,it->t", cross_columns(a, b), c) / 6


def positively_oriented(vertices: np.ndarray, tets: np.ndarray) -> np.ndarray:
    """The tets (T, 4), with two corners exchanged where the volume is negative."""
    return np.where((tet_volumes(vertices, tets) < 0)[:, None], tets[:, [0, 2, 1, 3]], tets)


def triangle_areas(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Areas [m^2] of triangles, (F,) float64."""
    a, b, c = np.moveaxis(np.asarray(vertices, np.float64)[faces], 1, 0)
    return 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1)


def enclosed_volume(vertices: np.ndarray, surface: np.ndarray) -> float:
    """Volume [m^3] within a closed outward surface (S, 3), by the divergence theorem."""
    x = np.asarray(vertices, np.float64)
    a, b, c = ((x - x.mean(0)).take(corner, axis=0).T for corner in np.asarray(surface).T)
    return float(np.einsum("is,is->", a, cross_columns(b, c))) / 6


def tet_faces(tets: np.ndarray) -> np.ndarray:
    """The four faces of each tet (T, 4), outward, (4 T, 3): face 4 t + k lies opposite corner k."""
    return np.asarray(tets).take(TET_FACES, axis=1).reshape(-1, 3)


def boundary_surface(tets: np.ndarray) -> np.ndarray:
    """Faces that belong to one tet only, outward for tets of positive volume, (S, 3) int32."""
    faces = tet_faces(tets)
    return faces[indices_of_unique(vertex_set_keys(faces))].astype(np.int32)


def vertex_set_keys(rows: np.ndarray) -> np.ndarray:
    """Keys (M,) int64 of edges (M, 2) or faces (M, 3): equal for the same vertices in any order; they sort fast."""
    columns = np.ascontiguousarray(np.asarray(rows, np.int64).T)
    low, high = columns.min(0), columns.max(0)
    if high.max(initial=0) >= 1 << INDEX_BITS:
        return np.unique(np.sort(columns.T, axis=1), axis=0, return_inverse=True)[1].reshape(-1)
    if len(columns) == 2:
        return (low << INDEX_BITS) | high
    return (low << 2 * INDEX_BITS) | (columns.sum(0) - low - high) << INDEX_BITS | high


def indices_of_unique(keys: np.ndarray) -> np.ndarray:
    """Ascending indices of the keys (M,) that occur once."""
    order = np.argsort(keys)  # unstable, which is several times faster; the order of equal keys does not matter
    differs = np.ones(len(keys) + 1, bool)
    differs[1:-1] = keys[order[1:]] != keys[order[:-1]]
    return np.sort(order[differs[1:] & differs[:-1]])


def shared_face_pairs(tets: np.ndarray) -> np.ndarray:
    """Faces that two tets share: both their indices into `tet_faces(tets)`, (n, 2), ascending."""
    keys = vertex_set_keys(tet_faces(tets))
    order = np.argsort(keys)
    same = keys[order[1:]] == keys[order[:-1]]
    pairs = np.sort([order[:-1][same], order[1:][same]], axis=0)
    return pairs[:, np.argsort(pairs[0])].T


def face_components(tets: np.ndarray) -> np.ndarray:
    """Connected component (T,) of each tet, where neighbours share a face. Component 0 has the most tets."""
    return _components(*(shared_face_pairs(tets) // 4).T, len(tets))


def vertex_components(tets: np.ndarray) -> np.ndarray:
    """Connected component (T,) of each tet, where neighbours share a vertex. Component 0 has the most tets."""
    tets = np.asarray(tets)
    corner, tet = tets.ravel(), np.repeat(np.arange(len(tets)), 4)
    tet_of_vertex = np.zeros(int(corner.max(initial=-1)) + 1, np.int64)
    tet_of_vertex[corner] = tet  # any one of those at the vertex
    return _components(tet, tet_of_vertex[corner], len(tets))


def _components(a: np.ndarray, b: np.ndarray, count: int) -> np.ndarray:
    """Component (count,) of each node of the graph with links from a to b (L,), by falling size."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    links = coo_matrix((np.ones(len(a), bool), (a, b)), (count, count))
    _, label = connected_components(links, directed=False)
    rank = np.argsort(np.argsort(-np.bincount(label, minlength=1), kind="stable"), kind="stable")
    return rank[label]


def box_mesh(size, cells, *, mirror: bool = True) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Vertices [m] (V, 3), tets (T, 4), surface (S, 3) of the box [0, size], six tets a cell (Kuhn's subdivision).

    With `mirror`, odd cells are mirrored: the mesh has no preferred diagonal.
    """
    cells = np.asarray(cells)
    grid = np.stack(np.meshgrid(*(np.arange(n + 1) for n in cells), indexing="ij"), -1).reshape(-1, 3)
    corner = np.stack(np.meshgrid(*(np.arange(n) for n in cells), indexing="ij"), -1).reshape(-1, 3)
    flip = (corner % 2 == 1) if mirror else np.zeros_like(corner, bool)
    tets = []
    for order in permutations(range(3)):
        path = np.zeros((4, 3), np.int64)
        for k, axis in enumerate(order):
            path[k + 1 :, axis] = 1
        local = np.where(flip[:, None], 1 - path, path) + corner[:, None]
        tets.append((local[..., 0] * (cells[1] + 1) + local[..., 1]) * (cells[2] + 1) + local[..., 2])
    x = grid * (np.asarray(size, np.float64) / cells)
    tets = positively_oriented(x, np.concatenate(tets))
    return x, tets, boundary_surface(tets)
