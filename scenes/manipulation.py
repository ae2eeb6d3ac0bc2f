"""Manipulation: hold and pull an animal in its place, by the ears, the nose and the tail; --animal fox|bear|horse."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from assets.library import default_material
from scenes.garden import garden_scene
from scenes.scene import Body, BodyState, Hand, Role, Scene, Vec3
from scenes.scripted_throw import ease

REACH = 0.07  # [m] of the scripted hand
PULLED, BACK = 0.05, 0.015  # [m] by which a part must be drawn out, and within which it is back
SETTLE_TIME, PULL_TIME, REST_TIME = 0.8, 1.1, 0.9  # [s] before the first scripted pull, of one, and until the next
EYE_DISTANCE = 1.45  # [m] before an animal of 1 m; nearer to a smaller one


@dataclass(frozen=True)
class Pull:
    """A part to pull at: where it is, as fractions of the animal's box, and in which direction."""

    part: str
    at: Vec3
    direction: Vec3


# Height [m], height [m] below which it is held fast, parts, and Young's modulus [Pa]: soft enough for a hand of 80 N
# to draw out a tail; on its own the animal would not stand up.
ANIMALS = {
    "fox": (0.47, 0.17, (Pull("ear", (0.24, 0.97, 0.84), (0, 1, 0)), Pull("nose", (0.5, 0.75, 0.97), (0, 0, 1)),
                         Pull("tail", (0.5, 0.41, 0.03), (0, 0, -1))), 2.5e4),
    "bear": (0.63, 0.20, (Pull("ear", (0.70, 0.98, 0.82), (0, 1, 0)), Pull("nose", (0.5, 0.76, 0.99), (0, 0, 1)),
                          Pull("tail", (0.5, 0.56, 0.02), (0, 0, -1))), 1.2e4),
    "horse": (1.02, 0.45, (Pull("ear", (0.56, 0.98, 0.80), (0, 1, 0)), Pull("nose", (0.5, 0.80, 0.98), (0, 0, 1)),
                          Pull("tail", (0.5, 0.49, 0.02), (0, 0, -1))), 1.6e4),
}  # fmt: skip


class Manipulation:
    """A part scores when it was drawn out by PULLED and has sprung back."""

    def __init__(self, parts: tuple[Pull, ...]):
        self.parts, self.goal = parts, len(parts)
        self.duration = len(parts) * (PULL_TIME + REST_TIME) + SETTLE_TIME + 0.6
        self.reset()

    def reset(self) -> None:
        self.touched = False
        self.rest: np.ndarray | None = None  # the corners of the animal's box [m], (2, 3)
        self.drawn = [0.0] * len(self.parts)  # [m] at most so far
        self.done: set[int] = set()

    def update(self, time: float, bodies: list[BodyState]) -> None:
        animal = bodies[0]
        box = np.array([animal.low, animal.high])
        self.touched |= animal.held
        if self.rest is None or not self.touched:  # it may still be settling
            self.rest = box
        for k, pull in enumerate(self.parts):
            d = np.array(pull.direction)
            longer = float(((box - self.rest) @ d)[1 if d.sum() > 0 else 0])
            if animal.held:
                self.drawn[k] = max(self.drawn[k], longer)
            elif self.drawn[k] > PULLED and longer < BACK:
                self.done.add(k)

    def hands(self, time: float, bodies: list[BodyState]) -> list[Hand]:
        since = max(time - SETTLE_TIME, 0.0)
        turn = min(int(since / (PULL_TIME + REST_TIME)), len(self.parts) - 1)
        pull, t = self.parts[turn], since - turn * (PULL_TIME + REST_TIME)
        way = 2.2 * PULLED * ease((t - 0.3) / (PULL_TIME - 0.35))
        away = 0.15 * (1 - ease(t / 0.25)) if t < PULL_TIME else 0.2 * ease((t - PULL_TIME) / 0.4)
        low, high = self.rest if self.rest is not None else (bodies[0].low, bodies[0].high)
        position = low + np.array(pull.at) * (high - low) + (way + away) * np.array(pull.direction)
        return [Hand(tuple(position), grip=0.3 <= t < PULL_TIME, reach=REACH)]

    @property
    def score(self) -> int:
        return len(self.done)

    @property
    def message(self) -> str:
        left = [pull.part for k, pull in enumerate(self.parts) if k not in self.done]
        return f"Pull at its {left[0]}, and let go." if left else "It has sprung back each time. Press R to play again."

    def verify(self, bodies: list[BodyState]) -> None:
        """Assert the outcome of the scripted play: each part was drawn out, and the animal is as it was."""
        assert self.score == len(self.parts), f"drawn out by {np.round(self.drawn, 3)} m, back: {sorted(self.done)}"
        assert np.abs(np.array([bodies[0].low, bodies[0].high]) - self.rest).max() < BACK, "it is not in its place"


def build(animal: Literal["fox", "bear", "horse"] = "fox") -> Scene:
    """`animal` is one of ANIMALS."""
    height, fixed, parts, young = ANIMALS[animal]
    soft = replace(default_material(animal), young=young)
    far = EYE_DISTANCE * max(height, 0.6)
    return garden_scene(
        [Body(animal, soft, fixed_below=fixed)],
        eye=(-0.75 * far, 0.75 * height + 0.35, far),
        target=(0.0, 0.5 * height, 0.0),
        game=Manipulation(parts),
        roles=(Role("animal", (animal,)),),
    )
