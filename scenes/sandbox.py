"""Sandbox: drop your own splat (--body FILE) on the table, here or in your own room (--stage), and play with it."""

from __future__ import annotations

import numpy as np

from assets.stage import Stage
from scenes.ring_toss import BOTTLE, PLASTER, TABLE_TOP, room
from scenes.scene import Body, BodyState, Hand, Light, Material, Plane, Scene
from scenes.throw import Throw

START = (0.0, TABLE_TOP + 0.03, 0.14)  # [m], of the body's lowest point
ABOVE = 0.05  # [m] over a stage's table or floor, where the body starts
LAMP = 1.15  # [m] above that


class Sandbox:
    """No goal. The scripted hand waits until the body rests, lifts it by its upper part and lobs it."""

    duration = 5.0
    wait = 1.2  # [s]

    def __init__(self, top: tuple[float, float, float] = (0.0, TABLE_TOP, 0.0)):
        self.top = top  # what the body is thrown back to
        self.reset()

    def reset(self) -> None:
        self.throw: Throw | None = None

    def update(self, time: float, bodies: list[BodyState]) -> None:
        body = bodies[0]
        if self.throw is None and time >= self.wait and not body.driven:  # what moves by itself is left to it
            grip = 0.5 * (body.low + body.high)
            grip[1] += 0.3 * (body.high[1] - body.low[1])
            up, onto = grip + [0.0, 0.45, 0.0], tuple(np.add(self.top, [0.0, 0.2, 0.0]))
            self.throw = Throw(tuple(grip), tuple(up), onto, reach=0.06, swing_time=0.12, flight_time=0.4)

    def hands(self, time: float, bodies: list[BodyState]) -> list[Hand]:
        return [self.throw.hand(time - self.wait)] if self.throw else []

    @property
    def score(self) -> int:
        return 0

    @property
    def message(self) -> str:
        return "Grab it, squeeze it, throw it."

    def verify(self, bodies: list[BodyState]) -> None:
        """What must hold once the scripted hand has played."""
        assert bodies[0].low[1] > -0.01, "the body fell through the floor"


def build(body: str = "ring_red", material: str = "plush", stage: str | None = None) -> Scene:
    """`material` is a name (see assets/materials.py), `stage` an asset that `prepare --static` made."""
    if stage is not None:
        return on_stage(body, Material.named(material), stage)
    toy = Body(body, Material.named(material), position=START)
    return Scene(
        bodies=[Body("dining_room"), Body("bottle", position=BOTTLE), toy],
        colliders=room(),
        light=Light(position=(0.0, 1.9, 0.1), target=(0.0, TABLE_TOP, 0.0)),
        background=PLASTER,
        eye=(0.0, 1.35, 1.0),
        target=(0.0, 0.85, 0.0),
        game=Sandbox(),
    )


def on_stage(body: str, material: Material, stage: str) -> Scene:
    """The same in a room of the user's: the body over its table or floor, which goes on beyond what was captured."""
    place = Stage.load(stage)
    x, y, z = place.drop
    return Scene(
        bodies=[Body(stage), Body(body, material, position=(x, y + ABOVE, z))],
        colliders=[Plane((0.0, place.floor, 0.0), (0.0, 1.0, 0.0))],
        light=Light(position=(x + 0.1, y + LAMP, z + 0.1), target=place.drop),
        background=PLASTER,
        eye=place.eye,
        target=(x, y + 0.1, z),
        game=Sandbox(place.drop),
    )
