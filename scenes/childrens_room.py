"""The children's room: its furniture, colliders and light."""

from __future__ import annotations

from scenes.scene import Body, Box, Light, Plane, Room, Vec3

FLOOR = 0.005  # [m] the pile of the rug gives way by as much as it is over the boards
PLAY_RADIUS = 0.9  # [m] of the floor that a play needs
BED_TOP, SHELF_TOP = 0.46, 0.64  # [m]
BACKGROUND = (0.55, 0.5, 0.42)  # behind the few pixels that no Gaussian covers


def furniture() -> list[Body]:
    """The static body: the room, whose distance grid holds the play tent, the ball and the blocks."""
    return [Body("childrens_room")]


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
