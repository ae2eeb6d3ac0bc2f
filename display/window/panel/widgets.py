"""Widgets of the panel's sections, as wide as the space that is left."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from display.user_commands import Command
from display.window.panel.slider import Slider, readable
from display.window.panel.theme import ACCENT, ON_ACCENT, QUIET

KNOB = (0.86, 0.88, 0.91, 1.0)  # of a slider
TRACK = (1.0, 1.0, 1.0, 0.14)


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
        text_right(value, colour)


class Sliders:
    """Sliders under their names and values: nothing covers a number. Ctrl+click types one, a right click resets it.

    They know whether a change goes on with the last one, so that a drag can be undone as one.
    """

    def __init__(self):
        self._changed: set[str] = set()  # since the mouse went down on them

    def draw(self, sliders: Sequence[Slider]) -> list[Command]:
        """Draw sliders; the commands of those that are moved."""
        moved = [(slider, self._draw(slider)) for slider in sliders]
        return [slider.command(*change) for slider, change in moved if change is not None]

    def _draw(self, slider: Slider) -> tuple[float, bool] | None:
        """Draw a slider. Returns the new value and whether this change goes on with the last one, or None."""
        from imgui_bundle import imgui

        flags, name, value, usual = imgui.SliderFlags_, slider.name, slider.value, slider.usual
        imgui.text_colored(QUIET, name)
        imgui.same_line()
        text_right(slider.shown)
        imgui.set_cursor_pos_y(imgui.get_cursor_pos_y() - imgui.get_style().item_spacing.y)
        imgui.push_style_var_y(imgui.StyleVar_.frame_padding, 0.0)
        clear = (imgui.Col_.frame_bg, imgui.Col_.frame_bg_hovered, imgui.Col_.frame_bg_active)
        for colour in (*clear, imgui.Col_.slider_grab, imgui.Col_.slider_grab_active):
            imgui.push_style_color(colour, (0.0, 0.0, 0.0, 0.0))
        imgui.set_next_item_width(-1)
        kind = flags.always_clamp | flags.no_round_to_format | (flags.logarithmic if slider.log else 0)
        changed, new = imgui.slider_float(f"##{name}", value, slider.low, slider.high, "", kind)
        imgui.pop_style_color(5)
        imgui.pop_style_var()
        if not (imgui.is_item_active() and imgui.get_io().want_text_input):
            draw_track(fraction_of(value, slider.low, slider.high, slider.log))
        if imgui.is_item_activated():
            self._changed.discard(name)
        if imgui.is_item_hovered() and imgui.is_mouse_clicked(imgui.MouseButton_.right) and usual not in (None, value):
            self._changed.discard(name)
            return usual, False
        if slider.tip:
            imgui.set_item_tooltip(slider.tip)
        new = readable(new)
        if not changed or new == value:
            return None
        continued = name in self._changed
        self._changed.add(name)
        return new, continued


def fraction_of(value: float, low: float, high: float, log: bool) -> float:
    """Place of a value between the ends of a slider, 0 to 1."""
    if log:
        value, low, high = math.log(max(value, low)), math.log(low), math.log(high)
    return min(max((value - low) / (high - low), 0.0), 1.0)


def draw_track(fraction: float) -> None:
    """Draw line and knob of the slider that was the last item."""
    from imgui_bundle import imgui

    draw_list, low, high = imgui.get_window_draw_list(), imgui.get_item_rect_min(), imgui.get_item_rect_max()
    busy = imgui.is_item_active()
    radius, half = pixels(6 if busy or imgui.is_item_hovered() else 5), pixels(1.5)
    y, left, right = 0.5 * (low.y + high.y), low.x + pixels(6), high.x - pixels(6)
    x = left + fraction * (right - left)
    colour = ACCENT if busy else KNOB
    draw_list.add_rect_filled((left, y - half), (right, y + half), imgui.get_color_u32(TRACK), half)
    draw_list.add_rect_filled((left, y - half), (x, y + half), imgui.get_color_u32((*colour[:3], 0.6)), half)
    draw_list.add_circle_filled((x, y), radius, imgui.get_color_u32(colour))


def shortened(text: str, width: float) -> str:
    """A text that is no wider than this [px]: the middle of a longer one is left out."""
    from imgui_bundle import imgui

    kept = len(text)
    short = text
    while kept > 2 and imgui.calc_text_size(short).x > width:
        kept -= 1
        short = f"{text[: (kept + 1) // 2]}...{text[len(text) - kept // 2 :]}"
    return short


def text_right(text: str, colour: tuple[float, ...] | None = None, beside: float = 0.0) -> None:
    """Draw a text flush right, so that `beside` [px] are left there."""
    from imgui_bundle import imgui

    space = imgui.get_content_region_avail().x - imgui.calc_text_size(text).x - beside
    imgui.set_cursor_pos_x(imgui.get_cursor_pos_x() + max(space, 0.0))
    imgui.text_colored(colour or imgui.get_style().color_(imgui.Col_.text), text)
