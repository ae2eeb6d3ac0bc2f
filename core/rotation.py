"""Rotations on the host: unit quaternions wxyz and rotation matrices, any number at once.

NumPy only: importing `scipy.spatial.transform` takes longer than all else before the first picture. Rotation vectors,
means and interpolation are left to SciPy's `Rotation` where they are used.
"""

from __future__ import annotations

import numpy as np


def matrices_from_quaternions(quaternions) -> np.ndarray:
    """Rotation matrices (..., 3, 3) of quaternions wxyz (..., 4), which need not be normalised."""
    q = np.asarray(quaternions, np.float64)
    w, x, y, z = np.moveaxis(q / np.linalg.norm(q, axis=-1, keepdims=True), -1, 0)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.ascontiguousarray(np.moveaxis(np.array(rows), (0, 1), (-2, -1)))


def pose_matrix(position, rotation) -> np.ndarray:
    """(4, 4) of a position (3,) and a rotation (or other linear map) (3, 3)."""
    m = np.eye(4)
    m[:3, :3], m[:3, 3] = rotation, position
    return m


def quaternions_from_matrices(matrices) -> np.ndarray:
    """Unit quaternions wxyz (..., 4) of rotation matrices (..., 3, 3); the largest component is positive.

    The entries of a rotation matrix give 4 q q^T; its row with the largest diagonal entry is the most accurate multiple
    of q (Shepperd 1978).
    """
    m = np.moveaxis(np.asarray(matrices, np.float64), (-2, -1), (0, 1))
    xx, yy, zz = m[0, 0], m[1, 1], m[2, 2]
    wx, wy, wz = m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1]
    xy, xz, yz = m[1, 0] + m[0, 1], m[0, 2] + m[2, 0], m[2, 1] + m[1, 2]
    products = np.array(
        [
            [1 + xx + yy + zz, wx, wy, wz],
            [wx, 1 + xx - yy - zz, xy, xz],
            [wy, xy, 1 - xx + yy - zz, yz],
            [wz, xz, yz, 1 - xx - yy + zz],
        ]
    )
    largest = np.einsum("ii...->i...", products).argmax(0)
    q = np.take_along_axis(products, largest[None, None], axis=0)[0]
    return np.moveaxis(q / np.linalg.norm(q, axis=0), 0, -1)


def best_fit_rotation(A: np.ndarray) -> np.ndarray:
    """Rotations R (..., 3, 3) that maximise tr(R^T A), for A = sum m x (rest - its centre)^T (Kabsch 1976)."""
    U, _, Vt = np.linalg.svd(A)
    U[..., 2] *= np.sign(np.linalg.det(U @ Vt))[..., None]
    return U @ Vt


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


def conjugate_quaternions(q) -> np.ndarray:
    """Conjugates of quaternions wxyz (..., 4): the inverse rotations of unit ones."""
    return np.asarray(q) * [1.0, -1.0, -1.0, -1.0]


def interpolate_quaternions(a, b, fraction: float) -> np.ndarray:
    """Unit quaternions (..., 4) at a fraction between a and b: linear along the shorter arc, then normalised."""
    a, b = np.asarray(a, np.float64), np.asarray(b, np.float64)
    b = np.where((a * b).sum(-1, keepdims=True) < 0.0, -b, b)
    q = a + fraction * (b - a)
    return q / np.maximum(np.linalg.norm(q, axis=-1, keepdims=True), 1e-12)


def turns_to(normals: np.ndarray, half_angles: np.ndarray) -> np.ndarray:
    """Quaternions wxyz that turn +z to normals (N, 3) of any length, after a turn about +z, (N, 4); not normalised."""
    z = normals / np.linalg.norm(normals, axis=1, keepdims=True)
    to = np.stack([1 + z[:, 2], -z[:, 1], z[:, 0], np.zeros(len(z))], 1)
    to[z[:, 2] < 1e-12 - 1] = [0, 1, 0, 0]
    return multiply_quaternions(to, np.stack([np.cos(half_angles), *np.zeros((2, len(z))), np.sin(half_angles)], 1))


def rotation_between(a, b) -> np.ndarray:
    """The smallest rotation (3, 3) that takes direction `a` to direction `b`."""
    a, b = (np.asarray(v, np.float64) / np.linalg.norm(v) for v in (a, b))
    half = a + b
    if np.linalg.norm(half) < 1e-9:  # opposite: half a turn about any axis across
        across = np.cross(a, np.eye(3)[np.argmin(np.abs(a))])
        across /= np.linalg.norm(across)
        return 2.0 * np.outer(across, across) - np.eye(3)
    half /= np.linalg.norm(half)
    return (2.0 * np.outer(half, half) - np.eye(3)) @ (2.0 * np.outer(a, a) - np.eye(3))
