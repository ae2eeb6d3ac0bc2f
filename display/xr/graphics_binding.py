"""How a runtime is told of our OpenGL context: through GLX, WGL, or EGL where there is no X server."""

from __future__ import annotations

import ctypes
import sys

from core.errors import BadInput

GLX_FBCONFIG_ID, GLX_SCREEN, GLX_VISUAL_ID = 0x8013, 0x800C, 0x800B  # registry of GLX enums


def extensions(window: bool) -> list[str]:
    """Instance extensions without which no picture can be handed over, with a window or without."""
    return ["XR_KHR_opengl_enable", *([] if window else ["XR_MNDX_egl_enable"])]


def requirements(runtime) -> tuple[int, int]:
    """Lowest OpenGL version (major, minor) that the runtime takes; must be asked for before a session."""
    xr = runtime.xr
    address = xr.get_instance_proc_addr(runtime.instance, "xrGetOpenGLGraphicsRequirementsKHR")
    ask = ctypes.cast(address, xr.PFN_xrGetOpenGLGraphicsRequirementsKHR)
    answer = xr.GraphicsRequirementsOpenGLKHR()
    result = xr.check_result(ask(runtime.instance, runtime.system, ctypes.byref(answer)))
    if result.is_exception():
        raise result
    version = xr.Version(answer.min_api_version_supported)
    return version.major, version.minor


def check(runtime, gl) -> None:
    """BadInput if the current context (moderngl) is older than what the runtime takes."""
    need, have = requirements(runtime), divmod(gl.version_code, 100)
    have = (have[0], have[1] // 10)
    if have < need:
        raise BadInput(
            f"--xr: {runtime.name} needs OpenGL {need[0]}.{need[1]}, this machine's driver has {have[0]}.{have[1]}"
        )


def binding(xr, egl):
    """The structure that names the current OpenGL context to the runtime; `egl` is None with a window."""
    if egl is not None:
        return egl_binding(xr, egl)
    if sys.platform == "win32":
        return windows_binding(xr)
    return glx_binding(xr)


def glx_binding(xr):
    """Display, FBConfig, visual, drawable and context of GLX, as XR_KHR_opengl_enable wants them."""
    gl = ctypes.CDLL("libGL.so.1")
    for name in ("glXGetCurrentDisplay", "glXGetCurrentContext", "glXChooseFBConfig"):
        getattr(gl, name).restype = ctypes.c_void_p
    gl.glXGetCurrentDrawable.restype = ctypes.c_ulong
    display, context = ctypes.c_void_p(gl.glXGetCurrentDisplay()), ctypes.c_void_p(gl.glXGetCurrentContext())
    number, screen, count, visual = (ctypes.c_int() for _ in range(4))
    gl.glXQueryContext(display, context, GLX_FBCONFIG_ID, ctypes.byref(number))
    gl.glXQueryContext(display, context, GLX_SCREEN, ctypes.byref(screen))
    wanted = (ctypes.c_int * 3)(GLX_FBCONFIG_ID, number.value, 0)
    found = gl.glXChooseFBConfig(display, screen, wanted, ctypes.byref(count))
    config = ctypes.cast(found, ctypes.POINTER(ctypes.c_void_p))[0] if found and count.value else None
    if config:
        gl.glXGetFBConfigAttrib(display, ctypes.c_void_p(config), GLX_VISUAL_ID, ctypes.byref(visual))
    b = xr.GraphicsBindingOpenGLXlibKHR()
    kinds = dict(b._fields_)
    b.x_display = ctypes.cast(display, kinds["x_display"])
    b.visualid = visual.value
    b.glx_fbconfig = ctypes.cast(ctypes.c_void_p(config), kinds["glx_fbconfig"])
    b.glx_drawable = gl.glXGetCurrentDrawable()
    b.glx_context = ctypes.cast(context, kinds["glx_context"])
    return b


def egl_binding(xr, egl):
    """Display, config and context of EGL, as XR_MNDX_egl_enable wants them."""
    b = xr.GraphicsBindingEGLMNDX()
    kinds = dict(b._fields_)
    for name in ("display", "config", "context"):
        setattr(b, name, ctypes.cast(getattr(egl, name), kinds[name]))
    b.get_proc_address = ctypes.cast(egl.library.eglGetProcAddress, xr.PFN_xrEglGetProcAddressMNDX)
    return b


def windows_binding(xr):
    """Device context and rendering context of WGL, as XR_KHR_opengl_enable wants them."""
    wgl = ctypes.windll.opengl32
    wgl.wglGetCurrentDC.restype = wgl.wglGetCurrentContext.restype = ctypes.c_void_p
    return xr.GraphicsBindingOpenGLWin32KHR(h_dc=wgl.wglGetCurrentDC(), h_glrc=wgl.wglGetCurrentContext())
