"""OpenGL contexts (moderngl): for a context made current elsewhere, or without a surface through EGL."""

from __future__ import annotations

import ctypes
from collections.abc import Callable

from core.errors import BadInput

NO_DISPLAY = "no display to open a window on"
HEADLESS_INSTEAD = "run with --headless instead"

# Registry of EGL enums.
SURFACELESS_PLATFORM, OPENGL_API = 0x31DD, 0x30A2
RED, GREEN, BLUE, SURFACE_TYPE, RENDERABLE_TYPE, OPENGL_BIT, NONE = 0x3024, 0x3023, 0x3022, 0x3033, 0x3040, 0x8, 0x3038
MAJOR, MINOR, PROFILE, CORE = 0x3098, 0x30FB, 0x30FD, 0x1
OPENGL_VERSION = (4, 5)


def context_of(address: Callable[[str], int | None]):
    """A moderngl context of the current OpenGL context.

    `address` finds OpenGL's functions by their names, on every platform alike. It is kept as the context's `extra`.
    """
    import moderngl

    class Loader:
        """The interface that moderngl asks of a context."""

        def load_opengl_function(self, name: str) -> int:
            return address(name) or 0

        def __enter__(self):
            return self

        def __exit__(self, *error):
            pass

        def release(self):
            pass

    moderngl.init_context(Loader())
    context = moderngl.get_context()
    context.extra = address
    return context


class EglContext:
    """A current OpenGL context `gl` without a surface (EGL_MESA_platform_surfaceless).

    `library`, `display`, `config`, `context` are EGL's. Raises BadInput where there is no EGL.
    """

    def __init__(self):
        try:
            self.library = egl = ctypes.CDLL("libEGL.so.1")
        except OSError as e:
            raise BadInput(f"{NO_DISPLAY}, and no EGL to do without; {HEADLESS_INSTEAD}") from e
        pointer = ctypes.c_void_p
        for function in (egl.eglGetPlatformDisplay, egl.eglCreateContext, egl.eglGetProcAddress):
            function.restype = pointer
        self.display = pointer(egl.eglGetPlatformDisplay(SURFACELESS_PLATFORM, pointer(0), pointer(0)))
        if not egl.eglInitialize(self.display, pointer(0), pointer(0)):
            raise BadInput(f"{NO_DISPLAY}, and EGL does not start; {HEADLESS_INSTEAD}")
        wanted = (SURFACE_TYPE, 1, RED, 8, GREEN, 8, BLUE, 8, RENDERABLE_TYPE, OPENGL_BIT, NONE)
        self.config, count = pointer(), ctypes.c_int()
        chosen = egl.eglChooseConfig(
            self.display, (ctypes.c_int * len(wanted))(*wanted), ctypes.byref(self.config), 1, ctypes.byref(count)
        )
        egl.eglBindAPI(OPENGL_API)
        attributes = (MAJOR, OPENGL_VERSION[0], MINOR, OPENGL_VERSION[1], PROFILE, CORE, NONE)
        self.context = pointer(
            egl.eglCreateContext(self.display, self.config, pointer(0), (ctypes.c_int * len(attributes))(*attributes))
        )
        current = self.context and egl.eglMakeCurrent(self.display, pointer(0), pointer(0), self.context)
        if not (chosen and count.value and current):
            raise BadInput(
                f"{NO_DISPLAY}, and no OpenGL {OPENGL_VERSION[0]}.{OPENGL_VERSION[1]} in EGL; {HEADLESS_INSTEAD}"
            )
        self.gl = context_of(lambda name: egl.eglGetProcAddress(name.encode()))

    def close(self) -> None:
        """Destroy the context. Further calls do nothing."""
        if self.display is not None:
            self.gl.release()
            nothing = ctypes.c_void_p(0)
            self.library.eglMakeCurrent(self.display, nothing, nothing, nothing)
            self.library.eglDestroyContext(self.display, self.context)
            self.library.eglTerminate(self.display)
            self.display = None
