"""The desktop display: a window, a camera moved by mouse and keys, a hand made of the mouse."""

from __future__ import annotations

from collections.abc import Iterator
from time import perf_counter

from imgui_bundle import imgui

from core.camera import project
from core.errors import Cancelled
from core.vocabulary import BodyState
from display.adaptive_resolution import WindowResolution
from display.clock import caught_up
from display.edit.selection_marker import COLOUR, marked, marker_lines, scaled
from display.panel import GIZMO_BUTTON, Panel
from display.preferences import Preferences
from display.protocol import Display, Frame, WorldView
from display.user_commands import Command, ViewFiles
from display.window.controls import HOVER_OPACITY, ROOM_GIZMO, Controls
from display.window.dialogs import LengthDialog, OpenDialog, SceneMenu, UpChoice
from display.window.gl_context import PictureTexture
from display.window.gl_window import GLWindow
from display.window.overlay import FirstHint, Gizmo, draw_lines, measuring_lines, text_box
from display.window.panel_drawer import PanelDrawer
from display.window.widgets import ACCENT, FILMING, MARGIN, QUIET, TITLE_SIZE
from scenes.scene import Scene

MAX_STEP = 1 / 20  # [s] of simulation at once
RESIZE_DELAY = 0.2  # [s] without a change of the window's size before the world draws in the new one
DEFAULT_SIZE = (960, 540)  # in screen coordinates


