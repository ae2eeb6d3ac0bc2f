"""Theme and widgets of all that ImGui draws: Roboto on dark glass with one accent colour.

Widgets are as wide as the space that is left.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

from imgui_bundle import imgui

from display.panel import ACCENT, QUIET, Slider, font_file, readable
from display.user_commands import Command

ON_ACCENT = (0.08, 0.08, 0.08, 1.0)
FILMING = (0.93, 0.16, 0.14, 1.0)
TEXT = (0.93, 0.94, 0.96, 1.0)
TEXT_SIZE = 15.0  # [px] at a display scale of 1
TITLE_SIZE = 20.0
MARGIN = 12.0  # [px] from the window's edge
WIDTH = 208.0  # [px] of the panel's content: at 960 x 540 it leaves three quarters of the picture
KNOB = (0.86, 0.88, 0.91, 1.0)  # of a slider
TRACK = (1.0, 1.0, 1.0, 0.14)
FOOT = 60.0  # [px] under a window at the lower edge, where hints stand
FIXED = (
    imgui.WindowFlags_.no_title_bar
    | imgui.WindowFlags_.no_resize
    | imgui.WindowFlags_.no_move
    | imgui.WindowFlags_.no_saved_settings
)
RESET_TIP = "Ctrl+click types a value, a right click brings the usual one back."


def apply_theme(scale: float) -> None:
    """Set fonts, sizes and colours of the current ImGui context; `scale` enlarges all of it."""
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
        colours.text: TEXT,
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
        colours.check_mark: ACCENT,
        colours.separator: (1.0, 1.0, 1.0, 0.10),
        colours.scrollbar_bg: (0.0, 0.0, 0.0, 0.0),
        colours.nav_cursor: (0.0, 0.0, 0.0, 0.0),
    }.items():
        style.set_color_(name, colour)


def pixels(length: float) -> float:
    """A length [px] at a display scale of 1, in pixels of this display."""
    return length * imgui.get_style().font_scale_dpi


def place_window(*, foot: bool = False) -> None:
    """Put the next window in the middle, or (`foot`) at the lower edge."""
    area = imgui.get_io().display_size
    y, pivot = (area.y - pixels(FOOT), 1.0) if foot else (0.5 * area.y, 0.5)
    imgui.set_next_window_pos((0.5 * area.x, y), 0, (0.5, pivot))


def heading(text: str) -> None:
    """Draw a title."""
    imgui.push_font(None, TITLE_SIZE)
    imgui.text(text)
    imgui.pop_font()


def paragraph(text: str, colour: tuple[float, ...] = QUIET) -> None:
    """Draw a text in as many lines as it needs."""
    imgui.push_text_wrap_pos(0.0)
    imgui.text_colored(colour, text)
    imgui.pop_text_wrap_pos()


def width_of(count: int, gap: float | None = None) -> float:
    """Width [px] of each of `count` widgets side by side; `gap` is that between items unless given."""
    gap = imgui.get_style().item_spacing.x if gap is None else gap
    return (imgui.get_content_region_avail().x - gap * (count - 1)) / count


def button_grid(
    names: Mapping[str, str], columns: int, *, current: str | None = None, gap: float | None = None
) -> str | None:
    """Draw buttons, `columns` in a row, `gap` [px] apart, with their tips; the `current` one is lit. Returns the name
    of the one that was pressed."""
    size, pressed = (width_of(columns, gap), 0), None
    for k, (name, tip) in enumerate(names.items()):
        if k % columns:
            imgui.same_line(0, -1 if gap is None else gap)
        if name == current:
            for colour in (imgui.Col_.button, imgui.Col_.button_hovered, imgui.Col_.button_active):
                imgui.push_style_color(colour, ACCENT)
            imgui.push_style_color(imgui.Col_.text, ON_ACCENT)
        if imgui.button(name, size):
            pressed = name
        if name == current:
            imgui.pop_style_color(4)
        if tip:
            imgui.set_item_tooltip(tip)
    return pressed


def draw_slider(slider: Slider, changed_before: set[str]) -> list[Command]:
    """Draw a slider under its name and value: nothing covers a number. Ctrl+click types one, a right click resets it.

    `changed_before` holds the names of sliders that were changed since the mouse went down on them: a drag is undone as
    one. Returns the command of a new value.
    """
    flags, name, value = imgui.SliderFlags_, slider.name, slider.value
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
        draw_track(slider)
    if imgui.is_item_activated():
        changed_before.discard(name)
    reset = imgui.is_item_hovered() and imgui.is_mouse_clicked(imgui.MouseButton_.right)
    if reset and slider.usual not in (None, value):
        changed_before.discard(name)
        return [slider.command(slider.usual, False)]
    tip = " ".join(filter(None, (slider.tip, "" if slider.usual is None else RESET_TIP)))
    if tip:
        imgui.set_item_tooltip(tip)
    new = readable(new)
    if not changed or new == value:
        return []
    continued = name in changed_before
    changed_before.add(name)
    return [slider.command(new, continued)]


def draw_track(slider: Slider) -> None:
    """Draw line and knob of the slider that was the last item."""
    value, first, last = slider.value, slider.low, slider.high
    if slider.log:
        value, first, last = math.log(max(value, first)), math.log(first), math.log(last)
    fraction = min(max((value - first) / (last - first), 0.0), 1.0)
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
    short, kept = text, len(text)
    while kept > 2 and imgui.calc_text_size(short).x > width:
        kept -= 1
        short = f"{text[: (kept + 1) // 2]}...{text[len(text) - kept // 2 :]}"
    return short


def text_right(text: str, colour: tuple[float, ...] | None = None, beside: float = 0.0) -> None:
    """Draw a text flush right, so that `beside` [px] are left there."""
    space = imgui.get_content_region_avail().x - imgui.calc_text_size(text).x - beside
    imgui.set_cursor_pos_x(imgui.get_cursor_pos_x() + max(space, 0.0))
    imgui.text_colored(colour or imgui.get_style().color_(imgui.Col_.text), text)
