"""A hand made of the mouse: grips what was clicked, follows the cursor, throws on release."""

from __future__ import annotations

import numpy as np

from assets.camera import Camera
from scenes.scene import Hand

FOLLOW = 0.03  # [s], time constant of the hand behind the cursor: evens out the events of slow mice
FASTEST = 8.0  # [m/s]; a hard throw by a real hand, and a flick of the wrist on a mouse pad can ask for more
NEAREST, FARTHEST = 0.1, 50.0  # [m] depth of the hand before the camera


class MouseHand:
    """The hand stands at a screen position (u, v) [px] and a depth [m] along the view axis.

    Both are kept in the camera's frame, so a camera that moves during a drag carries the hand along.
    """

    def __init__(self):
        self.gripping = False
        self.position = np.zeros(3)
        self._u = self._v = self._depth = self._reach = 0.0

    def grab(self, camera: Camera, u: float, v: float, distance: float, reach: float) -> None:
        """Grip at `distance` [m] along the ray through (u, v); takes what lies within `reach` [m]."""
        origin, direction = camera.ray(u, v)
        self.position = origin + distance * direction
        self._u, self._v, self._reach = u, v, reach
        self._depth = distance * float(direction @ camera.world_to_camera[2, :3])
        self.gripping = True

    def drag(self, du: float, dv: float) -> None:
        """Move in the plane parallel to the screen [px]."""
        self._u, self._v = self._u + du, self._v + dv

    def push(self, amount: float) -> None:
        """Move away (positive) or towards the camera by a factor exp(amount) of the depth."""
        self._depth = float(np.clip(self._depth * np.exp(amount), NEAREST, FARTHEST))

    def release(self) -> None:
        """Let go: what was held flies on with the hand's speed."""
        self.gripping = False

    def hand(self, camera: Camera, dt: float) -> Hand:
        """The hand after `dt` [s]: it closes in on the cursor, at most `FASTEST`."""
        if self.gripping:
            origin, direction = camera.ray(self._u, self._v)
            goal = origin + direction * (self._depth / float(direction @ camera.world_to_camera[2, :3]))
            step = (goal - self.position) * (1.0 - np.exp(-dt / FOLLOW))
            length = np.linalg.norm(step)
            if length > FASTEST * dt:
                step *= FASTEST * dt / length
            self.position = self.position + step
        return Hand(position=tuple(map(float, self.position)), grip=self.gripping, reach=self._reach or Hand.reach)
