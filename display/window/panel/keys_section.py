"""The panel's section of mouse and keys."""

from __future__ import annotations

from display.protocol import Command, WorldView
from display.window.key_bindings import help_rows
from display.window.panel.section import Section
from display.window.panel.theme import QUIET


class KeysSection(Section):
    """The list of mouse gestures and keys."""

    title = "Mouse and keys"
    open = False

    def draw(self, world: WorldView) -> list[Command]:
        """Draw the list; no commands."""
        from imgui_bundle import imgui

        if imgui.begin_table("help", 2, imgui.TableFlags_.sizing_fixed_fit):
            for keys, meaning in help_rows(world.editable):
                imgui.table_next_row()
                imgui.table_next_column()
                imgui.text(keys)
                imgui.table_next_column()
                imgui.push_text_wrap_pos(0.0)
                imgui.text_colored(QUIET, meaning)
                imgui.pop_text_wrap_pos()
            imgui.end_table()
        return []
