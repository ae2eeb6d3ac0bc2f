"""Reference of the contact law, in NumPy and float64, for many contacts at once; arrays are (N, ...)."""

import numpy as np


def dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.einsum("...i,...i->...", a, b)


def split(p: np.ndarray, n: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Normal component (N,) and tangential part (N, 3)."""
    return dot(p, n), p - dot(p, n)[:, None] * n


def contact_impulse(holding, n, A, friction: float) -> np.ndarray:
    """Of alpha n + theta (holding - alpha n), alpha = nAh/nAn, that of the largest theta in Coulomb's cone, bisected.

    A (N, 3, 3) inverse effective mass; one coefficient of friction; no impulse where alpha <= 0.
    """
    A_n = np.einsum("kij,kj->ki", A, n)
    alpha = dot(A_n, holding) / dot(A_n, n)
    free = np.maximum(alpha, 0.0)[:, None] * n
    low, high = np.zeros(len(n)), np.ones(len(n))
    for _ in range(60):
        theta = 0.5 * (low + high)
        p_n, p_t = split(free + theta[:, None] * (holding - free), n)
        within = np.linalg.norm(p_t, axis=1) <= friction * p_n
        low, high = np.where(within, theta, low), np.where(within, high, theta)
    whole, part = split(holding, n)
    low = np.where(np.linalg.norm(part, axis=1) <= friction * whole, 1.0, low)
    return np.where(alpha[:, None] > 0.0, free + low[:, None] * (holding - free), 0.0)


def holding_impulse(old, n, y, least, w_n, w_t, compliance=0.0, damping=1.0, most=np.inf) -> np.ndarray:
    """Normal part l, at most `most`: compliance l + damping (y_n + w_n (l - old_n)) = least; y_t stops."""
    (old_n, old_t), (y_n, y_t) = split(old, n), split(y, n)
    normal = np.minimum((least - damping * (y_n - w_n * old_n)) / (compliance + damping * w_n), most)
    return normal[:, None] * n + old_t - y_t / w_t[:, None]
