"""Drawings of ImGui over the picture, beside the panel: score and messages, first hint, card of keys, lines, gizmo."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from time import monotonic

import numpy as np
from imgui_bundle import imgui, imguizmo

from core.camera import Camera, project, view_depth
from core.rotation import quaternions_from_matrices
from display.panel import score_and_message
from display.protocol import Line, WorldView
from display.user_commands import Command, Place, Rescale, TurnRoom
from display.window.key_bindings import help_rows
from display.window.widgets import (
    ACCENT,
    FIXED,
    MARGIN,
    QUIET,
    TEXT,
    heading,
    paragraph,
    pixels,
    place_window,
    text_right,
)

DEMONSTRATION = "A demonstration plays. P or Esc ends it, and so does a grip."
PAUSED = "Paused. Space continues."
FADE_TIME = 0.8  # [s] of the hint
HINT_SIZE = 18.0  # [px] of its text in a window of FULL_HEIGHT
HINT_PADDING = 0.7  # of other windows
FULL_HEIGHT, MIN_FACTOR = 540.0, 0.65  # [px] of the window; a smaller one has a smaller hint, which hides less of it
HELP_COLUMN = 320.0  # [px] of the card's two
NEAR = 1e-3  # [m]: lines nearer than this, or behind the eye, are cut off
CROSS = 0.02  # of the eye's distance: half the length of a cross at a measured point
MEASURE_COLOUR = (1.0, 0.78, 0.25)
GIZMO_NEAR, GIZMO_FAR = 0.01, 1000.0  # [m] of the gizmo's projection
GIZMO_SIZE = 0.16  # of the gizmo, in half widths of the picture
GIZMO_STILL = 1e-5  # [m]; less is no motion, and no turn as a matrix's entries
TextLine = list[tuple[str, tuple[float, ...]]]  # texts side by side, with their colours


def text_box(
    name: str, lines: Sequence[TextLine], left: float, *, gap: float, scale: float = 1.0, height: float = 0.0
) -> None:
    """Draw lines of text on glass in the middle, right of `left` [px].

    gap     between texts side by side [px]
    scale   of the glass around them
    height  0: at the upper edge of the window, 1: at the lower one

    The size is computed here: a window that ImGui fits to its content is cut off in its first frame, which is the one
    that stays on the screen while something takes long.
    """
    style, area, edge = imgui.get_style(), imgui.get_io().display_size, pixels(MARGIN) * scale
    imgui.push_style_var(
        imgui.StyleVar_.window_padding, (style.window_padding.x * scale, style.window_padding.y * scale)
    )
    longest = max(area.x - left - 2 * edge - 2 * style.window_padding.x, pixels(100))
    extents = [[imgui.calc_text_size(text, False, longest) for text, _ in line] for line in lines]
    wide = max(sum(e.x + 1 for e in line) + gap * (len(line) - 1) for line in extents)  # ImGui places on whole pixels
    high = sum(max(e.y for e in line) for line in extents) + style.item_spacing.y * (len(lines) - 1)
    size = (min(wide, longest) + 2 * style.window_padding.x + 1, high + 2 * style.window_padding.y)
    x = max(0.5 * (area.x - size[0]), left + edge)
    imgui.set_next_window_pos((x, edge + height * (area.y - size[1] - 2 * edge)))
    imgui.set_next_window_size(size)
    flags = imgui.WindowFlags_
    still = flags.no_decoration | flags.no_inputs | flags.no_saved_settings | flags.no_bring_to_front_on_focus
    imgui.begin(name, None, still | flags.no_focus_on_appearing)
    for line in lines:
        for k, (text, colour) in enumerate(line):
            if k:
                imgui.same_line(0, gap)
            paragraph(text, colour)
    imgui.end()
    imgui.pop_style_var()


def lines_of(world: WorldView) -> list[TextLine]:
    """Lines for the top of the picture, from the score to notices and what is being opened."""
    score, message = score_and_message(world) if world.editable else ("", "")
    state = PAUSED if world.paused else DEMONSTRATION if world.demo else ""
    lines = [[(score, ACCENT), (message, TEXT)], *([(t, ACCENT)] for t in (state, world.notice, world.opening))]
    return [kept for line in lines if (kept := [(text, colour) for text, colour in line if text])]


class FirstHint:
    """The hint over the first picture: it stays until the user has begun, `done`, and then fades."""

    def __init__(self):
        self._faded: float | None = None  # [s], when it will have

    def draw(self, world: WorldView, left: float, *, done: bool) -> None:
        """Draw it at the bottom, right of `left` [px]; unless it has faded."""
        if done and self._faded is None:
            self._faded = monotonic() + FADE_TIME
        opacity = 1.0 if self._faded is None else (self._faded - monotonic()) / FADE_TIME
        if opacity <= 0.0:
            return
        hints = [("drag", "to grab"), ("F1", "panel")]
        if not world.editable:
            hints = [("drag", "to turn"), ("wheel", "to zoom"), ("F1", "panel")]
        elif world.scene.game is not None:
            hints.append(("P", "demonstration"))
        line: TextLine = []
        for what, does in hints:
            line += [(" \u00b7 ", QUIET)] if line else []
            line += [(what, ACCENT), (does, TEXT)]
        factor = min(max(imgui.get_io().display_size.y / pixels(FULL_HEIGHT), MIN_FACTOR), 1.0)
        imgui.push_font(None, HINT_SIZE * factor)
        imgui.push_style_var(imgui.StyleVar_.alpha, opacity)
        text_box("hint", [line], left, gap=pixels(5) * factor, scale=HINT_PADDING * factor, height=1.0)
        imgui.pop_style_var()
        imgui.pop_font()


def draw_help(*, bodies: bool) -> bool:
    """Draw a card with all that mouse and keys do, for a world with bodies or without; True if it was clicked away."""
    area, edge = imgui.get_io().display_size, pixels(MARGIN)
    width = min(pixels(2 * HELP_COLUMN), area.x - 2 * edge)
    place_window()
    imgui.set_next_window_size_constraints((width, 0), (width, max(area.y - 2 * edge, 1.0)))
    imgui.set_next_window_bg_alpha(0.95)
    imgui.set_next_window_focus()  # over the panel
    imgui.begin("help", None, FIXED | imgui.WindowFlags_.always_auto_resize | imgui.WindowFlags_.no_nav)
    heading("Mouse and keys")
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
    """Draw lines of a world under the panel; `from_picture` gives screen coordinates of the picture's pixels."""
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


