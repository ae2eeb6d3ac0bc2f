"""Rotations on the host: unit quaternions wxyz, matrices and rotation vectors, by way of SciPy."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation


def matrices_from_quaternions(quaternions) -> np.ndarray:
    """Rotation matrices (..., 3, 3) of quaternions wxyz (..., 4), which need not be normalised."""
    q = np.asarray(quaternions, np.float64)
    flat = q.reshape(-1, 4)
    if not len(flat):
        return np.zeros((*q.shape[:-1], 3, 3))
    return Rotation.from_quat(flat, scalar_first=True).as_matrix().reshape(*q.shape[:-1], 3, 3)


def quaternion_from_matrix(matrix) -> np.ndarray:
    """Unit quaternion wxyz (4,) of a rotation matrix (3, 3)."""
    return Rotation.from_matrix(np.asarray(matrix, np.float64)).as_quat(scalar_first=True)


def multiply_quaternions(a, b) -> np.ndarray:
    """Hamilton product a b of quaternions wxyz (..., 4): the rotation b, then a. Not normalised."""
    aw, ax, ay, az = np.moveaxis(np.asarray(a, np.float64), -1, 0)
    bw, bx, by, bz = np.moveaxis(np.asarray(b, np.float64), -1, 0)
    return np.stack(
        [
            aw * bw - ax * bx - ay * by - az * bz,
            aw * bx + ax * bw + ay * bz - az * by,
            aw * by - ax * bz + ay * bw + az * bx,
            aw * bz + ax * by - ay * bx + az * bw,
        ],
        -1,
    )
