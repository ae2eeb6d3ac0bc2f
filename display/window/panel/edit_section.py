"""The panel's section of edits: undo, redo, and what changes the selected body."""

from __future__ import annotations

from core.material import MATERIALS
from display import protocol
from display.edit.edit_steps import EDITS
from display.protocol import Command, WorldView
from display.window.panel.section import Section
from display.window.panel.theme import QUIET
from display.window.panel.widgets import button_grid, width_of

BUTTONS = {
    "Undo": (EDITS["undo"], "Undo the last change (Ctrl+Z)."),
    "Redo": (EDITS["redo"], "Redo it (Ctrl+Y)."),
    "Copy": (EDITS["copy"], "Copy the body that was held last (C)."),
    "Remove": (EDITS["remove"], "Remove it (Del)."),
    "Smaller": (EDITS["smaller"], "(-)"),
    "Larger": (EDITS["larger"], "(+)"),
    "Turn": (EDITS["turn"], "About the vertical (, and .)"),
}


class EditSection(Section):
    """Edits of the selected body."""

    title = "Edit"

    def shown(self, world: WorldView) -> bool:
        """True of worlds with bodies."""
        return world.editable

    def draw(self, world: WorldView) -> list[Command]:
        """Draw the buttons and the list of materials; their commands."""
        from imgui_bundle import imgui

        pressed = button_grid({name: tip for name, (_, tip) in BUTTONS.items()}, 4)
        commands = [] if pressed is None else [BUTTONS[pressed][0]]
        bodies, selected = world.bodies(), world.selected
        known = selected is not None and selected < len(bodies)
        imgui.text_colored(QUIET, bodies[selected].name if known else "Hold a body to select it.")
        if known:
            imgui.same_line(width_of(2))
            imgui.set_next_item_width(-1)
            if imgui.begin_combo("##material", "Material"):
                for name in MATERIALS:
                    if imgui.selectable(name, False)[0]:
                        commands.append(protocol.SetMaterial(selected, name))
                imgui.end_combo()
        return commands
