"""Manipulation: hold and pull an animal in its place, by the ears, the nose and the tail; --animal fox|bear|horse.

With --capture it is the largest object of a captured room, in its place, pulled at its most pointed ends.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated, Literal

import numpy as np

from assets.library import cage_vertices, default_material
from assets.room_folder import read_room
from core.errors import BadInput
from core.rotation import matrices_from_quaternions
from scenes.captured_room import room_scene
from scenes.garden import garden_scene
from scenes.roles import bounds
from scenes.scene import Body, BodyState, Hand, Role, Scene, Vec3
from scenes.scripted_hands import ease

REACH = 0.07  # [m] of the scripted hand
PULLED, BACK = 0.05, 0.015  # [m] by which a part must be drawn out, and within which it is back
SETTLE_TIME, PULL_TIME, REST_TIME = 0.8, 1.1, 0.9  # [s] before the first scripted pull, of one, and until the next
HELD_SHARE = 0.33  # of the height of a captured object that stands, which is held fast, as the animals' legs are
END_SHARE = 0.1  # of an object's extent along an axis, that is its end there
HAND_FORCE = 80.0  # [N] of a hand
DRAWN_OUT = 0.12  # [m] by which it is to press in or draw out a captured object, more than PULLED
REACH_SHARE = 0.1  # of a captured object's size that the scripted hand takes
FREE_SHARE = 0.12  # of its height over what is held fast, that does not move much either
LEVER = 10.0
SAG = 0.02  # strain by the weight of a captured object, which is as light as that asks for
DIRECTIONS = {
    "top": (0, 1, 0), "right": (1, 0, 0), "left": (-1, 0, 0), "front": (0, 0, 1), "back": (0, 0, -1),
    "lower end": (0, -1, 0),
}  # fmt: skip
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
    """A part scores when it was drawn out by PULLED and has sprung back.

    lever  ratio of the displacement of a part to that of the animal's centroid, by which the displacement of parts is
           found that do not stick out of the bounding box; 0: all parts stick out
    """

    def __init__(self, parts: tuple[Pull, ...], reach: float = REACH, lever: float = 0.0):
        self.parts, self.goal, self.reach, self.lever = parts, len(parts), reach, lever
        self.duration = len(parts) * (PULL_TIME + REST_TIME) + SETTLE_TIME + 0.6
        self.reset()

    def reset(self) -> None:
        self.touched = False
        self.rest: np.ndarray | None = None  # the corners of the animal's box [m], (2, 3)
        self.middle: np.ndarray | None = None  # its centroid at rest [m], (3,)
        self.drawn = [0.0] * len(self.parts)  # [m] at most so far
        self.done: set[int] = set()

    def update(self, time: float, bodies: list[BodyState]) -> None:
        animal = bodies[0]
        box = np.array([animal.low, animal.high])
        self.touched |= animal.held
        if self.rest is None or not self.touched:  # it may still be settling
            self.rest, self.middle = box, animal.centroid
        for k, pull in enumerate(self.parts):
            d = np.array(pull.direction)
            longer = float(((box - self.rest) @ d)[1 if d.sum() > 0 else 0])
            longer = max(longer, self.lever * float((animal.centroid - self.middle) @ d))
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
        return [Hand(tuple(position), grip=0.3 <= t < PULL_TIME, reach=self.reach)]

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


def build(
    animal: Literal["fox", "bear", "horse"] = "fox", capture: Annotated[str | None, "folder of a captured room"] = None
) -> Scene:
    """The scene of one of ANIMALS, or of the largest object in a captured room: `capture` is its folder."""
    if capture is not None:
        return captured_animal(capture)
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


def captured_animal(folder: str) -> Scene:
    """The largest object of a captured room, fixed where it was fixed, soft enough to be pulled.

    Raises BadInput if there is none.
    """
    room = read_room(folder)
    if not room.objects:
        raise BadInput(f"{folder}: no object was captured there; make it again with --marks: vrgs.py capture")
    scene = room_scene(folder)
    things = sorted(scene.bodies[1:], key=lambda body: -float(np.ptp(bounds(body.asset, body), axis=0).max()))
    own = cage_vertices(things[0].asset).astype(np.float64)
    fixed = things[0].fixed_below
    fixed = own[:, 1].min() + HELD_SHARE * np.ptp(own[:, 1]) if fixed is None else fixed
    turn = matrices_from_quaternions(np.array(things[0].rotation))
    parts = pointed_parts(own @ turn.T, own[:, 1] > fixed + FREE_SHARE * np.ptp(own[:, 1]), turn[:, 1])
    reach = max(REACH, REACH_SHARE * float(np.ptp(own, axis=0).max()))
    young = min(things[0].material.young, HAND_FORCE / (2.0 * reach * DRAWN_OUT))  # a disc of that radius, pressed in
    light = SAG * young / (9.81 * float(np.ptp(own, axis=0).max()))
    material = replace(things[0].material, young=young, density=min(things[0].material.density, light))
    animal = replace(things[0], material=material, fixed_below=float(fixed))
    return replace(
        scene,
        bodies=[scene.bodies[0], animal, *things[1:]],
        game=Manipulation(parts, reach, LEVER),
        roles=(Role("animal", (animal.asset,)),),
    )


def pointed_parts(x: np.ndarray, free: np.ndarray, away: np.ndarray) -> tuple[Pull, ...]:
    """Up to three parts to pull at: the ends of an object along the axes of the room, the most pointed first.

    x     vertices (V, 3) [m] in the room; `free` (V,) bool: well away from those that are fixed
    away  direction (3,) away from what it is fixed to
    """
    low, high = x.min(0), x.max(0)
    found = []
    for name, direction in DIRECTIONS.items():
        d = np.array(direction, float)
        along = x @ d
        end = free & (along > along[free].max(initial=-np.inf) - END_SHARE * np.ptp(along))
        if d @ away < -0.5 or not end.any():
            continue
        at = tuple(map(float, (x[end].mean(0) - low) / (high - low)))
        across = float(np.linalg.norm(np.ptp(x[end], axis=0)[d == 0]))
        found.append((across, Pull(name, at, direction)))
    found.sort(key=lambda part: part[0])
    return tuple(part for _, part in found[:3])
