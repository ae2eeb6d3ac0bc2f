"""Small tetrahedral meshes for tests: boxes cut into cells, six tets a cell (Kuhn), and the boundary of any mesh."""

from itertools import permutations

import numpy as np


def box(size, cells, *, mirror: bool = True):
    """Vertices (V, 3), tets (T, 4), surface (S, 3) of [0, size], `cells` along each axis.

    Odd cells are mirrored, so that the mesh has no preferred diagonal and neighbouring faces match.
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
    tets = np.concatenate(tets)
    x = grid * (np.asarray(size, np.float64) / cells)
    D = x[tets[:, 1:]] - x[tets[:, :1]]
    wrong = np.linalg.det(D) < 0
    tets[wrong] = tets[wrong][:, [0, 2, 1, 3]]
    return x, tets, boundary(tets)


def boundary(tets: np.ndarray) -> np.ndarray:
    """Triangles that belong to one tet only, (S, 3), counter-clockwise seen from outside."""
    faces = tets[:, [[1, 2, 3], [0, 3, 2], [0, 1, 3], [0, 2, 1]]].reshape(-1, 3)
    _, first, count = np.unique(np.sort(faces, 1), axis=0, return_index=True, return_counts=True)
    return faces[np.sort(first[count == 1])]
