"""The OpenXR runtime: instance, extensions, the headset's system and the OpenGL graphics binding.

Everything that must be known before a session begins. Knows nothing of worlds.
"""

from __future__ import annotations

import contextlib
import ctypes
import os
import sys
import time

from core.errors import BadInput
from display.xr import hand_tracking
from display.xr.swapchains import DEPTH_EXTENSION

WINDOW_INSTEAD = "leave out --xr to play in a window"
TIMESPEC_EXTENSION = "XR_KHR_convert_timespec_time"
HEADSET_TIMEOUT = 30.0  # [s] to wait for a headset that the runtime reports as not connected yet
GLX_FBCONFIG_ID, GLX_SCREEN, GLX_VISUAL_ID = 0x8013, 0x800C, 0x800B  # registry of GLX enums


def import_xr():
    """Import the module xr; BadInput names the missing package."""
    os.environ.setdefault("XR_LOADER_DEBUG", "none")  # the loader's complaints are reported here, in one line
    try:
        import xr
    except ImportError as e:
        raise BadInput(f"--xr: {e.name} is not installed; run `make play` once, or {WINDOW_INSTEAD}") from e
    except OSError as e:  # the loader's library does not open here
        raise BadInput(f"--xr: the OpenXR loader does not start on this system ({e}); {WINDOW_INSTEAD}") from e
    return xr


