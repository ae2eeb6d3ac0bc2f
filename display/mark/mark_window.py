"""Window to mark objects: strokes and boxes on photographs, or on a splat seen from a free camera; its panel."""

from __future__ import annotations

import itertools
import sys
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Protocol

import numpy as np
from imgui_bundle import imgui

from core.camera import Camera, look_at
from core.errors import BadInput, Cancelled
from display.mark.mark_edit import MarkEdit, MarkState, free_name
from display.picture import fit
from display.window.controls import ORBIT_PER_HEIGHT, WALK_KEYS
from display.window.gl_context import PictureTexture
from display.window.gl_window import GLWindow
from display.window.mouse import OrbitCamera
from display.window.widgets import FIXED, apply_theme

STEP = 0.06  # fraction of the distance per press of a walking key
POINT_GAP = 2.0  # in screen coordinates, between two points of a stroke
OUTSIDE_COLOUR = (0.05, 0.05, 0.05)
ZOOM_STEP, ZOOM_MAX = 1.25, 16.0  # of a notch of the wheel; of the whole picture's size
WIDTH = 248.0  # in screen coordinates at a display scale of 1
LIST_ROWS = 6  # of objects, or of views, that are seen at once
TOOLS = {"inside": "Inside", "outside": "Outside", "boxes": "Box", "points": "Points"}
POINT_COLOUR = (1.0, 0.85, 0.1)
HINTS = (
    "Left: inside; right, Shift: outside\n"
    "B: box   N: new   1-9: choose object\n"
    "Ctrl+Z, Ctrl+Y: undo, redo\n"
    "Del: delete the object\n"
)
PHOTOGRAPH_HINTS = (
    "Tab, Shift+Tab: next, previous\nWheel: nearer; middle: move; Home: all\n"
    "Colours are a first idea, of this photograph alone"
)
POINT_HINTS = "\nP: points of the place, numbered alike in the clip\nand in photographs; 1-9, N: choose, next number"
ORBIT_HINTS = "Space or middle drag: turn\nWheel: nearer   W A S D Q E: move\n+ -: grow, shrink   Tab: next view"


class Subject(Protocol):
    """Interface of the content to be marked. One view of it is shown.

    views       names of the pictures that have been marked or can be
    free        the free camera on a splat, None for photographs
    numbered    whether numbered points are marked, too
    size        (width, height) [px] of the shown view, in which marks are counted
    version     changes when a picture has become another one by itself
    picture     (H, W, 3) uint8 of the shown view with what is selected in colours, perhaps of another size
    view_shown  name of the shown view, None for one that has no name yet
    go_to       shows a view
    select      updates the selection from the marks; returns a line on the result. Raises BadInput
    colour      of an object, 0..1
    """

    views: list[str]
    free: FreeView | None
    numbered: bool
    size: tuple[int, int]
    version: int

    def picture(self) -> np.ndarray: ...
    def view_shown(self) -> str | None: ...
    def go_to(self, view: str) -> None: ...
    def select(self, state: MarkState) -> str: ...
    def colour(self, index: int) -> tuple[float, float, float]: ...


