"""Small tetrahedral meshes with their surfaces, and random Gaussians to embed in them."""

import numpy as np

from assets.gaussians import Gaussians
from core.tetmesh import boundary_surface, positively_oriented
from core.tetmesh import box_mesh as box


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
