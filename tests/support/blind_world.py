"""A world that is simulated but draws nothing: for plays whose pictures do not matter."""

from __future__ import annotations

from display.world import World
from scenes.scene import Scene


def blind_world(scene: Scene) -> World:
    """The world of a scene, its bodies as they start; neither shadows nor pictures are made."""
    world = World(scene, width=32, height=32)
    world.device.render = lambda cameras: None
    world.device.cast_shadow = lambda: None
    return world
