"""Scripted hands: one that throws a body, one that carries it, for films, tests and demonstrations."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from scenes.scene import BodyState, Hand, Vec3

GRAVITY = np.array([0.0, -9.81, 0.0])
STEADY_TIME = 0.1  # [s] at the velocity of the throw: a released body flies on with the hand's mean velocity
TO_SIDE = 1.9  # reach of a hand in a body that is drawn at its side, by the way there: see GRASP_DEPTH of the avatar
PLACING_TIME = 1.4  # [s] that `placing_hands` take
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

    @classmethod
    def of(cls, thing: BodyState, release, target, **times: float) -> Throw:
        """A throw of a whole body, taken anywhere."""
        size = float(np.ptp([thing.low, thing.high], axis=0).max())
        return cls(tuple(thing.centroid), release, target, grab_radius=0.7 * size, acceleration_time=0.15, **times)

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


@dataclass(frozen=True)
class Carry:
    """Take what lies within `reach` [m] of `grasp`, lift it to `height` [m], carry it to `to` [m] and let go there.

    Times [s]: `approach_time` until the hand closes, `lift_time`, `carry_time`, `lower_time`, and `rest_time` until it
    opens.
    """

    grasp: Vec3
    to: Vec3
    height: float
    reach: float = 0.08
    approach_time: float = 0.4
    lift_time: float = 0.35
    carry_time: float = 0.5
    lower_time: float = 0.3
    rest_time: float = 0.1

    @property
    def released_at(self) -> float:
        """Time [s] from the start until the hand opens."""
        return self.approach_time + self.lift_time + self.carry_time + self.lower_time + self.rest_time

    def hand(self, t: float) -> Hand:
        """The hand, `t` seconds after the start."""
        grasp, to = np.array(self.grasp, float), np.array(self.to, float)
        over, above = np.array([grasp[0], self.height, grasp[2]]), np.array([to[0], self.height, to[2]])
        path = [over, grasp, over, above, to, to, above]
        spans = [self.approach_time, self.lift_time, self.carry_time, self.lower_time, self.rest_time, 0.3]
        ends = np.cumsum(spans)
        k = min(int(np.searchsorted(ends, t, side="right")), len(spans) - 1)
        position = path[k] + (path[k + 1] - path[k]) * ease((t - ends[k] + spans[k]) / spans[k])
        return Hand(tuple(position), grip=self.approach_time <= t < self.released_at, reach=self.reach)


def placing_hands(body: BodyState, place: Vec3, factor: float, t: float) -> list[Hand]:
    """Two hands that put a standing body down at `place` and scale it by `factor`; their reach is to its side.

    `t` is the time [s] since the start, `body` the state at the start.
    """
    x, middle, z = body.centroid
    s = ease((t - 0.3) / 0.8)
    way = np.array(place) + [0.0, factor * (middle - body.low[1]), 0.0] - body.centroid
    at = np.array([x, middle + 0.35 * np.sin(np.pi * s), z]) + s * way
    size = 1 + (factor - 1) * s
    apart, half = 0.06 * size, 0.5 * (body.high[2] - body.low[2]) * size
    grips = 0.2 < t < 1.25
    return [Hand(tuple(at + [0.0, 0.0, d]), grip=grips, reach=TO_SIDE * (half - d)) for d in (-apart, apart)]
