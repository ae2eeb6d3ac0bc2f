"""How many pixels to draw so that the headset's rate holds.

A frame's work is a part that grows with the pixels and one that does not. One change makes a side at most DOWN
smaller or UP larger. A frame that took `seconds` of a `budget` is too slow above HIGH of it, and has room below LOW. A
larger picture takes at most (1 + UP)^2 as long, and LOW (1 + UP)^2 = 0.78 < HIGH: growing alone never makes a frame
too slow, so nothing swings to and fro. Growing takes PATIENT frames that all had room, shrinking QUICK of the last
FEW that were too slow: a single hitch, which no number of pixels would have spared, changes nothing. Nor does what is
slow for other reasons: where drawing is less than MATTERS of the work, fewer pixels would only be ugly.
"""

from __future__ import annotations

from collections import deque

HIGH, LOW = 0.9, 0.7  # of the budget
DOWN, UP = 0.15, 0.055  # of a side in one change
FEW, QUICK = 6, 4  # frames; of which so many are too slow
PATIENT = 45  # frames, half a second
MATTERS = 0.2  # of a frame's work
SETTLE = 3  # frames after a change that are not looked at: the first is not typical
LEAST = 0.5  # of a side: coarser is not worth seeing
GRAIN = 8  # [px] to which a side is rounded


class DynamicResolution:
    """`note` each frame's work, then draw pictures of `size`.

    full   (width, height) [px] of the largest picture
    least  the smallest share of a side
    """

    def __init__(self, full: tuple[int, int], *, least: float = LEAST):
        self.full, self.least, self.share = full, least, 1.0
        self._recent: deque[bool] = deque(maxlen=FEW)
        self._roomy, self._skip = 0, SETTLE

    @property
    def size(self) -> tuple[int, int]:
        """(width, height) [px] to draw now, never larger than `full`."""
        if self.share == 1.0:
            return self.full
        return tuple(min(side, max(GRAIN, round(side * self.share / GRAIN) * GRAIN)) for side in self.full)

    def note(self, seconds: float, budget: float, drawing: float | None = None) -> bool:
        """A frame took `seconds` of work, of these `drawing` for pixels, and had `budget` [s]; whether `size` is now
        another one."""
        if self._skip:
            self._skip -= 1
            return False
        load = seconds / budget
        self._recent.append(load > HIGH and (drawing is None or drawing > MATTERS * seconds))
        self._roomy = self._roomy + 1 if load < LOW else 0
        if self._recent[-1] and sum(self._recent) >= QUICK:
            return self._go(max(1.0 - DOWN, (HIGH * 0.95 / load) ** 0.5))
        if self._roomy >= PATIENT:
            return self._go(1.0 + UP)
        return False

    def hold(self, share: float) -> bool:
        """Draw this share of a side, whatever frames take; whether `size` is now another one."""
        return self._go(share / self.share)

    def _go(self, factor: float) -> bool:
        before = self.size
        self.share = min(1.0, max(self.least, self.share * factor))
        self._recent.clear()
        self._roomy, self._skip = 0, SETTLE
        return self.size != before
