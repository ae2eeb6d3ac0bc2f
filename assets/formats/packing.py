"""Quantisation that several splat formats share: 8-bit opacities, quaternions by their three smaller components."""

from __future__ import annotations

import numpy as np

ALPHA_EPSILON = 1e-6  # opacities read from 8 bits stay this far from 0 and 1, so that the logit is finite
OTHERS = np.array([[1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 1, 2]])  # the components without each one


def to_bytes(values: np.ndarray) -> np.ndarray:
    """Values rounded and clamped to 0..255, uint8."""
    return np.clip(np.round(values), 0, 255).astype(np.uint8)


def logits_from_bytes(alpha: np.ndarray) -> np.ndarray:
    """Logits (N,) float32 of 8-bit opacities (N,)."""
    a = np.clip(alpha / 255.0, ALPHA_EPSILON, 1 - ALPHA_EPSILON)
    return np.log(a / (1 - a)).astype(np.float32)


def bytes_from_logits(logits: np.ndarray) -> np.ndarray:
    """8-bit opacities (N,) uint8 of logits (N,)."""
    return to_bytes(255.0 / (1.0 + np.exp(-np.clip(logits.astype(np.float64), -80, 80))))


def split_largest(quaternions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Index (N,) of the largest component of unit quaternions (N, 4), and the three others (N, 3) in their order.

    Signs are those of the same rotation with a positive largest component, so the others lie within +-sqrt(1/2).
    """
    largest = np.abs(quaternions).argmax(axis=1)
    sign = np.where(np.take_along_axis(quaternions, largest[:, None], axis=1) < 0, -1.0, 1.0)
    return largest, np.take_along_axis(quaternions * sign, OTHERS[largest], axis=1)


def join_largest(largest: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Unit quaternions (N, 4), the inverse of `split_largest`."""
    quaternions = np.empty((len(largest), 4))
    np.put_along_axis(quaternions, OTHERS[largest], others, axis=1)
    missing = np.sqrt(np.maximum(0.0, 1.0 - (others**2).sum(axis=1)))
    np.put_along_axis(quaternions, largest[:, None].astype(np.int64), missing[:, None], axis=1)
    return quaternions
