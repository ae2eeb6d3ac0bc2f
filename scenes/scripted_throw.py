"""A scripted hand that takes a thing, carries it and throws it where it is told.

It is what plays a scene when nobody is there: in a recording, in a test, as a demonstration.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from scenes.scene import Hand

GRAVITY = np.array([0.0, -9.81, 0.0])
STEADY = 0.1  # [s] at the velocity of the throw: the mean of the last moments is what a thing flies on with
ROUNDING = 1e-6  # [s]; the frame that ends at the release must still swing, whatever its time was summed from


def throw_velocity(start, target, seconds: float) -> np.ndarray:
    """Velocity [m/s] that carries a point from `start` to `target` in free flight of `seconds`."""
    return (np.asarray(target) - np.asarray(start)) / seconds - 0.5 * GRAVITY * seconds


def ease(t: float) -> float:
    """0 to 1 with zero velocity at both ends."""
    t = min(max(t, 0.0), 1.0)
    return t * t * (3.0 - 2.0 * t)


@dataclass(frozen=True)
class Throw:
    """Take what lies at `grip`, carry it to the run-up, throw it from `release` to `target`.

    Times [s]: `reach_time` to reach it, `carry_time` to lift it, `swing_time` of constant acceleration
    up to the velocity that `flight_time` asks for, then STEADY. `reach` [m] is the grip's radius.
    """

    grip: tuple[float, float, float]
    release: tuple[float, float, float]
    target: tuple[float, float, float]
    reach: float = 0.04
    reach_time: float = 0.5
    carry_time: float = 0.9
    swing_time: float = 0.3
    flight_time: float = 0.45

    @property
    def released_at(self) -> float:
        """Seconds from the start until the hand opens."""
        return self.reach_time + self.carry_time + self.swing_time + STEADY

    def hand(self, t: float) -> Hand:
        """The hand, `t` seconds after the start of this throw."""
        grip, release = np.array(self.grip), np.array(self.release)
        velocity = throw_velocity(release, self.target, self.flight_time)
        run_up = release - velocity * (0.5 * self.swing_time + STEADY)
        above = grip + np.array([0.0, 0.25, 0.1])
        lifted = t - self.reach_time
        swung = lifted - self.carry_time
        if lifted < 0:
            position = above + (grip - above) * ease(t / self.reach_time)
        elif swung < 0:
            position = grip + (run_up - grip) * ease(lifted / self.carry_time)
        elif t <= self.released_at + ROUNDING:
            fast = max(swung - self.swing_time, 0.0)
            position = run_up + velocity * (0.5 * (swung - fast) ** 2 / self.swing_time + fast)
        else:  # follow through, slowing down
            after = t - self.released_at
            position = release + velocity * 0.1 * (1.0 - np.exp(-after / 0.1))
        grips = self.reach_time <= t <= self.released_at + ROUNDING
        return Hand(position=tuple(position), grip=grips, reach=self.reach)
