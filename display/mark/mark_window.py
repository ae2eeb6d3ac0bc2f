"""Window to mark objects: strokes and boxes on photographs, or on a splat seen from a free camera."""

from __future__ import annotations

import itertools
import sys
from typing import Protocol

import numpy as np

from core.errors import BadInput, Cancelled
from display.mark.free_view import FreeView
from display.mark.mark_edit import MarkEdit, MarkState
from display.mark.mark_panel import WIDTH, MarkPanel
from display.mark.placed_picture import PlacedPicture
from display.picture import PictureTexture
from display.window.gl_window import GLWindow, has_display
from display.window.panel.theme import apply_theme

ORBIT_PER_HEIGHT = np.pi  # [rad] of rotation for a drag over the picture's height
STEP = 0.06  # fraction of the distance per press of a walking key
POINT_GAP = 2.0  # in screen coordinates, between two points of a stroke
WALK = {"d": (1, 0, 0), "a": (-1, 0, 0), "e": (0, 1, 0), "q": (0, -1, 0), "w": (0, 0, 1), "s": (0, 0, -1)}
OUTSIDE_COLOUR = (0.05, 0.05, 0.05)


class Subject(Protocol):
    """Interface of the content to be marked. One view of it is shown.

    views   names of the pictures that have been marked or can be
    free    the free camera on a splat, None for photographs
    size    (width, height) [px] of the shown view, in which marks are counted
    version changes when a picture has become another one by itself
    """

    views: list[str]
    free: FreeView | None
    size: tuple[int, int]
    version: int

    def picture(self) -> np.ndarray:
        """Picture (H, W, 3) uint8 of the shown view with what is selected in colours, perhaps of another size."""

    def view_shown(self) -> str | None:
        """Name of the shown view, None for one that has no name yet."""

    def go_to(self, view: str) -> None:
        """Show a view."""

    def select(self, state: MarkState) -> str:
        """Update the selection from the marks; returns a line on the result. Raises BadInput."""

    def colour(self, index: int) -> tuple[float, float, float]:
        """Colour of an object, 0..1."""


