"""Scripted hands that take a body, carry it and put it down, for films, tests and demonstrations."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from scenes.scene import BodyState, Hand, Vec3
from scenes.scripted_throw import ease

PLACING_TIME = 1.4  # [s] that `placing_hands` take


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
    """Two hands that put a standing body down on the ground at `place`, and draw it larger by `factor`.

    `t` [s] after the start, when the body was as in `body`.
    """
    x, middle, z = body.centroid
    s = ease((t - 0.3) / 0.8)
    way = np.array(place) + [0.0, factor * (middle - body.low[1]), 0.0] - body.centroid
    at = np.array([x, middle + 0.35 * np.sin(np.pi * s), z]) + s * way
    apart = 0.06 * (1 + (factor - 1) * s)
    return [Hand(tuple(at + [0.0, 0.0, d]), grip=0.2 < t < 1.25, reach=0.2) for d in (-apart, apart)]