class Window(Display):
    """A display: `for frame in window.frames(world): world.step(frame); window.present(world)`.

    size         (width, height) in screen coordinates; None: that of the preferences. The attribute is the picture's
    preferences  keep size, place, panel, and the views of the scene of that `name` from one start to the next
    hint         the first picture says how to begin

    Raises BadInput without a display or OpenGL 3.3. Close it (or use it in a `with`), so that the screen is given back.
    """

    def __init__(
        self,
        scene: Scene,
        *,
        title: str = "VR-GS",
        size: tuple[int, int] | None = None,
        preferences: Preferences | None = None,
        name: str = "",
        hint: bool = True,
    ):
        self._preferences = preferences or Preferences()
        self._surface = GLWindow(title, *(size or DEFAULT_SIZE))
        self._opened = self._restore(asked=size is not None)
        self._texture = PictureTexture(self._surface.gl)
        self._menu, self._open_dialog = SceneMenu(self._surface.gl), OpenDialog(self._preferences)
        self._up_choice, self._length_dialog = UpChoice(self._surface.gl), LengthDialog()
        opened = self._preferences.get("panel.sections", dict[str, bool], {})
        self._panel = PanelDrawer(title, self._surface.scale, Panel(gizmo=True), opened)
        self._gizmo, self._hint = Gizmo(), FirstHint() if hint else None
        self._resolution = WindowResolution()
        self._controls = Controls(scene, self._preferences, name, self._open_dialog)
        self._controls.panel = self._preferences.get("panel.open", bool, True)
        self._controls.update_camera(self.size)
        self._moved = True  # the camera, in the last frame
        self._time = 0.0  # [s] of all frames
        self._busy = False  # does anything move
        self._dropped = 0.0  # [s] that have passed and were never simulated
        self._commands: list[Command] = []  # from the panel, for the next frame
        self._resized: tuple[tuple[int, int], float] = (self._surface.frame_size, 0.0)  # the window's size, since when
        self.loading(f"Loading {title}")

    def close(self) -> None:
        """Close the window. Further calls do nothing."""
        self._remember()
        self._surface.close()

    def _restore(self, *, asked: bool) -> dict:
        """Give the window its remembered place, and its size unless another is asked for; returns what it has then."""
        maximized = not asked and self._preferences.get("window.maximized", bool, False)
        size = None if asked else self._preferences.get("window.size", tuple[float, float])
        self._surface.restore(size, self._preferences.get("window.place", tuple[float, float]), maximized)
        return self._surface.geometry()

    def _remember(self) -> None:
        """Note what the user has changed about the window, for the next one."""
        if self._surface.handle is None:
            return
        for key, value in self._surface.geometry().items():
            if value != self._opened.get(key):
                self._preferences.set(f"window.{key}", value)
        self._preferences.set("panel.open", self._controls.panel)
        self._preferences.set("panel.sections", dict(self._panel.opened))

    @property
    def size(self) -> tuple[int, int]:
        """(width, height) [px] of the picture that fits the window now."""
        return self._resolution.size(self._surface.frame_size, self._panel.panel.scale)

    def loading(self, text: str, picture=None) -> None:
        """Show a line of text during a long operation, over a picture or the last one; the window is empty before.

        Raises Cancelled if Esc was pressed or the window closed.
        """
        if picture is not None:
            self._texture.upload(picture)
        events = self._surface.begin()
        imgui.push_font(None, TITLE_SIZE)
        if text:
            text_box("loading", [[(text, QUIET)]], 0.0, gap=0.0, height=0.5)
        imgui.pop_font()
        self._draw_picture()
        self._surface.end()
        self._surface.swap()
        if self._surface.closing or ("key", "escape", True) in events:
            raise Cancelled(quits=self._surface.closing)

    def show_scene(self, scene: Scene, title: str, name: str) -> None:
        """Show this scene from now on, from where it begins; `frames` is then called again, with its world."""
        self._surface.set_title(title)
        self._panel.title = title
        self._controls.show_scene(scene, name)
        self._commands = []

    def frames(self, world: WorldView) -> Iterator[Frame]:
        """Frames in real time until the user quits; slower where that cannot be kept up (display/clock.py)."""
        last, controls = perf_counter(), self._controls
        while not (controls.quit or self._surface.closing):
            if self._surface.asleep():
                world.timings.rest()
                last = perf_counter()
                continue
            events = self._surface.begin()
            now = perf_counter()
            seconds, last = now - last, now
            dt, dropped = (0.0, 0.0) if self._asks else caught_up(seconds, world.simulation_cost)
            self._dropped += dropped
            drawing = world.timings.latest("shadow", "render", "present")
            self._busy = self._moved or world.moving
            self._resolution.note(now, seconds, drawing, moving=self._busy)
            self._resize(now, world)
            commands = self._handle(events, world)
            hands = controls.hands(dt, commands, world)
            self._time += dt
            self._moved = controls.update_camera(self._surface.frame_size)
            camera = controls.camera.resized(*world.picture_size)
            yield Frame(dt, self._time, [camera], hands, commands, max_step=MAX_STEP)

    def present(self, world: WorldView) -> None:
        """Show the world's picture, and the panel over it."""
        with world.timings.stage("present"):
            self._texture.upload(world.picture)
            self._draw_picture()
            controls, panel = self._controls, self._panel
            lines = [*world.lines(), *measuring_lines(controls.measured, controls.orbit.eye)]
            draw_lines(lines, self._controls.camera, self._from_picture, self._surface.scale)
            panel.help = controls.help
            self._commands = panel.draw(world, visible=controls.panel) + self._draw_gizmo(world)
            controls.help = panel.help
            self._commands += self._draw_dialogs(world)
            if panel.pressed == GIZMO_BUTTON.name:
                controls.show_next_gizmo()
            if controls.drag == "grab":
                self._draw_hand()
            else:
                self._draw_markers(world)
            if self._hint is not None:
                self._hint.draw(
                    world, panel.right, done=world.demo or controls.drag == ("grab" if world.editable else "turn")
                )
            if world.film_seconds is not None:
                self._draw_film_mark(world.film_seconds)
            self._surface.end()
        self._surface.swap()
        world.timings.exact = self._panel.details
        world.timings.frame(missed=None if self._busy else 0, dropped=self._dropped)  # at rest nobody misses a picture

    def _draw_dialogs(self, world: WorldView) -> list[Command]:
        """Draw the menu of scenes or the dialog of files, and what else is asked; returns what was chosen there."""
        controls, dialog = self._controls, self._open_dialog
        if controls.asks_file:
            controls.asks_file = False
            dialog.ask()
        controls.menu = controls.menu and not dialog.shown
        chosen = self._menu.draw() if controls.menu else []
        controls.menu = controls.menu and not chosen
        measured, over = self._length_dialog.draw(controls.measured)
        if over:
            controls.measured = None
        return [*chosen, *dialog.draw(), *self._up_choice.draw(world), *measured]

    @property
    def _asks(self) -> bool:
        """True while a dialog or a text field has the keys; the world waits then, and does not slow the typing."""
        controls, typing = self._controls, imgui.get_io().want_text_input
        return typing or controls.menu or self._open_dialog.shown or len(controls.measured or ()) == 2

    def _resize(self, now: float, world: WorldView) -> None:
        """Let the world draw in the size that is wanted; a window's new size must be stable first, until then
        pictures are stretched."""
        window = self._surface.frame_size
        if self._resized[0] != window:
            self._resized = (window, now)
        elif now - self._resized[1] > RESIZE_DELAY and world.picture_size != self.size:
            world.resize(*self.size)

    def _handle(self, events: list[tuple], world: WorldView) -> list[Command]:
        io, controls = imgui.get_io(), self._controls
        listing = imgui.is_popup_open("", imgui.PopupFlags_.any_popup)  # a list that is open has the keys
        closing = () if io.want_text_input or listing else ("escape", "f2") if controls.menu else ("escape",)
        commands, self._commands = self._commands, []
        controls.note(commands)
        for kind, *what in events:
            if kind == "move":
                controls.move(*self._to_picture(*what))
            elif kind == "button":
                name, down, *position = what
                controls.cursor = self._to_picture(*position)
                if not down:
                    controls.release(name)
                elif not (io.want_capture_mouse or self._gizmo.over):
                    controls.press(name, world)
            elif kind == "wheel" and not io.want_capture_mouse:
                controls.wheel(*what)
            elif kind == "key" and not (what[1] and (self._asks or listing) and what[0] not in closing):
                commands += controls.key(*what, world)
            elif kind == "drop" and world.editable:
                self._open_dialog.offer(*what)
            elif kind == "drop":
                commands.append(ViewFiles(tuple(*what)))
            elif kind == "blur":
                controls.let_go()
        return controls.completed(commands, self._surface.frame_size, world)

    def _draw_picture(self) -> None:
        """Let the picture cover the window, whatever its size: it is drawn for the window's shape."""
        self._texture.draw(self._surface.frame_size, (0, 0, *self._surface.frame_size))

    def _to_picture(self, x: float, y: float) -> tuple[float, float]:
        (width, height), camera = self._surface.window_size, self._controls.camera
        return x / width * camera.width, y / height * camera.height

    def _from_picture(self, at: tuple[float, float]) -> tuple[float, float]:
        (width, height), camera = self._surface.window_size, self._controls.camera
        return at[0] / camera.width * width, at[1] / camera.height * height

    def _draw_gizmo(self, world: WorldView) -> list[Command]:
        """Draw the gizmo of the selected body, or of the room; its commands."""
        kind, k, bodies = self._controls.gizmo, world.selected, world.bodies()
        camera, area = self._controls.camera, (0, 0, *self._surface.window_size)
        if kind == ROOM_GIZMO and world.room_middle is not None:
            return self._gizmo.draw("turn", world.room_middle, None, camera, area)
        if kind in (None, ROOM_GIZMO) or k is None or k >= len(bodies) or bodies[k].held:
            self._gizmo.hide()
            return []
        commands = self._gizmo.draw(kind, bodies[k].centroid, k, camera, area)
        if self._gizmo.scaling != 1.0:
            self._draw_marker(scaled(bodies[k], self._gizmo.scaling))
        return commands

    def _draw_markers(self, world: WorldView) -> None:
        """Draw corners around the body that is to be marked, and fainter ones around that under the cursor."""
        body = marked(world, near=self._panel.edits)
        over = imgui.is_mouse_pos_valid() and not (imgui.get_io().want_capture_mouse or self._gizmo.over)
        under = self._controls.hovered(world, over=over, moving=self._busy)
        if body is not None:
            self._draw_marker(body)
        if under is not None and under is not body:
            self._draw_marker(under, HOVER_OPACITY)

    def _draw_marker(self, body: BodyState, strength: float = 1.0) -> None:
        draw_list, scale = imgui.get_background_draw_list(), self._surface.scale
        for start, end, opacity in marker_lines(body, self._controls.camera):
            a, b, opacity = self._from_picture(start), self._from_picture(end), strength * opacity
            for colour, width in (((0.0, 0.0, 0.0, 0.35 * opacity), 4.0), ((*COLOUR, opacity), 2.0)):
                draw_list.add_line(a, b, imgui.get_color_u32(colour), width * scale)

    def _draw_film_mark(self, seconds: float) -> None:
        """Draw a red dot and the film's length in the lower right corner, which notices leave free."""
        text, scale = f"{int(seconds) // 60}:{int(seconds) % 60:02d}", self._surface.scale
        draw_list, extent = imgui.get_foreground_draw_list(), imgui.calc_text_size(text)
        area, edge = imgui.get_io().display_size, 2 * MARGIN * scale
        left, middle = area.x - extent.x - edge, area.y - edge
        low, high = (left - 26 * scale, middle - extent.y), (left + extent.x + 8 * scale, middle + extent.y)
        draw_list.add_rect_filled(low, high, imgui.get_color_u32((0.0, 0.0, 0.0, 0.6)), 6 * scale)
        draw_list.add_circle_filled((left - 12 * scale, middle), 6 * scale, imgui.get_color_u32(FILMING))
        draw_list.add_text((left, middle - 0.5 * extent.y), imgui.get_color_u32((1.0, 1.0, 1.0, 1.0)), text)

    def _draw_hand(self) -> None:
        at = project(self._controls.camera, self._controls.hand.position)
        if at is None:
            return
        at = self._from_picture(at)
        draw_list, scale = imgui.get_background_draw_list(), self._surface.scale
        draw_list.add_circle(at, 9 * scale, imgui.get_color_u32((0.0, 0.0, 0.0, 0.5)), 0, 4 * scale)
        draw_list.add_circle(at, 9 * scale, imgui.get_color_u32(ACCENT), 0, 2 * scale)
        imgui.set_mouse_cursor(imgui.MouseCursor_.hand)
