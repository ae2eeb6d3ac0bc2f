"""Going with bare hands: the left one pinches at nothing and points at the floor, and where it lets go one stands.

Where a body is between finger and thumb, or within reach of them, the pinch is for that. Pointing anywhere but at the
floor, or a hand that is lost, changes nothing. To turn, one turns.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from display.xr.actions import LET_GO, PRESS, Controller

FARTHEST = 6.0  # [m] to go at once
NEAR = 0.05  # [m] from a body's bounds within which a pinch may be meant for it
DOWN = 0.12  # sine of the angle below the horizon from which on a hand points at the floor, and not just ahead


class Teleport:
    """What the left hand does about it."""

    def __init__(self):
        self._down = self._goes = False  # does it pinch; was that to go somewhere

    def lead(self, c: Controller, stage: np.ndarray, world) -> Controller:
        """The controller that the hand is instead: while it shows where to go, its stick is pushed and it holds
        nothing. `stage` (4, 4) is where the play space stands in the world, which may be None yet."""
        if c.grip is None and self._goes:  # lost: it goes on, but where it points nobody knows
            return replace(c, stick=(0.0, 1.0))
        if c.joints is None:
            self._down = self._goes = False
            return c
        pinches = c.pinch > (LET_GO if self._down else PRESS)
        began, self._down = pinches and not self._down, pinches
        if began and world is not None:
            aim = stage @ c.aim
            floor = on_the_floor(aim) is not None and -aim[1, 2] < -DOWN
            self._goes = floor and not any(near(b, (stage @ [*c.tip, 1.0])[:3]) for b in world.bodies())
        self._goes = self._goes and pinches
        return replace(c, stick=(0.0, 1.0), pinch=0.0) if self._goes else c


def near(body, point: np.ndarray) -> bool:
    """Whether a point (3,) is at most NEAR from the bounds of a body (BodyState)."""
    return float(np.linalg.norm(np.maximum(np.maximum(body.low - point, point - body.high), 0.0))) <= NEAR


def on_the_floor(aim: np.ndarray) -> np.ndarray | None:
    """Where a pointing hand (4, 4) meets y = 0 [m], no farther than FARTHEST; None if it points up."""
    start, way = aim[:3, 3], -aim[:3, 2]
    if way[1] >= -1e-3 or start[1] <= 0:
        return None
    spot = start - way * (start[1] / way[1])
    aside = spot - start
    length = np.hypot(aside[0], aside[2])
    return start + aside * min(1.0, FARTHEST / max(length, 1e-9))
