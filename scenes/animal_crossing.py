"""Animal crossing: bring animals into the garden, each to its place and size; they stand, fall, are petted.

In the transform mode two hands on an animal draw it larger or smaller (VR-GS, Sec. 6.2).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from scenes.garden import ANIMALS, BACKGROUND, animals, colliders, furniture, room, sun
from scenes.scene import BodyState, Hand, Role, Scene
from scenes.scripted_throw import ease

PLACE_RADIUS, SIZE_TOLERANCE = 0.35, 0.15  # [m], relative
STROKED, STROKE_SPEED = 0.3, 0.01  # [s] and [m/s] of an animal that is stroked
SCRIPT = (("bear", 1 / 0.62), ("rabbit", 1 / 1.45), ("fox", 1.0))  # whom the scripted hands move, and by which factor
MOVE_TIME, SETTLE_TIME = 1.4, 1.2  # [s]


@dataclass
class Guest:
    """An animal: height as modelled [m], y of its axis when it stands, for how long it was stroked [s], if at home."""

    height: float
    upright: float
    stroked: float = 0.0
    placed: bool = False


class AnimalCrossing:
    """An animal scores when it stands in its place in its own size, and once more when it is petted there."""

    moved = MOVE_TIME * len(SCRIPT)
    duration = moved + SETTLE_TIME + 1.6
    goal = 2 * len(ANIMALS)

    def __init__(self):
        self.reset()

    def reset(self) -> None:
        self.guests: list[Guest] = []
        self.time, self.start = 0.0, None

    def update(self, time: float, bodies: list[BodyState]) -> None:
        dt, self.time = time - self.time, time
        if not self.guests:
            sizes = [size for _, _, size, _ in ANIMALS.values()]
            self.guests = [
                Guest((b.high[1] - b.low[1]) / s, abs(b.axis[1])) for b, s in zip(bodies, sizes, strict=True)
            ]
        for guest, body, (*_, place) in zip(self.guests, bodies, ANIMALS.values(), strict=True):
            at_home = np.hypot(body.centroid[0] - place[0], body.centroid[2] - place[1]) < PLACE_RADIUS
            size = (body.high[1] - body.low[1]) / guest.height
            guest.placed = bool(at_home and stands(body, guest) and abs(size - 1) < SIZE_TOLERANCE)
            if guest.placed and body.held and np.linalg.norm(body.velocity) > STROKE_SPEED:
                guest.stroked += dt

    def interaction(self, time: float) -> str:
        """Mode of the scripted hands: they place the animals, then stroke one."""
        return "transform" if 0.1 < time < self.moved else "physics"

    def hands(self, time: float, bodies: list[BodyState]) -> list[Hand]:
        if time < self.moved:
            return self.moving(*SCRIPT[int(time / MOVE_TIME)], time % MOVE_TIME, bodies)
        fox, t = bodies[0], time - self.moved - SETTLE_TIME
        if t < 0.0:
            self.start = np.array([fox.centroid[0], fox.high[1] - 0.06, fox.centroid[2]])
            return [Hand(tuple(fox.centroid + [0.0, 0.6, 0.3])) for _ in range(2)]
        stroke = self.start + [0.035 * np.sin(2 * np.pi * t / 0.6), -0.01, 0.0]
        return [Hand(tuple(stroke), grip=0.2 < t < 1.3, reach=0.12), Hand(tuple(self.start + [0.3, 0.4, 0.3]))]

    def moving(self, name: str, factor: float, t: float, bodies: list[BodyState]) -> list[Hand]:
        """Two hands that take an animal by its sides to its place, and draw it larger by `factor`."""
        body, place = bodies[list(ANIMALS).index(name)], ANIMALS[name][3]
        if t < 0.2 or self.start is None:
            self.start = np.array([body.centroid, [body.centroid[0], body.low[1], body.centroid[2]]])
        (middle, foot), s = self.start, ease((t - 0.3) / 0.8)
        scale = 1 + (factor - 1) * s
        goal = np.array([place[0], foot[1] + factor * (middle[1] - foot[1]), place[1]])
        at = middle + (goal - middle) * s + [0.0, 0.35 * np.sin(np.pi * s), 0.0]
        return [Hand(tuple(at + [0.0, 0.0, d * scale]), grip=0.2 < t < 1.25, reach=0.2) for d in (-0.06, 0.06)]

    @property
    def score(self) -> int:
        return sum(g.placed + (g.stroked >= STROKED) for g in self.guests)

    @property
    def message(self) -> str:
        if self.score == self.goal:
            return "All are at home, and petted. Press R to play again."
        for name, guest in zip(ANIMALS, self.guests, strict=False):
            if not guest.placed:
                return f"Bring the {name} to its ring of flowers, as large as it should be: two hands draw it larger."
            if guest.stroked < STROKED:
                return f"The {name} is at home: pet it."
        return "Bring the animals home."

    def verify(self, bodies: list[BodyState]) -> None:
        """Assert the outcome of the scripted play."""
        placed = [name for name, guest in zip(ANIMALS, self.guests, strict=True) if guest.placed]
        assert set(placed) == {name for name, _ in SCRIPT}, f"at home are {placed}"
        assert self.guests[0].stroked >= STROKED, "the fox was not petted"
        assert all(map(stands, bodies, self.guests)), "an animal has fallen"


def stands(body: BodyState, guest: Guest) -> bool:
    """Test if an animal is as upright as it was at first."""
    return abs(abs(body.axis[1]) - guest.upright) < 0.35


def build() -> Scene:
    return Scene(
        bodies=[*furniture(), *animals()],
        colliders=colliders(),
        light=sun(),
        background=BACKGROUND,
        eye=(-0.1, 1.5, 2.55),
        target=(0.1, 0.35, -0.6),
        game=AnimalCrossing(),
        roles=(Role("animal", tuple(ANIMALS), resize=False),),
        room=room(),
    )
