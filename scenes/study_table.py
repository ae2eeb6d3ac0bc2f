"""The study's table, on which the brick game plays: the room's colliders, the tower, and where the ball lies."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from core.material import Material
from scenes.scene import IDENTITY, Body, Box, Capsule, Light, Plane, Quat, Room, Vec3

TABLE_TOP = 0.76  # [m] above the floor
TABLE_HALF = (0.75, 0.40)  # [m] along x and z, about the origin
ROOM_LOW, ROOM_HIGH = (-1.9, 0.0, -1.75), (1.9, 2.7, 2.2)  # [m]
PLAY_RADIUS = 0.35  # [m] of the table top that the play needs
BACKGROUND = (0.30, 0.24, 0.18)  # dim wood, behind the few pixels that no Gaussian covers
BALL_RADIUS = 0.042  # [m]
BALL_HEIGHT = 0.047  # [m] of its centre above the table: it lies on the ring
BALL_RING = ((0.40, TABLE_TOP, 0.14), 0.030, 0.007)  # a wooden ring that keeps the ball: centre, radius, its rod's [m]
PLANK, CUBE, GAP = (0.15, 0.032, 0.049), 0.049, 0.001  # [m] sizes of the bricks; air between neighbours
TOWER = (0.0, TABLE_TOP, -0.06)  # [m] centre of its foot
LAYERS = 4  # of three planks, crosswise
PLANKS = ("brick_maple", "brick_red", "brick_green", "brick_walnut", "brick_blue", "brick_yellow")
BRICK = Material.named("wood", friction=0.5, kinetic_friction=0.35)
RUBBER = Material(young=3e4, poisson=0.35, density=900.0, friction=0.7, damping=30.0)  # [Pa], [-], [kg/m^3], [-], [1/s]
JELLY = Material.named("jelly", young=1.2e4, poisson=0.35, friction=0.7, kinetic_friction=0.5, damping=30.0)
QUARTER: Quat = (0.5**0.5, 0.0, 0.5**0.5, 0.0)  # turned by 90 degrees about y


def colliders() -> list[Plane | Box | Capsule]:
    """The study's floor, walls, table top, the bookcase at the far wall, and the ring that keeps the ball."""
    (x0, _, z0), (x1, _, z1) = ROOM_LOW, ROOM_HIGH
    (x, y, z), radius, rod = BALL_RING
    angle = np.linspace(0, 2 * np.pi, 9)
    rim = np.stack([x + radius * np.cos(angle), 0 * angle + y + rod, z + radius * np.sin(angle)], 1)
    return [
        Plane((0, 0, 0), (0, 1, 0)),
        Plane((x0, 0, 0), (1, 0, 0)),
        Plane((x1, 0, 0), (-1, 0, 0)),
        Plane((0, 0, z0 + 0.32), (0, 0, 1)),
        Plane((0, 0, z1), (0, 0, -1)),
        Box((0, TABLE_TOP - 0.02, 0), (TABLE_HALF[0], 0.02, TABLE_HALF[1]), friction=0.6),
        *(Capsule(tuple(a), tuple(b), rod) for a, b in pairwise(rim)),
    ]


def room() -> Room:
    """The study, from which the play moves on to another table."""
    return Room(("study",), tuple(colliders()), (0.0, TABLE_TOP, 0.0), PLAY_RADIUS)


def tower() -> list[Body]:
    """Crosswise layers of planks, two lettered cubes on them, and a plank across these."""
    x, y, z = TOWER
    bodies = []
    for k in range(3 * LAYERS):
        layer, aside = k // 3, (k % 3 - 1) * (PLANK[2] + GAP)
        height = y + (layer + 0.5) * PLANK[1]
        along_x = layer % 2 == 0
        at = (x, height, z + aside) if along_x else (x + aside, height, z)
        bodies.append(_brick(PLANKS[(k + 2 * layer) % len(PLANKS)], at, IDENTITY if along_x else QUARTER))
    top = y + LAYERS * PLANK[1]
    bodies += [_brick("brick_letters", (x + s * 0.045, top + 0.5 * CUBE, z), IDENTITY) for s in (-1, 1)]
    return [*bodies, _brick("brick_red", (x, top + CUBE + 0.5 * PLANK[1], z), IDENTITY)]


def tower_height() -> float:
    """Height of the tower's top above the floor [m]."""
    return TABLE_TOP + (LAYERS + 1) * PLANK[1] + CUBE


def toys() -> list[Body]:
    """The bear of jelly on top of the tower, and the ball in its ring."""
    (x, y, z), _, _ = BALL_RING
    bear = Body("jelly_bear", JELLY, position=(TOWER[0], tower_height(), TOWER[2]), asleep=True)
    return [bear, Body("rubber_ball", RUBBER, position=(x, y + BALL_HEIGHT, z), asleep=True)]


def lamp(target: Vec3 = (0.0, TABLE_TOP, 0.0)) -> Light:
    """Daylight from the window at the left."""
    return Light(position=(-1.5, 2.1, 0.7), target=target)


def _brick(asset: str, position: Vec3, rotation: Quat) -> Body:
    return Body(asset, BRICK, position=position, rotation=rotation, kind="rigid", asleep=True)