class OpenXrRuntime:
    """One OpenXR instance and the headset's system. Raises BadInput with one clear line.

    It takes pictures of a desktop window's OpenGL context, or not `windowed`, of an EGL one; `depth`: with their depth,
    if it can. `timeout` [s] for a headset that is not connected yet. `view_sizes` are the recommended (width, height)
    [px] of the eyes, `enabled` the names of the enabled extensions. `tracks_hands`: XR_EXT_hand_tracking is supported.
    """

    def __init__(self, *, windowed: bool, timeout: float, depth: bool = True):
        self.xr = xr = import_xr()
        self.instance = None
        required = ["XR_KHR_opengl_enable", *([] if windowed else ["XR_MNDX_egl_enable"])]
        optional = [TIMESPEC_EXTENSION, hand_tracking.EXTENSION, *([DEPTH_EXTENSION] if depth else [])]
        try:
            offered = {e.extension_name.decode() for e in xr.enumerate_instance_extension_properties()}
        except xr.exception.ResultException as e:
            raise no_runtime() from e
        if missing := [name for name in required if name not in offered]:
            raise BadInput(f"--xr: this OpenXR runtime cannot take OpenGL pictures (no {missing[0]}); {WINDOW_INSTEAD}")
        self.enabled = [*required, *(e for e in optional if e in offered)]
        try:
            self.instance = xr.create_instance(
                xr.InstanceCreateInfo(
                    enabled_extension_names=self.enabled,
                    application_info=xr.ApplicationInfo("VR-GS", 1, "VR-GS", 1, xr.Version(1, 0, 34)),
                )
            )
        except (xr.RuntimeUnavailableError, xr.InitializationFailedError, xr.RuntimeFailureError) as e:
            raise no_runtime() from e
        except xr.exception.ResultException as e:
            raise BadInput(f"--xr: the OpenXR runtime does not start ({type(e).__name__}); {WINDOW_INSTEAD}") from e
        self.name = "the runtime"
        try:
            properties = xr.get_instance_properties(self.instance)
            self.name = f"{properties.runtime_name.decode(errors='replace')} {xr.Version(properties.runtime_version)}"
            self.system = self._wait_for_system(timeout)
            self.view_sizes, self.blend_mode = self._view_sizes(), self._blend_mode()
            self.tracks_hands = hand_tracking.EXTENSION in self.enabled and hand_tracking.supported(
                xr, self.instance, self.system
            )
        except xr.exception.ResultException as e:
            self.close()
            raise BadInput(f"--xr: {self.name} fails ({type(e).__name__}); restart it, or {WINDOW_INSTEAD}") from e
        except BaseException:
            self.close()
            raise

    def _wait_for_system(self, timeout: float):
        """XrSystemId of the headset; one that is not connected may be within `timeout` [s]."""
        xr, end, announced = self.xr, time.monotonic() + timeout, False
        while True:
            try:
                return xr.get_system(self.instance, xr.SystemGetInfo(form_factor=xr.FormFactor.HEAD_MOUNTED_DISPLAY))
            except xr.FormFactorUnsupportedError as e:
                raise BadInput(f"--xr: {self.name} drives no headset; {WINDOW_INSTEAD}") from e
            except xr.FormFactorUnavailableError as e:
                if time.monotonic() >= end:
                    raise BadInput(
                        f"--xr: {self.name} finds no headset; connect it and put it on, or {WINDOW_INSTEAD}"
                    ) from e
                if not announced:
                    print(f"{self.name}: waiting {timeout:.0f} s for a headset", file=sys.stderr, flush=True)
                    announced = True
                time.sleep(0.5)

    def _view_sizes(self) -> list[tuple[int, int]]:
        stereo = self.xr.ViewConfigurationType.PRIMARY_STEREO
        views = self.xr.enumerate_view_configuration_views(self.instance, self.system, stereo)
        return [(v.recommended_image_rect_width, v.recommended_image_rect_height) for v in views]

    def _blend_mode(self):
        """XrEnvironmentBlendMode: opaque where the headset offers it; see-through glasses have others."""
        xr = self.xr
        stereo = xr.ViewConfigurationType.PRIMARY_STEREO
        offered = xr.enumerate_environment_blend_modes(self.instance, self.system, stereo)
        modes = [xr.EnvironmentBlendMode(m) for m in offered]
        return xr.EnvironmentBlendMode.OPAQUE if xr.EnvironmentBlendMode.OPAQUE in modes else modes[0]

    def call(self, name: str, *arguments) -> None:
        """Call an extension's function. Raises the exception of a result that reports a failure."""
        function = ctypes.cast(self.xr.get_instance_proc_addr(self.instance, name), getattr(self.xr, f"PFN_{name}"))
        result = self.xr.check_result(function(*arguments))
        if result.is_exception():
            raise result

    def now(self) -> int | None:
        """The present as an XrTime [ns]; None where the runtime cannot tell (XR_KHR_convert_timespec_time)."""
        if TIMESPEC_EXTENSION not in self.enabled:
            return None
        answer = self.xr.Time()
        present = self.xr.timespec(*divmod(time.clock_gettime_ns(time.CLOCK_MONOTONIC), 10**9))
        self.call("xrConvertTimespecTimeToTimeKHR", self.instance, ctypes.byref(present), ctypes.byref(answer))
        return answer.value

    def lowest_opengl(self) -> tuple[int, int]:
        """Lowest OpenGL version (major, minor) that the runtime takes; must be asked for before each session."""
        xr, answer = self.xr, self.xr.GraphicsRequirementsOpenGLKHR()
        self.call("xrGetOpenGLGraphicsRequirementsKHR", self.instance, self.system, ctypes.byref(answer))
        version = xr.Version(answer.min_api_version_supported)
        return version.major, version.minor

    def check_opengl(self, gl) -> None:
        """Raise BadInput if the current context (moderngl) is older than what the runtime takes."""
        need, (major, rest) = self.lowest_opengl(), divmod(gl.version_code, 100)
        if (major, rest // 10) < need:
            has = f"this machine's driver has {major}.{rest // 10}"
            raise BadInput(f"--xr: {self.name} needs OpenGL {need[0]}.{need[1]}, {has}")

    def path(self, text: str):
        """XrPath of a semantic path such as "/user/hand/left"."""
        return self.xr.string_to_path(self.instance, text)

    def events(self):
        """Yield the events since the last call, as XrEventData structures of their own type; unknown ones are
        skipped."""
        xr = self.xr
        kinds = {
            xr.StructureType.EVENT_DATA_SESSION_STATE_CHANGED.value: xr.EventDataSessionStateChanged,
            xr.StructureType.EVENT_DATA_INSTANCE_LOSS_PENDING.value: xr.EventDataInstanceLossPending,
        }
        while True:
            try:
                event = xr.poll_event(self.instance)
            except xr.EventUnavailable:
                return
            kind = kinds.get(event._type)
            if kind is not None:
                yield kind.from_buffer_copy(event)

    def close(self) -> None:
        """Destroy the instance. Further calls do nothing."""
        if self.instance is not None:
            instance, self.instance = self.instance, None
            with contextlib.suppress(self.xr.exception.ResultException):  # it may be gone already
                self.xr.destroy_instance(instance)


def no_runtime() -> BadInput:
    """The error where no OpenXR runtime is active."""
    return BadInput(
        "--xr: no OpenXR runtime answers; start SteamVR, Quest Link, WiVRn or Monado and make it the active one, "
        f"or {WINDOW_INSTEAD}"
    )


def graphics_binding(xr, egl):
    """The structure that names the current OpenGL context to the runtime; `egl` (EglContext) is None with a window."""
    if egl is not None:
        return egl_binding(xr, egl)
    return windows_binding(xr) if sys.platform == "win32" else glx_binding(xr)


def glx_binding(xr):
    """Display, FBConfig, visual, drawable and context of GLX, as XR_KHR_opengl_enable wants them."""
    gl, pointer = ctypes.CDLL("libGL.so.1"), ctypes.c_void_p
    gl.glXGetCurrentDisplay.restype = gl.glXGetCurrentContext.restype = gl.glXChooseFBConfig.restype = pointer
    gl.glXGetCurrentDrawable.restype = ctypes.c_ulong
    display, context = pointer(gl.glXGetCurrentDisplay()), pointer(gl.glXGetCurrentContext())
    number, screen, count, visual = (ctypes.c_int() for _ in range(4))
    gl.glXQueryContext(display, context, GLX_FBCONFIG_ID, ctypes.byref(number))
    gl.glXQueryContext(display, context, GLX_SCREEN, ctypes.byref(screen))
    wanted = (ctypes.c_int * 3)(GLX_FBCONFIG_ID, number.value, 0)
    found = gl.glXChooseFBConfig(display, screen, wanted, ctypes.byref(count))
    config = ctypes.cast(found, ctypes.POINTER(pointer))[0] if found and count.value else None
    if config:
        gl.glXGetFBConfigAttrib(display, pointer(config), GLX_VISUAL_ID, ctypes.byref(visual))
    binding = xr.GraphicsBindingOpenGLXlibKHR()
    kinds = dict(binding._fields_)
    binding.x_display = ctypes.cast(display, kinds["x_display"])
    binding.visualid = visual.value
    binding.glx_fbconfig = ctypes.cast(pointer(config), kinds["glx_fbconfig"])
    binding.glx_drawable = gl.glXGetCurrentDrawable()
    binding.glx_context = ctypes.cast(context, kinds["glx_context"])
    return binding


def egl_binding(xr, egl):
    """Display, config and context of EGL, as XR_MNDX_egl_enable wants them."""
    binding = xr.GraphicsBindingEGLMNDX()
    kinds = dict(binding._fields_)
    binding.display = ctypes.cast(egl.display, kinds["display"])
    binding.config = ctypes.cast(egl.config, kinds["config"])
    binding.context = ctypes.cast(egl.context, kinds["context"])
    binding.get_proc_address = ctypes.cast(egl.library.eglGetProcAddress, xr.PFN_xrEglGetProcAddressMNDX)
    return binding


def windows_binding(xr):
    """Device context and rendering context of WGL, as XR_KHR_opengl_enable wants them."""
    wgl = ctypes.windll.opengl32
    wgl.wglGetCurrentDC.restype = wgl.wglGetCurrentContext.restype = ctypes.c_void_p
    return xr.GraphicsBindingOpenGLWin32KHR(h_dc=wgl.wglGetCurrentDC(), h_glrc=wgl.wglGetCurrentContext())
