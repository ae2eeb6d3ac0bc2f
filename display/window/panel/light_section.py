"""The panel's section of the light: its kind, place and shadow."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

from core.vocabulary import Light
from display import user_commands
from display.protocol import WorldView
from display.user_commands import Command
from display.window.panel.section import Section
from display.window.panel.slider import Slider
from display.window.panel.widgets import Sliders, choice

HUNDREDTHS = {"shadow": ("strength", 100.0, "%"), "edge": ("softness", 20.0, "cm")}  # field, largest, unit
RANGE = 4.0  # [m] of the sliders around the scene's target


class LightSection(Section):
    """The scene's light."""

    title = "Light"
    open = False

    def __init__(self):
        self._sliders = Sliders()

    def shown(self, world: WorldView) -> bool:
        """True of worlds with a light."""
        return world.light is not None

    def draw(self, world: WorldView) -> list[Command]:
        """Draw the sliders; the changed light."""
        light = world.light
        kind = choice(["Point", "Directional"], light.kind.capitalize()).lower()
        commands = [] if kind == light.kind else [user_commands.SetLight(replace(light, kind=kind))]
        return commands + self._sliders.draw(sliders(world))


def sliders(world: WorldView) -> list[Slider]:
    """Those of the light's place, and of the strength and edge of its shadow."""
    light, made = world.light, []
    for axis, (name, middle) in enumerate(zip("xyz", world.scene.target, strict=True)):
        at = light.position[axis]
        made.append(Slider(name, at, middle - RANGE, middle + RANGE, f"{at:.2f} m", partial(moved, light, axis)))
    for name, (field, high, unit) in HUNDREDTHS.items():
        value = 100.0 * getattr(light, field)
        made.append(Slider(name, value, 0.0, high, f"{value:.3g} {unit}", partial(shaded, light, field)))
    return made


def moved(light: Light, axis: int, value: float, continued: bool) -> user_commands.SetLight:
    """The command that moves a light along an axis to `value` [m]."""
    position = (*light.position[:axis], value, *light.position[axis + 1 :])
    return user_commands.SetLight(replace(light, position=position))


def shaded(light: Light, field: str, hundredths: float, continued: bool) -> user_commands.SetLight:
    """The command that changes a light's field to a number of hundredths."""
    return user_commands.SetLight(replace(light, **{field: hundredths / 100.0}))
