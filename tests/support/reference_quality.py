"""Float64 NumPy twin of prepare/cage/mesh_quality.py."""

import numpy as np

POWER, SHAPE = 8, 2.0
REGULAR = 6**1.5 * 6 * 2**0.5  # (sum of squared edges)^1.5 / V of a regular tet
TET_FACES = np.array([[1, 2, 3], [0, 3, 2], [0, 1, 3], [0, 2, 1]])  # opposite each corner, outward


def energy(x: np.ndarray, tets: np.ndarray, unit: float = 1.0):
    """sum_t (kappa_t W^(2/3) / unit)^p + (SHAPE q_t)^p, with q = (sum of squared edges)^1.5 / V of a regular tet.

    W is the volume of all tets.
    Out.  the energy (infinite if a tet is inverted), its gradient (V, 3), and kappa_t W^(2/3) (T,)
    """
    n, flat = len(x), tets.ravel()
    corners = x[tets]
    face = corners[:, TET_FACES]  # (T, 4, 3, 3): face a is opposite corner a
    normal = _cross(face[:, :, 1] - face[:, :, 0], face[:, :, 2] - face[:, :, 0])  # twice the area, outward
    volume = np.einsum("ti,ti->t", corners[:, 0] - corners[:, 1], normal[:, 0]) / -6
    if volume.min() <= 0:
        return np.inf, None, None
    whole = volume.sum()
    weight = 1 / np.bincount(flat, np.repeat(volume / 4, 4), n)[tets]  # 1 / m_a
    per_area = whole ** (2 / 3) * weight / (9 * volume[:, None])
    terms = per_area * (normal**2).sum(-1) / 4
    kappa = terms.sum(1)
    stiff = (kappa / unit) ** POWER
    arm = corners - corners.mean(1, keepdims=True)
    square = 4 * (arm**2).sum((1, 2))  # of all six edges
    poor = (SHAPE * square**1.5 / (REGULAR * volume)) ** POWER

    slope = POWER * stiff / kappa  # dE / dkappa_t
    by_mass = np.bincount(flat, (-slope[:, None] * terms * weight).ravel(), n)
    by_volume = by_mass[tets].sum(1) / 4 - POWER * (stiff + poor) / volume + POWER * stiff.sum() * (2 / 3) / whole
    at_corner = (12 * POWER * poor / square)[:, None, None] * arm - (by_volume / 6)[:, None, None] * normal
    h = (slope[:, None] * per_area / 2)[..., None] * normal  # dE / dnormal_a
    at_face = _cross(h[:, :, None], np.roll(face, 1, axis=2) - np.roll(face, -1, axis=2))
    index = np.concatenate([flat, tets[:, TET_FACES].ravel()])
    values = np.concatenate([at_corner.reshape(-1, 3), at_face.reshape(-1, 3)])
    gradient = np.stack([np.bincount(index, values[:, d], n) for d in range(3)], 1)
    return float(stiff.sum() + poor.sum()), gradient, kappa


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """np.cross of (..., 3), four times faster."""
    a0, a1, a2 = a[..., 0], a[..., 1], a[..., 2]
    b0, b1, b2 = b[..., 0], b[..., 1], b[..., 2]
    return np.stack([a1 * b2 - a2 * b1, a2 * b0 - a0 * b2, a0 * b1 - a1 * b0], -1)
