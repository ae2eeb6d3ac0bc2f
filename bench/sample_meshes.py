"""Small tetrahedral meshes with their surfaces, and random Gaussians to embed in them."""

from itertools import permutations

import numpy as np

from assets.gaussians import Gaussians
from core.tetmesh import boundary_surface, positively_oriented


def box(size, cells, *, mirror: bool = True):
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


def tet_bar(cells, size):
    """Vertices [m] (V, 3) float32 and tets (T, 4) of the box [0, size], as an asset's cage holds them."""
    x, tets, _ = box(size, cells, mirror=False)
    return x.astype(np.float32), tets


def torus(radius: float = 0.08, tube: float = 0.015, around: int = 24, across: int = 2):
    """Vertices [m] (V, 3), tets (T, 4), surface (S, 3) of a ring about the y axis; `around` must be even.

    A long box of `around` x `across`^2 cells is bent into a circle and its square section mapped to a disc.
    """
    assert around % 2 == 0, "mirrored cells match at the seam only if their number is even"
    x, tets, _ = box((around, across, across), (around, across, across))
    last = int((across + 1) ** 2)  # vertices of one section; the section at x = around is the one at 0
    tets = tets % (around * last)
    x = x[: around * last]
    section = 2 * x[:, 1:] / across - 1
    largest = np.abs(section).max(1, keepdims=True)
    length = np.maximum(np.linalg.norm(section, axis=1, keepdims=True), 1e-12)
    disc = section * largest / length * tube  # squares about the centre become circles
    angle = 2 * np.pi * x[:, 0] / around
    away = radius + disc[:, 0]
    x = np.stack([away * np.cos(angle), disc[:, 1], away * np.sin(angle)], axis=1)
    tets = positively_oriented(x, tets)
    return x, tets, boundary_surface(tets)


def random_gaussians(rng, count, *, low=(0, 0, 0), high=(1, 0.2, 0.2), sigma=0.01, spread=0.5) -> Gaussians:
    """Gaussians uniform in a box [m] with standard deviations of median `sigma` [m] and log-normal `spread`."""
    scales = sigma * np.exp(spread * rng.normal(size=(count, 3)))
    quats = rng.normal(size=(count, 4))
    return Gaussians.of(
        rng.uniform(low, high, (count, 3)), quats, np.log(scales), np.zeros(count), np.zeros((count, 1, 3))
    )
