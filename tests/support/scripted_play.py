"""A scene without its room, simulated but not drawn, and played through by its scripted hands."""

from dataclasses import replace
from unittest.mock import patch

from display.protocol import Frame
from scenes.scene import Scene

DT = 1 / 60  # [s]


def blind_world(scene: Scene):
    """The World of a scene's bodies without its room, as they start; Gaussians neither follow them nor are drawn."""
    from display.world import DeviceScene, World

    class Undrawn(DeviceScene):
        def deform(self):
            pass

        cast_shadow = deform

        def render(self, cameras):
            pass

    bare = replace(scene, bodies=[b for b in scene.bodies if b.material is not None])
    with patch("display.world.DeviceScene", Undrawn):
        return World(bare, width=32, height=32)


def frames(world, seconds: float, *, begin: float = 0.0, dt: float = DT):
    """Step a world through `seconds` of its script from `begin` [s] on; yields the time after each frame."""
    for k in range(round(seconds / dt)):
        time = begin + (k + 1) * dt
        world.step(Frame(dt, time, [], world.scripted_hands(time)))
        yield time


def play(scene: Scene, seconds: float | None = None, each=None, *, dt: float = DT):
    """The World after the game's duration, or `seconds`; `each(time, world)` is called after every frame."""
    world = blind_world(scene)
    for time in frames(world, seconds or scene.game.duration, dt=dt):
        if each is not None:
            each(time, world)
    return world
