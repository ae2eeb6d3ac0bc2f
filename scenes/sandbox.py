"""Sandbox: drop your own splats (--body FILE) on the table, here or in your own room (--stage), and play with them.

An animated body cannot be carried off: beside it lies a ring to throw at it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from assets.library import animated_height, default_material
from core.material import Material
from scenes.dining_table import RING_MATERIAL, TABLE_TOP, table_scene
from scenes.roles import bounds
from scenes.scene import Body, BodyState, Hand, Role, Scene, Vec3
from scenes.scripted_hands import Throw

START = (0.0, TABLE_TOP + 0.03, 0.14)  # [m], of the body's lowest point
GAP = 0.04  # [m] between bodies side by side
ROW_WIDTH = 1.4  # [m] of the table of 1.6 m; what finds no place in a row falls from above it
RING = "ring_red"  # thrown at an animated body
TOYS = (RING, "jelly_bear", "toy_duck")  # where the user brings none
RING_SCALE_PER_METRE = 2.2  # size of the ring, in multiples of the ring toss's, for each metre of that body's height


class Sandbox:
    """No goal. The scripted hand waits until the body rests, lifts it by its upper part and throws it.

    target          of the throw [m]
    dancer_height   of an animated body [m], at which the hand throws a ring, again and again; None: not animated
    """

    score = 0
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
            reach = max(0.06, 0.45 * float((body.high - body.low).max()))  # beyond the rim of a ring's hole
            self.throw = Throw(
                tuple(grasp), tuple(release), target, grab_radius=reach, acceleration_time=0.12, flight_time=0.4
            )
            self.throw_start = time

    def throw_at_dancer(self, body: BodyState, ring: BodyState) -> Throw:
        """A throw from the front at the dancer's chest, wherever ring and dancer are now."""
        h = self.dancer_height
        middle = 0.5 * (body.low + body.high)
        release = (middle[0] + 0.25 * h, body.low[1] + 0.9 * h, body.high[2] + 0.7 * h)
        chest = (middle[0], body.low[1] + 0.65 * h, middle[2])
        return Throw.of(ring, release, chest, approach_time=0.3, lift_time=0.5, flight_time=0.25 * np.sqrt(h))

    def hands(self, time: float, bodies: list[BodyState]) -> list[Hand]:
        return [self.throw.hand(time - self.throw_start)] if self.throw else []

    @property
    def message(self) -> str:
        return "Grab it, squeeze it, throw it." if self.dancer_height is None else "Throw the ring at it."

    def verify(self, bodies: list[BodyState]) -> None:
        """Assert the outcome of the scripted play."""
        assert bodies[0].low[1] > -0.01, "the body fell through the floor"


def build(body: tuple[str, ...] = TOYS, material: str | None = None) -> Scene:
    """Bodies side by side on the dining table.

    body      assets, of which the scripted hand takes the first
    material  a name (core/material.py); None: the assets' own
    """
    height = animated_height(body[0])
    start = START if height is None else (START[0], TABLE_TOP, 0.0)
    back = 0.0 if height is None else min(max(1.5 * height - 0.7, 0.0), 1.2)  # [m], to see it from head to foot
    return table_scene(
        [*side_by_side(body, material, start), *rings(start, height)],
        eye=(0.0, 1.35 + 0.3 * back, 1.0 + back),
        target=(0.0, 0.85 + 0.6 * back, 0.0),
        game=Sandbox(dancer_height=height),
        roles=(Role("toy" if height is None else "dancer", tuple(body)),),
    )


def side_by_side(assets: tuple[str, ...], material: str | None, start: Vec3) -> list[Body]:
    """Bodies in rows from left to right, one row above the other, dropped from the height of `start` or dancing on the
    table; a single body is at `start`."""
    bodies = []
    for asset in assets:
        height = animated_height(asset)
        made_of = default_material(asset) if material is None else Material.named(material)
        bodies.append(Body(asset, made_of if height is None else made_of.animated(height)))
    if len(bodies) == 1:
        return [replace(bodies[0], position=start)]
    boxes = [bounds(body.asset, body) for body in bodies]
    placed, foot = [], start[1]
    for row in rows_of([high[0] - low[0] for low, high in boxes]):
        left = start[0] - 0.5 * (sum(boxes[k][1][0] - boxes[k][0][0] for k in row) + GAP * (len(row) - 1))
        for k in row:
            low, high = boxes[k]
            at = foot if animated_height(assets[k]) is None else TABLE_TOP
            placed.append(replace(bodies[k], position=(float(left - low[0]), float(at - low[1]), start[2])))
            left += high[0] - low[0] + GAP
        foot += max(boxes[k][1][1] - boxes[k][0][1] for k in row) + GAP
    return placed


def rows_of(widths: Sequence[float]) -> list[list[int]]:
    """Indices of bodies of these widths [m] in rows of at most ROW_WIDTH, in their order."""
    rows, used = [[]], 0.0
    for k, width in enumerate(widths):
        if rows[-1] and used + width > ROW_WIDTH:
            rows.append([])
            used = 0.0
        rows[-1].append(k)
        used += width + GAP
    return rows


def rings(place: Vec3, height: float | None) -> list[Body]:
    """A ring beside an animated body of this height [m] that stands at `place`; [] beside any other body."""
    if height is None:
        return []
    scale = float(np.clip(RING_SCALE_PER_METRE * height, 0.5, 1.5))
    at = (place[0] + 0.12 * scale + 0.25 * height, place[1] + 0.019 * scale, place[2] + 0.1 * scale)
    return [Body(RING, RING_MATERIAL, position=at, scale=scale)]
