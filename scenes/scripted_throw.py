"""Scripted hand that grasps a body, lifts it and throws it at a target, for films, tests and demonstrations."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from scenes.scene import Hand

GRAVITY = np.array([0.0, -9.81, 0.0])
STEADY_TIME = (
    0.1  # [s] at the velocity of the throw: a released body flies on with the hand's mean over the last moments
)
TIME_ROUNDING = 1e-6  # [s]; the frame that ends at the release still holds on, whatever its time was summed from


def throw_velocity(start, target, seconds: float) -> np.ndarray:
    """Velocity [m/s] that carries a point from `start` to `target` in free flight of `seconds`."""
    return (np.asarray(target) - np.asarray(start)) / seconds - 0.5 * GRAVITY * seconds


def ease(t: float) -> float:
    """0 to 1 with zero velocity at both ends."""
    t = min(max(t, 0.0), 1.0)
    return t * t * (3.0 - 2.0 * t)


@dataclass(frozen=True)
class Throw:
    """Grasp what lies within `grab_radius` [m] of `grasp`, lift it, and throw it from `release` to `target` [m].

    Times [s]: `approach_time` to reach it, `lift_time` to lift it to the run-up, `acceleration_time` of constant
    acceleration to the velocity that hits the target after `flight_time`, then STEADY_TIME at that velocity.
    """

    grasp: tuple[float, float, float]
    release: tuple[float, float, float]
    target: tuple[float, float, float]
    grab_radius: float = 0.04
    approach_time: float = 0.5
    lift_time: float = 0.9
    acceleration_time: float = 0.3
    flight_time: float = 0.45

    @property
    def released_at(self) -> float:
        """Time [s] from the start until the hand opens."""
        return self.approach_time + self.lift_time + self.acceleration_time + STEADY_TIME

    def hand(self, t: float) -> Hand:
        """The hand, `t` seconds after the start of this throw."""
        grasp, release = np.array(self.grasp), np.array(self.release)
        velocity = throw_velocity(release, self.target, self.flight_time)
        run_up = release - velocity * (0.5 * self.acceleration_time + STEADY_TIME)
        above = grasp + np.array([0.0, 0.25, 0.1])
        lifted = t - self.approach_time
        accelerating = lifted - self.lift_time
        if lifted < 0:
            position = above + (grasp - above) * ease(t / self.approach_time)
        elif accelerating < 0:
            position = grasp + (run_up - grasp) * ease(lifted / self.lift_time)
        elif t <= self.released_at + TIME_ROUNDING:
            steady = max(accelerating - self.acceleration_time, 0.0)
            position = run_up + velocity * (0.5 * (accelerating - steady) ** 2 / self.acceleration_time + steady)
        else:  # follow through, slowing down
            after = t - self.released_at
            position = release + velocity * 0.1 * (1.0 - np.exp(-after / 0.1))
        grips = self.approach_time <= t <= self.released_at + TIME_ROUNDING
        return Hand(position=tuple(position), grip=grips, reach=self.grab_radius)
