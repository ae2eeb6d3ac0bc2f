"""Colour that changes with the point of view, as spherical harmonics."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from assets.gaussians import SH_COUNTS
from assets.sh import sh_basis

DIRECTIONS = 96
BATCH = 4096  # Gaussians at a time


def view_dependent(normals: np.ndarray, look: Callable, degree: int) -> np.ndarray:
    """Coefficients (N, K, 3) that fit `look(directions, cosine)` over the half space in front of each surface.

    directions (N, M, 3) run from the camera to the Gaussian; cosine (N, M) is that between the normal and the
    way back. Only what can be seen counts, so a low degree does: the other half space is left to a small ridge.
    """
    k = SH_COUNTS[degree]
    i = np.arange(DIRECTIONS) + 0.5  # Fibonacci sphere
    z, a = 1 - 2 * i / DIRECTIONS, np.pi * (1 + 5**0.5) * i
    d = np.stack([np.sqrt(1 - z * z) * np.cos(a), np.sqrt(1 - z * z) * np.sin(a), z], 1)
    basis = sh_basis(d, k)
    cosine = -(normals @ d.T)
    weight = np.clip(cosine, 0, 1) ** 0.5
    target = look(np.broadcast_to(d, (len(normals), *d.shape)), np.clip(cosine, 0, 1)) - 0.5
    result = np.empty((len(normals), k, 3))
    ridge = np.diag([0.0] + [0.02] * (k - 1)) * DIRECTIONS * 0.05
    for s in range(0, len(normals), BATCH):
        w = weight[s : s + BATCH]
        left = np.einsum("nm,mi,mj->nij", w, basis, basis, optimize=True) + ridge
        right = np.einsum("nm,mi,nmc->nic", w, basis, target[s : s + BATCH], optimize=True)
        result[s : s + BATCH] = np.linalg.solve(left, right)
    return result
