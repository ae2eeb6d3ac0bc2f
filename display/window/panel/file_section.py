"""The panel's sections of a viewer of splat files: what is known of the file, and the crop."""

from __future__ import annotations

import numpy as np

from display import user_commands
from display.protocol import WorldView
from display.user_commands import Command
from display.window.panel.section import Section
from display.window.panel.slider import Slider
from display.window.panel.theme import QUIET
from display.window.panel.widgets import Sliders, button_grid, shortened, table_row, width_of

BUTTONS = {
    "Next file": (user_commands.NextFile(), "Tab"),
    "Turn up": (user_commands.TurnUp(), "The next of the file's axes points up (Y)."),
    "Axes": (None, "x red, y green, z blue; each 1, 0.1 or 10 m long (X)."),
    "Background": (user_commands.NextBackground(), "Grey, black, white, blue (B)."),
}


class FileSection(Section):
    """Name and numbers of the file that is shown, and how it is shown."""

    title = "File"

    def shown(self, world: WorldView) -> bool:
        """True where files are looked at."""
        return world.file is not None

    def draw(self, world: WorldView) -> list[Command]:
        """Draw the buttons and the table; the commands of the buttons."""
        from imgui_bundle import imgui

        number, count = world.file_number
        imgui.text_colored(QUIET, shortened(f"{number} of {count}: {world.file.path.name}", width_of(1)))
        names = {name: tip for name, (_, tip) in BUTTONS.items() if count > 1 or name != "Next file"}
        pressed = button_grid(names, 2)
        if imgui.begin_table("facts", 2, imgui.TableFlags_.sizing_stretch_prop):
            for name, value in world.file.facts:
                table_row(name, value)
            imgui.end_table()
        if pressed is None:
            return []
        return [BUTTONS[pressed][0] or user_commands.ShowAxes(not world.axes)]


class CropSection(Section):
    """Six sliders of a box outside of which nothing is shown, and buttons to write what is left."""

    title = "Crop"
    open = False

    def __init__(self):
        self._sliders = Sliders()

    def shown(self, world: WorldView) -> bool:
        """True where files are looked at."""
        return world.file is not None

    def draw(self, world: WorldView) -> list[Command]:
        """Draw sliders and buttons; their commands, of which the last moved slider counts."""
        commands = self._sliders.draw(sliders(world))
        pressed = button_grid({"All": "Crop nothing.", "Write": "What is left, as a splat file of its own (O)."}, 2)
        if pressed == "All":
            bounds = world.file.bounds
            commands.append(user_commands.Crop(tuple(bounds.low.tolist()), tuple(bounds.high.tolist())))
        return [*commands, user_commands.WriteSplats()] if pressed == "Write" else commands


def sliders(world: WorldView) -> list[Slider]:
    """A slider for each side of the crop."""
    bounds, box = world.file.bounds, world.file.crop or world.file.bounds
    made = []
    for side, corner in (("from", box.low), ("to", box.high)):
        for axis, name in enumerate("xyz"):

            def command(value: float, _: bool, side=side, axis=axis) -> Command:
                low, high = np.array(box.low), np.array(box.high)
                (low if side == "from" else high)[axis] = value
                return user_commands.Crop(tuple(np.minimum(low, high).tolist()), tuple(np.maximum(low, high).tolist()))

            ends, value = (float(bounds.low[axis]), float(bounds.high[axis])), float(corner[axis])
            usual = ends[0] if side == "from" else ends[1]
            made.append(Slider(f"{name} {side}", value, *ends, f"{value:.3g} m", command, usual=usual))
    return sorted(made, key=lambda slider: slider.name[0])
