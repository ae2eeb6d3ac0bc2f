"""Scripted hand that takes a body, carries it and puts it down, for films, tests and demonstrations."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from scenes.scene import Hand, Vec3
from scenes.scripted_throw import ease


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
