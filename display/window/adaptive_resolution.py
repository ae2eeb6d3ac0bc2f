"""How fine to draw in a window: as many pixels as keep the pace while things move, all of them once they are still."""

from __future__ import annotations

LEVELS = (1.0, 0.75, 0.5)  # share of the window's pixels a side
PACE = 1 / 25  # [s] that a frame may take while things move
STILL = 0.25  # [s] without motion before the picture is refined
SETTLE = 4  # frames at a level before the next decision: the first one after a change is not typical
BLEND = 0.3  # weight of the latest frame in the mean


class AdaptiveResolution:
    """`share` after each frame's `note`. What was found out about the machine is kept while nothing moves."""

    def __init__(self):
        self._level, self._frames, self._mean = 0, 0, 0.0
        self._moved = -STILL
        self._now = 0.0

    def note(self, now: float, seconds: float, *, moving: bool) -> None:
        """A frame ended at `now` [s] that took `seconds`; `moving`: the camera or something before it moved."""
        was_moving, self._now = self._now - self._moved < STILL, now
        if not moving:
            return
        self._moved = now
        if not was_moving:  # it was drawn finer than what comes now
            self._frames = 0
            return
        self._frames += 1
        self._mean = seconds if self._frames == 1 else self._mean + BLEND * (seconds - self._mean)
        if self._frames < SETTLE:
            return
        if self._mean > 1.2 * PACE and self._level + 1 < len(LEVELS):
            self._change(1)
        elif self._level > 0:
            growth = (LEVELS[self._level - 1] / LEVELS[self._level]) ** 2  # if pixels were all that took time
            if self._mean * growth < 0.9 * PACE:
                self._change(-1)

    def _change(self, step: int) -> None:
        self._level, self._frames = self._level + step, 0

    @property
    def share(self) -> float:
        """Share of the window's pixels a side that the next frame should have."""
        return LEVELS[self._level] if self._now - self._moved < STILL else 1.0
