"""Table brick game: draw planks from the tower, then knock it down with a rubber ball (VR-GS, Sec. 6.2)."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from core.material import Material
from scenes.scene import IDENTITY, Body, BodyState, Box, Capsule, Hand, Light, Plane, Quat, Role, Room, Scene, Vec3
from scenes.scripted_hands import Throw, ease

# The study
TABLE_TOP = 0.76  # [m] above the floor
TABLE_HALF = (0.75, 0.40)  # [m] along x and z, about the origin
ROOM_LOW, ROOM_HIGH = (-1.9, 0.0, -1.75), (1.9, 2.7, 2.2)  # [m]
BACKGROUND = (0.30, 0.24, 0.18)  # dim wood, behind the few pixels that no Gaussian covers
BALL_RADIUS = 0.042  # [m]
BALL_HEIGHT = 0.047  # [m] of its centre above the table: it lies on the ring
BALL_RING = ((0.40, TABLE_TOP, 0.14), 0.030, 0.007)  # a ring that keeps the ball: centre, radius, its rod's [m]
PLANK, CUBE, GAP = (0.15, 0.032, 0.049), 0.049, 0.001  # [m] sizes of the bricks; air between neighbours
TOWER = (0.0, TABLE_TOP, -0.06)  # [m] centre of its foot
LAYERS = 4  # of three planks, crosswise
PLANKS = ("brick_maple", "brick_red", "brick_green", "brick_walnut", "brick_blue", "brick_yellow")
BRICK = Material.named("wood", friction=0.5, kinetic_friction=0.35)
RUBBER = Material(young=3e4, poisson=0.35, density=900.0, friction=0.7, damping=30.0)  # [Pa], [-], [kg/m^3], [-], [1/s]
JELLY = Material.named("jelly", young=1.2e4, poisson=0.35, friction=0.7, kinetic_friction=0.5, damping=30.0)
QUARTER: Quat = (0.5**0.5, 0.0, 0.5**0.5, 0.0)  # turned by 90 degrees about y

# The play
GOAL = 8  # bricks, of fifteen
FALLEN, AWAY = 0.5 * PLANK[1], 0.5 * PLANK[0]  # [m] under its place, or beside it: a brick that is down, or drawn out
STILL = 0.05  # [m/s] below which bricks have come to rest
DRAWN = 4  # the plank that the scripted hand draws: the middle one of the second layer, which points at the player
DRAW_AT, DRAW_TIME, LAY_TIME = 0.5, 0.9, 0.8  # [s]
THROW_AT, THROW_TIME = 2.4, 3.0  # [s]


class TableBrickGame:
    """A brick scores while it has fallen or lies beside the tower, and no hand holds it.

    The game is won when enough of them lie still; the fewer throws it took the better.
    """

    duration = THROW_AT + THROW_TIME
    goal = GOAL

    def __init__(self):
        self.places = [np.array(body.position) for body in tower()]
        self.reset()

    def reset(self) -> None:
        self.down: set[int] = set()
        self.throws, self.held = 0, False
        self.throws_needed: int | None = None  # for the goal, once the bricks lie still
        self.throw: Throw | None = None
        self.standing = 0  # bricks that drawing has left in place

    def update(self, time: float, bodies: list[BodyState]) -> None:
        bricks, ball = bodies[: len(self.places)], bodies[-1]
        off = np.array([b.centroid - at for b, at in zip(bricks, self.places, strict=True)])
        out = (off[:, 1] < -FALLEN) | (np.hypot(off[:, 0], off[:, 2]) > AWAY)
        self.down = {k for k, b in enumerate(bricks) if out[k] and not b.held}
        self.throws, self.held = self.throws + (self.held and not ball.held), ball.held
        still = all(np.linalg.norm(b.velocity) < STILL for b in bricks)
        if self.score >= GOAL and self.throws_needed is None and still:
            self.throws_needed = self.throws
        if time < THROW_AT:
            self.standing = len(self.places) - len(self.down)

    def hands(self, time: float, bodies: list[BodyState]) -> list[Hand]:
        if time < THROW_AT:
            return [self.drawing_hand(time - DRAW_AT)]
        if self.throw is None:
            ball = bodies[-1].centroid
            aim = (TOWER[0], tower_height() - 0.10, TOWER[2])
            times = {"approach_time": 0.4, "lift_time": 0.7, "acceleration_time": 0.14, "flight_time": 0.16}
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
            few = {0: "without a throw", 1: "with one throw"}
            throws = few.get(self.throws_needed, f"with {self.throws_needed} throws")
            return f"Most of the tower is down {throws}! Press R to build it again."
        return f"{self.score} of {GOAL} bricks down. Draw planks, then throw the ball: the fewer throws the better."

    def verify(self, bodies: list[BodyState]) -> None:
        """Assert the outcome of the scripted play: a plank was drawn from a tower that stood; one throw felled it."""
        assert self.standing == len(self.places) - 1, f"{self.standing} bricks stood after one was drawn"
        assert self.throws_needed == 1, f"{self.score} bricks are down, the goal took {self.throws_needed} throws"
        low, high = np.array(ROOM_LOW) - 0.02, np.array(ROOM_HIGH)
        assert all((b.low > low).all() and (b.high < high).all() for b in bodies), "something has left the room"


def tower() -> list[Body]:
    """Crosswise layers of planks, two lettered cubes on them, and a plank across these."""
    x, y, z = TOWER
    bodies = []
    for k in range(3 * LAYERS):
        layer, aside = k // 3, (k % 3 - 1) * (PLANK[2] + GAP)
        height = y + (layer + 0.5) * PLANK[1]
        along_x = layer % 2 == 0
        at = (x, height, z + aside) if along_x else (x + aside, height, z)
        bodies.append(_brick(PLANKS[(k + 2 * layer) % len(PLANKS)], at, IDENTITY if along_x else QUARTER))
    top = y + LAYERS * PLANK[1]
    bodies += [_brick("brick_letters", (x + s * 0.045, top + 0.5 * CUBE, z), IDENTITY) for s in (-1, 1)]
    return [*bodies, _brick("brick_red", (x, top + CUBE + 0.5 * PLANK[1], z), IDENTITY)]


def tower_height() -> float:
    """Height of the tower's top above the floor [m]."""
    return TABLE_TOP + (LAYERS + 1) * PLANK[1] + CUBE


