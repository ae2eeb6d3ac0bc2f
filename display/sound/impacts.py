"""Impacts, found in the velocities of bodies that are read back each frame anyway: nothing is added to the solver."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from core.vocabulary import BodyState

SPEED_MIN = 0.2  # [m/s] of a fall from 2 mm: slower blows, and the shaking of soft bodies, are not heard
SUPPORT = 2.0  # times gravity's push in a frame: what a body that rests, rolls or sways gets from the ground
FORGET = 0.08  # [s] after a blow, which lasts for some frames where bodies are soft, until a lesser one is heard


class Impacts:
    """`detect` once a frame. What is held, or moved by the program, makes no sound."""

    def __init__(self):
        self.forget()

    def forget(self) -> None:
        """Begin anew: bodies were moved by something else than the simulation."""
        self._velocity: np.ndarray | None = None  # (B, 3) [m/s] of the last frame
        self._free = self._heard = np.empty(0)  # (B,) not held then; speed [m/s] that was heard and still rings

    def detect(self, bodies: Sequence[BodyState], dt: float, gravity: Sequence[float]) -> list[tuple[int, float]]:
        """Index of each body that was struck in the frame of `dt` [s], and the speed [m/s] of the blow.

        Contacts have changed the velocity by dv - g dt, along n. A body that hits something had been moving against n
        with the speed that counts; one that is hit was not, and the change itself counts, less what bears its weight. A
        change that is no larger than that is none.
        """
        velocity = np.array([b.velocity for b in bodies]).reshape(-1, 3)
        free = np.array([not (b.held or b.driven) for b in bodies], bool)
        before, was_free, heard = self._velocity, self._free, self._heard
        self._velocity, self._free = velocity, free
        if before is None or len(before) != len(velocity) or dt <= 0.0:
            self._heard = np.zeros(len(velocity))
            return []
        fall = dt * np.asarray(gravity)
        change = velocity - before - fall
        size = np.linalg.norm(change, axis=1)
        closing = -np.einsum("bi,bi->b", before, change) / np.maximum(size, 1e-9)
        beyond = size - SUPPORT * np.linalg.norm(fall)
        speed = np.where(closing > SPEED_MIN, closing, beyond)
        heard = np.where(beyond > 0, heard, heard * np.exp(-dt / FORGET))
        struck = free & was_free & (beyond > 0) & (speed > SPEED_MIN) & (speed > heard) & np.isfinite(speed)
        self._heard = np.where(struck, speed, heard)
        return [(int(k), float(speed[k])) for k in np.flatnonzero(struck)]
