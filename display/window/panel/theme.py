"""Theme of all that ImGui draws: Roboto on dark glass with one accent colour."""

from __future__ import annotations

from pathlib import Path

ACCENT = (0.98, 0.66, 0.24, 1.0)
ON_ACCENT = (0.08, 0.08, 0.08, 1.0)
FILMING = (0.93, 0.16, 0.14, 1.0)
TEXT = (0.93, 0.94, 0.96, 1.0)
QUIET = (0.66, 0.69, 0.74, 1.0)
TEXT_SIZE = 15.0  # [px] at a display scale of 1
TITLE_SIZE = 20.0
MARGIN = 12.0  # [px] from the window's edge
WIDTH = 208.0  # [px] of the panel's content: at 960 x 540 it leaves three quarters of the picture


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
