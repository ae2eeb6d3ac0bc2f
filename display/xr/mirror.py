"""Where OpenGL runs: in the mirror on the desktop, or, where there is no X server, on nothing but EGL."""

from __future__ import annotations

import ctypes

from core.errors import BadInput
from display.picture import PictureTexture
from display.protocol import Command, WorldView
from display.window.gl_context import context_of
from display.window.gl_window import INSTEAD, GLWindow, has_display
from display.window.panel import Panel
from scenes.scene import Scene

# Registry of EGL enums.
SURFACELESS_PLATFORM, OPENGL_API = 0x31DD, 0x30A2
RED, GREEN, BLUE, SURFACE_TYPE, RENDERABLE_TYPE, OPENGL_BIT, NONE = 0x3024, 0x3023, 0x3022, 0x3033, 0x3040, 0x8, 0x3038
MAJOR, MINOR, PROFILE, CORE = 0x3098, 0x30FB, 0x30FD, 0x1
VERSION = (4, 5)


class Mirror:
    """A window that shows what the left eye sees, and the panel. `gl` is its context (moderngl)."""

    egl = None

    def __init__(self, scene: Scene, title: str, width: int, height: int, views: int):
        self._surface = GLWindow(title, width, height, vsync=False)  # the headset sets the pace
        self.gl = self._surface.gl
        self.texture = PictureTexture(self.gl, views=views)
        self._panel = Panel(scene, title, self._surface.scale)

    @property
    def closing(self) -> bool:
        """Has the user asked to close the window?"""
        return self._surface.closing

    @property
    def share(self) -> float | None:
        """Of a side of the headset's pictures, as the user has chosen; None: as many pixels as hold the rate."""
        return self._panel.resolution

    def show(self, world: WorldView | None) -> list[Command]:
        """Draw the picture that was last uploaded; the panel's commands. `world` may be None yet."""
        self._surface.begin()
        self.texture.draw(self._surface.frame_size)
        commands = self._panel.draw(world, visible=True) if world is not None else []
        self._surface.end()
        self._surface.swap()
        return commands

    def close(self) -> None:
        """Close the window. Further calls do nothing."""
        self._surface.close()


class NoMirror:
    """OpenGL without a window, through EGL's surfaceless platform (EGL_MESA_platform_surfaceless)."""

    closing, share = False, None

    def __init__(self, views: int):
        try:
            self.egl = Egl()
        except OSError as e:
            raise BadInput(f"no display to open a window on, and no EGL to do without; {INSTEAD}") from e
        self.gl = self.egl.gl
        self.texture = PictureTexture(self.gl, views=views)

    def show(self, world: WorldView | None) -> list[Command]:
        """There is nothing to show it on."""
        return []

    def close(self) -> None:
        """Give the context back. Further calls do nothing."""
        self.egl.close()


class Egl:
    """A current OpenGL context without a surface. `library`, `display`, `config`, `context` are EGL's."""

    def __init__(self):
        self.library = egl = ctypes.CDLL("libEGL.so.1")
        pointer = ctypes.c_void_p
        for name in ("eglGetPlatformDisplay", "eglCreateContext", "eglGetProcAddress"):
            getattr(egl, name).restype = pointer
        self.display = pointer(egl.eglGetPlatformDisplay(SURFACELESS_PLATFORM, pointer(0), pointer(0)))
        if not egl.eglInitialize(self.display, pointer(0), pointer(0)):
            raise BadInput(f"no display to open a window on, and EGL does not start; {INSTEAD}")
        wanted = (SURFACE_TYPE, 1, RED, 8, GREEN, 8, BLUE, 8, RENDERABLE_TYPE, OPENGL_BIT, NONE)
        self.config, count = pointer(), ctypes.c_int()
        chosen = egl.eglChooseConfig(
            self.display, (ctypes.c_int * len(wanted))(*wanted), ctypes.byref(self.config), 1, ctypes.byref(count)
        )
        egl.eglBindAPI(OPENGL_API)
        attributes = (MAJOR, VERSION[0], MINOR, VERSION[1], PROFILE, CORE, NONE)
        self.context = pointer(
            egl.eglCreateContext(self.display, self.config, pointer(0), (ctypes.c_int * len(attributes))(*attributes))
        )
        current = self.context and egl.eglMakeCurrent(self.display, pointer(0), pointer(0), self.context)
        if not (chosen and count.value and current):
            raise BadInput(f"no display to open a window on, and no OpenGL {VERSION[0]}.{VERSION[1]} in EGL; {INSTEAD}")
        self.gl = context_of(lambda name: egl.eglGetProcAddress(name.encode()))

    def close(self) -> None:
        """Give the context back. Further calls do nothing."""
        if self.display is not None:
            self.gl.release()
            nothing = ctypes.c_void_p(0)
            self.library.eglMakeCurrent(self.display, nothing, nothing, nothing)
            self.library.eglDestroyContext(self.display, self.context)
            self.library.eglTerminate(self.display)
            self.display = None


def mirror(scene: Scene, title: str, size: tuple[int, int], views: int) -> Mirror | NoMirror:
    """The window where there is a screen for it, else none."""
    return Mirror(scene, title, *size, views) if has_display() else NoMirror(views)
