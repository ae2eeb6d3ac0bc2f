"""Mass, centre and inertia of a solid made of tetrahedra (NumPy only)."""

from __future__ import annotations

import numpy as np


def solid_inertia(vertices: np.ndarray, tets: np.ndarray, density: float) -> tuple[float, np.ndarray, np.ndarray]:
    """Mass [kg], centre of mass [m] (3,), inertia about it [kg m^2] (3, 3), of homogeneous tets.

    Second moments of a tet of volume V and corners x_k: V/20 (sum_k x_k x_k^T + (sum_k x_k)(sum_k x_k)^T).
    """
    corners = np.asarray(vertices, np.float64)[np.asarray(tets)]
    about = corners.reshape(-1, 3).mean(0)  # sums about a point of the body hardly cancel
    corners = corners - about
    volume = np.linalg.det(corners[:, 1:] - corners[:, :1]) / 6
    mass = density * volume.sum()
    center = (volume[:, None] * corners.mean(1)).sum(0) / volume.sum()
    total = corners.sum(1)
    second = np.einsum("tki,tkj->tij", corners, corners) + np.einsum("ti,tj->tij", total, total)
    moments = density * (volume[:, None, None] * second).sum(0) / 20 - mass * np.outer(center, center)
    return mass, center + about, np.trace(moments) * np.eye(3) - moments
