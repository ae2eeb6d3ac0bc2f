"""Table brick game: draw planks from the tower, then knock it down with a rubber ball (VR-GS, Sec. 6.2)."""

from __future__ import annotations

import numpy as np

from scenes.scene import Body, BodyState, Hand, Role, Scene
from scenes.scripted_throw import Throw, ease
from scenes.study_table import (
    BACKGROUND,
    PLANK,
    ROOM_HIGH,
    ROOM_LOW,
    TABLE_TOP,
    TOWER,
    colliders,
    lamp,
    room,
    tower,
    tower_height,
    toys,
)

GOAL = 10  # bricks, of fifteen
MOVED = 0.5 * PLANK[1]  # [m] off its place: a brick that is down, or drawn out
DRAWN = 4  # the plank that the scripted hand draws: the middle one of the second layer, which points at the player
DRAW_AT, DRAW_TIME, LAY_TIME = 0.5, 0.9, 0.8  # [s]
THROW_AT, THROW_TIME = 2.4, 2.8  # [s]


class TableBrickGame:
    """A brick scores while it is out of its place and no hand holds it; the fewer throws for the goal the better."""

    duration = THROW_AT + THROW_TIME
    goal = GOAL

    def __init__(self):
        self.places = [np.array(body.position) for body in tower()]
        self.reset()

    def reset(self) -> None:
        self.down: set[int] = set()
        self.throws, self.held = 0, False
        self.throws_needed: int | None = None  # for the goal
        self.throw: Throw | None = None
        self.standing = 0  # bricks that drawing has left in place

    def update(self, time: float, bodies: list[BodyState]) -> None:
        bricks, ball = bodies[: len(self.places)], bodies[-1]
        off = [np.linalg.norm(b.centroid - at) > MOVED for b, at in zip(bricks, self.places, strict=True)]
        self.down = {k for k, b in enumerate(bricks) if off[k] and not b.held}
        self.throws, self.held = self.throws + (self.held and not ball.held), ball.held
        if self.score >= GOAL and self.throws_needed is None:
            self.throws_needed = self.throws
        if time < THROW_AT:
            self.standing = len(self.places) - len(self.down)

    def hands(self, time: float, bodies: list[BodyState]) -> list[Hand]:
        if time < THROW_AT:
            return [self.drawing_hand(time - DRAW_AT)]
        if self.throw is None:
            ball = bodies[-1].centroid
            times = {"approach_time": 0.4, "lift_time": 0.7, "acceleration_time": 0.14, "flight_time": 0.16}
            aim = (TOWER[0], tower_height() - 0.10, TOWER[2])
            self.throw = Throw(tuple(ball), (0.05, 1.02, 0.75), aim, grab_radius=0.07, **times)
        return [self.throw.hand(time - THROW_AT)]

    def drawing_hand(self, t: float) -> Hand:
        """The hand that draws a plank towards the player and lays it on the table, `t` seconds after it took hold."""
        start = self.places[DRAWN] + (0.0, 0.0, 0.5 * PLANK[0])
        out = start + (0.0, 0.0, 1.3 * PLANK[0])
        aside = np.array([-0.35, TABLE_TOP + 0.5 * PLANK[1] + 0.004, 0.3])
        laying = (t - DRAW_TIME) / LAY_TIME
        at = start + (out - start) * ease(t / DRAW_TIME)
        at = at + (aside - at) * (ease(2 * laying), ease(2 * laying - 1), ease(2 * laying)) if laying > 0 else at
        return Hand(tuple(at), grip=0.0 <= t < DRAW_TIME + LAY_TIME, reach=0.02)

    @property
    def score(self) -> int:
        return len(self.down)

    @property
    def message(self) -> str:
        if self.throws_needed is not None:
            throws = {0: "without a throw", 1: "with one throw"}.get(
                self.throws_needed, f"with {self.throws_needed} throws"
            )
            return f"The tower is down {throws}! Press R to build it again."
        return f"{self.score} of {GOAL} bricks out. Draw planks from the tower, then throw the ball at it."

    def verify(self, bodies: list[BodyState]) -> None:
        """Assert the outcome of the scripted play: a plank was drawn from a tower that stood; one throw felled it."""
        assert self.standing == len(self.places) - 1, f"{self.standing} bricks stood after one was drawn"
        assert self.throws_needed == 1, f"{self.score} bricks are down, the goal took {self.throws_needed} throws"
        low, high = np.array(ROOM_LOW) - 0.02, np.array(ROOM_HIGH)
        assert all((b.low > low).all() and (b.high < high).all() for b in bodies), "something has left the room"


def build() -> Scene:
    return Scene(
        bodies=[Body("study"), *tower(), *toys()],
        colliders=colliders(),
        light=lamp(),
        background=BACKGROUND,
        eye=(0.0, 1.28, 0.92),
        target=(0.0, 0.87, -0.08),
        game=TableBrickGame(),
        roles=(Role("figure", ("jelly_bear",)), Role("ball", ("rubber_ball",))),
        room=room(),
    )
