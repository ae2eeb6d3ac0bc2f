"""The panel drawn with ImGui: title, rate, the sections of display/panel.py; and the game's score beside it."""

from __future__ import annotations

from collections.abc import Mapping

from imgui_bundle import imgui

from display.panel import ButtonGrid, Choice, Panel, Section, Slider, Table, Text, Toggle
from display.protocol import WorldView
from display.user_commands import Command
from display.window.overlay import draw_help, lines_of, text_box
from display.window.widgets import (
    ACCENT,
    FIXED,
    MARGIN,
    QUIET,
    TITLE_SIZE,
    WIDTH,
    apply_theme,
    button_grid,
    draw_slider,
    paragraph,
    pixels,
    shortened,
    text_right,
    width_of,
)


class PanelDrawer:
    """Draws a panel in an ImGui context, which it themes; `draw` returns the user's commands for the world.

    opened   whether the content of sections is on view, by title: as remembered, then as the user leaves it
    pressed  name of the button that was pressed in the last frame
    help     the card of mouse and keys is on view
    """

    def __init__(self, title: str, scale: float, panel: Panel, opened: Mapping[str, bool] | None = None):
        self.title, self.panel, self.opened = title, panel, dict(opened or {})
        self.help, self.pressed = False, ""
        self._visible, self._hovered = False, ""  # title of the section under the cursor
        self._changed: set[str] = set()  # names of sliders (draw_slider)
        apply_theme(scale)

    @property
    def right(self) -> float:
        """Left edge of the picture beside the panel [px]."""
        return pixels(WIDTH + 2 * MARGIN) + 2 * imgui.get_style().window_padding.x if self._visible else 0.0

    @property
    def details(self) -> bool:
        """True while the timings are on view."""
        return self._visible and self.opened.get("Performance", False)

    @property
    def edits(self) -> bool:
        """True while the cursor is among the edits of a body."""
        return self._visible and self._hovered == "Body"

    def draw(self, world: WorldView, *, visible: bool) -> list[Command]:
        """Draw one frame of the panel, of the score and of the card of keys; the commands that the user gives."""
        self._visible, self._hovered, self.pressed = visible, "", ""
        if lines := lines_of(world):
            text_box("score", lines, self.right, gap=pixels(12))
        commands = self._panel(world) if visible else []
        if self.help:
            self.help = not draw_help(bodies=world.editable)
        return commands

    def _panel(self, world: WorldView) -> list[Command]:
        self.panel.read(world)
        edge, padding = pixels(MARGIN), imgui.get_style().window_padding.x
        width, height = pixels(WIDTH) + 2 * padding, max(imgui.get_io().display_size.y - 2 * edge, 1.0)
        imgui.set_next_window_pos((edge, edge))
        imgui.set_next_window_size_constraints((width, 0), (width, height))
        imgui.set_next_window_content_size((pixels(WIDTH), 0))  # a scroll bar is beside it, in the padding
        flags = imgui.WindowFlags_
        imgui.begin("panel", None, FIXED | flags.always_auto_resize | flags.no_nav | flags.no_focus_on_appearing)
        self._draw_title(world)
        commands = [command for section in self.panel.sections(world) for command in self._section(section)]
        imgui.end()
        return commands

    def _draw_title(self, world: WorldView) -> None:
        imgui.push_font(None, TITLE_SIZE)
        title, rate = self.title.split(": ")[-1].replace("_", " "), f"{self.panel.fps:.0f} fps"
        imgui.text(shortened(title, width_of(1) - pixels(90)))  # the window has all of it
        imgui.pop_font()
        imgui.same_line()
        imgui.set_cursor_pos_y(imgui.get_cursor_pos_y() + pixels(4))  # onto the title's base line
        button = imgui.get_frame_height() + imgui.get_style().item_spacing.x
        text_right(rate, ACCENT, button)
        imgui.same_line()
        imgui.set_cursor_pos_y(imgui.get_cursor_pos_y() - pixels(2))
        self.help ^= imgui.button("?", (imgui.get_frame_height(), 0))
        imgui.set_item_tooltip("Mouse and keys (H).")
        imgui.dummy((0, pixels(2)))
        for file, role in world.scene.cast:
            imgui.text_colored(QUIET, shortened(f"{file} is {role}", width_of(1)))
            imgui.set_item_tooltip(f"{file} is {role}")

    def _section(self, section: Section) -> list[Command]:
        title = section.title
        if not section.plain:
            label = shortened(section.label or title, width_of(1) - pixels(40))
            imgui.set_next_item_open(self.opened.setdefault(title, not section.folded))
            imgui.push_style_var(imgui.StyleVar_.frame_padding, (pixels(4), pixels(2)))
            self.opened[title] = imgui.collapsing_header(f"{label}###{title}")
            imgui.pop_style_var()
            if not self.opened[title]:
                return []
        imgui.begin_group()
        commands: list[Command] = []
        for row in section.rows:
            commands += self._row(title, row)
        imgui.end_group()
        if imgui.is_mouse_hovering_rect(imgui.get_item_rect_min(), imgui.get_item_rect_max()):
            self._hovered = title
        return commands

    def _row(self, title: str, row) -> list[Command]:
        match row:
            case Slider():
                return draw_slider(row, self._changed)
            case ButtonGrid():
                by_text = {button.text: button for button in row.buttons}
                pressed = button_grid({text: button.tip for text, button in by_text.items()}, row.columns)
                if pressed is not None:
                    self.pressed = by_text[pressed].name
                    return list(by_text[pressed].commands)
            case Choice():
                if row.listed:
                    chosen = unfolding_list(row)
                else:
                    chosen = button_grid(row.options, len(row.options), current=row.current, gap=pixels(2))
                return [] if chosen in (None, row.current) else list(row.choose(chosen))
            case Toggle():
                toggled, on = imgui.checkbox(row.name, row.on)
                return list(row.switch(on)) if toggled else []
            case Text():
                paragraph(row.text)
            case Table() if row.rows:
                imgui.begin_table(f"table {title}", len(row.rows[0]), imgui.TableFlags_.sizing_stretch_prop)
                for k, (name, *values) in enumerate(row.rows):
                    imgui.table_next_row()
                    imgui.table_next_column()
                    imgui.text_colored(QUIET, name)
                    for value in values:
                        imgui.table_next_column()
                        text_right(value, QUIET if row.head and k == 0 else None)
                imgui.end_table()
        return []


def unfolding_list(row: Choice) -> str:
    """Draw a choice as a list that unfolds, with what is said of each option after its name. Returns the chosen one."""
    chosen = row.current
    imgui.set_next_item_width(-1)
    unfolded = imgui.begin_combo(f"##{row.name}", row.current)
    if row.tip and not unfolded:
        imgui.set_item_tooltip(row.tip)
    if unfolded:
        for name, text in row.options.items():
            if imgui.selectable(f"{name}, {text}" if text else name, name == row.current)[0]:
                chosen = name
        if imgui.is_key_pressed(imgui.Key.escape):
            imgui.close_current_popup()
        imgui.end_combo()
    return chosen