class MarkWindow:
    """Call `run` for the marks, or None if the user leaves without saving. Raises BadInput."""

    def __init__(self, subject: Subject, edit: MarkEdit, title: str, size: tuple[int, int]):
        self.subject, self.edit = subject, edit
        self._undo, self._redo = partial(self._step, edit.undo), partial(self._step, edit.redo)
        self.tool, self.line = "inside", ""  # what the left button draws; what is said at the panel's foot
        self.number = 0  # of the point that is put next
        self._surface = GLWindow(title, *size)
        apply_theme(self._surface.scale)
        self._texture, self._placed = PictureTexture(self._surface.gl), PlacedPicture()
        self._typed: str | None = None  # a name that is being written
        self._seen, self._cursor = None, (0.0, 0.0)
        self._drag: str | None = None  # "inside", "outside", "boxes" or "turn"
        self._points: list[tuple[float, float]] = []
        self._held: set[str] = set()
        self._selected, self._result = MarkState(), None
        self._open, self._leaving = True, False

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
        free, surface = self.subject.free, self._surface
        key = (self.subject.version, self.subject.view_shown(), free and free.orbit.view)
        if key != self._seen:
            self._texture.upload_pixels(self.subject.picture())
            self._seen, self._placed.size = key, self.subject.size
        left, (width, height) = int(WIDTH * surface.scale), surface.window_size
        self._placed.area = (left, 0, width - left, height)
        pixels = surface.frame_size[0] / max(width, 1)
        self._texture.draw(surface.frame_size, tuple(round(n * pixels) for n in self._placed.place))
        self._draw_marks()
        self._draw_panel((left, height))

    def _draw_marks(self) -> None:
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
        dark, bright = (imgui.get_color_u32((*c, 1.0)) for c in (OUTSIDE_COLOUR, POINT_COLOUR))
        for number, point in enumerate(self.edit.state.points.get(shown, ()), 1):
            if point is not None:
                x, y = self._placed.to_window(point)
                for radius, paint in ((5.5, dark), (4.0, bright), (1.5, dark)):
                    draw.add_circle_filled((x, y), radius * scale, paint)
                for off, paint in ((1.0, dark), (0.0, bright)):
                    draw.add_text((x + 7 * scale + off, y - 16 * scale + off), paint, str(number))

    def _handle(self, kind: str, *what) -> None:
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
        if self.tool == "points":
            self.edit.put_point(self.subject.view_shown(), self.number, self._placed.to_picture(x, y))
            self.number += 1
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
            "ctrl+z": self._undo,
            "ctrl+y": self._redo,
            "n": self._next,
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
        elif name == "p" and self.subject.numbered:
            self.use("inside" if self.tool == "points" else "points")
        elif name.isdigit() and self.tool == "points":
            self.number = max(int(name) - 1, 0)
        elif name.isdigit():
            self.edit.choose(int(name) - 1)
        elif self.subject.free is not None and name in WALK_KEYS:
            orbit = self.subject.free.orbit
            orbit.move(*(STEP * orbit.distance * np.array(WALK_KEYS[name])))
        elif self.subject.free is not None and name in ("plus", "minus"):
            self.edit.grow(1 if name == "plus" else -1)

    def use(self, tool: str) -> None:
        """Draw with one of TOOLS from now on."""
        self.tool, self.number = tool, self.edit.missing_point(self.subject.view_shown() or "")

    def _next(self) -> None:
        """Go on to the next number of a point, or to a new object."""
        if self.tool == "points":
            self.number += 1
        else:
            self.edit.new_object()

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
        self.use(self.tool)

    def _step(self, act: Callable[[], None]) -> None:
        """Undo or redo, and show the photograph that this changed."""
        before, rows = set(self.edit.state.marks), set(self.edit.state.points.items())
        act()
        changed = {m.view for m in before ^ set(self.edit.state.marks)}
        changed |= {view for view, _ in rows ^ set(self.edit.state.points.items())}
        if self.subject.free is None and changed and self.subject.view_shown() not in changed:
            self.go_to(min(changed))

    def finish(self) -> None:
        """End with the marks, if every object that has marks has some inside."""
        marks = self.edit.state.marks
        bare = {m.object for m in marks} - {m.object for m in marks if m.kind != "outside"}
        if not marks:
            self.line = "draw a stroke inside of an object first"
        elif bare:
            self.line = f"{min(bare)} has no stroke inside of it yet"
        else:
            self._result, self._open = self.edit.state, False

    def leave(self) -> None:
        """End without the marks; if something was marked, the second time."""
        if self.edit.changed and not self._leaving:
            self._leaving, self.line = True, "Once more leaves without keeping the marks; Enter keeps them"
        else:
            self._open = False

    def _escape(self) -> None:
        if self._drag is not None:
            self._drag = None
        elif self.tool != "inside":
            self.tool = "inside"
        else:
            self.leave()

    # the panel

    def _draw_panel(self, size: tuple[int, int]) -> None:
        """Draw the panel at the left, (width, height) in screen coordinates, and carry out what is clicked."""
        imgui.set_next_window_pos((0, 0))
        imgui.set_next_window_size(size)
        flags = imgui.WindowFlags_.no_nav | imgui.WindowFlags_.no_bring_to_front_on_focus
        imgui.begin("Marks", None, FIXED | flags)
        self._draw_objects()
        imgui.separator()
        self._draw_tools()
        imgui.separator()
        self._draw_views()
        imgui.separator()
        imgui.text_wrapped(self.line or "Draw a stroke inside of what shall be an object.")
        done = imgui.get_frame_height_with_spacing()
        hints = HINTS + (PHOTOGRAPH_HINTS if self.subject.free is None else ORBIT_HINTS)
        hints += POINT_HINTS if self.subject.numbered else ""
        wide = imgui.get_content_region_avail().x
        high = imgui.calc_text_size(hints, False, wide).y
        imgui.set_cursor_pos_y(
            max(imgui.get_cursor_pos_y(), size[1] - done - high - 3 * imgui.get_style().item_spacing.y)
        )
        if imgui.button("Done (Enter)", (wide, 0.0)):
            self.finish()
        imgui.push_style_color(imgui.Col_.text, imgui.get_style().color_(imgui.Col_.text_disabled))
        imgui.text_wrapped(hints)
        imgui.pop_style_color()
        imgui.end()

    def _draw_objects(self) -> None:
        edit, subject = self.edit, self.subject
        rows = min(len(edit.state.objects), LIST_ROWS)
        imgui.text("Objects")
        imgui.begin_child("objects", (0.0, rows * imgui.get_frame_height_with_spacing()))
        for k, name in enumerate(edit.state.objects):
            imgui.color_button(f"##colour{k}", (*subject.colour(k), 1.0))
            imgui.same_line()
            if k == edit.current:
                self._draw_name(name)
                continue
            views = len({m.view for m in edit.state.marks if m.object == name})
            if imgui.selectable(f"{k + 1}  {name}   {f'in {views}' if views else 'no marks'}##{k}", False)[0]:
                edit.choose(k)
        imgui.end_child()
        draw_buttons({"New": edit.new_object, "Delete": edit.delete, "Undo": self._undo, "Redo": self._redo})

    def _draw_name(self, name: str) -> None:
        """The name of the current object, editable."""
        imgui.set_next_item_width(-1.0)
        imgui.push_item_flag(imgui.ItemFlags_.no_tab_stop, True)  # Tab is for the next view
        current = name if self._typed is None else self._typed
        changed, text = imgui.input_text("##name", current, imgui.InputTextFlags_.auto_select_all)
        if changed:
            self._typed = text
        imgui.pop_item_flag()
        if imgui.is_item_deactivated() and self._typed is not None:
            text, self._typed = self._typed.strip(), None
            if not self.edit.rename(text):
                self.line = f"{text!r} cannot be its name"

    def _draw_tools(self) -> None:
        tools = list(TOOLS)[: None if self.subject.numbered else -1]
        for kind in tools:
            if imgui.radio_button(TOOLS[kind], self.tool == kind):
                self.use(kind)
            if kind not in ("boxes", tools[-1]):
                imgui.same_line()
        if self.tool == "points":
            imgui.same_line()
            imgui.text(f"next: {self.number + 1}")
        if self.subject.free is not None:
            draw_buttons({"Grow": lambda: self.edit.grow(1), "Shrink": lambda: self.edit.grow(-1)})

    def _draw_views(self) -> None:
        subject = self.subject
        views, shown = subject.views, subject.view_shown()
        if subject.free is None:
            at = views.index(shown)
            imgui.text(f"Photograph {at + 1} of {len(views)}")
            draw_buttons({"Previous": lambda: self.turn_page(-1), "Next": lambda: self.turn_page(1)})
            if len(views) > 1:
                imgui.set_next_item_width(-1.0)
                moved, chosen = imgui.slider_int("##photograph", at + 1, 1, len(views), shown.replace("%", "%%"))
                if moved:
                    self.go_to(views[min(max(chosen, 1), len(views)) - 1])
        marked = self.edit.state.views
        imgui.text("With marks:" if marked else "None has marks yet")
        imgui.begin_child("views", (0.0, min(len(marked), LIST_ROWS) * imgui.get_text_line_height_with_spacing() + 1))
        for name in marked:
            if imgui.selectable(f"{name}##view", name == shown)[0]:
                self.go_to(name)
        imgui.end_child()


