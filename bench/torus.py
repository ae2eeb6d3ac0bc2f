"""A ring as a tetrahedral mesh for tests."""

import numpy as np

from bench.sample_meshes import boundary, box


def torus(radius: float = 0.08, tube: float = 0.015, around: int = 24, across: int = 2):
    """Vertices (V, 3), tets (T, 4), surface (S, 3) of a ring about the y axis; `around` must be even.

    A long box, bent into a circle, its square section of `across`^2 cells mapped to a disc.
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
    corners = x[tets]
    wrong = np.linalg.det(corners[:, 1:] - corners[:, :1]) < 0
    tets[wrong] = tets[wrong][:, [0, 2, 1, 3]]
    return x, tets, boundary(tets)
