"""The panel's section of what is kept: pictures, films, states, exports."""

from __future__ import annotations

from typing import get_args, get_type_hints

from display.protocol import WorldView
from display.user_commands import Command, Export, Film, LoadState, SaveState, TakePicture, WriteCamera
from display.window.panel.section import Section
from display.window.panel.widgets import button_grid, width_of

KINDS = get_args(get_type_hints(Export)["kind"])
CAGES = ("vtu", "obj")  # of which colours are no part
KIND_TIP = "ply, spz, splat: Gaussians as they are now. vtu: cages with their fields. obj: surfaces of the cages."


class KeepSection(Section):
    """Buttons that write files."""

    title = "Keep"
    open = False

    def __init__(self):
        self._kind, self._selected_only, self._shadows = KINDS[0], False, True

    def draw(self, world: WorldView) -> list[Command]:
        """Draw the buttons; their commands."""
        body = world.selected if self._selected_only else None
        commands = buttons(world, Export(self._kind, body, self._shadows))
        pressed = button_grid({name: tip for name, (_, tip) in commands.items()}, 3)
        if world.editable:
            self._choices(world)
        return [] if pressed is None else [commands[pressed][0]]

    def _choices(self, world: WorldView) -> None:
        """Draw what an export is to be."""
        from imgui_bundle import imgui

        imgui.set_next_item_width(width_of(1))
        _, k = imgui.combo("##kind", KINDS.index(self._kind), [f"export .{kind}" for kind in KINDS])
        imgui.set_item_tooltip(KIND_TIP)
        self._kind = KINDS[k]
        imgui.begin_disabled(world.selected is None)
        _, self._selected_only = imgui.checkbox(
            "selected body only", self._selected_only and world.selected is not None
        )
        imgui.end_disabled()
        if self._kind not in CAGES:
            _, self._shadows = imgui.checkbox("with shadows", self._shadows)


def buttons(world: WorldView, export: Export) -> dict[str, tuple[Command, str]]:
    """Command and tip of each button by its name."""
    film = "Film" if world.film_seconds is None else "End film"
    made: dict[str, tuple[Command, str]] = {
        "Picture": (TakePicture(), "As a PNG, without panel and marks (F12)."),
        film: (Film(world.film_seconds is None), "As an MP4, without panel and marks (F9)."),
        "Camera": (WriteCamera(), "As a file for vrgs.py render --camera (Shift+F12)."),
    }
    if world.editable:
        made |= {
            "Save": (SaveState(), "The state of the scene (Ctrl+S)."),
            "Load": (LoadState(), "Go on from the last one (Ctrl+L)."),
            "Export": (export, "For other programs, as chosen below (Ctrl+E)."),
        }
    return made
