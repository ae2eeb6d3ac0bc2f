"""The dining room's table, on which several demos play: its furniture and colliders."""

from __future__ import annotations

from collections.abc import Iterable

from core.material import Material
from scenes.scene import Body, Box, Capsule, Light, Room, Scene, floor_and_walls

TABLE_TOP = 0.75  # [m] above the floor
BOTTLE = (0.0, TABLE_TOP, -0.15)  # [m]
BOTTLE_HEIGHT = 0.30  # [m]
RING_MATERIAL = Material.named("silicone")
BACKGROUND = (0.5, 0.47, 0.4)  # plaster, behind the few pixels that no Gaussian covers


def table_scene(bodies: Iterable[Body], colliders: Iterable[Capsule] = (), **rest) -> Scene:
    """A scene on the table, which another table can replace: the bottle moves there too; `rest`: further fields."""
    own = [*floor_and_walls((-2, 2), (-2.2, 2.3)), Box((0, TABLE_TOP - 0.02, 0), (0.8, 0.02, 0.45), friction=0.5)]
    return Scene(
        bodies=[Body("dining_room"), Body("bottle", position=BOTTLE), *bodies],
        colliders=[*own, *colliders],
        light=Light(position=(0.0, 1.9, 0.1), target=(0.0, TABLE_TOP, 0.0)),  # the lamp above the table
        background=BACKGROUND,
        room=Room(("dining_room",), tuple(own), spot=(0.0, TABLE_TOP, 0.0), radius=0.3),
        **rest,
    )
