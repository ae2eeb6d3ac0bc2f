"""Box moving: carry the attic's boxes to the pallet, and see what the biggest one hid (VR-GS, Sec. 6.2).

With --capture ROOM/ it plays on the floor of a captured room: pallet and stacks are where the ground is free, and
smaller where there is little.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated

import numpy as np

from scenes.attic_floor import BACKGROUND, FAR, HOLE, PALLET, PLACES, SIZES, boxes, colliders, furniture, lamp, room
from scenes.captured_room import in_captured_room
from scenes.scene import BodyState, Hand, Role, Scene, Spot, Vec3
from scenes.scripted_throw import ease

NAMES = list(PLACES)
APPROACH, LIFT, CARRY, LOWER, LEAVE = 0.3, 0.5, 0.9, 0.5, 0.2  # [s] of the scripted hand with each box
WIDE_GRIP = 0.4  # reach of the hand over a box's width: held by a small spot, a soft box swings
CLEARANCE = 0.30  # [m] between a box that is carried and the pallet
TURN = APPROACH + LIFT + CARRY + LOWER + LEAVE  # [s]


class BoxMoving:
    """A box scores while it stands on the pallet and no hand holds it.

    pallet  middle of its foot [m]
    size    of boxes and pallet: 1 as they are in the attic
    over    height [m] of the highest ground between boxes and pallet
    hole    whether the big box hides a mouse hole
    """

    duration = TURN * len(NAMES) + 0.6
    goal = len(NAMES)

    def __init__(self, pallet: Vec3 = PALLET[0], size: float = 1.0, over: float = 0.0, hole: bool = True):
        self.pallet, self.size, self.over, self.hole = np.array(pallet), size, over, hole
        self.reset()

    def reset(self) -> None:
        self.placed: set[int] = set()
        self.found = False
        self.grasps: dict[int, np.ndarray] = {}  # top of each box as its turn began

    def update(self, time: float, bodies: list[BodyState]) -> None:
        self.placed = {k for k, b in enumerate(bodies) if self.on_pallet(b) and not b.held}
        self.found = self.hole and (self.found or not any(before_hole(b) for b in bodies))

    def hands(self, time: float, bodies: list[BodyState]) -> list[Hand]:
        k = min(int(time / TURN), len(NAMES) - 1)
        t = time - k * TURN
        width, height, depth = np.multiply(self.size, SIZES[NAMES[k]])
        top = np.array([bodies[k].centroid[0], bodies[k].high[1], bodies[k].centroid[2]])
        start, end = self.grasps.setdefault(k, top), self.place_of(NAMES[k]) + [0.0, 0.5 * height, 0.0]
        clear = max(end[1], self.over + height) + self.size * CLEARANCE
        over = np.array([0.0, max(start[1], clear), 0.0])
        high, ready = np.where([0, 1, 0], over, start), np.where([0, 1, 0], over, end)
        away = np.array([0.0, 0.25, 0.15])
        path = [start + away, start, high, ready, end, end + away]
        keys = np.cumsum([0.0, APPROACH, LIFT, CARRY, LOWER, LEAVE])
        leg = int(np.clip(np.searchsorted(keys, t) - 1, 0, len(path) - 2))
        at = path[leg] + (path[leg + 1] - path[leg]) * ease((t - keys[leg]) / (keys[leg + 1] - keys[leg]))
        return [Hand(tuple(at), grip=keys[1] <= t < keys[4], reach=WIDE_GRIP * min(width, depth))]

    def place_of(self, name: str) -> np.ndarray:
        """Place of a box on the pallet [m]: its centre, a little above."""
        x, z = PLACES[name]
        return self.pallet + self.size * np.array([x, PALLET[1][1] + 0.5 * SIZES[name][1], z]) + [0.0, 0.004, 0.0]

    def on_pallet(self, box: BodyState) -> bool:
        """Test if a box stands on the pallet, or on another one there."""
        w, height, d = np.multiply(self.size, PALLET[1])
        aside = np.abs(box.centroid - self.pallet)
        return bool(box.low[1] > self.pallet[1] + height - 0.02 * self.size and aside[0] < w / 2 and aside[2] < d / 2)

    @property
    def score(self) -> int:
        return len(self.placed)

    @property
    def message(self) -> str:
        count = f"{self.score} of {len(NAMES)} boxes"
        if self.score == len(NAMES):
            mouse = ", and the mouse has its door free" if self.hole else ""
            return f"All four are on the pallet{mouse}! Press R to play again."
        if self.found:
            return f"A mouse lives there! {count} on the pallet."
        return f"{count} on the pallet with the chalk cross.{' What does the big box hide?' if self.hole else ''}"

    def verify(self, bodies: list[BodyState]) -> None:
        """Assert the outcome of the scripted play: all boxes lie still on the pallet and the hole is free."""
        assert self.score == len(NAMES), f"only {self.score} of {len(NAMES)} boxes are on the pallet"
        assert self.found or not self.hole, "the mouse hole is still hidden"
        assert all(np.linalg.norm(b.velocity) < 0.02 for b in bodies), "a box still moves"


def before_hole(box: BodyState) -> bool:
    """Test if a box stands in the way of the mouse."""
    return bool(box.low[0] < HOLE[1] and box.high[0] > HOLE[0] and box.low[1] < HOLE[2] and box.low[2] < FAR + 0.3)


def game_at(spots: Sequence[Spot], size: float) -> BoxMoving:
    """The game in another room, where the pallet and two stacks of boxes stand on these spots."""
    (x, z), pallet = spots[0].at, spots[0].ground
    return BoxMoving((x, pallet, z), size, max(spot.over for spot in spots), hole=False)


def build(capture: Annotated[str | None, "folder of a captured room"] = None) -> Scene:
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
        room=room(game_at),
    )
    return scene if capture is None else in_captured_room(scene, capture)