def draw_buttons(actions: dict[str, Callable[[], object]]) -> None:
    """Draw buttons in a row, and carry out the one that is pressed."""
    for k, (text, act) in enumerate(actions.items()):
        if k:
            imgui.same_line()
        if imgui.button(text):
            act()


def marked_in_window(subject: Subject, edit: MarkEdit, title: str, size: tuple[int, int]) -> MarkState:
    """Marks drawn in a window. Raises BadInput without a display, Cancelled if the user leaves without saving."""
    state = MarkWindow(subject, edit, title, size).run()
    if state is None:
        print("the window was left: no marks are kept, nothing is written", file=sys.stderr)
        raise Cancelled(quits=True)
    return state


class PlacedPicture:
    """A picture of `size` (width, height) in an `area` (left, top, width, height) of a window.

    Pixels of the picture and positions in the window count to the right and down.
    """

    def __init__(self) -> None:
        self.size, self.area, self._zoom = (1, 1), (0, 0, 1, 1), 1.0
        self._middle = (0.5, 0.5)  # the part of the picture at the middle of the area

    @property
    def place(self) -> tuple[float, float, float, float]:
        """Left, top, width and height of the whole picture in the window; larger than the area when zoomed."""
        left, top, width, height = self.area
        x, y, w, h = fit(self.size, (max(width, 1), max(height, 1)))
        if self._zoom == 1.0:
            return left + x, top + y, w, h
        w, h = w * self._zoom, h * self._zoom
        return left + 0.5 * width - self._middle[0] * w, top + 0.5 * height - self._middle[1] * h, w, h

    def to_window(self, point) -> tuple[float, float]:
        """Position in the window of a pixel of the picture."""
        left, top, width, height = self.place
        return left + point[0] / self.size[0] * width, top + point[1] / self.size[1] * height

    def to_picture(self, x: float, y: float) -> tuple[float, float]:
        """Position in the picture, the nearest within it."""
        left, top, width, height = self.place
        u, v = (x - left) / width * self.size[0], (y - top) / height * self.size[1]
        return min(max(u, 0.0), float(self.size[0])), min(max(v, 0.0), float(self.size[1]))

    def zoom(self, notches: float, x: float, y: float) -> None:
        """Zoom about a position in the window."""
        u, v = (p / n for p, n in zip(self.to_picture(x, y), self.size, strict=True))
        self._zoom = min(max(self._zoom * ZOOM_STEP**notches, 1.0), ZOOM_MAX)
        left, top, width, height = self.area
        _, _, w, h = self.place
        self._look_at(u - (x - left - 0.5 * width) / w, v - (y - top - 0.5 * height) / h)

    def move(self, dx: float, dy: float) -> None:
        """Move an enlarged picture with the hand that drags it."""
        _, _, width, height = self.place
        self._look_at(self._middle[0] - dx / width, self._middle[1] - dy / height)

    def whole(self) -> None:
        """Show the whole picture."""
        self._zoom, self._middle = 1.0, (0.5, 0.5)

    def _look_at(self, u: float, v: float) -> None:
        self._middle = (min(max(u, 0.0), 1.0), min(max(v, 0.0), 1.0)) if self._zoom > 1.0 else (0.5, 0.5)


