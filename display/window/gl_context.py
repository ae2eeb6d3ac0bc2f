"""OpenGL contexts (moderngl), and the picture as a texture, which CUDA writes.

A context is made current elsewhere (GLFW), or has no surface (EGL). A picture goes from CUDA to OpenGL on the device by
the driver's own library, which is there wherever Taichi runs on CUDA (CUDA driver API, chapter "OpenGL
Interoperability"); both must run on the same GPU.
"""

from __future__ import annotations

import ctypes
import sys
from collections.abc import Callable

import numpy as np

from core.errors import BadInput
from display.picture import fit, pixels_of

NO_DISPLAY = "no display to open a window on"
HEADLESS_INSTEAD = "run with --headless instead"

# Registry of EGL enums.
SURFACELESS_PLATFORM, OPENGL_API = 0x31DD, 0x30A2
RED, GREEN, BLUE, SURFACE_TYPE, RENDERABLE_TYPE, OPENGL_BIT, NONE = 0x3024, 0x3023, 0x3022, 0x3033, 0x3040, 0x8, 0x3038
MAJOR, MINOR, PROFILE, CORE = 0x3098, 0x30FB, 0x30FD, 0x1
OPENGL_VERSION = (4, 5)
TEXTURE_2D = 0x0DE1  # OpenGL's enum
WRITE_DISCARD = 0x02  # CU_GRAPHICS_REGISTER_FLAGS_WRITE_DISCARD
DEVICE, ARRAY = 2, 3  # CUmemorytype
BYTES_PER_PIXEL = 4
VERTEX = """
#version 330
uniform int views;  // one below the other; the first is shown
out vec2 uv;
void main() {  // one triangle that covers the viewport; row 0 of the texture is the top
    vec2 corner = vec2((gl_VertexID << 1) & 2, gl_VertexID & 2);
    uv = vec2(corner.x, (1.0 - corner.y) / float(views));
    gl_Position = vec4(2.0 * corner - 1.0, 0.0, 1.0);
}
"""
FRAGMENT = """
#version 330
uniform sampler2D picture;
in vec2 uv;
out vec4 colour;
void main() { colour = vec4(texture(picture, uv).rgb, 1.0); }
"""


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


def integers(*values: int) -> ctypes.Array:
    """An array of C."""
    return (ctypes.c_int * len(values))(*values)


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
        wanted = integers(SURFACE_TYPE, 1, RED, 8, GREEN, 8, BLUE, 8, RENDERABLE_TYPE, OPENGL_BIT, NONE)
        self.config, count = pointer(), ctypes.c_int()
        chosen = egl.eglChooseConfig(self.display, wanted, ctypes.byref(self.config), 1, ctypes.byref(count))
        egl.eglBindAPI(OPENGL_API)
        attributes = integers(MAJOR, OPENGL_VERSION[0], MINOR, OPENGL_VERSION[1], PROFILE, CORE, NONE)
        self.context = pointer(egl.eglCreateContext(self.display, self.config, pointer(0), attributes))
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


class NoInterop(Exception):
    """This picture cannot go to OpenGL on the device; the message says why."""


class Copy2D(ctypes.Structure):
    """CUDA_MEMCPY2D_v2: source, destination and extent of `cuMemcpy2DAsync_v2`."""

    _fields_ = [
        (side + name, kind)
        for side in ("src", "dst")
        for name, kind in (
            ("XInBytes", ctypes.c_size_t),
            ("Y", ctypes.c_size_t),
            ("MemoryType", ctypes.c_int),
            ("Host", ctypes.c_void_p),
            ("Device", ctypes.c_uint64),
            ("Array", ctypes.c_void_p),
            ("Pitch", ctypes.c_size_t),
        )
    ] + [("WidthInBytes", ctypes.c_size_t), ("Height", ctypes.c_size_t)]


