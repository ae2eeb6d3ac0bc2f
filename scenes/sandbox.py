"""Sandbox: drop your own splat (--body FILE) on the table, here or in your own room (--stage), and play with it.

An animated body cannot be carried off: beside it lies a ring to throw at it.
"""

from __future__ import annotations

import numpy as np

from assets.environment import Environment
from assets.library import animated_height, default_material
from core.material import Material
from scenes.dining_table import BACKGROUND, RING_MATERIAL, TABLE_TOP, colliders, furniture, lamp
from scenes.scene import Body, BodyState, Hand, Light, Plane, Scene, Vec3
from scenes.scripted_throw import Throw

START = (0.0, TABLE_TOP + 0.03, 0.14)  # [m], of the body's lowest point
START_HEIGHT = 0.05  # [m] of the body over a room's table or floor
LAMP_HEIGHT = 1.15  # [m] of the light over that
RING = "ring_red"  # thrown at an animated body
RING_SCALE_PER_METRE = 2.2  # size of the ring, in multiples of the ring toss's, for each metre of that body's height


class Sandbox:
    """No goal. The scripted hand waits until the body rests, lifts it by its upper part and lobs it.

    target          where the body is thrown back to [m]
    dancer_height   of an animated body [m]: then the hand throws a ring at it, again and again
    """

    first_throw = 1.2  # [s]
    ring_period = 2.2  # [s] from one throw of a ring to the next

    def __init__(self, target: Vec3 = (0.0, TABLE_TOP, 0.0), dancer_height: float | None = None):
        self.target, self.dancer_height = target, dancer_height
        self.duration = 5.0 if dancer_height is None else self.first_throw + 2 * self.ring_period
        self.reset()

    def reset(self) -> None:
        self.throw: Throw | None = None
        self.throw_start = 0.0

    def update(self, time: float, bodies: list[BodyState]) -> None:
        if time < self.first_throw:
            return
        if self.dancer_height is not None:
            if len(bodies) > 1 and (self.throw is None or time >= self.throw_start + self.ring_period):
                self.throw, self.throw_start = self.throw_at_dancer(*bodies[:2]), time
        elif self.throw is None:
            body = bodies[0]
            grasp = 0.5 * (body.low + body.high)
            grasp[1] += 0.3 * (body.high[1] - body.low[1])
            release, target = grasp + [0.0, 0.45, 0.0], tuple(np.add(self.target, [0.0, 0.2, 0.0]))
            times = {"acceleration_time": 0.12, "flight_time": 0.4}
            self.throw = Throw(tuple(grasp), tuple(release), target, grab_radius=0.06, **times)
            self.throw_start = time

    def throw_at_dancer(self, body: BodyState, ring: BodyState) -> Throw:
        """A throw from the front at the dancer's chest, wherever ring and dancer are now."""
        h = self.dancer_height
        middle = 0.5 * (body.low + body.high)
        release = (middle[0] + 0.25 * h, body.low[1] + 0.9 * h, body.high[2] + 0.7 * h)
        chest = (middle[0], body.low[1] + 0.65 * h, middle[2])
        size = float(np.ptp([ring.low, ring.high], axis=0).max())
        times = {"approach_time": 0.3, "lift_time": 0.5, "acceleration_time": 0.15, "flight_time": 0.25 * np.sqrt(h)}
        return Throw(tuple(ring.centroid), release, chest, grab_radius=0.7 * size, **times)

    def hands(self, time: float, bodies: list[BodyState]) -> list[Hand]:
        return [self.throw.hand(time - self.throw_start)] if self.throw else []

    @property
    def score(self) -> int:
        return 0

    @property
    def message(self) -> str:
        return "Grab it, squeeze it, throw it." if self.dancer_height is None else "Throw the ring at it."

    def verify(self, bodies: list[BodyState]) -> None:
        """Assert the outcome of the scripted play."""
        assert bodies[0].low[1] > -0.01, "the body fell through the floor"


def build(body: str = "ring_red", material: str | None = None, stage: str | None = None) -> Scene:
    """A body on the dining table, or in a room.

    body      an asset
    material  a name (core/material.py); None: the asset's own
    stage     an asset made by `prepare --static`: the room
    """
    height = animated_height(body)
    made_of = body_material(body, material, height)
    if stage is not None:
        return in_room(body, made_of, stage, height)
    start = START if height is None else (START[0], TABLE_TOP, 0.0)
    back = 0.0 if height is None else min(max(1.5 * height - 0.7, 0.0), 1.2)  # [m], to see it from head to foot
    return Scene(
        bodies=[*furniture(), Body(body, made_of, position=start), *rings(start, height)],
        colliders=colliders(),
        light=lamp(),
        background=BACKGROUND,
        eye=(0.0, 1.35 + 0.3 * back, 1.0 + back),
        target=(0.0, 0.85 + 0.6 * back, 0.0),
        game=Sandbox(dancer_height=height),
    )


def body_material(body: str, name: str | None, height: float | None) -> Material:
    """The named material or else the asset's own; for an animated body of this height [m], adapted to its size."""
    material = default_material(body) if name is None else Material.named(name)
    return material if height is None else material.animated(height)


def rings(place: Vec3, height: float | None) -> list[Body]:
    """A ring beside an animated body of this height [m] that stands at `place`; none beside another body."""
    if height is None:
        return []
    scale = float(np.clip(RING_SCALE_PER_METRE * height, 0.5, 1.5))
    at = (place[0] + 0.12 * scale + 0.25 * height, place[1] + 0.019 * scale, place[2] + 0.1 * scale)
    return [Body(RING, RING_MATERIAL, position=at, scale=scale)]


def in_room(body: str, material: Material, stage: str, height: float | None = None) -> Scene:
    """The body over the table or floor of a captured room, whose floor extends beyond the capture."""
    room = Environment.load(stage)
    x, y, z = room.drop_point
    start = (x, y + START_HEIGHT, z) if height is None else (x, y, z)
    return Scene(
        bodies=[Body(stage), Body(body, material, position=start), *rings(start, height)],
        colliders=[Plane((0.0, room.floor_height, 0.0), (0.0, 1.0, 0.0))],
        light=Light(position=(x + 0.1, y + LAMP_HEIGHT, z + 0.1), target=room.drop_point),
        background=BACKGROUND,
        eye=room.eye_position,
        target=(x, y + 0.1, z),
        game=Sandbox(room.drop_point, height),
    )