class FreeView:
    """An OrbitCamera in a frame that is upright, and marked views in that of the splat's file.

    orbit    the camera that the user moves
    size     (width, height) [px] of its pictures
    upright  (4, 4) rotation from the file's frame
    cameras  of the marked views by name, in the file's frame
    """

    def __init__(self, orbit: OrbitCamera, size: tuple[int, int], upright: np.ndarray, cameras: dict[str, Camera]):
        self.orbit, self.size, self._upright, self.cameras = orbit, size, upright, dict(cameras)

    @property
    def camera(self) -> Camera:
        """The free camera in the frame of the file."""
        camera = self.orbit.camera(*self.size)
        return replace(camera, world_to_camera=camera.world_to_camera @ self._upright)

    def shown(self) -> str | None:
        """The view that was marked from here, if there is one."""
        here = self.camera
        for name, camera in self.cameras.items():
            lenses = ([c.width, c.height, c.fx, c.fy, c.cx, c.cy] for c in (camera, here))
            if np.allclose(*lenses) and np.allclose(camera.world_to_camera, here.world_to_camera, atol=1e-6):
                return name
        return None

    def named(self) -> str:
        """Name of the view from here, a new one if it has none."""
        name = self.shown()
        if name is None:
            name = free_name("view", self.cameras)
            self.cameras[name] = self.camera
        return name

    def go_to(self, view: str) -> None:
        """Look from where a view was marked; its roll is ignored."""
        pose = self.cameras[view].world_to_camera @ self._upright.T
        eye = -pose[:3, :3].T @ pose[:3, 3]
        self.orbit.look_from(eye, eye + self.orbit.distance * pose[2, :3])
        if np.allclose(look_at(*self.orbit.view), pose, atol=1e-6):
            self.cameras[view] = replace(self.cameras[view], world_to_camera=self.camera.world_to_camera)
