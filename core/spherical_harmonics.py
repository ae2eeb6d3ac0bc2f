"""Real spherical harmonics up to degree 3, with the constants and signs of 3D Gaussian Splatting."""

from __future__ import annotations

import numpy as np

from core.camera import directions_around
from core.program import batches

C0 = 0.28209479177387814
C1 = 0.4886025119029199
C2 = (1.0925484305920792, -1.0925484305920792, 0.31539156525252005, -1.0925484305920792, 0.5462742152960396)
C3 = (
    -0.5900435899266435,
    2.890611442640554,
    -0.4570457994644658,
    0.3731763325901154,
    -0.4570457994644658,
    1.445305721320277,
    -0.5900435899266435,
)


def sh_basis(directions: np.ndarray, count: int = 16) -> np.ndarray:
    """Values of the first `count` basis functions, (M, count), at unit directions (M, 3)."""
    x, y, z = np.asarray(directions, np.float64).T
    xx, yy, zz = x * x, y * y, z * z
    rows = [
        C0 + 0 * x,
        -C1 * y,
        C1 * z,
        -C1 * x,
        C2[0] * x * y,
        C2[1] * y * z,
        C2[2] * (2 * zz - xx - yy),
        C2[3] * x * z,
        C2[4] * (xx - yy),
        C3[0] * y * (3 * xx - yy),
        C3[1] * x * y * z,
        C3[2] * y * (4 * zz - xx - yy),
        C3[3] * z * (2 * zz - 3 * xx - 3 * yy),
        C3[4] * x * (4 * zz - xx - yy),
        C3[5] * z * (xx - yy),
        C3[6] * x * (xx - 3 * yy),
    ]
    return np.stack(rows[:count], axis=1)


def rotate_sh(sh: np.ndarray, rotation: np.ndarray) -> np.ndarray:
    """Rotate coefficients (N, K, 3) with their object by `rotation` (3, 3), or each by its own (N, 3, 3).

    The turned object shows in direction d what it showed in R^T d. Each band is closed under rotation, so
    least squares over a few dozen directions gives the matrix exactly.
    """
    count = sh.shape[1]
    if count == 1:
        return sh.copy()
    d, rotation, out = directions_around(64), np.asarray(rotation, np.float64), np.empty(sh.shape, np.float32)
    inverse = np.linalg.pinv(sh_basis(d, count))
    if rotation.ndim == 2:
        by_channel = np.kron((inverse @ sh_basis(d @ rotation, count)).T, np.eye(3))  # one product is fastest
        return (sh.reshape(len(sh), -1) @ by_channel).astype(np.float32).reshape(sh.shape)
    for some in batches(len(sh), 4096):  # 35 MB at once
        turned = d @ rotation[some]  # R^T d of each, (n, D, 3)
        basis = sh_basis(turned.reshape(-1, 3), count).reshape(*turned.shape[:2], count)
        out[some] = inverse @ (basis @ sh[some])
    return out