def toys() -> list[Body]:
    """The bear of jelly on top of the tower, and the ball in its ring."""
    (x, y, z), _, _ = BALL_RING
    bear = Body("jelly_bear", JELLY, position=(TOWER[0], tower_height(), TOWER[2]), asleep=True)
    return [bear, Body("rubber_ball", RUBBER, position=(x, y + BALL_HEIGHT, z), asleep=True)]


def _brick(asset: str, position: Vec3, rotation: Quat) -> Body:
    return Body(asset, BRICK, position=position, rotation=rotation, kind="rigid", asleep=True)


def room_colliders() -> list[Plane | Box | Capsule]:
    """The study's floor, walls, table top, the bookcase at the far wall, and the ring that keeps the ball."""
    (x0, _, z0), (x1, _, z1) = ROOM_LOW, ROOM_HIGH
    (x, y, z), radius, rod = BALL_RING
    angle = np.linspace(0, 2 * np.pi, 9)
    rim = np.stack([x + radius * np.cos(angle), 0 * angle + y + rod, z + radius * np.sin(angle)], 1)
    return [
        Plane((0, 0, 0), (0, 1, 0)),
        Plane((x0, 0, 0), (1, 0, 0)),
        Plane((x1, 0, 0), (-1, 0, 0)),
        Plane((0, 0, z0 + 0.32), (0, 0, 1)),
        Plane((0, 0, z1), (0, 0, -1)),
        Box((0, TABLE_TOP - 0.02, 0), (TABLE_HALF[0], 0.02, TABLE_HALF[1]), friction=0.6),
        *(Capsule(tuple(a), tuple(b), rod) for a, b in pairwise(rim)),
    ]


def build() -> Scene:
    study = room_colliders()
    return Scene(
        bodies=[Body("study"), *tower(), *toys()],
        colliders=study,
        light=Light(position=(-1.5, 2.1, 0.7), target=(0.0, TABLE_TOP, 0.0)),  # daylight from the window at the left
        background=BACKGROUND,
        eye=(0.0, 1.28, 0.92),
        target=(0.0, 0.87, -0.08),
        game=TableBrickGame(),
        roles=(Role("figure", ("jelly_bear",)), Role("ball", ("rubber_ball",))),
        room=Room(("study",), tuple(study), spot=(0.0, TABLE_TOP, 0.0), radius=0.35),
    )
