"""The question for the length between two points that the user has clicked."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from core.errors import BadInput
from core.measured_length import length_of
from display.protocol import Line
from display.user_commands import Command, Measure
from display.window.panel.theme import ACCENT, QUIET
from display.window.panel.widgets import button_grid, pixels

WIDTH, FOOT = 300.0, 60.0  # [px] of the dialog, and under it, where hints stand
CROSS = 0.02  # of the distance of the points, or of the eye from the first: half the length of a cross
COLOUR = (1.0, 0.78, 0.25)


class LengthDialog:
    """Asks for a length once there are two points; `draw` gives the command, and whether it is over."""

    def __init__(self):
        self._typed, self._problem, self._shown = "", "", False

    def draw(self, points: Sequence[np.ndarray] | None) -> tuple[list[Command], bool]:
        """Draw the dialog for the points (3,) [m], if there are two of them."""
        if points is None or len(points) < 2:
            self._typed, self._problem, self._shown = "", "", False
            return [], False
        from imgui_bundle import imgui

        area, flags = imgui.get_io().display_size, imgui.WindowFlags_
        imgui.set_next_window_pos((0.5 * area.x, area.y - pixels(FOOT)), 0, (0.5, 1.0))  # seldom over a point
        imgui.set_next_window_size((min(pixels(WIDTH), area.x), 0))
        imgui.begin("length", None, flags.no_title_bar | flags.no_resize | flags.no_move | flags.no_saved_settings)
        imgui.text("How long is that in truth?")
        now = float(np.linalg.norm(np.subtract(points[1], points[0])))
        imgui.text_colored(QUIET, f"{now:.3g} m as it is now; type 1.2 or 35 cm")
        if self._problem:
            imgui.push_text_wrap_pos(0.0)
            imgui.text_colored(ACCENT, self._problem)
            imgui.pop_text_wrap_pos()
        if not self._shown:
            imgui.set_keyboard_focus_here()
        self._shown = True
        imgui.set_next_item_width(-1)
        entered, self._typed = imgui.input_text("##length", self._typed, imgui.InputTextFlags_.enter_returns_true)
        pressed = button_grid({"Set": "(Enter)", "Cancel": "(Esc)"}, 2)
        imgui.end()
        if pressed == "Cancel" or imgui.is_key_pressed(imgui.Key.escape):
            return [], True
        if not (entered or pressed == "Set"):
            return [], False
        try:
            start, end = (tuple(np.asarray(p).tolist()) for p in points)
            return [Measure(start, end, length_of(self._typed))], True
        except BadInput as e:
            self._problem, self._shown = str(e), False
            return [], False


def measuring_lines(points: Sequence[np.ndarray] | None, eye: np.ndarray) -> list[Line]:
    """Crosses at the points, and the line between two of them with its length."""
    if not points:
        return []
    half = CROSS * float(np.linalg.norm(np.subtract(points[0], eye)))
    lines = [Line(p - half * axis, p + half * axis, COLOUR) for p in points for axis in np.eye(3)]
    if len(points) == 2:
        lines.append(Line(points[0], points[1], COLOUR, f"{np.linalg.norm(points[1] - points[0]):.3g} m"))
    return lines
