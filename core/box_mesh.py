"""Tetrahedral lattice of a box."""

from itertools import permutations

import numpy as np

from core.tetmesh import boundary_surface, positively_oriented


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
