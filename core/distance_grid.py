"""Signed distances on a grid."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


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
