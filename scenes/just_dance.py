"""Just dance: throw two rings and a ball at the dancer on the stage; --body takes one of yours (prepare --rig)."""

from __future__ import annotations

import numpy as np

from assets.library import animated_height, default_material
from core.material import Material
from scenes.scene import Body, BodyState, Box, Hand, Light, Plane, Role, Room, Scene, floor_and_walls
from scenes.scripted_hands import Throw

# The theatre
STAGE_TOP = 0.75  # [m] height of the boards
STAGE_FRONT, STAGE_BACK, STAGE_HALF_WIDTH = 0.72, -1.75, 2.1  # [m]
OPENING_HALF_WIDTH = 1.55  # [m] between the pilasters
TABLE_TOP = 0.86  # [m]
TABLES = ((-0.70, TABLE_TOP, 1.18), (0.70, TABLE_TOP, 1.18))  # [m] centres of their tops
TABLE_HALF = (0.31, 0.17)  # [m] along x and z
HALL_HALF_WIDTH, HALL_BACK = 2.9, 5.2  # [m]
BACKGROUND = (0.10, 0.03, 0.03)  # velvet in the dark, behind the few pixels that no Gaussian covers

# The play
PLACE = (0.0, STAGE_TOP, -0.05)  # [m] where the dancer stands
PROPS = ("ring_red", "ring_yellow", "ball")
RING_SCALE, BALL_SCALE = 1.4, 1.4  # times the sizes of the ring toss
THROW_PERIOD, FLIGHT_TIME = 2.0, 0.42  # [s]
MEETING_SPEED = 0.1  # [m/s] by which a meeting changes the velocity along the floor, which is constant in flight


class JustDance:
    """Each ring and the ball scores once, when it has been thrown and meets the dancer."""

    duration = THROW_PERIOD * len(PROPS) + 0.8
    goal = len(PROPS)

    def __init__(self):
        self.reset()

    def reset(self) -> None:
        self.thrown: set[int] = set()
        self.hit: set[int] = set()
        self.throw: Throw | None = None
        self.turn = -1
        self.drift = np.zeros((len(PROPS), 2))  # [m/s] velocities along the floor a frame ago

    def update(self, time: float, bodies: list[BodyState]) -> None:
        dancer, *props = bodies
        for k, prop in enumerate(props):
            if prop.held:
                self.thrown.add(k)
            elif k in self.thrown and (prop.high > dancer.low).all() and (prop.low < dancer.high).all():
                turned = np.linalg.norm(prop.velocity[::2] - self.drift[k]) > MEETING_SPEED
                self.hit |= {k} if turned else set()
            self.drift[k] = prop.velocity[::2]
        turn = min(int(time / THROW_PERIOD), len(props) - 1)
        if turn != self.turn:
            self.turn, self.throw = turn, self.throw_at(dancer, props[turn])

    def throw_at(self, dancer: BodyState, prop: BodyState) -> Throw:
        """A throw from the hall at the dancer's skirt, or the middle of another body, from where both are now."""
        target = 0.5 * (dancer.low + dancer.high)
        release = (0.5 * prop.centroid[0], 1.45, 1.15)
        return Throw.of(prop, release, tuple(target), approach_time=0.3, lift_time=0.6, flight_time=FLIGHT_TIME)

    def hands(self, time: float, bodies: list[BodyState]) -> list[Hand]:
        return [self.throw.hand(time - self.turn * THROW_PERIOD)] if self.throw else []

    @property
    def score(self) -> int:
        return len(self.hit)

    @property
    def message(self) -> str:
        if self.score == len(PROPS):
            return "Bravo! Press R to play again."
        left = ["the " + " ".join(name.split("_")[::-1]) for k, name in enumerate(PROPS) if k not in self.hit]
        what = " and ".join([", ".join(left[:-1]), left[-1]] if len(left) > 1 else left)
        return f"{self.score} of {len(PROPS)} have met the dancer. Throw {what}."

    def verify(self, bodies: list[BodyState]) -> None:
        """Assert the outcome of the scripted play."""
        assert self.score == len(PROPS), f"only {self.score} of {len(PROPS)} have met the dancer"
        assert all(b.low[1] > -0.02 and np.isfinite(b.centroid).all() for b in bodies), "something fell through"


def room_colliders() -> list[Plane | Box]:
    """Floor and walls of the hall, the stage with its footlights, backdrop and pilasters, and the tables."""
    middle, half = 0.5 * (STAGE_FRONT + STAGE_BACK), 0.5 * (STAGE_FRONT - STAGE_BACK)
    pilaster = 0.5 * (HALL_HALF_WIDTH - OPENING_HALF_WIDTH)
    return [
        *floor_and_walls((-HALL_HALF_WIDTH, HALL_HALF_WIDTH), (STAGE_BACK, HALL_BACK)),
        Box((0, 0.5 * STAGE_TOP, middle), (HALL_HALF_WIDTH, 0.5 * STAGE_TOP, half), friction=0.5),
        Box((0, STAGE_TOP + 0.035, 0.635), (1.32, 0.035, 0.045)),  # the footlights
        *(Box((s * (OPENING_HALF_WIDTH + pilaster), 2.2, 0.37), (pilaster, 1.5, 0.07)) for s in (-1, 1)),
        *(Box((x, y - 0.02, z), (TABLE_HALF[0], 0.02, TABLE_HALF[1]), friction=0.6) for x, y, z in TABLES),
    ]


def build(material: str | None = None) -> Scene:
    """`material` of the dancer: a name (core/material.py) or None for its own."""
    height = animated_height("dancer")
    made_of = default_material("dancer") if material is None else Material.named(material)
    (lx, _, lz), (rx, _, rz) = TABLES
    places = ((lx - 0.15, TABLE_TOP + 0.022, lz), (lx + 0.15, TABLE_TOP + 0.022, lz), (rx, TABLE_TOP + 0.002, rz))
    props = [
        Body(name, default_material(name), position=at, scale=BALL_SCALE if name == "ball" else RING_SCALE)
        for name, at in zip(PROPS, places, strict=True)
    ]
    theatre = room_colliders()
    back = max(1.3 * height - 1.1, 0.0)  # [m], to see it from head to foot
    return Scene(
        bodies=[Body("stage"), Body("dancer", made_of.animated(height), position=PLACE), *props],
        colliders=theatre,
        light=Light(position=(0.55, 3.2, 1.35), target=PLACE),  # the spot above the hall
        background=BACKGROUND,
        eye=(0.0, 1.6, 2.1 + back),
        target=(0.0, STAGE_TOP + 0.45 * height, 0.0),
        game=JustDance(),
        roles=(Role("dancer", ("dancer",), animated=True), Role("prop", PROPS)),
        room=Room(("stage",), tuple(theatre), spot=(0.0, STAGE_TOP, 0.0), radius=0.8, on_floor=True),
    )
