"""The garden: its colliders and sun, and the places of the animals on the lawn."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from assets.library import default_material
from core.material import Material
from scenes.scene import Body, Capsule, Light, Plane, Room, Scene, floor_and_walls

BACKGROUND = (0.62, 0.74, 0.85)  # sky, behind the few pixels that no Gaussian covers
SUNLIGHT = (0.52, -0.74, -0.42)  # direction in which it travels

ANIMALS = {  # name: x, z on the path [m], turn [degrees], size of its own; x, z of its place on the lawn [m]
    "fox": ((1.35, 0.75), -70, 1.0, (-0.95, 0.15)), "bear": ((1.45, -0.15), -95, 0.62, (-0.25, -0.85)),
    "horse": ((1.62, -1.1), -60, 1.0, (-1.25, -1.45)), "sheep": ((1.55, -2.0), -100, 1.0, (0.55, -1.55)),
    "rabbit": ((0.55, 1.3), -80, 1.45, (0.45, 0.25)),
}  # fmt: skip
YOUNG = {"horse": 6.5e5}  # [Pa] where legs would buckle that are as soft as the asset's


def garden_scene(bodies: Iterable[Body], **rest) -> Scene:
    """A scene in the garden, whose distance grid holds the bench and the pots; `rest`: further fields of Scene."""
    return Scene(
        bodies=[Body("garden"), *bodies],
        colliders=colliders(),
        light=sun(),
        background=BACKGROUND,
        room=Room(("garden",), tuple(colliders()), spot=(0.0, 0.0, 0.0), radius=1.2, on_floor=True),
        **rest,
    )


def colliders() -> list[Plane | Capsule]:
    """Lawn, hedges, fence, and the trunk of the tree."""
    trunk = Capsule((-2.15, 0.0, -2.35), (-2.12, 1.3, -2.32), 0.13)
    return [*floor_and_walls((-3.6, 3.6), (-4.2, 3.0), friction=0.9), trunk]


def sun() -> Light:
    """The sun, over the player's left shoulder."""
    position = tuple(-10.0 * d for d in SUNLIGHT)
    return Light(position=position, target=(0.0, 0.0, 0.0), kind="directional", strength=0.6, softness=0.015)


def animals() -> list[Body]:
    """All animals on the path, as at the start of the crossing."""
    return [
        Body(
            name,
            _material(name),
            position=(x, 0.004, z),
            rotation=(np.cos(np.radians(turn) / 2), 0.0, np.sin(np.radians(turn) / 2), 0.0),
            scale=size,
        )
        for name, ((x, z), turn, size, _) in ANIMALS.items()
    ]


def _material(name: str) -> Material:
    """The animal's own material, stiff enough for it to stand."""
    own = default_material(name)
    return replace(own, young=max(own.young, YOUNG.get(name, 0.0)))
