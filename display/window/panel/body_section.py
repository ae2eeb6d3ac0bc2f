"""The panel's section of the selected body: its material, live, and edits."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

from core.material import MATERIALS, Material
from display import user_commands
from display.edit.edit_steps import EDITS
from display.protocol import WorldView
from display.user_commands import Command
from display.window.panel.section import Section
from display.window.panel.slider import Slider
from display.window.panel.theme import QUIET
from display.window.panel.widgets import Sliders, button_grid, pixels, shortened, width_of

BUTTONS = {
    "Copy": (EDITS["copy"], "A copy above it (C)."),
    "Remove": (EDITS["remove"], "(Del)"),
    "Turn": (EDITS["turn"], "About the vertical (, and .)."),
    "Smaller": (EDITS["smaller"], "(-)"),
    "Larger": (EDITS["larger"], "(+)"),
}
GIZMO_TIP = "Handles to move, turn or scale it, then none (G)."
NOTHING = "Take hold of a body to change it."


@dataclass(frozen=True)
class Property:
    """A number of a material that has a slider, from `low` to `high`; `shown` writes it with its unit."""

    field: str
    name: str
    low: float
    high: float
    shown: Callable[[float], str]
    tip: str
    log: bool = False
    rigid: bool = False  # rigid bodies have it too


def pascals(value: float) -> str:
    """A modulus [Pa] with a prefix: "30 kPa"."""
    for factor, unit in ((1e9, "GPa"), (1e6, "MPa"), (1e3, "kPa")):
        if value >= 0.9995 * factor:
            return f"{value / factor:.3g} {unit}"
    return f"{value:.3g} Pa"


PROPERTIES = (
    Property("young", "stiffness", 1e3, 1e8, pascals, "Young's modulus [Pa]: jelly 5 kPa, rubber 2 MPa.", log=True),
    Property(
        "density", "density", 10.0, 5000.0, lambda x: f"{x:,.4g} kg/m\u00b3", "Water has 1,000.", log=True, rigid=True
    ),
    Property("friction", "friction", 0.0, 2.0, lambda x: f"{x:.2f}", "Coefficient: ice 0.05, rubber 1.", rigid=True),
    Property(
        "damping",
        "damping",
        0.0,
        50.0,
        lambda x: f"{x:.1f} /s",
        "Rate at which vibrations lose their energy.",
        log=False,
    ),
)


class BodySection(Section):
    """Material and edits of the body that was last held or pointed at.

    `offers_gizmo`: there is one, of which the next kind was asked for in this frame if `next_gizmo`.
    """

    title = "Body"

    def __init__(self):
        self._sliders = Sliders()
        self.offers_gizmo = self.next_gizmo = False

    def shown(self, world: WorldView) -> bool:
        """True of worlds with bodies."""
        return world.editable

    def label(self, world: WorldView) -> str:
        """The body's name, once one is selected."""
        bodies, k = world.bodies(), world.selected
        return (
            self.title if k is None or k >= len(bodies) else shortened(called(bodies[k].name), width_of(1) - pixels(40))
        )

    def draw(self, world: WorldView) -> list[Command]:
        """Draw sliders, the list of materials and buttons; their commands."""
        from imgui_bundle import imgui

        bodies, k = world.bodies(), world.selected
        if k is None or k >= len(bodies):
            imgui.push_text_wrap_pos(0.0)
            imgui.text_colored(QUIET, NOTHING)
            imgui.pop_text_wrap_pos()
            return []
        _, name = world.material(k)
        commands = self._materials(k, name) + self._sliders.draw(sliders(world))
        tips = {name: tip for name, (_, tip) in BUTTONS.items()} | ({"Gizmo": GIZMO_TIP} if self.offers_gizmo else {})
        pressed = button_grid(tips, 3)
        self.next_gizmo = pressed == "Gizmo"
        return commands + ([BUTTONS[pressed][0]] if pressed in BUTTONS else [])

    def _materials(self, k: int, current: str) -> list[Command]:
        """Draw the list of materials; the command that chooses one."""
        from imgui_bundle import imgui

        commands: list[Command] = []
        imgui.set_next_item_width(-1)
        if imgui.begin_combo("##material", current):
            for name, material in MATERIALS.items():
                if imgui.selectable(f"{name}, {pascals(material.young)}", name == current)[0]:
                    commands.append(user_commands.SetMaterial(k, name))
            if imgui.is_key_pressed(imgui.Key.escape):
                imgui.close_current_popup()
            imgui.end_combo()
        return commands


def sliders(world: WorldView) -> list[Slider]:
    """A slider for each number of the selected body's material."""
    k = world.selected
    material, name = world.material(k)
    return [
        Slider(
            p.name,
            getattr(material, p.field),
            p.low,
            p.high,
            p.shown(getattr(material, p.field)),
            partial(set_property, k, material, p.field),
            log=p.log,
            tip=p.tip,
        )
        for p in PROPERTIES
        if p.rigid or name != "rigid"
    ]


def set_property(k: int, material: Material, field: str, value: float, continued: bool) -> user_commands.SetMaterial:
    """The command that gives body k a material with another number."""
    return user_commands.SetMaterial(k, changed(material, field, value), continued=continued)


def called(name: str) -> str:
    """A body's name for the user: of an asset from a file, that of the file; of a cached one, without its digest."""
    return re.sub(r"-[0-9a-f]{16}$", "", Path(name).stem).replace("_", " ")


def changed(material: Material, field: str, value: float) -> Material:
    """A material with another number; what slides keeps its ratio to the friction of what sticks."""
    if field == "friction" and material.kinetic_friction is not None:
        ratio = material.kinetic_friction / material.friction if material.friction > 0.0 else 1.0
        return replace(material, friction=value, kinetic_friction=ratio * value)
    return replace(material, **{field: value})
