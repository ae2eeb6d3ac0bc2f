"""Sandbox: drop your own splat (--body FILE) on the table, here or in your own room (--stage), and play with it.

What moves by itself cannot be carried off: beside it lies a ring to throw at it.
"""

from __future__ import annotations

import numpy as np

from assets.environment import Environment
from assets.library import animated_height
from core.material import Material
from scenes.ring_toss import BOTTLE, PLASTER, RUBBER, TABLE_TOP, room
from scenes.scene import Body, BodyState, Hand, Light, Plane, Scene
from scenes.scripted_throw import Throw

START = (0.0, TABLE_TOP + 0.03, 0.14)  # [m], of the body's lowest point
ABOVE = 0.05  # [m] over a stage's table or floor, where the body starts
LAMP = 1.15  # [m] above that
RING = "ring_red"  # what is thrown at a body that moves by itself
RING_SHARE = 2.2  # of such a body's height, for which the ring is as large as in the ring toss


class Sandbox:
    """No goal. The scripted hand waits until the body rests, lifts it by its upper part and lobs it.

    dancer  height [m] of a body that moves by itself: then the hand throws a ring at it, again and again
    """

    wait = 1.2  # [s]
    again = 2.2  # [s] from one throw of a ring to the next

    def __init__(self, top: tuple[float, float, float] = (0.0, TABLE_TOP, 0.0), dancer: float | None = None):
        self.top, self.dancer = top, dancer  # top: what the body is thrown back to
        self.duration = 5.0 if dancer is None else self.wait + 2 * self.again
        self.reset()

    def reset(self) -> None:
        self.throw: Throw | None = None
        self.begun = 0.0

    def update(self, time: float, bodies: list[BodyState]) -> None:
        if time < self.wait:
            return
        if self.dancer is not None:
            if len(bodies) > 1 and (self.throw is None or time >= self.begun + self.again):
                self.throw, self.begun = self.at_the_dancer(*bodies[:2]), time
        elif self.throw is None:
            body = bodies[0]
            grip = 0.5 * (body.low + body.high)
            grip[1] += 0.3 * (body.high[1] - body.low[1])
            up, onto = grip + [0.0, 0.45, 0.0], tuple(np.add(self.top, [0.0, 0.2, 0.0]))
            self.throw = Throw(tuple(grip), tuple(up), onto, reach=0.06, swing_time=0.12, flight_time=0.4)
            self.begun = time

    def at_the_dancer(self, body: BodyState, ring: BodyState) -> Throw:
        """From the front at its chest, wherever ring and dancer are now."""
        h = self.dancer
        middle = 0.5 * (body.low + body.high)
        release = (middle[0] + 0.25 * h, body.low[1] + 0.9 * h, body.high[2] + 0.7 * h)
        chest = (middle[0], body.low[1] + 0.65 * h, middle[2])
        size = float(np.ptp([ring.low, ring.high], axis=0).max())
        times = {"reach_time": 0.3, "carry_time": 0.5, "swing_time": 0.15, "flight_time": 0.25 * np.sqrt(h)}
        return Throw(tuple(ring.centroid), release, chest, reach=0.7 * size, **times)

    def hands(self, time: float, bodies: list[BodyState]) -> list[Hand]:
        return [self.throw.hand(time - self.begun)] if self.throw else []

    @property
    def score(self) -> int:
        return 0

    @property
    def message(self) -> str:
        return "Grab it, squeeze it, throw it." if self.dancer is None else "Throw the ring at it."

    def verify(self, bodies: list[BodyState]) -> None:
        """What must hold once the scripted hand has played."""
        assert bodies[0].low[1] > -0.01, "the body fell through the floor"


def build(body: str = "ring_red", material: str = "plush", stage: str | None = None) -> Scene:
    """`material` is a name (see core/material.py), `stage` an asset that `prepare --static` made."""
    height = animated_height(body)
    of = Material.named(material) if height is None else Material.animated(material, height)
    if stage is not None:
        return on_stage(body, of, stage, height)
    start = START if height is None else (START[0], TABLE_TOP, 0.0)
    toy = Body(body, of, position=start)
    far = 0.0 if height is None else min(max(1.5 * height - 0.7, 0.0), 1.2)  # to see it from head to foot
    return Scene(
        bodies=[Body("dining_room"), Body("bottle", position=BOTTLE), toy, *rings(start, height)],
        colliders=room(),
        light=Light(position=(0.0, 1.9, 0.1), target=(0.0, TABLE_TOP, 0.0)),
        background=PLASTER,
        eye=(0.0, 1.35 + 0.3 * far, 1.0 + far),
        target=(0.0, 0.85 + 0.6 * far, 0.0),
        game=Sandbox(dancer=height),
    )


def rings(at: tuple[float, float, float], height: float | None) -> list[Body]:
    """A ring beside a body of this height [m] that moves by itself and stands `at`; nothing beside another one."""
    if height is None:
        return []
    scale = float(np.clip(RING_SHARE * height, 0.5, 1.5))
    place = (at[0] + 0.12 * scale + 0.25 * height, at[1] + 0.019 * scale, at[2] + 0.1 * scale)
    return [Body(RING, RUBBER, position=place, scale=scale)]


def on_stage(body: str, material: Material, stage: str, height: float | None = None) -> Scene:
    """The same in a room of the user's: the body over its table or floor, which goes on beyond what was captured."""
    place = Environment.load(stage)
    x, y, z = place.drop_point
    start = (x, y + ABOVE, z) if height is None else (x, y, z)
    return Scene(
        bodies=[Body(stage), Body(body, material, position=start), *rings(start, height)],
        colliders=[Plane((0.0, place.floor_height, 0.0), (0.0, 1.0, 0.0))],
        light=Light(position=(x + 0.1, y + LAMP, z + 0.1), target=place.drop_point),
        background=PLASTER,
        eye=place.eye_position,
        target=(x, y + 0.1, z),
        game=Sandbox(place.drop_point, height),
    )
