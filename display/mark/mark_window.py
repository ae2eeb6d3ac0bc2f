"""The window in which a user marks objects: strokes and boxes on photographs, or on a splat that one turns around."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from core.errors import BadInput, Cancelled
from display.mark.mark_edit import MarkEdit, MarkState
from display.picture import PictureTexture, fit
from display.window.gl_window import GLWindow, has_display
from display.window.panel.theme import apply_theme

ORBIT_PER_HEIGHT = np.pi  # [rad] of turning for a drag over the picture's height
STEP = 0.06  # of the distance, for a key that walks
POINT_GAP = 2.0  # [px] of the picture between two points of a stroke
HELP = "Left: inside   Right or Shift: outside   B: box   N: new object   1-9: choose   Ctrl+Z, Ctrl+Y   + -: size"
HELP_VIEWS = "Tab: next view   Del: clear   Enter: done   Esc: leave"
HELP_ORBIT = "Space or middle drag: turn   Wheel: nearer   W A S D Q E: move"
WALK = {"d": (1, 0, 0), "a": (-1, 0, 0), "e": (0, 1, 0), "q": (0, -1, 0), "w": (0, 0, 1), "s": (0, 0, -1)}
OUTSIDE_COLOUR = (0.05, 0.05, 0.05)


class Subject(Protocol):
    """Interface of what is marked.

    views   names of the pictures that have been marked or can be
    orbit   an OrbitCamera where one looks freely, None for photographs
    """

    views: list[str]
    orbit: object | None

    def picture(self, view: str | None) -> np.ndarray:
        """Picture (H, W, 3) uint8 of a view with what is selected in colours; of the free camera for None."""

    def view_here(self) -> str:
        """Name of the view of the free camera as it stands, a new one if need be."""

    def view_shown(self) -> str | None:
        """Name of the view that the free camera sees now, None if it is none."""

    def go_to(self, view: str) -> None:
        """Let the free camera see a view."""

    def select(self, state: MarkState) -> str:
        """Select by the marks; a line on what was found. Raises BadInput."""

    def colour(self, index: int) -> tuple[float, float, float]:
        """Colour of an object, 0..1."""


class MarkWindow:
    """Open it, `run` it until the user has done: the marks, or None if they are not wanted. Raises BadInput."""

    def __init__(self, subject: Subject, edit: MarkEdit, title: str, size: tuple[int, int]):
        if not has_display():
            raise BadInput("no display to mark objects on: --marks MARKS.json takes marks from a file")
        self.subject, self.edit = subject, edit
        self._surface = GLWindow(title, *size, vsync=True)
        apply_theme(self._surface.scale)
        self._texture = PictureTexture(self._surface.gl)
        self._index, self._seen, self._cursor = 0, None, (0.0, 0.0)
        self._drag: str | None = None  # "inside", "outside", "boxes" or "turn"
        self._points: list[tuple[float, float]] = []
        self._held: set[str] = set()
        self._box = self._leaving = False
        self._line, self._selected = "", MarkState()
        self._shape = (1, 1)
        self._result: MarkState | None = None
        self._open = True

    def run(self) -> MarkState | None:
        """Let the user mark."""
        try:
            while self._open and not self._surface.closing:
                if self._surface.asleep():
                    continue
                for event in self._surface.begin():
                    self._handle(*event)
                waiting = self._drag is None and self.edit.state != self._selected
                if waiting:
                    self._line = "selecting ..."
                self._show()
                self._surface.end()
                self._surface.swap()
                if waiting:
                    self._select()
            return self._result
        finally:
            self._surface.close()

    @property
    def view(self) -> str | None:
        """The view that is shown; None: the free camera."""
        return None if self.subject.orbit is not None else self.subject.views[self._index]

    def _select(self) -> None:
        self._selected, self._seen = self.edit.state, None
        try:
            self._line = self.subject.select(self.edit.state)
        except BadInput as e:
            self._line = " ".join(str(e).split())

    def _show(self) -> None:
        """Draw picture, strokes and panel."""
        orbit = self.subject.orbit
        key = (self.view, None if orbit is None else (*orbit.eye, *orbit.target), self._surface.frame_size)
        if key != self._seen:
            picture = self.subject.picture(self.view)
            self._texture.upload_pixels(picture)
            self._seen, self._shape = key, picture.shape[1::-1]
        self._texture.draw(self._surface.frame_size)
        self._draw_marks()
        self._draw_panel()

    def _draw_marks(self) -> None:
        from imgui_bundle import imgui

        draw, scale = imgui.get_background_draw_list(), self._surface.scale
        shown = self.subject.view_shown() if self.subject.orbit is not None else self.view
        lines = [(m.object, m.kind, m.points) for m in self.edit.state.marks if m.view == shown]
        if self._drag in ("inside", "outside", "boxes"):
            lines.append((self.edit.name, self._drag, self._points))
        for name, kind, points in lines:
            index = self.edit.state.objects.index(name)
            colour = OUTSIDE_COLOUR if kind == "outside" else self.subject.colour(index)
            colour, edge = imgui.get_color_u32((*colour, 1.0)), imgui.get_color_u32((1.0, 1.0, 1.0, 0.8))
            at = [self._to_screen(p) for p in points]
            if kind == "boxes" and len(at) > 1:
                draw.add_rect(at[0], at[-1], colour, 0.0, 0, 2.5 * scale)
                continue
            for a, b in zip(at, at[1:] or at, strict=False):
                draw.add_line(a, b, edge, 6.0 * scale)
            for a, b in zip(at, at[1:] or at, strict=False):
                draw.add_line(a, b, colour, 4.0 * scale)

    def _draw_panel(self) -> None:
        from imgui_bundle import imgui

        area = imgui.get_io().display_size
        imgui.set_next_window_pos((8, 8))
        flags = imgui.WindowFlags_.always_auto_resize | imgui.WindowFlags_.no_move | imgui.WindowFlags_.no_collapse
        imgui.begin("Objects", None, flags)
        for k, name in enumerate(self.edit.state.objects):
            imgui.color_button(f"##colour{k}", (*self.subject.colour(k), 1.0))
            imgui.same_line()
            if k == self.edit.current:
                imgui.set_next_item_width(150 * self._surface.scale)
                entered, text = imgui.input_text("##name", name, imgui.InputTextFlags_.enter_returns_true)
                if entered and not self.edit.rename(text.strip()):
                    self._line = f"{text.strip()!r} cannot be its name"
            elif imgui.selectable(f"{k + 1} {name}", False)[0]:
                self.edit.choose(k)
        for text, act in (
            ("New", self.edit.new_object),
            ("Undo", self.edit.undo),
            ("Redo", self.edit.redo),
            ("Grow", lambda: self.edit.grow(1)),
            ("Shrink", lambda: self.edit.grow(-1)),
            ("Done", self._finish),
        ):
            if imgui.button(text):
                act()
            if text != "Done":
                imgui.same_line()
        imgui.text(("box: drag around it" if self._box else self.view or "free view") + f"   {self._line}")
        imgui.end()
        draw = imgui.get_foreground_draw_list()
        lines = [HELP, HELP_VIEWS + ("   " + HELP_ORBIT if self.subject.orbit is not None else "")]
        height = imgui.get_text_line_height_with_spacing()
        top = area.y - len(lines) * height - 6
        draw.add_rect_filled((0, top - 4), (area.x, area.y), imgui.get_color_u32((0.0, 0.0, 0.0, 0.65)))
        for k, line in enumerate(lines):
            draw.add_text((8, top + k * height), imgui.get_color_u32((1.0, 1.0, 1.0, 1.0)), line)

    def _to_screen(self, point) -> tuple[float, float]:
        left, top, width, height = fit(self._shape, self._surface.window_size)
        return left + point[0] / self._shape[0] * width, top + point[1] / self._shape[1] * height

    def _to_picture(self, x: float, y: float) -> tuple[float, float]:
        left, top, width, height = fit(self._shape, self._surface.window_size)
        u, v = (x - left) / width * self._shape[0], (y - top) / height * self._shape[1]
        return min(max(u, 0.0), float(self._shape[0])), min(max(v, 0.0), float(self._shape[1]))

    def _handle(self, kind: str, *what) -> None:
        from imgui_bundle import imgui

        io = imgui.get_io()
        if kind == "move":
            self._move(*what)
        elif kind == "button":
            name, down, x, y = what
            if down and not io.want_capture_mouse:
                self._press(name, x, y)
            elif not down:
                self._release()
        elif kind == "wheel" and self.subject.orbit is not None and not io.want_capture_mouse:
            self.subject.orbit.zoom(what[0])
        elif kind == "key" and not (what[1] and io.want_text_input):
            self._key(*what)
        elif kind == "blur":
            self._held.clear()
            self._release()

    def _press(self, button: str, x: float, y: float) -> None:
        if self._drag is not None:
            return
        self._cursor, self._leaving = (x, y), False
        if self.subject.orbit is not None and (button == "middle" or "space" in self._held):
            self._drag = "turn"
            return
        outside = button == "right" or "shift" in self._held
        self._drag = "outside" if outside else "boxes" if self._box else "inside"
        self._points = [self._to_picture(x, y)]

    def _move(self, x: float, y: float) -> None:
        du, dv, self._cursor = x - self._cursor[0], y - self._cursor[1], (x, y)
        if self._drag == "turn":
            gain = ORBIT_PER_HEIGHT / max(self._surface.window_size[1], 1)
            self.subject.orbit.turn(-gain * du, gain * dv)
        elif self._drag == "boxes":
            self._points = [self._points[0], self._to_picture(x, y)]
        elif self._drag is not None:
            point = self._to_picture(x, y)
            if np.hypot(point[0] - self._points[-1][0], point[1] - self._points[-1][1]) >= POINT_GAP:
                self._points.append(point)

    def _release(self) -> None:
        drag, self._drag = self._drag, None
        if drag in (None, "turn"):
            return
        if drag == "boxes":
            x, y = zip(*self._points, strict=True)
            if max(x) - min(x) < 1 or max(y) - min(y) < 1:
                return
            self._points, self._box = [(min(x), min(y)), (max(x), max(y))], False
        self.edit.add(self.subject.view_here() if self.subject.orbit is not None else self.view, drag, self._points)

    def _key(self, name: str, down: bool) -> None:
        if name in ("shift", "space"):
            (self._held.add if down else self._held.discard)(name)
            return
        if not down:
            return
        if name != "escape":
            self._leaving = False
        actions = {
            "ctrl+z": self.edit.undo,
            "ctrl+y": self.edit.redo,
            "n": self.edit.new_object,
            "plus": lambda: self.edit.grow(1),
            "minus": lambda: self.edit.grow(-1),
            "delete": self.edit.clear,
            "tab": self._next_view,
            "enter": self._finish,
            "escape": self._escape,
        }
        if name in actions:
            actions[name]()
        elif name == "b":
            self._box = not self._box
        elif name.isdigit():
            self.edit.choose(int(name) - 1)
        elif name in WALK and self.subject.orbit is not None:
            orbit = self.subject.orbit
            orbit.move(*(STEP * orbit.distance * np.array(WALK[name])))

    def _next_view(self) -> None:
        """Show the next view, the previous one with Shift."""
        if not self.subject.views:
            self._line = "no view has marks yet"
            return
        self._index = (self._index + (-1 if "shift" in self._held else 1)) % len(self.subject.views)
        if self.subject.orbit is not None:
            self.subject.go_to(self.subject.views[self._index])

    def _finish(self) -> None:
        """End with the marks, if each object has some."""
        named = {m.object for m in self.edit.state.marks if m.kind != "outside"}
        bare = [name for name in self.edit.state.objects if name not in named]
        if bare:
            self._line = f"{bare[0]} has no stroke inside of it yet"
            return
        self._result, self._open = self.edit.state, False

    def _escape(self) -> None:
        """End the drag or the box; else leave, asked twice if something was marked."""
        if self._drag is not None:
            self._drag = None
        elif self._box:
            self._box = False
        elif self.edit.changed and not self._leaving:
            self._leaving, self._line = True, "Esc again leaves without keeping the marks; Enter keeps them"
        else:
            self._open = False


def marked_in_window(subject: Subject, edit: MarkEdit, title: str, size: tuple[int, int]) -> MarkState:
    """The marks that a user makes in a window. Raises BadInput without a display, Cancelled if none are wanted."""
    state = MarkWindow(subject, edit, title, size).run()
    if state is None:
        raise Cancelled(quits=True)
    return state
