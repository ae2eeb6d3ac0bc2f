"""Box moving: carry the attic's boxes to the pallet, and see what the biggest one hid (VR-GS, Sec. 6.2).

With --capture ROOM/ it plays on the floor of a captured room.
"""

from __future__ import annotations

import numpy as np

from scenes.attic_floor import BACKGROUND, FAR, HOLE, PALLET, PLACES, SIZES, boxes, colliders, furniture, lamp, room
from scenes.captured_room import in_captured_room
from scenes.scene import BodyState, Hand, Role, Scene
from scenes.scripted_throw import ease

NAMES = list(PLACES)
APPROACH, LIFT, CARRY, LOWER, LEAVE = 0.3, 0.5, 0.9, 0.5, 0.2  # [s] of the scripted hand with each box
WIDE_GRIP = 0.4  # reach of the hand over a box's width: held by a small spot, a soft box swings
CLEARANCE = 0.30  # [m] between a box that is carried and the pallet
TURN = APPROACH + LIFT + CARRY + LOWER + LEAVE  # [s]


class BoxMoving:
    """A box scores while it stands on the pallet and no hand holds it."""

    duration = TURN * len(NAMES) + 0.6
    goal = len(NAMES)

    def __init__(self):
        self.starts = [np.array(body.position) for body in boxes()]
        self.reset()

    def reset(self) -> None:
        self.placed: set[int] = set()
        self.found = False

    def update(self, time: float, bodies: list[BodyState]) -> None:
        self.placed = {k for k, b in enumerate(bodies) if on_pallet(b) and not b.held}
        self.found = self.found or not any(before_hole(b) for b in bodies)

    def hands(self, time: float, bodies: list[BodyState]) -> list[Hand]:
        k = min(int(time / TURN), len(NAMES) - 1)
        t = time - k * TURN
        width, height, depth = SIZES[NAMES[k]]
        top = np.array([0.0, 0.5 * height, 0.0])
        start, end = self.starts[k] + top, np.array(place_of(NAMES[k])) + top
        over = np.array([0.0, max(start[1], end[1] + CLEARANCE), 0.0])
        high, ready = np.where([0, 1, 0], over, start), np.where([0, 1, 0], over, end)
        away = np.array([0.0, 0.25, 0.15])
        path = [start + away, start, high, ready, end, end + away]
        keys = np.cumsum([0.0, APPROACH, LIFT, CARRY, LOWER, LEAVE])
        leg = int(np.clip(np.searchsorted(keys, t) - 1, 0, len(path) - 2))
        at = path[leg] + (path[leg + 1] - path[leg]) * ease((t - keys[leg]) / (keys[leg + 1] - keys[leg]))
        return [Hand(tuple(at), grip=keys[1] <= t < keys[4], reach=WIDE_GRIP * min(width, depth))]

    @property
    def score(self) -> int:
        return len(self.placed)

    @property
    def message(self) -> str:
        if self.score == len(NAMES):
            return "All four are on the pallet, and the mouse has its door free! Press R to play again."
        if self.found:
            return f"A mouse lives there! {self.score} of {len(NAMES)} boxes on the pallet."
        return f"{self.score} of {len(NAMES)} boxes on the pallet with the chalk cross. What does the big box hide?"

    def verify(self, bodies: list[BodyState]) -> None:
        """Assert the outcome of the scripted play: all boxes lie still on the pallet and the hole is free."""
        assert self.score == len(NAMES), f"only {self.score} of {len(NAMES)} boxes are on the pallet"
        assert self.found, "the mouse hole is still hidden"
        assert all(np.linalg.norm(b.velocity) < 0.02 for b in bodies), "a box still moves"


def place_of(name: str) -> tuple[float, float, float]:
    """Place of a box on the pallet [m]: its centre, a little above."""
    (x, _, z), (_, height, _) = PALLET
    return x + PLACES[name][0], height + 0.5 * SIZES[name][1] + 0.004, z + PLACES[name][1]


def on_pallet(box: BodyState) -> bool:
    """Test if a box stands on the pallet, or on another one there."""
    (x, _, z), (w, height, d) = PALLET
    aside = np.abs(box.centroid - (x, 0.0, z))
    return bool(box.low[1] > height - 0.02 and aside[0] < w / 2 and aside[2] < d / 2)


def before_hole(box: BodyState) -> bool:
    """Test if a box stands in the way of the mouse."""
    return bool(box.low[0] < HOLE[1] and box.high[0] > HOLE[0] and box.low[1] < HOLE[2] and box.low[2] < FAR + 0.3)


def build(capture: str | None = None) -> Scene:
    """The scene in the attic, or in a captured room: `capture` is its folder."""
    scene = Scene(
        bodies=[*furniture(), *boxes()],
        colliders=colliders(),
        light=lamp(),
        background=BACKGROUND,
        eye=(0.15, 1.30, 1.45),
        target=(0.20, 0.42, -0.60),
        game=BoxMoving(),
        roles=(Role("box", tuple(NAMES)),),
        room=room(),
    )
    return scene if capture is None else in_captured_room(scene, capture)