class MarkWindow:
    """Call `run` for the marks, or None if the user leaves without saving. Raises BadInput."""

    def __init__(self, subject: Subject, edit: MarkEdit, title: str, size: tuple[int, int]):
        if not has_display():
            raise BadInput("no display to mark objects on: --marks MARKS.json takes marks from a file")
        self.subject, self.edit = subject, edit
        self.tool, self.line = "inside", ""  # what the left button draws; what is said at the panel's foot
        self._surface = GLWindow(title, *size, vsync=True)
        apply_theme(self._surface.scale)
        self._texture, self._placed = PictureTexture(self._surface.gl), PlacedPicture()
        self._panel = MarkPanel(self)
        self._seen, self._cursor = None, (0.0, 0.0)
        self._drag: str | None = None  # "inside", "outside", "boxes" or "turn"
        self._points: list[tuple[float, float]] = []
        self._held: set[str] = set()
        self._leaving = False
        self._selected = MarkState()
        self._result: MarkState | None = None
        self._open = True

    def run(self) -> MarkState | None:
        """Let the user mark."""
        try:
            while self._open:
                if self._surface.closing:
                    self._surface.stay()
                    self.leave()
                if self._surface.asleep():
                    continue
                for event in self._surface.begin():
                    self._handle(*event)
                waiting = self._drag is None and self.edit.state != self._selected
                if waiting:
                    self.line = "selecting ..."
                self._show()
                self._surface.end()
                self._surface.swap()
                if waiting:
                    self._select()
            return self._result
        finally:
            self._surface.close()

    def _select(self) -> None:
        self._selected, self._seen = self.edit.state, None
        try:
            self.line = self.subject.select(self.edit.state)
        except BadInput as e:
            self.line = " ".join(str(e).split())

    def _show(self) -> None:
        """Draw picture, strokes and panel."""
        free, surface = self.subject.free, self._surface
        key = (
            self.subject.version,
            self.subject.view_shown(),
            None if free is None else (*free.orbit.eye, *free.orbit.target),
        )
        if key != self._seen:
            self._texture.upload_pixels(self.subject.picture())
            self._seen, self._placed.size = key, self.subject.size
        left, (width, height) = int(WIDTH * surface.scale), surface.window_size
        self._placed.area = (left, 0, width - left, height)
        pixels = surface.frame_size[0] / max(width, 1)
        self._texture.draw(surface.frame_size, tuple(round(n * pixels) for n in self._placed.place))
        self._draw_marks()
        self._panel.draw((left, height), surface.scale)

    def _draw_marks(self) -> None:
        from imgui_bundle import imgui

        draw, scale, shown = imgui.get_background_draw_list(), self._surface.scale, self.subject.view_shown()
        lines = [(m.object, m.kind, m.points) for m in self.edit.state.marks if m.view == shown]
        if self._drag in ("inside", "outside", "boxes"):
            lines.append((self.edit.name, self._drag, self._points))
        for name, kind, points in lines:
            index = self.edit.state.objects.index(name)
            colour = OUTSIDE_COLOUR if kind == "outside" else self.subject.colour(index)
            colour, edge = imgui.get_color_u32((*colour, 1.0)), imgui.get_color_u32((1.0, 1.0, 1.0, 0.8))
            at = [self._placed.to_window(p) for p in points]
            if kind == "boxes" and len(at) > 1:
                draw.add_rect(at[0], at[-1], edge, thickness=4.5 * scale)
                draw.add_rect(at[0], at[-1], colour, thickness=2.5 * scale)
                continue
            if len(at) == 1:
                draw.add_circle_filled(at[0], 4.0 * scale, edge)
                draw.add_circle_filled(at[0], 3.0 * scale, colour)
            for thickness, paint in ((6.0, edge), (4.0, colour)):
                for a, b in itertools.pairwise(at):
                    draw.add_line(a, b, paint, thickness * scale)

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
        elif kind == "wheel" and not io.want_capture_mouse:
            if self.subject.free is not None:
                self.subject.free.orbit.zoom(what[0])
            else:
                self._placed.zoom(what[0], *self._cursor)
        elif kind == "key" and not (what[1] and io.want_text_input):
            self._key(*what)
        elif kind == "blur":
            self._held.clear()
            self._release()

    def _press(self, button: str, x: float, y: float) -> None:
        if self._drag is not None:
            return
        self._cursor, self._leaving = (x, y), False
        if button == "middle" or "space" in self._held:
            self._drag = "turn"
            return
        self._drag = "outside" if button == "right" or "shift" in self._held else self.tool
        self._points = [self._placed.to_picture(x, y)]

    def _move(self, x: float, y: float) -> None:
        du, dv, self._cursor = x - self._cursor[0], y - self._cursor[1], (x, y)
        if self._drag == "turn" and self.subject.free is None:
            self._placed.move(du, dv)
        elif self._drag == "turn":
            gain = ORBIT_PER_HEIGHT / max(self._surface.window_size[1], 1)
            self.subject.free.orbit.turn(-gain * du, gain * dv)
        elif self._drag == "boxes":
            self._points = [self._points[0], self._placed.to_picture(x, y)]
        elif self._drag is not None:
            last = self._placed.to_window(self._points[-1])
            if np.hypot(x - last[0], y - last[1]) >= POINT_GAP:
                self._points.append(self._placed.to_picture(x, y))

    def _release(self) -> None:
        drag, self._drag = self._drag, None
        if drag in (None, "turn"):
            return
        if drag == "boxes":
            x, y = zip(*self._points, strict=True)
            if max(x) - min(x) < 1 or max(y) - min(y) < 1:
                return
            self._points, self.tool = [(min(x), min(y)), (max(x), max(y))], "inside"
        free = self.subject.free
        self.edit.add(self.subject.view_shown() if free is None else free.named(), drag, self._points)

    def _key(self, name: str, down: bool) -> None:
        if name in ("shift", "space"):
            (self._held.add if down else self._held.discard)(name)
            return
        if not down:
            return
        if name != "escape":
            self._leaving = False
        actions = {
            "ctrl+z": self.undo,
            "ctrl+y": self.redo,
            "n": self.edit.new_object,
            "delete": self.edit.delete,
            "tab": lambda: self.turn_page(-1 if "shift" in self._held else 1),
            "home": self._placed.whole,
            "enter": self.finish,
            "escape": self._escape,
        }
        if name in actions:
            actions[name]()
        elif name == "b":
            self.tool = "inside" if self.tool == "boxes" else "boxes"
        elif name.isdigit():
            self.edit.choose(int(name) - 1)
        elif self.subject.free is not None and name in WALK:
            orbit = self.subject.free.orbit
            orbit.move(*(STEP * orbit.distance * np.array(WALK[name])))
        elif self.subject.free is not None and name in ("plus", "minus"):
            self.edit.grow(1 if name == "plus" else -1)

    def turn_page(self, step: int) -> None:
        """Show the next view, or the previous one for -1."""
        views, shown = self.subject.views, self.subject.view_shown()
        if not views:
            self.line = "no view has marks yet"
            return
        self.go_to(views[(views.index(shown) + step) % len(views) if shown in views else min(step, 0)])

    def go_to(self, view: str) -> None:
        """Show a view as a whole."""
        self._placed.whole()
        self.subject.go_to(view)

    def undo(self) -> None:
        """Take the last step back; where it was on another photograph, show that."""
        self._step(self.edit.undo)

    def redo(self) -> None:
        """Take the step that was undone last again."""
        self._step(self.edit.redo)

    def _step(self, act) -> None:
        before = set(self.edit.state.marks)
        act()
        changed = {m.view for m in before ^ set(self.edit.state.marks)}
        if self.subject.free is None and changed and self.subject.view_shown() not in changed:
            self.go_to(min(changed))

    def finish(self) -> None:
        """End with the marks, if there are some, and each object that has marks has some inside."""
        marks = self.edit.state.marks
        bare = {m.object for m in marks} - {m.object for m in marks if m.kind != "outside"}
        if not marks:
            self.line = "draw a stroke inside of an object first"
        elif bare:
            self.line = f"{min(bare)} has no stroke inside of it yet"
        else:
            self._result, self._open = self.edit.state, False

    def leave(self) -> None:
        """End without the marks, asked twice if something was marked."""
        if self.edit.changed and not self._leaving:
            self._leaving, self.line = True, "Once more leaves without keeping the marks; Enter keeps them"
        else:
            self._open = False

    def _escape(self) -> None:
        """End the drag or the box; else leave."""
        if self._drag is not None:
            self._drag = None
        elif self.tool != "inside":
            self.tool = "inside"
        else:
            self.leave()


def marked_in_window(subject: Subject, edit: MarkEdit, title: str, size: tuple[int, int]) -> MarkState:
    """Marks drawn in a window. Raises BadInput without a display, Cancelled if the user leaves without saving."""
    state = MarkWindow(subject, edit, title, size).run()
    if state is None:
        print("the window was left: no marks are kept, nothing is written", file=sys.stderr)
        raise Cancelled(quits=True)
    return state
