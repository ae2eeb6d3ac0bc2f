"""Widgets of the panel's sections, as wide as the space that is left."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from display.window.panel.theme import ACCENT, ON_ACCENT, QUIET


def pixels(length: float) -> float:
    """A length [px] at a display scale of 1, in pixels of this display."""
    from imgui_bundle import imgui

    return length * imgui.get_style().font_scale_dpi


def width_of(count: int, gap: float | None = None) -> float:
    """Width [px] of each of `count` widgets side by side; `gap` is that between items unless given."""
    from imgui_bundle import imgui

    gap = imgui.get_style().item_spacing.x if gap is None else gap
    return (imgui.get_content_region_avail().x - gap * (count - 1)) / count


def button_grid(names: Mapping[str, str], columns: int) -> str | None:
    """Draw buttons, `columns` in a row, with their tips. Returns the name of the one that was pressed."""
    from imgui_bundle import imgui

    size, pressed = (width_of(columns), 0), None
    for k, (name, tip) in enumerate(names.items()):
        if k % columns:
            imgui.same_line()
        if imgui.button(name, size):
            pressed = name
        if tip:
            imgui.set_item_tooltip(tip)
    return pressed


def choice(names: Sequence[str], current: str, tips: Mapping[str, str] | None = None) -> str:
    """Draw buttons side by side of which one is on. Returns the chosen name."""
    from imgui_bundle import imgui

    gap = pixels(2)
    size = (width_of(len(names), gap), 0)
    for index, name in enumerate(names):
        if index:
            imgui.same_line(0, gap)
        on = name == current
        if on:
            for colour in (imgui.Col_.button, imgui.Col_.button_hovered, imgui.Col_.button_active):
                imgui.push_style_color(colour, ACCENT)
            imgui.push_style_color(imgui.Col_.text, ON_ACCENT)
        if imgui.button(name, size):
            current = name
        if on:
            imgui.pop_style_color(4)
        if tips:
            imgui.set_item_tooltip(tips[name])
    return current


def table_row(name: str, *values: str, colour: tuple[float, ...] | None = None) -> None:
    """Draw a row of a table: the name, then values flush right."""
    from imgui_bundle import imgui

    imgui.table_next_row()
    imgui.table_next_column()
    imgui.text_colored(QUIET, name)
    for value in values:
        imgui.table_next_column()
        space = imgui.get_content_region_avail().x - imgui.calc_text_size(value).x
        imgui.set_cursor_pos_x(imgui.get_cursor_pos_x() + max(space, 0.0))
        imgui.text_colored(colour or imgui.get_style().color_(imgui.Col_.text), value)
