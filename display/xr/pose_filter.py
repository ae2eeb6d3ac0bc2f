"""Hands that were lost and are found again.

While a controller is not tracked, or another program has the input, its hand stays where it was and holds what it holds
(display/xr/player.py). Found again somewhere else, it is led there evenly within a moment, so that nothing it
holds is flung: at SPEED, in LONGEST at most, however the hand moves on meanwhile.
"""

from __future__ import annotations

import numpy as np

from core.rotation import matrices_from_quaternions, quaternions_from_matrices
from display.xr.actions import Controller

SPEED, TURNING = 2.0, 2 * np.pi  # [m/s], [rad/s] of a hand that is led
LONGEST = 0.5  # [s]


class PoseFilter:
    """`lead` the controllers of each frame."""

    def __init__(self):
        self._shown: list[np.ndarray | None] = [None, None]  # grip poses as they were given on
        self._left: list[float | None] = [0.0, 0.0]  # [s] until the hand is there; None while it is lost

    def lead(self, controllers: list[Controller], dt: float) -> None:
        """Change the grip poses of hands that have just been found. `dt` [s] is the frame's."""
        for h, c in enumerate(controllers):
            before = self._shown[h]
            if c.grip is None:
                self._left[h] = None
                continue
            if self._left[h] is None:
                self._left[h] = 0.0 if before is None else way(before, c.grip)
            if self._left[h] > 0.0:
                c.grip = towards(before, c.grip, min(1.0, dt / self._left[h]))
                self._left[h] = max(self._left[h] - dt, 0.0)
            self._shown[h] = c.grip


def way(a: np.ndarray, b: np.ndarray) -> float:
    """How long [s] a hand takes from one pose (4, 4) to another."""
    turned = np.arccos(np.clip((np.trace(a[:3, :3].T @ b[:3, :3]) - 1) / 2, -1, 1))
    return min(LONGEST, max(float(np.linalg.norm(b[:3, 3] - a[:3, 3])) / SPEED, float(turned) / TURNING))


def towards(a: np.ndarray, b: np.ndarray, share: float) -> np.ndarray:
    """The pose (4, 4) at a share of the way from a to b."""
    p, q = quaternions_from_matrices(a[:3, :3]), quaternions_from_matrices(b[:3, :3])
    q = (1 - share) * p + share * (q if p @ q >= 0 else -q)
    m = b.copy()
    m[:3, :3] = matrices_from_quaternions((q / np.linalg.norm(q))[None])[0]
    m[:3, 3] = (1 - share) * a[:3, 3] + share * b[:3, 3]
    return m
