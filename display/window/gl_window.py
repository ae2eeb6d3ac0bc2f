"""A desktop window (GLFW) with OpenGL 3.3, a queue of its events, and ImGui. Knows nothing of worlds."""

from __future__ import annotations

import ctypes
import os
import sys

from core.errors import BadInput
from display.window.gl_context import HEADLESS_INSTEAD, NO_DISPLAY, context_of
from display.window.key_bindings import PLACES, chord_name


def import_libraries():
    """GLFW and ImGui, which names the GLFW library that both then use; servers may lack what they need."""
    from imgui_bundle import imgui
    import glfw  # isort: skip

    return glfw, imgui


def has_display() -> bool:
    """True if this process can open a window."""
    if sys.platform.startswith("linux") and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        return False
    glfw, _ = import_libraries()
    glfw.set_error_callback(lambda code, text: None)  # the answer says enough
    if sys.platform.startswith("linux") and os.environ.get("DISPLAY"):
        glfw.init_hint(glfw.PLATFORM, glfw.PLATFORM_X11)  # also under Wayland: it draws no frame without libdecor
    return bool(glfw.init())


class GLWindow:
    """One open window; `gl` is its context (moderngl). Raises BadInput without a display or without OpenGL 3.3.

    Events are ("key", name, down), ("button", "left"|"right"|"middle", down, x, y), ("move", x, y),
    ("wheel", notches), ("drop", paths) and ("blur",), positions in screen coordinates (not pixels on every platform).
    """

    def __init__(self, title: str, width: int, height: int, *, vsync: bool = True):
        if not has_display():
            raise BadInput(f"{NO_DISPLAY}; {HEADLESS_INSTEAD}")
        self.glfw, self.imgui = glfw, _ = import_libraries()
        errors: list[str] = []
        glfw.set_error_callback(lambda code, text: errors.append(text.decode(errors="replace")))
        for hint, value in {
            glfw.CONTEXT_VERSION_MAJOR: 3,
            glfw.CONTEXT_VERSION_MINOR: 3,
            glfw.OPENGL_PROFILE: glfw.OPENGL_CORE_PROFILE,
            glfw.OPENGL_FORWARD_COMPAT: True,
            glfw.SCALE_TO_MONITOR: True,
        }.items():
            glfw.window_hint(hint, value)
        self.handle = glfw.create_window(width, height, title, None, None)
        if not self.handle:
            glfw.terminate()
            raise BadInput(f"no window with OpenGL 3.3 ({'; '.join(errors) or 'no reason given'}); {HEADLESS_INSTEAD}")
        glfw.make_context_current(self.handle)
        glfw.swap_interval(1 if vsync else 0)
        glfw.set_window_size_limits(self.handle, 320, 240, glfw.DONT_CARE, glfw.DONT_CARE)
        self._events: list[tuple] = []
        self._listen()
        self.gl = context_of(glfw.get_proc_address)
        self.scale = self._start_imgui()

    def _listen(self) -> None:
        """Queue the events: they are handled in order, once a frame, when ImGui knows what the cursor is over."""
        glfw, add = self.glfw, self._events.append
        buttons = {glfw.MOUSE_BUTTON_LEFT: "left", glfw.MOUSE_BUTTON_RIGHT: "right", glfw.MOUSE_BUTTON_MIDDLE: "middle"}
        keys = {getattr(glfw, f"KEY_{name.upper()}"): name for name in PLACES}
        keys |= {glfw.KEY_LEFT_SHIFT: "shift", glfw.KEY_RIGHT_SHIFT: "shift"}
        keys |= {glfw.KEY_KP_ADD: "plus", glfw.KEY_KP_SUBTRACT: "minus", glfw.KEY_KP_ENTER: "enter"}

        def key(window, code, scancode, action, mods):
            if action == glfw.REPEAT:
                return
            printed = (glfw.get_key_name(code, scancode) or "").lower()
            down, ctrl = action == glfw.PRESS, mods & (glfw.MOD_CONTROL | glfw.MOD_SUPER)
            name = chord_name(keys.get(code), printed, down=down, ctrl=bool(ctrl))
            if name is not None:
                add(("key", name, down))

        cursor = glfw.get_cursor_pos(self.handle)  # as of the last event: by now it may be elsewhere

        def move(window, x, y):
            nonlocal cursor
            cursor = (x, y)
            add(("move", x, y))

        def button(window, code, action, mods):
            if code in buttons:
                add(("button", buttons[code], action == glfw.PRESS, *cursor))

        def focus(window, focused):
            if not focused:
                add(("blur",))

        glfw.set_key_callback(self.handle, key)
        glfw.set_mouse_button_callback(self.handle, button)
        glfw.set_cursor_pos_callback(self.handle, move)
        glfw.set_scroll_callback(self.handle, lambda window, dx, dy: add(("wheel", dy)))
        glfw.set_window_focus_callback(self.handle, focus)
        glfw.set_drop_callback(self.handle, lambda window, paths: add(("drop", list(paths))))

    def _start_imgui(self) -> float:
        """Start ImGui; its callbacks call ours in turn. Returns the scale of text and widgets, 1 as usual."""
        self.imgui.create_context()
        self.imgui.get_io().set_ini_filename("")  # no settings file in the working directory
        self.imgui.backends.glfw_init_for_opengl(ctypes.cast(self.handle, ctypes.c_void_p).value, True)
        self.imgui.backends.opengl3_init("#version 330")
        pixels = self.frame_size[0] / max(self.window_size[0], 1)  # 2 on a Retina screen, else 1
        return self.glfw.get_window_content_scale(self.handle)[0] / pixels

    @property
    def frame_size(self) -> tuple[int, int]:
        """(width, height) of the framebuffer [px]; (0, 0) while minimised on some systems."""
        return self.glfw.get_framebuffer_size(self.handle)

    @property
    def window_size(self) -> tuple[int, int]:
        """(width, height) in screen coordinates."""
        return self.glfw.get_window_size(self.handle)

    def set_title(self, title: str) -> None:
        """Show another title."""
        self.glfw.set_window_title(self.handle, title)

    @property
    def closing(self) -> bool:
        """True once the user has asked to close the window."""
        return bool(self.glfw.window_should_close(self.handle))

    def stay(self) -> None:
        """Ignore the user's request to close the window."""
        self.glfw.set_window_should_close(self.handle, False)

    def geometry(self) -> dict:
        """Placement for `restore`: "size" and "place" in screen coordinates, or "maximized" alone."""
        if self.glfw.get_window_attrib(self.handle, self.glfw.MAXIMIZED):
            return {"maximized": True}
        return {"size": [*self.window_size], "place": [*self.glfw.get_window_pos(self.handle)], "maximized": False}

    def restore(self, size, place, maximized: bool) -> None:
        """Give the window the size, place (None: as it is) and state that it had, as far as a screen shows them."""
        areas = [self.glfw.get_monitor_workarea(monitor) for monitor in self.glfw.get_monitors()]
        width = (size or self.window_size)[0]
        shown = place and [a for a in areas if covers(a, place[0] + width / 2, place[1])]
        if size is not None and areas:
            _, _, wide, high = (shown or areas)[0]
            self.glfw.set_window_size(self.handle, min(int(size[0]), wide), min(int(size[1]), high))
        if shown:
            self.glfw.set_window_pos(self.handle, int(place[0]), int(place[1]))
        if maximized:
            self.glfw.maximize_window(self.handle)

    def asleep(self) -> bool:
        """True while the window is minimised; waits briefly in that case."""
        if self.glfw.get_window_attrib(self.handle, self.glfw.ICONIFIED) or 0 in self.frame_size:
            self.glfw.wait_events_timeout(0.1)
            return True
        return False

    def begin(self) -> list[tuple]:
        """Begin a frame: the events since the last one. ImGui calls are allowed until `end`."""
        self.glfw.poll_events()
        events = self._events.copy()
        self._events.clear()
        self.imgui.backends.opengl3_new_frame()
        self.imgui.backends.glfw_new_frame()
        self.imgui.new_frame()
        return events

    def end(self) -> None:
        """Draw ImGui's part over what was drawn. `swap` shows it."""
        self.imgui.render()
        self.imgui.backends.opengl3_render_draw_data(self.imgui.get_draw_data())

    def swap(self) -> None:
        """Show the frame; waits for the screen with vsync."""
        self.glfw.swap_buffers(self.handle)

    def close(self) -> None:
        """Close the window. Further calls do nothing."""
        if self.handle is None:
            return
        self.imgui.backends.opengl3_shutdown()
        self.imgui.backends.glfw_shutdown()
        self.imgui.destroy_context()
        self.gl.release()
        self.glfw.destroy_window(self.handle)
        self.glfw.terminate()
        self.handle = None


def covers(area: tuple[int, int, int, int], x: float, y: float) -> bool:
    """True if a point lies in an area (left, top, width, height)."""
    return area[0] <= x < area[0] + area[2] and area[1] <= y < area[1] + area[3]
