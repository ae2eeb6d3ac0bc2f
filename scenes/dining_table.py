"""The dining room's table, on which several demos play: its furniture and colliders."""

from __future__ import annotations

from core.material import Material
from scenes.scene import Body, Box, Light, Plane, Room, floor_and_walls

TABLE_TOP = 0.75  # [m] above the floor
BOTTLE = (0.0, TABLE_TOP, -0.15)  # [m]
BOTTLE_HEIGHT = 0.30  # [m]
RING_MATERIAL = Material.named("silicone")
BACKGROUND = (0.5, 0.47, 0.4)  # plaster, behind the few pixels that no Gaussian covers


def furniture() -> list[Body]:
    """The static bodies: the room with its table, and the bottle."""
    return [Body("dining_room"), Body("bottle", position=BOTTLE)]


def colliders() -> list[Plane | Box]:
    """The dining room's floor, walls and table top."""
    return [*floor_and_walls((-2, 2), (-2.2, 2.3)), Box((0, TABLE_TOP - 0.02, 0), (0.8, 0.02, 0.45), friction=0.5)]


def room() -> Room:
    """The dining room, which another table can replace: the bottle moves there too."""
    return Room(("dining_room",), tuple(colliders()), spot=(0.0, TABLE_TOP, 0.0), radius=0.3)


def lamp() -> Light:
    """The lamp above the table."""
    return Light(position=(0.0, 1.9, 0.1), target=(0.0, TABLE_TOP, 0.0))
