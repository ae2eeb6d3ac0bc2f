"""Lines of a world over its picture: axes, boxes."""

from __future__ import annotations

from collections.abc import Callable, Iterable

import numpy as np

from core.camera import Camera, project, view_depth
from display.protocol import Line

NEAR = 1e-3  # [m]: what is nearer, or behind the eye, is cut off


def visible_part(line: Line, camera: Camera) -> tuple[tuple[float, float], tuple[float, float]] | None:
    """Ends [px of the picture] of the part of a line before the camera, None if there is none."""
    a, b = np.asarray(line.start, np.float64), np.asarray(line.end, np.float64)
    depth_a, depth_b = view_depth(camera, a), view_depth(camera, b)
    if max(depth_a, depth_b) <= NEAR:
        return None
    if min(depth_a, depth_b) < NEAR:
        cut = a + (NEAR - depth_a) / (depth_b - depth_a) * (b - a)
        a, b = (cut, b) if depth_a < depth_b else (a, cut)
    return project(camera, a), project(camera, b)


def draw_lines(lines: Iterable[Line], camera: Camera, from_picture: Callable, scale: float) -> None:
    """Draw lines under the panel; `from_picture` gives screen coordinates of the picture's pixels."""
    from imgui_bundle import imgui

    draw_list = imgui.get_background_draw_list()
    for line in lines:
        ends = visible_part(line, camera)
        if ends is None:
            continue
        a, b = from_picture(ends[0]), from_picture(ends[1])
        colour = imgui.get_color_u32((*line.colour, 1.0))
        draw_list.add_line(a, b, imgui.get_color_u32((0.0, 0.0, 0.0, 0.4)), 3.5 * scale)
        draw_list.add_line(a, b, colour, 1.5 * scale)
        if line.text:
            draw_list.add_text((b[0] + 4 * scale, b[1] - 8 * scale), colour, line.text)
