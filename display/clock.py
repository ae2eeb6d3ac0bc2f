"""Clock of the world in a headset: the simulation advances to the time at which the picture will be seen.

The world is simulated up to the predicted time of display, however many frames were missed, in equal steps no longer
than the display's period (or MAX_STEP). No time is left over for an interpolation of states, which would cost a copy of
all vertices and show held bodies up to a step behind the hand.

On a slow machine a frame catches up with no more than max(MIN_CATCH_UP, CATCH_UP_TIME (1 - cost)), where `cost` is the
number of seconds that it takes to simulate one. Catching up with a gap g takes cost g, during which cost g more passes,
and so on: g / (1 - cost) in all. So every gap is closed within CATCH_UP_TIME, and where cost >= 1 the world is slower.
The remaining time is dropped, and counted in `dropped`.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

import numpy as np

from core.rotation import interpolate_quaternions
from core.vocabulary import Hand, Touch

MAX_STEP, MIN_PERIOD = 1 / 60, 1 / 240  # [s] longest step, and shortest period that is believed
MIN_CATCH_UP = 1 / 20  # [s] that a frame always catches up with
CATCH_UP_TIME = 0.5  # [s] within which a gap is closed
MISSED_PERIODS = 1.5  # between two frames, from which on the frames between were missed
JUMP_DISTANCE = 1.0  # [m] in a frame: a hand that moves farther is placed, not swept
STEP_SLACK = 0.25  # of a step: jitter of the prediction does not split a step


@dataclass(frozen=True)
class Tick:
    """Time that a frame simulates [s], its longest step [s], the display's period [s], and the missed frames before."""

    dt: float
    max_step: float
    period: float
    missed: int


class Clock:
    """`advance` once a frame. `time` [s] is the sum of all ticks, `dropped` [s] what was never simulated."""

    def __init__(self):
        self.time = self.dropped = 0.0
        self._last: int | None = None

    def rest(self) -> None:
        """Pause while nothing is shown."""
        self._last = None

    def advance(self, shown: int, period: int, cost: float | None) -> Tick:
        """Advance to the frame displayed at `shown` [ns], with the display's `period` [ns].

        `cost` is None while it is unknown, as kernels are being compiled: time that passes then is not counted.
        """
        last, self._last = self._last, shown
        seconds = max(period * 1e-9, MIN_PERIOD)
        step = min(seconds, MAX_STEP)
        if last is None or shown <= last:  # the first frame, or another clock
            self.time += step
            return Tick(step, step, seconds, 0)
        passed = shown - last
        missed = round(passed / period) - 1 if 0 < MISSED_PERIODS * period < passed else 0
        dt, dropped = caught_up(passed * 1e-9, cost)
        self.dropped += dropped
        self.time += dt
        return Tick(dt, step, seconds, missed)


def caught_up(seconds: float, cost: float | None) -> tuple[float, float]:
    """Time [s] that a frame simulates after `seconds`, and what is left out, if simulating one takes `cost` seconds.

    `cost` is None while it is unknown, as kernels are being compiled: time that passes then does not count.
    """
    if cost is None:
        return min(seconds, MIN_CATCH_UP), 0.0
    dt = min(seconds, max(MIN_CATCH_UP, CATCH_UP_TIME * (1.0 - cost)))
    return dt, seconds - dt


class SimulationCost:
    """Seconds of computing for a second of simulation: the median of the last frames, robust against a single hitch."""

    def __init__(self):
        self._samples: deque[float] = deque(maxlen=9)  # [s] each
        self._first = True

    def note(self, seconds: float, dt: float) -> None:
        """Note that it took `seconds` to simulate `dt` [s]. The first call includes compilation and does not count."""
        if dt > 0.0 and not self._first:
            self._samples.append(seconds / dt)
        self._first &= dt <= 0.0

    @property
    def value(self) -> float | None:
        """The median; None before the second call of `note`."""
        return float(np.median(self._samples)) if self._samples else None


def frame_steps(dt: float, step: float | None, before: list[Hand], now: list[Hand]) -> list[tuple[float, list[Hand]]]:
    """Steps of a frame: the length of each [s], and the hands at its end.

    step    longest step [s]; None: one step of any length
    before  hands at the beginning of the frame, `now` at its end; poses in between are interpolated
    """
    n = 1 if step is None else max(1, math.ceil(dt / step - STEP_SLACK))
    pairs = list(zip([*before, *[None] * len(now)], now, strict=False))
    between = [[interpolate_hand(a, b, k / n) for a, b in pairs] for k in range(1, n)]
    return [(dt / n, hands) for hands in [*between, now]]


def interpolate_hand(before: Hand | None, now: Hand | None, fraction: float) -> Hand | None:
    """Hand at a fraction (0 <= fraction < 1) between two poses, its finger capsules and reach too.

    The grip changes only at the end. One that was not there before, or is suddenly JUMP_DISTANCE away, is at its
    present pose.
    """
    if before is None or now is None or not math.dist(before.position, now.position) < JUMP_DISTANCE:
        return now

    def between(a, b):
        return tuple((x + fraction * (y - x)) for x, y in zip(a, b, strict=True))

    touch = before.touch
    if len(before.touch) == len(now.touch):
        touch = tuple(
            Touch(between(a.a, b.a), between(a.b, b.b), a.radius + fraction * (b.radius - a.radius))
            for a, b in zip(before.touch, now.touch, strict=True)
        )
    return Hand(
        between(before.position, now.position),
        tuple(interpolate_quaternions(before.rotation, now.rotation, fraction).tolist()),
        before.grip,
        before.reach + fraction * (now.reach - before.reach),
        touch,
    )
