"""The body under the cursor, which a press of the button would take."""

from __future__ import annotations

from time import perf_counter

from core.camera import Camera
from core.vocabulary import BodyState
from display.protocol import WorldView

PERIOD = 0.05  # [s] between two looks
OPACITY = 0.5  # of the corners around it


class Hover:
    """Looks for the body when something moves, but not in each frame: a look costs as much as a ray into the world."""

    def __init__(self):
        self._found: tuple[int | None, float] = (None, 0.0)  # and when [s]
        self._cursor: tuple[float, float] | None = None  # of the last look

    def under(
        self, world: WorldView, camera: Camera, cursor: tuple[float, float] | None, *, moving: bool
    ) -> BodyState | None:
        """The body under the cursor (u, v) [px of the camera]; a cursor of None takes nothing.

        moving  the camera or anything in view moved
        """
        if cursor is None or not world.editable or world.demo:
            self._found, self._cursor = (None, 0.0), None
            return None
        now = perf_counter()
        if now - self._found[1] > PERIOD and (moving or cursor != self._cursor):
            hit, self._cursor = world.pick(*camera.ray(*cursor)), cursor
            self._found = (None if hit is None else hit[1], now)
        bodies, k = world.bodies(), self._found[0]
        return bodies[k] if k is not None and k < len(bodies) and not bodies[k].held else None
