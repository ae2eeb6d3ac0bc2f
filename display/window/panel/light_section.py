"""The panel's section of the light: its kind, place and shadow."""

from __future__ import annotations

from dataclasses import replace

from display import protocol
from display.protocol import Command, WorldView
from display.window.panel.section import Section
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
        changed = light if kind == light.kind else replace(light, kind=kind)
        for axis, (name, middle) in enumerate(zip("xyz", world.scene.target, strict=True)):
            at = light.position[axis]
            moved = self._sliders.draw(name, at, middle - RANGE, middle + RANGE, f"{at:.2f} m")
            if moved is not None:
                changed = replace(changed, position=(*light.position[:axis], moved[0], *light.position[axis + 1 :]))
        for name, (field, high, unit) in HUNDREDTHS.items():
            value = 100.0 * getattr(light, field)
            moved = self._sliders.draw(name, value, 0.0, high, f"{value:.3g} {unit}")
            if moved is not None:
                changed = replace(changed, **{field: moved[0] / 100.0})
        return [] if changed is light else [protocol.SetLight(changed)]
