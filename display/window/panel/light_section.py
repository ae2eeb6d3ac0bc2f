"""The panel's section of the light: its kind, place and shadow."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from display import protocol
from display.protocol import Command, WorldView
from display.window.panel.section import Section
from display.window.panel.widgets import choice, width_of

RANGE = 4.0  # [m] of the sliders around the scene's target


class LightSection(Section):
    """The scene's light."""

    title = "Light"

    def shown(self, world: WorldView) -> bool:
        """True of worlds with a light."""
        return world.light is not None

    def draw(self, world: WorldView) -> list[Command]:
        """Draw the sliders; the changed light."""
        from imgui_bundle import imgui

        light = world.light
        kind = choice(["Point", "Directional"], light.kind.capitalize()).lower()
        low, high = np.array(world.scene.target) - RANGE, np.array(world.scene.target) + RANGE
        gap = imgui.get_style().item_inner_spacing.x
        imgui.push_item_width(width_of(3, gap))
        position = list(light.position)
        for axis, name in enumerate("xyz"):
            if axis:
                imgui.same_line(0, gap)
            label, form = f"##light {name}", f"{name} %.2f m"
            _, position[axis] = imgui.slider_float(label, position[axis], low[axis], high[axis], form)
        imgui.pop_item_width()
        imgui.push_item_width(width_of(2, gap))
        _, strength = imgui.slider_float("##strength", light.strength, 0.0, 1.0, "shadow %.2f")
        imgui.same_line(0, gap)
        _, softness = imgui.slider_float("##softness", 100 * light.softness, 0.0, 20.0, "edge %.1f cm")
        imgui.pop_item_width()
        before = [*light.position, light.strength, 100 * light.softness]
        if kind == light.kind and np.allclose([*position, strength, softness], before):
            return []
        position = tuple(map(float, position))
        changed = replace(light, kind=kind, position=position, strength=strength, softness=softness / 100)
        return [protocol.SetLight(changed)]
