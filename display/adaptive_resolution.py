"""Controllers of picture resolution: for a window, which is redrawn finer once the scene is still, and for a headset.

Both scale a side of the picture by a factor in (0, 1] so that frames keep their time budget.
"""

from __future__ import annotations

from collections import deque


class AdaptiveResolution:
    """Resolution in a window: as many pixels as hold the rate while anything moves, all of them once all is still.

    `scale` after each frame's `note`. The level found for the machine is kept while nothing moves.
    """

    LEVELS = (1.0, 0.75, 0.5)  # scales of a side
    MAX_FRAME_TIME = 1 / 25  # [s] of a frame while anything moves
    STILL_AFTER = 0.25  # [s] without motion before the picture is refined
    FRAMES_PER_LEVEL = 4  # before the next decision: the first one after a change is not typical
    BLEND = 0.3  # weight of the latest frame in the mean

    def __init__(self):
        self._level, self._frames, self._mean = 0, 0, 0.0
        self._moved = -self.STILL_AFTER
        self._now = 0.0

    def note(self, now: float, seconds: float, *, moving: bool) -> None:
        """Note a frame that ended at `now` [s] and took `seconds`; `moving`: the camera or anything in view moved."""
        was_moving, self._now = self._now - self._moved < self.STILL_AFTER, now
        if not moving:
            return
        self._moved = now
        if not was_moving:  # it was drawn finer than the next one
            self._frames = 0
            return
        self._frames += 1
        self._mean = seconds if self._frames == 1 else self._mean + self.BLEND * (seconds - self._mean)
        if self._frames < self.FRAMES_PER_LEVEL:
            return
        if self._mean > 1.2 * self.MAX_FRAME_TIME and self._level + 1 < len(self.LEVELS):
            self._change(1)
        elif self._level > 0:
            growth = (self.LEVELS[self._level - 1] / self.LEVELS[self._level]) ** 2  # if pixels took all the time
            if self._mean * growth < 0.9 * self.MAX_FRAME_TIME:
                self._change(-1)

    def _change(self, step: int) -> None:
        self._level, self._frames = self._level + step, 0

    @property
    def scale(self) -> float:
        """Scale of a side of the next frame's picture against the window's."""
        return self.LEVELS[self._level] if self._now - self._moved < self.STILL_AFTER else 1.0


class DynamicResolution:
    """Resolution in a headset: as many pixels as hold its rate. `note` each frame's work, then draw `size`.

    A frame's work is a part that grows with the pixels and one that does not. One change makes a side at most
    MAX_SHRINK smaller or MAX_GROWTH larger. A frame that took `seconds` of a `budget` is too slow above HIGH_LOAD of
    it, and has time left below LOW_LOAD. A larger picture takes at most (1 + MAX_GROWTH)^2 as long, and
    LOW_LOAD (1 + MAX_GROWTH)^2 = 0.78 < HIGH_LOAD: growing alone never makes a frame too slow, so the size does not
    oscillate. Growing takes GROW_AFTER frames that all had time left, shrinking SLOW_FRAMES of the last RECENT_FRAMES
    that were too slow: a single hitch, which fewer pixels would not have avoided, changes nothing. Neither do frames
    that are slow for other reasons: where drawing is less than MIN_DRAWING of the work, fewer pixels would not help.

    `full` is the (width, height) [px] of the largest picture.
    """

    HIGH_LOAD, LOW_LOAD = 0.9, 0.7  # of the budget
    MAX_SHRINK, MAX_GROWTH = 0.15, 0.055  # of a side in one change
    RECENT_FRAMES, SLOW_FRAMES = 6, 4
    GROW_AFTER = 45  # frames, half a second
    MIN_DRAWING = 0.2  # of a frame's work
    SKIPPED_FRAMES = 3  # after a change: the first is not typical
    MIN_SCALE = 0.5  # of a side
    ROUNDING = 8  # [px] to which a side is rounded

    def __init__(self, full: tuple[int, int]):
        self.full, self.scale = full, 1.0
        self._too_slow: deque[bool] = deque(maxlen=self.RECENT_FRAMES)
        self._fast_frames, self._skip = 0, self.SKIPPED_FRAMES

    @property
    def size(self) -> tuple[int, int]:
        """(width, height) [px] to draw now, never larger than `full`."""
        if self.scale == 1.0:
            return self.full
        grain = self.ROUNDING
        return tuple(min(side, max(grain, round(side * self.scale / grain) * grain)) for side in self.full)

    def note(self, seconds: float, budget: float, drawing: float | None = None) -> None:
        """Note a frame that took `seconds` of a `budget` [s], of these `drawing` for pixels."""
        if self._skip:
            self._skip -= 1
            return
        load = seconds / budget
        self._too_slow.append(load > self.HIGH_LOAD and (drawing is None or drawing > self.MIN_DRAWING * seconds))
        self._fast_frames = self._fast_frames + 1 if load < self.LOW_LOAD else 0
        if self._too_slow[-1] and sum(self._too_slow) >= self.SLOW_FRAMES:
            self.hold(self.scale * max(1.0 - self.MAX_SHRINK, (self.HIGH_LOAD * 0.95 / load) ** 0.5))
        elif self._fast_frames >= self.GROW_AFTER:
            self.hold(self.scale * (1.0 + self.MAX_GROWTH))

    def hold(self, scale: float) -> None:
        """Draw this scale of a side from now on, and look at the next frames anew."""
        self.scale = min(1.0, max(self.MIN_SCALE, scale))
        self._too_slow.clear()
        self._fast_frames, self._skip = 0, self.SKIPPED_FRAMES
