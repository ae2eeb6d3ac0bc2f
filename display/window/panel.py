"""The panel over the picture (ImGui): simulation, edits, light, performance; the game's score.

The theme is Roboto on dark glass with one accent colour.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from time import perf_counter

import numpy as np

from core.material import MATERIALS
from display import protocol
from display.protocol import Command, WorldView
from display.timing import Timings
from display.window.controls import CAMERA_HELP, EDITS, HELP
from scenes.scene import Light, Scene

ACCENT = (0.98, 0.66, 0.24, 1.0)
QUIET = (0.66, 0.69, 0.74, 1.0)
TEXT_SIZE = 15.0  # [px] at a display scale of 1
TITLE_SIZE = 20.0
MARGIN = 12.0  # [px] from the window's edge
WIDTH = 252.0  # [px] of the panel's content
OPEN_HELP_HEIGHT = 700.0  # [px] of window height above which the list of keys is open at the start
READ_INTERVAL = 0.5  # [s] between two readings of the numbers: faster ones cannot be read
LIGHT_RANGE = 4.0  # [m] of the sliders around the scene's target
INTERACTIONS = {
    "Physics": "Bodies deform, collide and fall.",
    "Transform": "A body that you hold moves rigidly; nothing deforms.",
}
EDIT_BUTTONS = {
    "Undo": (EDITS["undo"], "Undo the last change (Ctrl+Z)."),
    "Redo": (EDITS["redo"], "Redo it (Ctrl+Y)."),
    "Copy": (EDITS["copy"], "Copy the body that was held last (C)."),
    "Remove": (EDITS["remove"], "Remove it (Del)."),
    "Smaller": (EDITS["smaller"], "(-)"),
    "Larger": (EDITS["larger"], "(+)"),
    "Turn": (EDITS["turn"], "About the vertical (, and .)"),
}
RESOLUTIONS = {"Auto": None, "Full": 1.0, "3/4": 0.75, "1/2": 0.5}  # scale of a side of the picture


class Panel:
    """The panel of an ImGui context, which it themes; `draw` returns the user's commands for the world.

    `resolution` is the scale of a side of the picture that the user has chosen, None: what keeps the rate
    (display/adaptive_resolution.py). `details`: the list of stages is on view; `edits`: the cursor is among the edits.
    """

    def __init__(self, scene: Scene, title: str, scale: float):
        self.scene, self.title, self.scale = scene, title, scale
        self.resolution: float | None = None
        self.details = self.edits = False
        self._read = -READ_INTERVAL
        self._fps, self._stages, self._stats = 0.0, [], {}
        self._frame_lines: list[str] = []
        apply_theme(scale)

    def draw(self, world: WorldView, *, visible: bool) -> list[Command]:
        """Draw one frame of the panel and of the score; the commands that the user gives."""
        from imgui_bundle import imgui

        if world.editable and (self.scene.game is not None or world.notice):
            self._score(imgui, world, visible)
        self.edits = False
        if not visible:
            self.details = False
            return []
        now = perf_counter()
        if now - self._read >= READ_INTERVAL:
            self._read = now
            self._fps, self._stages, self._stats = world.timings.recent_fps(), world.timings.recent(), world.stats()
            self._frame_lines = frame_lines(world.timings)
        edge = MARGIN * self.scale
        height = imgui.get_io().display_size.y - 2 * edge
        imgui.set_next_window_pos((edge, edge))
        imgui.set_next_window_size_constraints((0, 0), (imgui.FLT_MAX, max(height, 1.0)))
        flags = imgui.WindowFlags_
        fixed = flags.no_title_bar | flags.always_auto_resize | flags.no_move | flags.no_saved_settings
        imgui.begin("panel", None, fixed | flags.no_nav | flags.no_focus_on_appearing)
        self._title(imgui)
        commands: list[Command] = []
        if world.editable:
            commands += self._buttons(imgui, world)
        if world.editable and imgui.collapsing_header("Edit", imgui.TreeNodeFlags_.default_open):
            imgui.begin_group()
            commands += self._edit(imgui, world)
            imgui.end_group()
            self.edits = imgui.is_mouse_hovering_rect(imgui.get_item_rect_min(), imgui.get_item_rect_max())
        if world.light is not None and imgui.collapsing_header("Light", imgui.TreeNodeFlags_.default_open):
            commands += self._light(imgui, world.light)
        self.details = imgui.collapsing_header("Performance", imgui.TreeNodeFlags_.default_open)
        if self.details:
            self._performance(imgui)
        tall = imgui.get_io().display_size.y >= OPEN_HELP_HEIGHT * self.scale
        if imgui.collapsing_header("Mouse and keys", imgui.TreeNodeFlags_.default_open if tall else 0):
            self._help(imgui)
        imgui.end()
        return commands

    def _title(self, imgui) -> None:
        width = WIDTH * self.scale
        imgui.push_font(None, TITLE_SIZE)
        imgui.text(self.title)
        imgui.pop_font()
        rate = f"{self._fps:.0f} fps"
        imgui.same_line(width - imgui.calc_text_size(rate).x + imgui.get_style().window_padding.x)
        imgui.set_cursor_pos_y(imgui.get_cursor_pos_y() + 4 * self.scale)  # onto the title's base line
        imgui.text_colored(ACCENT, rate)
        imgui.dummy((width, 2 * self.scale))
        for file, role in self.scene.cast:
            imgui.push_text_wrap_pos(width)
            imgui.text_colored(QUIET, f"{file} is {role}")
            imgui.pop_text_wrap_pos()

    def _buttons(self, imgui, world: WorldView) -> list[Command]:
        commands = []
        gap = imgui.get_style().item_spacing.x
        third = ((WIDTH * self.scale - 2 * gap) / 3, 0)
        if imgui.button("Resume" if world.paused else "Pause", third):
            commands.append(protocol.Pause(not world.paused))
        imgui.same_line()
        if imgui.button("Step", third):
            commands += [protocol.Pause(True), protocol.SingleStep()]
        imgui.same_line()
        if imgui.button("Reset", third):
            commands.append(protocol.Reset())
        chosen = self._choice(imgui, list(INTERACTIONS), world.interaction.capitalize(), INTERACTIONS)
        if chosen.lower() != world.interaction:
            commands.append(protocol.SetInteraction(chosen.lower()))
        return commands

    def _edit(self, imgui, world: WorldView) -> list[Command]:
        """Draw undo, redo, and the edits of the selected body."""
        commands, gap = [], imgui.get_style().item_spacing.x
        quarter = ((WIDTH * self.scale - 3 * gap) / 4, 0)
        for k, (name, (command, tip)) in enumerate(EDIT_BUTTONS.items()):
            if k % 4:
                imgui.same_line()
            if imgui.button(name, quarter):
                commands.append(command)
            imgui.set_item_tooltip(tip)
        bodies, selected = world.bodies(), world.selected
        known = selected is not None and selected < len(bodies)
        imgui.text_colored(QUIET, bodies[selected].name if known else "Hold a body to select it.")
        if known:
            imgui.same_line(WIDTH * self.scale * 0.5)
            imgui.set_next_item_width(WIDTH * self.scale * 0.5 + imgui.get_style().window_padding.x)
            if imgui.begin_combo("##material", "Material"):
                for name in MATERIALS:
                    if imgui.selectable(name, False)[0]:
                        commands.append(protocol.SetMaterial(selected, name))
                imgui.end_combo()
        return commands

    def _choice(self, imgui, names: list[str], current: str, tips: dict[str, str] | None = None) -> str:
        """Draw buttons side by side of which one is on. Returns the chosen name."""
        gap = 2 * self.scale
        size = ((WIDTH * self.scale - gap * (len(names) - 1)) / len(names), 0)
        for index, name in enumerate(names):
            if index:
                imgui.same_line(0, gap)
            on = name == current
            if on:
                imgui.push_style_color(imgui.Col_.button, ACCENT)
                imgui.push_style_color(imgui.Col_.button_hovered, ACCENT)
                imgui.push_style_color(imgui.Col_.button_active, ACCENT)
                imgui.push_style_color(imgui.Col_.text, (0.08, 0.08, 0.08, 1.0))
            if imgui.button(name, size):
                current = name
            if on:
                imgui.pop_style_color(4)
            if tips:
                imgui.set_item_tooltip(tips[name])
        return current

    def _light(self, imgui, light: Light) -> list[Command]:
        kind = self._choice(imgui, ["Point", "Directional"], light.kind.capitalize()).lower()
        low, high = np.array(self.scene.target) - LIGHT_RANGE, np.array(self.scene.target) + LIGHT_RANGE
        gap = imgui.get_style().item_inner_spacing.x
        imgui.push_item_width((WIDTH * self.scale - 2 * gap) / 3)
        position = list(light.position)
        for axis, name in enumerate("xyz"):
            if axis:
                imgui.same_line(0, gap)
            label, form = f"##light {name}", f"{name} %.2f m"
            _, position[axis] = imgui.slider_float(label, position[axis], low[axis], high[axis], form)
        imgui.pop_item_width()
        imgui.push_item_width((WIDTH * self.scale - gap) / 2)
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

    def _performance(self, imgui) -> None:
        current = next(name for name, scale in RESOLUTIONS.items() if scale == self.resolution)
        tips = dict.fromkeys(RESOLUTIONS, "Size of the drawn picture, on each side: fewer pixels are faster.")
        tips["Auto"] = "Fewer pixels while things move, if that is slow; all of them once they are still."
        self.resolution = RESOLUTIONS[self._choice(imgui, list(RESOLUTIONS), current, tips)]
        stretch = imgui.TableFlags_.sizing_stretch_prop | imgui.TableFlags_.no_host_extend_x
        if imgui.begin_table("stages", 3, stretch, (WIDTH * self.scale, 0)):
            self._row(imgui, "ms", "median", "worst", QUIET)
            for name, median, worst in self._stages:
                self._row(imgui, name, f"{median:.2f}", f"{worst:.2f}")
            imgui.end_table()
        for line in self._frame_lines:
            imgui.text_colored(QUIET, line)
        names = [name for name in ("gaussians", "vertices", "tets", "substeps") if name in self._stats]
        counts = [f"{self._stats[name]:,} {name}" for name in names]
        for first in range(0, len(counts), 2):
            imgui.text_colored(QUIET, ", ".join(counts[first : first + 2]))

    @staticmethod
    def _row(imgui, name: str, *values: str) -> None:
        """Draw a line of a table: the name, then values flush right. A colour as the last value paints all."""
        colour = values[-1] if isinstance(values[-1], tuple) else None
        values = values[:-1] if colour else values
        imgui.table_next_row()
        imgui.table_next_column()
        imgui.text_colored(QUIET, name)
        for value in values:
            imgui.table_next_column()
            space = imgui.get_content_region_avail().x - imgui.calc_text_size(value).x
            imgui.set_cursor_pos_x(imgui.get_cursor_pos_x() + max(space, 0.0))
            imgui.text_colored(colour or imgui.get_style().color_(imgui.Col_.text), value)

    def _help(self, imgui) -> None:
        if imgui.begin_table("help", 2, imgui.TableFlags_.sizing_fixed_fit):
            for keys, meaning in CAMERA_HELP if self.scene.light is None else HELP:
                imgui.table_next_row()
                imgui.table_next_column()
                imgui.text(keys)
                imgui.table_next_column()
                imgui.text_colored(QUIET, meaning)
            imgui.end_table()

    def _score(self, imgui, world: WorldView, beside_panel: bool) -> None:
        """Draw score and message at the top: in the middle, or right of the panel in a small window."""
        score, message = ("", "") if self.scene.game is None else (str(world.score or ""), world.message)
        if score in message.split():  # the game says it itself
            score = ""
        text = f"{score}   {message}".strip()
        middle = 0.5 * imgui.get_io().display_size.x
        if beside_panel:
            half = 0.5 * imgui.calc_text_size(text).x
            middle = max(middle, (WIDTH + 6 * MARGIN) * self.scale + half)
        imgui.set_next_window_pos((middle, MARGIN * self.scale), 0, (0.5, 0.0))
        flags = imgui.WindowFlags_
        still = flags.no_decoration | flags.always_auto_resize | flags.no_inputs | flags.no_saved_settings
        imgui.begin("score", None, still | flags.no_nav | flags.no_focus_on_appearing)
        if score:
            imgui.text_colored(ACCENT, score)
            imgui.same_line(0, 12 * self.scale)
        if message:
            imgui.text(message)
        if world.notice:
            imgui.text_colored(ACCENT, world.notice)
        imgui.end()


def frame_lines(timings: Timings) -> list[str]:
    """Lines about the frames: the longest, missed ones, time not simulated, and from the head's motion to light."""
    lines = [f"longest frame {1e3 * timings.worst:.0f} ms, {timings.missed:,} missed"]
    if timings.to_light is not None:
        lines.append(f"from motion to light {1e3 * timings.to_light:.0f} ms")
    if timings.dropped >= 0.1:
        lines.append(f"{timings.dropped:.1f} s left out: too slow for real time")
    return lines


