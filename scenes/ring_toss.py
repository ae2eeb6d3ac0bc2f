"""Ring toss: throw elastic rings over the bottle on the dining table (VR-GS, Sec. 6.2)."""

from __future__ import annotations

import numpy as np

from core.material import Material
from scenes.scene import Body, BodyState, Box, Capsule, Hand, Light, Plane, Scene
from scenes.scripted_throw import Throw

RUBBER = Material(young=3e4, poisson=0.4, density=1100.0, friction=0.6)
TABLE_TOP = 0.75  # [m]
BOTTLE = (0.0, TABLE_TOP, -0.15)
BOTTLE_HEIGHT = 0.30  # [m]
PLASTER = (0.5, 0.47, 0.4)  # the colour behind the few pixels that no Gaussian covers
RING_RADIUS = 0.08  # [m], of the tube's centre line
STARTS = [(-0.24, 0.30), (-0.03, 0.34), (0.17, 0.30)]  # x, z of each ring on the table [m]
COLOURS = ["ring_red", "ring_yellow", "ring_blue"]
TURN = 3.4  # [s] from one scripted throw to the next


class RingToss:
    """A ring scores once it has come to rest around the bottle: its disc holds the bottle's axis."""

    duration = TURN * len(STARTS) + 0.6

    def __init__(self):
        above = (BOTTLE[0], TABLE_TOP + BOTTLE_HEIGHT + 0.03, BOTTLE[2])
        self.throws = [
            Throw(
                grip=(x, TABLE_TOP + 0.02, z),
                release=(0.4 * x, 1.16, 0.42),  # far and high enough for the swing to stay clear of the table
                target=above,
                reach=0.11,
                swing_time=0.15,
                flight_time=0.42,
            )
            for x, z in STARTS
        ]
        self.reset()

    def reset(self) -> None:
        self.ringed: set[int] = set()

    def update(self, time: float, bodies: list[BodyState]) -> None:
        self.ringed = {i for i, b in enumerate(bodies) if around_bottle(b) and not b.held}

    def hands(self, time: float, bodies: list[BodyState]) -> list[Hand]:
        turn = min(int(time / TURN), len(self.throws) - 1)
        return [self.throws[turn].hand(time - turn * TURN)]

    @property
    def score(self) -> int:
        return len(self.ringed)

    @property
    def message(self) -> str:
        if self.score == len(STARTS):
            return "All three! Press R to play again."
        return f"{self.score} of {len(STARTS)} rings on the bottle. Grab a ring and throw it."

    def verify(self, bodies: list[BodyState]) -> None:
        """What must hold once the scripted hand has played."""
        assert self.score >= 2, f"only {self.score} of 3 rings on the bottle"
        assert all(b.low[1] > -0.01 for b in bodies), "a ring fell through the floor"


def around_bottle(ring: BodyState) -> bool:
    """Does the bottle's axis pass through the ring's disc, below the bottle's mouth?"""
    slope = ring.axis[1]
    if abs(slope) < 0.2:  # the ring stands upright
        return False
    foot = np.array(BOTTLE)
    height = np.dot(ring.centroid - foot, ring.axis) / slope  # where the axis meets the ring's plane
    crossing = foot + np.array([0.0, height, 0.0])
    return -0.02 < height < BOTTLE_HEIGHT and np.linalg.norm(crossing - ring.centroid) < RING_RADIUS


def build() -> Scene:
    rings = [
        Body(asset, RUBBER, position=(x, TABLE_TOP + 0.018, z)) for asset, (x, z) in zip(COLOURS, STARTS, strict=True)
    ]
    neck = Capsule((BOTTLE[0], TABLE_TOP + 0.2, BOTTLE[2]), (BOTTLE[0], TABLE_TOP + 0.28, BOTTLE[2]), 0.014)
    return Scene(
        bodies=[Body("dining_room"), Body("bottle", position=BOTTLE), *rings],
        colliders=[*room(), neck],
        light=Light(position=(0.0, 1.9, 0.1), target=(0.0, TABLE_TOP, 0.0)),
        background=PLASTER,
        eye=(0.0, 1.42, 1.15),
        target=(0.0, 0.86, -0.12),
        game=RingToss(),
    )


def room() -> list[Plane | Box]:
    """The dining room's floor, walls and table top."""
    return [
        Plane((0, 0, 0), (0, 1, 0)),
        Plane((-2, 0, 0), (1, 0, 0)),
        Plane((2, 0, 0), (-1, 0, 0)),
        Plane((0, 0, -2.2), (0, 0, 1)),
        Plane((0, 0, 2.3), (0, 0, -1)),
        Box((0, TABLE_TOP - 0.02, 0), (0.8, 0.02, 0.45), friction=0.5),
    ]