class CudaTexture:
    """An OpenGL texture (moderngl, RGBA of 8 bits a channel) that CUDA can write. Raises NoInterop."""

    def __init__(self, texture):
        self.texture, self._driver = texture, cuda_driver()
        current = ctypes.c_void_p()
        self._call("cuCtxGetCurrent", ctypes.byref(current))
        if not current:  # Taichi's context, the device's primary one, becomes this thread's
            device, primary = ctypes.c_int(), ctypes.c_void_p()
            self._call("cuDeviceGet", ctypes.byref(device), 0)
            self._call("cuDevicePrimaryCtxRetain", ctypes.byref(primary), device)
            self._call("cuCtxSetCurrent", primary)
        self._resource = ctypes.c_void_p()
        self._call("cuGraphicsGLRegisterImage", ctypes.byref(self._resource), texture.glo, TEXTURE_2D, WRITE_DISCARD)

    def _call(self, name: str, *arguments) -> None:
        status = self._driver[name](*arguments)
        if status != 0:
            raise NoInterop(f"{name} returns {status}")

    def write(self, address: int) -> None:
        """Copy the pixels at an address of the device, row after row, once the kernels that draw them are done."""
        width, height = self.texture.size
        array = ctypes.c_void_p()
        self._call("cuGraphicsMapResources", 1, ctypes.byref(self._resource), None)
        try:
            self._call("cuGraphicsSubResourceGetMappedArray", ctypes.byref(array), self._resource, 0, 0)
            copy = Copy2D(
                srcMemoryType=DEVICE,
                srcDevice=address,
                srcPitch=width * BYTES_PER_PIXEL,
                dstMemoryType=ARRAY,
                dstArray=array,
                WidthInBytes=width * BYTES_PER_PIXEL,
                Height=height,
            )
            self._call("cuMemcpy2DAsync_v2", ctypes.byref(copy), None)
        finally:
            self._call("cuGraphicsUnmapResources", 1, ctypes.byref(self._resource), None)

    def close(self) -> None:
        """Unregister the texture, before OpenGL deletes it. Further calls do nothing."""
        if self._resource:
            self._driver.cuGraphicsUnregisterResource(self._resource)
            self._resource = ctypes.c_void_p()


def cuda_driver() -> ctypes.CDLL:
    """CUDA's driver. Raises NoInterop."""
    try:
        return ctypes.CDLL("nvcuda.dll" if sys.platform == "win32" else "libcuda.so.1")
    except OSError as e:
        raise NoInterop("there is no CUDA driver") from e


class PictureTexture:
    """The picture as an OpenGL texture of the current context, drawn to fill a window.

    `upload` is the one place where the picture leaves Taichi: on CUDA it stays on the device, or passes
    through the host where OpenGL runs elsewhere, which is reported once. Of several `views`, one below the other,
    `draw` shows the first.

    texture       the whole picture as it was uploaded, row 0 on top; None before the first
    through_host  the picture passes through the host; None before the first
    """

    def __init__(self, gl, *, views: int = 1):
        self._gl, self._views = gl, views
        self._program = gl.program(vertex_shader=VERTEX, fragment_shader=FRAGMENT)
        self._triangle = gl.vertex_array(self._program, [])
        self._program["views"] = views
        self.texture = self._shared = None
        self.through_host: bool | None = None

    @property
    def size(self) -> tuple[int, int] | None:
        """(width, height) [px] of the last picture, None before the first."""
        return self.texture.size if self.texture is not None else None

    def upload(self, picture) -> None:
        """Take over a finished picture, a ti.ndarray u32 (H, W); its size may change."""
        self._make(*picture.shape)
        if not self._share(picture):
            self.texture.write(pixels_of(picture))

    def upload_pixels(self, pixels: np.ndarray) -> None:
        """Take over a picture on the host, (H, W, 3) uint8 RGB."""
        height, width = pixels.shape[:2]
        self._make(height, width)
        opaque = np.full((height, width, 1), 255, np.uint8)
        self.texture.write(np.concatenate([pixels, opaque], axis=2).tobytes())

    def _make(self, height: int, width: int) -> None:
        """Make the texture of this size, unless it is that already."""
        if self.size != (width, height):
            self.release()
            self.texture = self._gl.texture((width, height), 4)
            self.texture.repeat_x = self.texture.repeat_y = False

    def _share(self, picture) -> bool:
        """Copy the picture on the device; False if that is impossible here."""
        import taichi as ti

        from core.runtime import address_of

        if self.through_host is None:
            self.through_host = ti.cfg.arch != ti.cuda
        if self.through_host:
            return False
        ti.sync()  # Taichi draws in a stream of its own
        try:
            self._shared = self._shared or CudaTexture(self.texture)
            self._shared.write(address_of(picture))
        except NoInterop as e:
            self.through_host = True
            print(f"pictures pass through the host: OpenGL does not share the GPU ({e})", file=sys.stderr, flush=True)
            return False
        return True

    def release(self) -> None:
        """Free the texture. Further calls do nothing."""
        if self._shared is not None:
            self._shared.close()
        if self.texture is not None:
            self.texture.release()
        self.texture = self._shared = None

    def draw(self, frame: tuple[int, int], place: tuple[int, int, int, int] | None = None) -> None:
        """Fill a framebuffer of `frame` (width, height) [px], bars at the sides if the aspect differs.

        place  (left, top, width, height) [px] of the picture, which may reach beyond the framebuffer
        """
        gl = self._gl
        gl.screen.use()
        gl.viewport = (0, 0, *frame)
        gl.clear(0.0, 0.0, 0.0)
        if self.texture is None:
            return
        left, top, width, height = place or fit((self.size[0], self.size[1] // self._views), frame)
        gl.viewport = (left, frame[1] - top - height, width, height)
        gl.disable(gl.BLEND | gl.DEPTH_TEST | gl.CULL_FACE)
        self.texture.use(0)
        self._triangle.render(gl.TRIANGLES, vertices=3)
