"""Signed distances on a grid."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import map_coordinates


@dataclass(frozen=True)
class DistanceGrid:
    """Signed distances [m] on a regular grid, negative inside; node (i, j, k) lies at origin + spacing * (i, j, k).

    values   (X, Y, Z) float16 or float32
    origin   (3,) [m]
    spacing  [m]
    """

    values: np.ndarray
    origin: np.ndarray
    spacing: float


def sample(values: np.ndarray, origin, spacing: float, points: np.ndarray) -> np.ndarray:
    """Trilinear interpolation of `values` (X, Y, Z) at points [m] (..., 3); beyond the grid the border's value.

    Node (i, j, k) lies at origin + spacing (i, j, k) [m]. Returns (...) float64.
    """
    cells = (np.asarray(points, np.float64) - origin) / spacing
    flat = cells.reshape(-1, 3).T
    return map_coordinates(values, flat, order=1, mode="nearest", output=np.float64).reshape(cells.shape[:-1])
