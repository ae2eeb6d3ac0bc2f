"""Resolution of the picture: as many pixels as keep the frame time, in a headset and, in motion, in a window."""

from __future__ import annotations

from collections import deque


class DynamicResolution:
    """As many pixels as keep a frame's time. `note` each frame's work, then draw `size`.

    A frame's work is a part that grows with the pixels and one that does not. One change makes a side at most
    `max_shrink` smaller or MAX_GROWTH larger. A frame that took `seconds` of a `budget` is too slow above HIGH_LOAD of
    it, and has time left below LOW_LOAD. A larger picture takes at most (1 + MAX_GROWTH)^2 as long, and
    LOW_LOAD (1 + MAX_GROWTH)^2 = 0.78 < HIGH_LOAD: growing alone never makes a frame too slow, so the size does not
    oscillate. Growing takes GROW_AFTER frames that all had time left, shrinking SLOW_FRAMES of the last RECENT_FRAMES
    that were too slow: a single hitch, which fewer pixels would not have avoided, changes nothing. Neither do frames
    that are slow for other reasons: where drawing is less than MIN_DRAWING of the work, fewer pixels would not help.

    `full` is the (width, height) [px] of the largest picture.
    """

    HIGH_LOAD, LOW_LOAD = 0.9, 0.7  # of the budget
    MAX_SHRINK, MAX_GROWTH = 0.15, 0.055  # of a side in one change; more would be seen in a headset
    RECENT_FRAMES, SLOW_FRAMES = 6, 4
    GROW_AFTER = 45  # frames, half a second
    MIN_DRAWING = 0.2  # of a frame's work
    SKIPPED_FRAMES = 3  # after a change: the first is not typical
    MIN_SCALE = 0.5  # of a side
    ROUNDING = 8  # [px] to which a side is rounded

    def __init__(self, full: tuple[int, int], *, max_shrink: float = MAX_SHRINK):
        self.full, self.scale, self._max_shrink = full, 1.0, max_shrink
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
            self.hold(self.scale * max(1.0 - self._max_shrink, (self.HIGH_LOAD * 0.95 / load) ** 0.5))
        elif self._fast_frames >= self.GROW_AFTER:
            self.hold(self.scale * (1.0 + self.MAX_GROWTH))

    def hold(self, scale: float) -> None:
        """Draw this scale of a side from now on, and look at the next frames anew."""
        self.scale = min(1.0, max(self.MIN_SCALE, scale))
        self._too_slow.clear()
        self._fast_frames, self._skip = 0, self.SKIPPED_FRAMES


class WindowResolution:
    """Resolution in a window: what DynamicResolution finds while anything moves, all pixels once all is still.

    `note` each frame, then draw `size`. What was found for the machine is kept while nothing moves.
    """

    FRAME_TIME = 1 / 20  # [s] of a frame while anything moves
    MAX_SHRINK = 0.5  # of a side in one change: a slow machine must not take seconds to find its size
    MIN_SIDE = 16  # [px]
    STILL_AFTER = 0.25  # [s] without motion before the picture is refined

    def __init__(self):
        self._dynamic = DynamicResolution((1, 1), max_shrink=self.MAX_SHRINK)
        self._now, self._moved = 0.0, -self.STILL_AFTER

    def note(self, now: float, seconds: float, drawing: float | None = None, *, moving: bool) -> None:
        """Note a frame that ended at `now` [s] and took `seconds`, of these `drawing` for pixels.

        moving  the camera or anything in view moved
        """
        was_still, self._now = self.still, now
        if not moving:
            return
        self._moved = now
        if was_still:  # it was drawn finer than the next one
            self._dynamic.hold(self._dynamic.scale)
        self._dynamic.note(seconds, self.FRAME_TIME, drawing)

    @property
    def still(self) -> bool:
        """True once nothing has moved for STILL_AFTER."""
        return self._now - self._moved >= self.STILL_AFTER

    def size(self, full: tuple[int, int], scale: float | None = None) -> tuple[int, int]:
        """(width, height) [px] of the next picture in a window of `full`; `scale` of a side, if the user chose one."""
        self._dynamic.full = full
        if scale is not None:
            full = tuple(round(side * scale) for side in full)
        elif not self.still:
            full = self._dynamic.size
        return tuple(max(self.MIN_SIDE, side) for side in full)
