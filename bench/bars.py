"""Structured tet bars, an analytic twist of them, and random Gaussians inside: for the tests of the embedding."""

import itertools

import numpy as np

from assets.gaussians import Gaussians


def tet_bar(cells, size):
    """Vertices (V, 3) float32 and tets (T, 4) of a box [0, size], six tets to a cell."""
    grid = np.stack(np.meshgrid(*(np.arange(n + 1) for n in cells), indexing="ij"), -1)
    index = np.arange(grid[..., 0].size).reshape(grid.shape[:3])
    vertices = (grid.reshape(-1, 3) / cells * size).astype(np.float32)
    tets = []
    for order in itertools.permutations(np.eye(3, dtype=int)):
        path = np.concatenate([[[0, 0, 0]], np.cumsum(order, 0)])
        corners = [index[tuple(slice(a, n + a) for a, n in zip(p, cells, strict=True))].ravel() for p in path]
        if np.linalg.det(np.array(order)) < 0:
            corners[2], corners[3] = corners[3], corners[2]
        tets.append(np.stack(corners, 1))
    return vertices, np.concatenate(tets)


def twist(x, *, turn=np.pi, stretch=0.3, centre=0.1):
    """Turn a bar of 1 m along x about its axis by `turn` [rad] and stretch it ever more: positions and gradients F."""
    angle = turn * x[:, 0]
    c, s = np.cos(angle), np.sin(angle)
    y, z = x[:, 1] - centre, x[:, 2] - centre
    moved = np.stack([x[:, 0] * (1 + stretch * x[:, 0]), c * y - s * z, s * y + c * z], 1)
    F = np.zeros((len(x), 3, 3))
    F[:, 0, 0] = 1 + 2 * stretch * x[:, 0]
    F[:, 1, 0], F[:, 2, 0] = turn * (-s * y - c * z), turn * (c * y - s * z)
    F[:, 1, 1], F[:, 1, 2], F[:, 2, 1], F[:, 2, 2] = c, -s, s, c
    return moved, F


def random_gaussians(rng, count, *, low=(0, 0, 0), high=(1, 0.2, 0.2), sigma=0.01, spread=0.5) -> Gaussians:
    """Gaussians of standard deviations around `sigma` [m] with a log-normal `spread`, anywhere in a box."""
    scales = sigma * np.exp(spread * rng.normal(size=(count, 3)))
    quats = rng.normal(size=(count, 4))
    return Gaussians.of(
        rng.uniform(low, high, (count, 3)), quats, np.log(scales), np.zeros(count), np.zeros((count, 1, 3))
    )