def font_file() -> Path:
    """Roboto, which comes with ImGui."""
    import imgui_bundle

    return Path(imgui_bundle.__file__).parent / "assets" / "fonts" / "Roboto" / "Roboto-Regular.ttf"


def apply_theme(scale: float) -> None:
    """Set fonts, sizes and colours of the current ImGui context; `scale` enlarges all of it."""
    from imgui_bundle import imgui

    io, style = imgui.get_io(), imgui.get_style()
    io.fonts.add_font_from_file_ttf(str(font_file()), TEXT_SIZE)
    imgui.style_colors_dark()
    style.font_size_base = TEXT_SIZE
    style.window_rounding = style.popup_rounding = 10.0
    style.frame_rounding = style.grab_rounding = style.scrollbar_rounding = 6.0
    style.window_border_size = 0.0
    style.window_padding, style.frame_padding = (14.0, 12.0), (8.0, 4.0)
    style.item_spacing, style.item_inner_spacing = (8.0, 6.0), (6.0, 4.0)
    style.cell_padding = (4.0, 1.5)
    style.grab_min_size, style.scrollbar_size = 12.0, 9.0
    style.scale_all_sizes(scale)
    style.font_scale_dpi = scale
    colours = imgui.Col_
    for name, colour in {
        colours.text: (0.93, 0.94, 0.96, 1.0),
        colours.text_disabled: QUIET,
        colours.window_bg: (0.07, 0.08, 0.10, 0.86),
        colours.popup_bg: (0.09, 0.10, 0.13, 0.97),
        colours.frame_bg: (1.0, 1.0, 1.0, 0.08),
        colours.frame_bg_hovered: (1.0, 1.0, 1.0, 0.14),
        colours.frame_bg_active: (1.0, 1.0, 1.0, 0.18),
        colours.button: (1.0, 1.0, 1.0, 0.10),
        colours.button_hovered: (1.0, 1.0, 1.0, 0.18),
        colours.button_active: (1.0, 1.0, 1.0, 0.26),
        colours.header: (1.0, 1.0, 1.0, 0.0),
        colours.header_hovered: (1.0, 1.0, 1.0, 0.10),
        colours.header_active: (1.0, 1.0, 1.0, 0.16),
        colours.slider_grab: (1.0, 1.0, 1.0, 0.30),
        colours.slider_grab_active: ACCENT,
        colours.separator: (1.0, 1.0, 1.0, 0.10),
        colours.scrollbar_bg: (0.0, 0.0, 0.0, 0.0),
        colours.nav_cursor: (0.0, 0.0, 0.0, 0.0),
    }.items():
        style.set_color_(name, colour)
