"""Animal crossing: bring animals into the garden, each to its place and size; they stand, fall, are petted.

In the transform mode two hands on an animal draw it larger or smaller (VR-GS, Sec. 6.2).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from scenes.garden import ANIMALS, animals, garden_scene
from scenes.scene import Body, BodyState, Hand, Role, Scene
from scenes.scripted_hands import PLACING_TIME, placing_hands

PLACE_RADIUS, SIZE_TOLERANCE = 0.35, 0.15  # [m], relative
PLACES = {name: (x, 0.0, z) for name, (*_, (x, z)) in ANIMALS.items()}  # [m]
FLOWERS = dict(zip(ANIMALS, ("orange", "violet", "pink", "white", "yellow"), strict=True))  # around its place
STROKED, STROKE_SPEED = 0.3, 0.01  # [s] and [m/s] of an animal that is stroked
SCRIPT = (
    ("bear", 1 / 0.62),
    ("rabbit", 1 / 1.45),
    ("fox", 1.0),
)  # animals that the scripted hands place, and their factors of size
BACK = 0.25  # height of a back over the centroid, by that of the ears
SETTLE_TIME = 1.2  # [s] between the last of these and the first stroke


@dataclass
class Guest:
    """An animal: height as modelled [m], y of its axis when upright, time it was stroked [s], whether it is home."""

    height: float
    upright: float
    stroked: float = 0.0
    placed: bool = False

    def stands(self, body: BodyState) -> bool:
        """True if it is as upright as at the start."""
        return abs(abs(body.axis[1]) - self.upright) < 0.35


class AnimalCrossing:
    """An animal scores when it stands in its place at its proper size, and once more when it is petted there."""

    moved = PLACING_TIME * len(SCRIPT)
    duration = moved + SETTLE_TIME + 1.6
    goal = 2 * len(ANIMALS)

    def __init__(self):
        self.reset()

    def reset(self) -> None:
        self.guests: list[Guest] = []
        self.time, self.taken = 0.0, None  # taken: the body in the scripted hands, as it was

    def update(self, time: float, bodies: list[BodyState]) -> None:
        dt, self.time = time - self.time, time
        if not self.guests:
            for body, (_, _, size, _) in zip(bodies, ANIMALS.values(), strict=True):
                self.guests.append(Guest((body.high[1] - body.low[1]) / size, abs(body.axis[1])))
        for guest, body, (x, _, z) in zip(self.guests, bodies, PLACES.values(), strict=True):
            is_home = np.hypot(x - body.centroid[0], z - body.centroid[2]) < PLACE_RADIUS
            size = (body.high[1] - body.low[1]) / guest.height
            guest.placed = bool(is_home and guest.stands(body) and abs(size - 1) < SIZE_TOLERANCE)
            if guest.placed and body.held and np.linalg.norm(body.velocity) > STROKE_SPEED:
                guest.stroked += dt

    def interaction(self, time: float) -> str:
        """Mode of the scripted hands: they place the animals, then stroke one."""
        return "transform" if 0.1 < time < self.moved else "physics"

    def hands(self, time: float, bodies: list[BodyState]) -> list[Hand]:
        if time < self.moved:
            (name, factor), t = SCRIPT[int(time / PLACING_TIME)], time % PLACING_TIME
            if t < 0.2 or self.taken is None:
                self.taken = bodies[list(ANIMALS).index(name)]
            return placing_hands(self.taken, PLACES[name], factor, t)
        t = time - self.moved - SETTLE_TIME
        if t < 0.0:
            self.taken = bodies[0]
            return [Hand(tuple(bodies[0].centroid + [0.0, 0.6, 0.3])) for _ in range(2)]
        middle = self.taken.centroid
        back = middle + [0.0, BACK * (self.taken.high[1] - middle[1]), 0.0]
        stroke = back + np.array([0.035 * np.sin(2 * np.pi * t / 0.6), 0.0, 0.0])
        return [Hand(tuple(stroke), grip=0.2 < t < 1.3, reach=0.12), Hand(tuple(back + [0.3, 0.4, 0.3]))]

    @property
    def score(self) -> int:
        return sum(g.placed + (g.stroked >= STROKED) for g in self.guests)

    @property
    def message(self) -> str:
        if self.score == self.goal:
            return "All are at home, and petted. Press R to play again."
        for name, guest in zip(ANIMALS, self.guests, strict=False):
            if not guest.placed:
                home = f"to its ring of {FLOWERS[name]} flowers"
                return f"Bring the {name} {home}, as large as it should be: two hands draw it larger."
            if guest.stroked < STROKED:
                return f"The {name} is at home: pet it."
        return "Bring the animals home."

    def verify(self, bodies: list[BodyState]) -> None:
        """Assert the outcome of the scripted play."""
        placed = [name for name, guest in zip(ANIMALS, self.guests, strict=True) if guest.placed]
        assert set(placed) == {name for name, _ in SCRIPT}, f"at home are {placed}"
        assert self.guests[0].stroked >= STROKED, "the fox was not petted"
        assert all(map(Guest.stands, self.guests, bodies)), "an animal has fallen"


def build() -> Scene:
    scene = garden_scene(
        animals(),
        eye=(-0.1, 1.5, 2.55),
        target=(0.1, 0.35, -0.6),
        game=AnimalCrossing(),
        roles=(Role("animal", tuple(ANIMALS), resize=False),),
    )
    marks = tuple(Body(f"flower_ring_{k}", position=at) for k, at in enumerate(PLACES.values()))
    return replace(scene, room=replace(scene.room, must_fit=True, marks=marks))
