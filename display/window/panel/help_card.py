"""A card over the picture with all that mouse and keys do."""

from __future__ import annotations

from display.window.key_bindings import help_rows
from display.window.panel.theme import MARGIN, QUIET, TITLE_SIZE
from display.window.panel.widgets import pixels, text_right

COLUMN = 320.0  # [px] of the card's two


def draw_help(*, bodies: bool) -> bool:
    """Draw the card in the middle, in two columns, for a world with bodies or without; True if it was clicked away."""
    from imgui_bundle import imgui

    area, edge = imgui.get_io().display_size, pixels(MARGIN)
    width = min(pixels(2 * COLUMN), area.x - 2 * edge)
    imgui.set_next_window_pos((0.5 * area.x, 0.5 * area.y), 0, (0.5, 0.5))
    imgui.set_next_window_size_constraints((width, 0), (width, max(area.y - 2 * edge, 1.0)))
    flags = imgui.WindowFlags_
    fixed = flags.no_title_bar | flags.always_auto_resize | flags.no_move | flags.no_saved_settings | flags.no_nav
    imgui.set_next_window_bg_alpha(0.95)
    imgui.set_next_window_focus()  # over the panel
    imgui.begin("help", None, fixed)
    imgui.push_font(None, TITLE_SIZE)
    imgui.text("Mouse and keys")
    imgui.pop_font()
    imgui.same_line()
    imgui.set_cursor_pos_y(imgui.get_cursor_pos_y() + pixels(4))
    text_right("H, Esc or a click closes this", QUIET)
    rows = help_rows(bodies)
    half = (len(rows) + 1) // 2
    if imgui.begin_table("keys", 4, imgui.TableFlags_.sizing_stretch_prop):
        for k in range(4):
            kind = imgui.TableColumnFlags_.width_stretch if k % 2 else imgui.TableColumnFlags_.width_fixed
            imgui.table_setup_column(f"{k}", kind)
        for pair in zip(rows[:half], [*rows[half:], ("", "")], strict=False):
            imgui.table_next_row()
            for keys, meaning in pair:
                imgui.table_next_column()
                imgui.text(keys)
                imgui.table_next_column()
                imgui.text_colored(QUIET, meaning)
        imgui.end_table()
    imgui.end()
    return imgui.is_mouse_clicked(imgui.MouseButton_.left)
