"""Sandbox: drop your own splat (--body FILE) on the table, then grab, squeeze and throw it."""

from __future__ import annotations

from scenes.ring_toss import BOTTLE, PLASTER, TABLE_TOP, room
from scenes.scene import Body, BodyState, Hand, Light, Material, Scene
from scenes.throw import Throw

START = (0.0, TABLE_TOP + 0.03, 0.14)  # [m], of the body's lowest point


class Sandbox:
    """No goal. The scripted hand waits until the body rests, lifts it by its upper part and lobs it."""

    duration = 5.0
    wait = 1.2  # [s]

    def __init__(self):
        self.reset()

    def reset(self) -> None:
        self.throw: Throw | None = None

    def update(self, time: float, bodies: list[BodyState]) -> None:
        body = bodies[0]
        if self.throw is None and time >= self.wait and not body.driven:  # what moves by itself is left to it
            grip = 0.5 * (body.low + body.high)
            grip[1] += 0.3 * (body.high[1] - body.low[1])
            up, onto = grip + [0.0, 0.45, 0.0], (0.0, TABLE_TOP + 0.2, 0.0)
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


def build(body: str = "ring_red", material: str = "plush") -> Scene:
    """`material` is a name (see assets/materials.py)."""
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
