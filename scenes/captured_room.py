"""A captured room, made by `vrgs.py capture`: its objects can be grabbed, each at its place; --scene ROOM/ plays it.

In a room without objects there is a jelly bear, or what the user brings.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from assets.environment import Environment
from assets.library import default_material
from assets.room_folder import RoomObject, read_room
from core.rotation import matrices_from_quaternions
from scenes.scene import Body, BodyState, Hand, Light, Plane, Role, Scene
from scenes.scripted_hands import ease

TOY, TOY_DROP = "jelly_bear", 0.02  # where no object was captured; [m] over the free place
BACKGROUND = (0.12, 0.13, 0.14)  # where no photograph showed anything
SUN_HEIGHT = 10.0  # [m] above what is looked at
SHADOW = (0.35, 0.03)  # strength and softness: weak, as the photographs have shadows of their own
SETTLE_TIME, TURN_TIME = 0.5, 2.4  # [s] before the scripted hand's first object, and with each
TURNS_MAX = 3  # objects that it takes
LIFT = 0.2  # [m] by which it lifts a free object
DRAWN = 0.15  # of a fixed object's size, by which it is drawn off
MOVED = 0.03  # [m] that an object which was taken has moved at least
SUNK = 0.05  # [m] under the floor at which an object has fallen through it


class CapturedRoom:
    """No goal. The scripted hand lifts free objects a little and lets them fall; it pulls at fixed ones."""

    score, message = 0, "Grab what is here, squeeze it, throw it."

    def __init__(self, objects: tuple[RoomObject, ...], floor: float):
        self.objects, self.floor = objects, floor
        turns = min(len(objects), TURNS_MAX)
        self.duration = SETTLE_TIME + TURN_TIME * turns + 0.4
        self.away = [matrices_from_quaternions(np.array(o.rotation))[:, 1] for o in objects]  # from what holds it
        self.reset()

    def reset(self) -> None:
        self.starts: dict[int, BodyState] = {}
        self.farthest: dict[int, float] = {}

    def update(self, time: float, bodies: list[BodyState]) -> None:
        for k, body in enumerate(bodies):
            if body.held and k in self.starts:
                moved = np.abs(np.subtract([body.low, body.high], [self.starts[k].low, self.starts[k].high])).max()
                self.farthest[k] = max(self.farthest.get(k, 0.0), float(moved))

    def hands(self, time: float, bodies: list[BodyState]) -> list[Hand]:
        since = max(time - SETTLE_TIME, 0.0)
        k = int(since / TURN_TIME)
        if k >= min(len(bodies), TURNS_MAX):
            return []
        body, t = self.starts.setdefault(k, bodies[k]), since - k * TURN_TIME
        size, fixed = body.high - body.low, self.objects[k].fixed_below is not None
        if fixed:
            grasp = 0.5 * (body.low + body.high) + 0.4 * self.away[k] * (np.abs(self.away[k]) @ size)
            way, reach = DRAWN * size.max() * self.away[k], 0.25 * float(size.max())
        else:
            grasp = 0.5 * (body.low + body.high) + [0.0, 0.2 * size[1], 0.0]
            way, reach = np.array([0.0, LIFT, 0.0]), 0.45 * float(size.max())
        position = grasp + 0.15 * self.away[k] * (1 - ease(t / 0.3)) + way * ease((t - 0.3) / 0.8)
        return [Hand(tuple(position), grip=0.3 <= t < 1.4, reach=max(reach, 0.05))]

    def verify(self, bodies: list[BodyState]) -> None:
        """Assert the outcome of the scripted play: what was free and taken has moved, and nothing left the room."""
        for k, (body, thing) in enumerate(zip(bodies, self.objects, strict=True)):
            assert np.isfinite(body.centroid).all() and body.high[1] > self.floor - SUNK, f"{thing.name} fell out"
            if k < TURNS_MAX and thing.fixed_below is None:
                assert self.farthest.get(k, 0.0) > MOVED, f"{thing.name} was not moved"


def room_scene(folder: str) -> Scene:
    """The scene of a captured room: the player stands where a photographer stood. Raises BadInput."""
    path, room = Path(folder), read_room(folder)
    objects = []
    for thing in room.objects:
        asset = str(path / thing.asset)
        body = Body(asset, default_material(asset), position=thing.position, rotation=thing.rotation)
        objects.append(replace(body, fixed_below=thing.fixed_below, asleep=True, captured=True))
    shown = room.objects or (RoomObject(TOY, TOY, (0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0)),)
    if not objects:
        x, y, z = Environment.load(path / room.background).drop_point
        objects = [Body(TOY, default_material(TOY), position=(x, y + TOY_DROP, z))]
    tx, ty, tz = room.target  # lit from above, as in most rooms: photographs do not tell where their light was
    return Scene(
        bodies=[Body(str(path / room.background)), *objects],
        colliders=[Plane((0.0, room.floor, 0.0), (0.0, 1.0, 0.0), friction=0.8)],
        light=Light((tx + 2.0, ty + SUN_HEIGHT, tz + 3.0), room.target, "directional", *SHADOW),
        background=BACKGROUND,
        eye=room.eye,
        target=room.target,
        fov_y=room.fov_y,
        floor=room.floor,
        game=CapturedRoom(shown, room.floor),
        roles=(Role("object", tuple(b.asset for b in objects), resize=bool(room.objects)),),
    )