def measuring_lines(points: Sequence[np.ndarray] | None, eye: np.ndarray) -> list[Line]:
    """Crosses at the points (3,) [m] of a length to be measured, and the line between two of them with its length."""
    if not points:
        return []
    half = CROSS * float(np.linalg.norm(np.subtract(points[0], eye)))
    lines = [Line(p - half * axis, p + half * axis, MEASURE_COLOUR) for p in points for axis in np.eye(3)]
    if len(points) == 2:
        lines.append(Line(points[0], points[1], MEASURE_COLOUR, f"{np.linalg.norm(points[1] - points[0]):.3g} m"))
    return lines


class Gizmo:
    """Handles at a body's centre, or at what a room is turned about. A drag of move or turn acts at once, one of scale
    when it ends.

    `over`: the cursor is on a handle or drags it, so that the mouse does nothing else. `scaling` is the factor that a
    drag of scale has now, else 1.
    """

    def __init__(self):
        self.over, self.scaling = False, 1.0
        self._dragging = self._sent = False
        self._matrix = np.eye(4)  # of the handles: world_from_gizmo
        self._turned = np.eye(3)  # how far the body has been turned in this drag

    def hide(self) -> None:
        """Let go of a drag without its end."""
        self.over, self.scaling, self._dragging = False, 1.0, False

    def draw(
        self, kind: str, at: np.ndarray, k: int | None, camera: Camera, area: tuple[float, float, float, float]
    ) -> list[Command]:
        """Draw the handles of `kind` at the centre (3,) of body k into an area (left, top, width, height) [px]; the
        user's commands. None: of the room, which can be turned only."""
        gizmo = imguizmo.im_guizmo
        operation = {"move": "translate", "turn": "rotate", "scale": "scale"}[kind]
        if not self._dragging:
            self._matrix, self._turned, self._sent, self.scaling = np.eye(4), np.eye(3), False, 1.0
            self._matrix[:3, 3] = at
        gizmo.begin_frame()
        gizmo.set_drawlist(imgui.get_background_draw_list())
        gizmo.set_rect(*area)
        gizmo.set_gizmo_size_clip_space(GIZMO_SIZE)
        gizmo.allow_axis_flip(False)
        style = gizmo.get_style()
        style.translation_line_thickness = style.scale_line_thickness = 4.0
        style.rotation_line_thickness, style.rotation_outer_line_thickness = 3.0, 2.0
        style.translation_line_arrow_size = style.scale_line_circle_size = 7.0
        view, projection = view_matrices(camera)
        matrix = gizmo.Matrix16(self._matrix.T.ravel().tolist())
        gizmo.manipulate(
            gizmo.Matrix16(view.T.ravel().tolist()),
            gizmo.Matrix16(projection.T.ravel().tolist()),
            gizmo.OPERATION.__members__[operation],
            gizmo.MODE.__members__["world" if kind != "scale" else "local"],
            matrix,
        )
        was, self._dragging = self._dragging, gizmo.is_using()
        self.over = self._dragging or gizmo.is_over()
        self._matrix = np.array(matrix.values, np.float64).reshape(4, 4).T
        if kind == "scale":
            return self._scale(k, ended=was and not self._dragging)
        return self._place(at, k) if self._dragging else []

    def _scale(self, k: int, *, ended: bool) -> list[Command]:
        """The factor of any handle is that of the whole body."""
        factor, self.scaling = self.scaling, 1.0
        if ended:
            return [Rescale(k, factor)]
        if self._dragging:
            axes = np.linalg.norm(self._matrix[:3, :3], axis=0)
            self.scaling = float(axes[np.argmax(np.abs(np.log(np.maximum(axes, 1e-3))))])
        return []

    def _place(self, at: np.ndarray, k: int | None) -> list[Command]:
        """Bring the body to where the handles are, in every frame: it neither falls nor is pushed away."""
        turned = self._matrix[:3, :3] / np.linalg.norm(self._matrix[:3, :3], axis=0)
        rotation, offset = turned @ self._turned.T, self._matrix[:3, 3] - at
        if not self._sent and np.abs(offset).max() < GIZMO_STILL and np.abs(rotation - np.eye(3)).max() < GIZMO_STILL:
            return []
        self._turned, continued, self._sent = turned, self._sent, True
        quaternion = tuple(quaternions_from_matrices(rotation).tolist())
        if k is None:
            return [TurnRoom(quaternion, continued)]
        return [Place(k, tuple(offset.tolist()), quaternion, continued)]


def view_matrices(camera: Camera) -> tuple[np.ndarray, np.ndarray]:
    """OpenGL's view (4, 4) and projection (4, 4) of a camera: -z forward and +y up."""
    view = np.diag([1.0, -1.0, -1.0, 1.0]) @ camera.world_to_camera
    projection, depth = np.zeros((4, 4)), GIZMO_FAR - GIZMO_NEAR
    projection[0, 0], projection[0, 2] = 2 * camera.fx / camera.width, 1 - 2 * camera.cx / camera.width
    projection[1, 1], projection[1, 2] = 2 * camera.fy / camera.height, 2 * camera.cy / camera.height - 1
    projection[2, 2], projection[2, 3] = -(GIZMO_FAR + GIZMO_NEAR) / depth, -2 * GIZMO_FAR * GIZMO_NEAR / depth
    projection[3, 2] = -1.0
    return view, projection
