"""The children's room: its furniture, the toys strewn about, colliders and light."""

from __future__ import annotations

import numpy as np

from core.material import Material
from scenes.scene import Body, Box, Light, Plane, Quat, Room, Vec3

FLOOR = 0.005  # [m] the pile of the rug gives way by as much as it is over the boards
PLAY_RADIUS = 0.9  # [m] of the floor that a play needs
BED_TOP, SHELF_TOP = 0.46, 0.64  # [m]
BACKGROUND = (0.55, 0.5, 0.42)  # behind the few pixels that no Gaussian covers
PLUSH = Material.named("plush")
TOYS = {  # name: (x, y, z) [m], turn about the vertical and forwards [degrees]
    "toy_teddy": ((-0.68, FLOOR, 0.48), 40, 0), "toy_rabbit": ((0.70, FLOOR, 0.45), -35, 0),
    "toy_elephant": ((-0.66, FLOOR, 0.02), 60, 0), "toy_cat": ((0.66, FLOOR, 0.02), -50, 0),
    "toy_duck": ((-0.24, FLOOR, -0.30), 20, 0), "toy_penguin": ((0.22, FLOOR, -0.34), -15, 0),
    "toy_star": ((-0.62, FLOOR + 0.059, -0.46), 30, -90), "toy_frog": ((0.62, FLOOR, -0.42), -25, 0),
    "toy_octopus": ((0.0, FLOOR, -0.74), 0, 0), "toy_ladybird": ((1.02, FLOOR, 0.3), -70, 0),
    "toy_dinosaur": ((-1.33, BED_TOP + 0.005, -0.32), 60, 0), "toy_whale": ((-1.33, BED_TOP + 0.005, -0.85), 50, 0),
}  # fmt: skip


def furniture() -> list[Body]:
    """The static body: the room, whose distance grid holds the play tent, the ball and the blocks."""
    return [Body("childrens_room")]


def toys() -> list[Body]:
    """The plush toys, strewn about, at rest."""
    return [
        Body(name, PLUSH, position=at, rotation=_turned(turn, forwards), asleep=True)
        for name, (at, turn, forwards) in TOYS.items()
    ]


def _turned(turn: float, forwards: float) -> Quat:
    """Quaternion of a body that is first tipped forwards, then turned about the vertical [degrees]."""
    a, b = np.radians([turn, forwards]) / 2
    return (np.cos(a) * np.cos(b), np.cos(a) * np.sin(b), np.sin(a) * np.cos(b), -np.sin(a) * np.sin(b))


def colliders() -> list[Plane | Box]:
    """Floor and walls, bed, and the boards of the shelf."""
    boards = [Box((-0.19, y, -1.51), (0.67, 0.011, 0.17)) for y in (0.061, 0.334, SHELF_TOP - 0.011)]
    uprights = [Box((-0.849 + 0.4393 * k, 0.31, -1.51), (0.011, 0.31, 0.165)) for k in range(4)]
    return [
        Plane((0, FLOOR, 0), (0, 1, 0), friction=0.7),
        Plane((-1.9, 0, 0), (1, 0, 0)),
        Plane((1.9, 0, 0), (-1, 0, 0)),
        Plane((0, 0, -1.7), (0, 0, 1)),
        Plane((0, 0, 2.1), (0, 0, -1)),
        Box((-1.43, BED_TOP / 2, -0.76), (0.45, BED_TOP / 2, 0.92), friction=0.8),
        Box((-1.43, 0.40, -1.65), (0.45, 0.40, 0.03)),
        Box((-1.43, 0.28, 0.13), (0.45, 0.28, 0.03)),
        *boards,
        *uprights,
    ]


def room() -> Room:
    """The children's room, from which a play moves on to another floor."""
    return Room(("childrens_room",), tuple(colliders()), (0.0, FLOOR, 0.0), PLAY_RADIUS, on_floor=True)


def lamp(target: Vec3 = (0.0, 0.0, 0.0)) -> Light:
    """The paper lantern over the rug."""
    return Light(position=(0.25, 2.02, 0.35), target=target, strength=0.5, softness=0.03)
