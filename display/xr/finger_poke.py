"""The finger that a controller stretches out while its trigger is touched or half pulled, and pushes with."""

from __future__ import annotations

import numpy as np

from display.xr.actions import PRESS, Controller
from scenes.scene import Touch

BEGIN = 0.1  # of the trigger's way
LENGTH, RADIUS = 0.09, 0.009  # [m] of the finger
STRETCH = 1 / 6  # of its length in a frame: were it there at once, it would be inside what is near


class FingerPoke:
    """How far one hand's finger is out, 0 to 1."""

    def __init__(self):
        self.out = 0.0

    def stretch(self, c: Controller, grips: bool) -> np.ndarray:
        """Stretch or draw in by a frame; where finger and thumb would meet (3,) in the play space."""
        wanted = c.fingers is None and (c.point or c.pinch > BEGIN) and c.grab < PRESS and not grips
        self.out = float(np.clip(self.out + (STRETCH if wanted else -STRETCH), 0.0, 1.0))
        return c.tip if c.tip is not None else c.grip[:3, 3] + LENGTH * ahead(c)

    def pieces(self, c: Controller) -> np.ndarray:
        """What this hand touches with, (n, 7): two ends and radius [m] in the play space."""
        if c.fingers is not None:
            return c.fingers
        if self.out == 0.0:
            return np.zeros((0, 7))
        start = c.grip[:3, 3]
        return np.concatenate([start, start + self.out * LENGTH * ahead(c), [RADIUS]])[None]


def ahead(c: Controller) -> np.ndarray:
    """Unit vector to where a controller points, in the play space."""
    return -(c.grip if c.aim is None else c.aim)[:3, 2]


def moved(pose: np.ndarray, to: np.ndarray) -> np.ndarray:
    """The same attitude (4, 4) at another place."""
    result = pose.copy()
    result[:3, 3] = to
    return result


def touches(stage: np.ndarray, pieces: np.ndarray) -> tuple[Touch, ...]:
    """Pieces (n, 7) of the play space, which stands in the world by `stage` (4, 4), as the solver takes them."""
    R, t = stage[:3, :3], stage[:3, 3]
    starts, ends = pieces[:, :3] @ R.T + t, pieces[:, 3:6] @ R.T + t
    rows = zip(starts.tolist(), ends.tolist(), pieces[:, 6].tolist(), strict=True)
    return tuple(Touch(tuple(a), tuple(b), r) for a, b, r in rows)
