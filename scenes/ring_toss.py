"""Ring toss: throw elastic rings over the bottle on the dining table (VR-GS, Sec. 6.2)."""

from __future__ import annotations

import numpy as np

from scenes.dining_table import BOTTLE, BOTTLE_HEIGHT, RING_MATERIAL, TABLE_TOP, table_scene
from scenes.scene import Body, BodyState, Capsule, Hand, Role, Scene
from scenes.scripted_hands import Throw

RING_RADIUS = 0.08  # [m], of the tube's centre line
STARTS = [(-0.24, 0.30), (-0.03, 0.34), (0.17, 0.30)]  # x, z of each ring on the table [m]
COLOURS = ["ring_red", "ring_yellow", "ring_blue"]
THROW_PERIOD = 3.4  # [s] from one scripted throw to the next


class RingToss:
    """A ring scores once it has come to rest around the bottle: its disc holds the bottle's axis."""

    duration = THROW_PERIOD * len(STARTS) + 0.6
    goal = len(STARTS)

    def __init__(self):
        above = (BOTTLE[0], TABLE_TOP + BOTTLE_HEIGHT + 0.03, BOTTLE[2])
        self.throws = [
            Throw(
                grasp=(x, TABLE_TOP + 0.02, z),
                release=(0.4 * x, 1.16, 0.42),  # far and high enough for the run-up to stay clear of the table
                target=above,
                grab_radius=0.11,
                acceleration_time=0.15,
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
        turn = min(int(time / THROW_PERIOD), len(self.throws) - 1)
        return [self.throws[turn].hand(time - turn * THROW_PERIOD)]

    @property
    def score(self) -> int:
        return len(self.ringed)

    @property
    def message(self) -> str:
        if self.score == len(STARTS):
            return "All three! Press R to play again."
        return f"{self.score} of {len(STARTS)} rings on the bottle. Grab a ring and throw it."

    def verify(self, bodies: list[BodyState]) -> None:
        """Assert the outcome of the scripted play."""
        assert self.score >= 2, f"only {self.score} of 3 rings on the bottle"
        assert all(b.low[1] > -0.01 for b in bodies), "a ring fell through the floor"


def around_bottle(ring: BodyState) -> bool:
    """Test if the bottle's axis passes through the ring's disc, below the bottle's mouth."""
    slope = ring.axis[1]
    if abs(slope) < 0.2:  # the ring stands upright
        return False
    foot = np.array(BOTTLE)
    height = np.dot(ring.centroid - foot, ring.axis) / slope  # where the axis meets the ring's plane
    crossing = foot + np.array([0.0, height, 0.0])
    return -0.02 < height < BOTTLE_HEIGHT and np.linalg.norm(crossing - ring.centroid) < RING_RADIUS


def build() -> Scene:
    rings = [
        Body(asset, RING_MATERIAL, position=(x, TABLE_TOP + 0.018, z))
        for asset, (x, z) in zip(COLOURS, STARTS, strict=True)
    ]
    neck = Capsule((BOTTLE[0], TABLE_TOP + 0.2, BOTTLE[2]), (BOTTLE[0], TABLE_TOP + 0.28, BOTTLE[2]), 0.014)
    return table_scene(
        rings,
        [neck],
        eye=(0.0, 1.42, 1.15),
        target=(0.0, 0.86, -0.12),
        game=RingToss(),
        roles=(Role("ring", tuple(COLOURS)),),
    )
