"""Colour that changes with the point of view, as spherical harmonics."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from assets.gaussians import SH_COUNTS
from core.spherical_harmonics import sh_basis
from studio.dining_room.layout import EYES

AROUND, AHEAD = 96, 64  # directions of view that count: from all sides, and from where the player stands
BATCH = 4096  # Gaussians at a time


def directions(at) -> tuple[np.ndarray, np.ndarray]:
    """Unit directions from cameras to the point `at` (M, 3), and how much each counts (M,)."""
    i = np.arange(AROUND) + 0.5  # Fibonacci sphere
    z, a = 1 - 2 * i / AROUND, np.pi * (1 + 5**0.5) * i
    sphere = np.stack([np.sqrt(1 - z * z) * np.cos(a), np.sqrt(1 - z * z) * np.sin(a), z], 1)
    low, high = np.min(EYES, axis=0), np.max(EYES, axis=0)
    share = (np.arange(1, AHEAD + 1)[:, None] * [0.8191725, 0.6710436, 0.5497005]) % 1  # R3 sequence
    ahead = np.asarray(at) - (low + share * (high - low))
    ahead /= np.linalg.norm(ahead, axis=1, keepdims=True)
    return np.concatenate([sphere, ahead]), np.concatenate([np.full(AROUND, 0.25), np.full(AHEAD, 1.0)])


def view_dependent(normals: np.ndarray, look: Callable, degree: int, views: tuple) -> np.ndarray:
    """Coefficients (N, K, 3) that fit `look(cosine)` over the `views` (directions, weights) in front of each surface.

    cosine (N, M) is that between the normal and the way back to the camera; `look` gives colours (N, M, 3). Only
    what can be seen counts, so a low degree does: the other half space is left to a small ridge.
    """
    k = SH_COUNTS[degree]
    d, share = views
    basis = sh_basis(d, k)
    cosine = -(normals @ d.T)
    weight = share * np.clip(cosine, 0, 1) ** 0.5
    target = look(np.clip(cosine, 0, 1)) - 0.5
    result = np.empty((len(normals), k, 3))
    ridge = np.diag([0.0] + [1.0] * (k - 1)) * 1e-3 * share.sum()
    for s in range(0, len(normals), BATCH):
        w = weight[s : s + BATCH]
        left = np.einsum("nm,mi,mj->nij", w, basis, basis, optimize=True) + ridge
        right = np.einsum("nm,mi,nmc->nic", w, basis, target[s : s + BATCH], optimize=True)
        result[s : s + BATCH] = np.linalg.solve(left, right)
    return result
