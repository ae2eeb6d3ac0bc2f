"""Positions and velocities of all vertices as the host sees them: read, written, checked, in single precision twice.

Each quantity is a pair of float32 arrays, of which the second holds what lies under the last bit of the first.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from core.errors import BadInput
from core.fields import Download, Upload
from sim.state import State

MOTION = ("x", "x_lo", "v", "v_lo")  # arrays of a snapshot


class MotionArrays:
    """Copies of a state's motion, (4, V, 3) float32 in the order of MOTION."""

    def __init__(self, state: State):
        self.state = state
        fields = [getattr(state, name) for name in MOTION]
        self._download, self._upload = Download(fields), Upload(fields)

    def read(self) -> np.ndarray:
        """The motion of all vertices."""
        return self._download(self.state.sizes.vertices)

    def read_exactly(self) -> tuple[np.ndarray, np.ndarray]:
        """Positions [m] and velocities [m/s] of all vertices, (V, 3) float64."""
        x, x_lo, v, v_lo = self.read().astype(np.float64)
        return x + x_lo, v + v_lo

    def write(self, motion: Sequence[np.ndarray]) -> None:
        """Set the motion of all vertices, four arrays (V, 3)."""
        self._upload(list(motion))


def motion_of(snapshot: dict, vertices: int) -> list[np.ndarray]:
    """The four arrays of a snapshot with at least "x" and "v", which may be float64. Raises BadInput."""
    motion = []
    for name, low in (("x", "x_lo"), ("v", "v_lo")):
        value = np.asarray(snapshot[name])
        if value.shape != (vertices, 3) or not np.isfinite(value).all():
            raise BadInput(f"snapshot: {name} must be finite and of shape {(vertices, 3)}, not {value.shape}")
        high = value.astype(np.float32)
        motion += [high, snapshot.get(low, value - high)]
    return motion
