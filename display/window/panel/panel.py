"""The panel as a whole: title, rate, sections; and the game's score beside it."""

from __future__ import annotations

from display.protocol import WorldView
from display.user_commands import Command
from display.window.panel.body_section import BodySection
from display.window.panel.file_section import CropSection, FileSection
from display.window.panel.help_card import draw_help
from display.window.panel.keep_section import KeepSection
from display.window.panel.light_section import LightSection
from display.window.panel.performance_section import PerformanceSection
from display.window.panel.play_section import PlaySection
from display.window.panel.score_line import draw_score
from display.window.panel.section import Section
from display.window.panel.theme import ACCENT, MARGIN, QUIET, TITLE_SIZE, WIDTH, apply_theme
from display.window.panel.widgets import pixels, shortened, text_right, width_of
from display.window.panel.world_section import WorldSection


class Panel:
    """The panel of an ImGui context, which it themes; `draw` returns the user's commands for the world.

    `sections` are drawn from top to bottom, each under its title; `body` is that of the selected body. `help` is
    whether the card of mouse and keys is on view.
    """

    def __init__(self, title: str, scale: float):
        self.title = title
        self.body, self._performance = BodySection(), PerformanceSection()
        self.sections: list[Section] = [
            PlaySection(),
            self.body,
            WorldSection(),
            LightSection(),
            FileSection(),
            CropSection(),
            KeepSection(),
            self._performance,
        ]
        self._visible = self.help = False
        apply_theme(scale)

    @property
    def resolution(self) -> float | None:
        """Scale of a side of the picture that the user has chosen; None: what keeps the rate."""
        return self._performance.resolution

    @property
    def right(self) -> float:
        """Left edge of the picture beside the panel [px]."""
        from imgui_bundle import imgui

        return pixels(WIDTH + 2 * MARGIN) + 2 * imgui.get_style().window_padding.x if self._visible else 0.0

    @property
    def details(self) -> bool:
        """True while the list of stages is on view."""
        return self._visible and self._performance.open

    @property
    def edits(self) -> bool:
        """True while the cursor is among the edits of a body."""
        return self._visible and self.body.hovered

    def draw(self, world: WorldView, *, visible: bool) -> list[Command]:
        """Draw one frame of the panel and of the score; the commands that the user gives."""
        self._visible = visible
        draw_score(world, self.right)
        commands = self._draw(world) if visible else []
        if self.help:
            self.help = not draw_help(bodies=world.editable)
        return commands

    def _draw(self, world: WorldView) -> list[Command]:
        from imgui_bundle import imgui

        self._performance.read(world)
        edge, padding = pixels(MARGIN), imgui.get_style().window_padding.x
        width, height = pixels(WIDTH) + 2 * padding, max(imgui.get_io().display_size.y - 2 * edge, 1.0)
        imgui.set_next_window_pos((edge, edge))
        imgui.set_next_window_size_constraints((width, 0), (width, height))
        imgui.set_next_window_content_size((pixels(WIDTH), 0))  # a scroll bar is beside it, in the padding
        flags = imgui.WindowFlags_
        fixed = flags.no_title_bar | flags.always_auto_resize | flags.no_move | flags.no_saved_settings
        imgui.begin("panel", None, fixed | flags.no_nav | flags.no_focus_on_appearing)
        self._title(world)
        commands: list[Command] = []
        for section in self.sections:
            if section.shown(world):
                commands += self._section(section, world)
        imgui.end()
        return commands

    def _section(self, section: Section, world: WorldView) -> list[Command]:
        from imgui_bundle import imgui

        if section.title:
            imgui.set_next_item_open(section.open)
            imgui.push_style_var(imgui.StyleVar_.frame_padding, (pixels(4), pixels(2)))
            section.open = imgui.collapsing_header(f"{section.label(world)}###{section.title}")
            imgui.pop_style_var()
        section.hovered = False
        if not section.open:
            return []
        imgui.begin_group()
        commands = section.draw(world)
        imgui.end_group()
        section.hovered = imgui.is_mouse_hovering_rect(imgui.get_item_rect_min(), imgui.get_item_rect_max())
        return commands

    def _title(self, world: WorldView) -> None:
        from imgui_bundle import imgui

        imgui.push_font(None, TITLE_SIZE)
        title, rate = self.title.split(": ")[-1].replace("_", " "), f"{self._performance.fps:.0f} fps"
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
