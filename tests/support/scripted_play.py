"""A scene without its room played through by its scripted hands; nothing is drawn."""

from __future__ import annotations

from dataclasses import replace

from display.protocol import Frame
from scenes.scene import Scene

DT = 1 / 60  # [s]


def play(scene: Scene, seconds: float | None = None, each=None):
    """The World after the game's duration, or `seconds`; `each(time, world)` is called after every frame."""
    from display.world import World

    bare = replace(scene, bodies=[b for b in scene.bodies if b.material is not None])
    world = World(bare, width=32, height=32)
    world.device.render, world.device.cast_shadow = lambda cameras: None, lambda: None
    for k in range(round((seconds or scene.game.duration) / DT)):
        time = (k + 1) * DT
        world.step(Frame(DT, time, [], world.scripted_hands(time)))
        if each is not None:
            each(time, world)
    return world
