"""The hint over the first picture: the three things with which everything can be found out."""

from __future__ import annotations

from time import monotonic

from display.protocol import WorldView
from display.window.panel.theme import ACCENT, MARGIN, TEXT
from display.window.panel.widgets import pixels

FADE_TIME = 0.8  # [s]
SIZE = 18.0  # [px] of the text in a window of FULL_HEIGHT
FULL_HEIGHT, MIN_FACTOR = 540.0, 0.65  # [px] of the window; a smaller one has a smaller hint, which hides less of it


def hints(world: WorldView) -> list[tuple[str, str]]:
    """(what to do, what it does)."""
    if not world.editable:
        return [("drag", "to turn"), ("wheel", "to zoom"), ("F1", "panel")]
    watch = [] if world.scene.game is None else [("P", "demonstration")]
    return [("drag", "to grab"), ("F1", "panel"), *watch]


class FirstHint:
    """The hint: it stays until the user has begun, `done`, and then fades."""

    def __init__(self):
        self._faded: float | None = None  # [s], when it will have

    def draw(self, world: WorldView, left: float, *, done: bool) -> None:
        """Draw it at the bottom: in the middle, or right of `left` [px] in a small window; unless it has faded."""
        from imgui_bundle import imgui

        if done and self._faded is None:
            self._faded = monotonic() + FADE_TIME
        opacity = 1.0 if self._faded is None else (self._faded - monotonic()) / FADE_TIME
        if opacity <= 0.0:
            return
        area = imgui.get_io().display_size
        factor = min(max(area.y / pixels(FULL_HEIGHT), MIN_FACTOR), 1.0)
        unit = pixels(factor)
        imgui.push_font(None, SIZE * factor)
        gap, space = 22 * unit, imgui.calc_text_size(" ").x
        texts = [
            (what, does, imgui.calc_text_size(what).x, imgui.calc_text_size(does).x) for what, does in hints(world)
        ]
        width = sum(a + space + b for *_, a, b in texts) + gap * (len(texts) - 1)
        height, padding = imgui.get_text_line_height(), (18 * unit, 8 * unit)
        x, y = max(0.5 * (area.x - width), left + padding[0]), area.y - MARGIN * unit - padding[1] - height
        low, high = (x - padding[0], y - padding[1]), (x + width + padding[0], y + height + padding[1])
        draw_list = imgui.get_background_draw_list()  # under the panel
        draw_list.add_rect_filled(low, high, imgui.get_color_u32((0.07, 0.08, 0.10, 0.72 * opacity)), high[1] - low[1])
        for k, (what, does, a, b) in enumerate(texts):
            if k:
                dot = (x - 0.5 * gap, y + 0.5 * height)
                draw_list.add_circle_filled(dot, 2 * unit, imgui.get_color_u32((*TEXT[:3], 0.5 * opacity)), 12)
            draw_list.add_text((x, y), imgui.get_color_u32((*ACCENT[:3], opacity)), what)
            draw_list.add_text((x + a + space, y), imgui.get_color_u32((*TEXT[:3], opacity)), does)
            x += a + space + b + gap
        imgui.pop_font()
