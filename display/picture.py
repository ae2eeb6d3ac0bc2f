"""The finished picture: its pixels on the host, a picture file, an OpenGL texture; the surface that it shows."""

from __future__ import annotations

import ctypes
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

from assets.file_access import PICTURES, atomic_write
from core.camera import Camera
from core.errors import BadInput
from display.window.gl_context import CudaTexture, NoInterop

SURFACE_SIDE = 16  # [px] of the part of the picture that is drawn for its depth: a tile
OPAQUE = 0.5  # of a pixel; fainter ones show no surface
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


def pixels_of(picture) -> np.ndarray:
    """Pixels (H, W, 4) uint8 RGBA of a finished picture, a ti.ndarray u32 (H, W).

    On the CPU this is a view of the picture itself, valid until the next one is drawn (a copy through
    Taichi takes 4 ms at 960x540, more than the rest of showing it); from a GPU it is a copy.
    """
    import taichi as ti
    from taichi.lang import impl

    height, width = picture.shape
    if ti.cfg.arch in (ti.x64, ti.arm64):
        ti.sync()
        address = impl.get_runtime().prog.get_ndarray_data_ptr_as_int(picture.arr)
        flat = np.ctypeslib.as_array((ctypes.c_uint8 * (4 * width * height)).from_address(address))
    else:
        flat = picture.to_numpy().view(np.uint8)
    return flat.reshape(height, width, 4)


def surface_point(splats, camera: Camera, u: float, v: float) -> np.ndarray | None:
    """The point (3,) [m] of splats (render/splats.py) that is seen at a pixel; None: nothing opaque is there."""
    from render.renderer import Renderer

    if not (0 <= u < camera.width and 0 <= v < camera.height):
        return None
    left, top = int(u) - SURFACE_SIDE // 2, int(v) - SURFACE_SIDE // 2
    near = replace(camera, width=SURFACE_SIDE, height=SURFACE_SIDE, cx=camera.cx - left, cy=camera.cy - top)
    renderer = Renderer(splats, SURFACE_SIDE, SURFACE_SIDE, outputs="float", sort="z")
    renderer.render([near])
    middle = (0, SURFACE_SIDE // 2, SURFACE_SIDE // 2)
    depth, alpha = renderer.depth.to_numpy()[middle], renderer.alpha.to_numpy()[middle]
    renderer.destroy()
    if alpha < OPAQUE:
        return None
    origin, direction = camera.ray(u, v)
    return origin + direction * float(depth / alpha) / float(direction @ camera.world_to_camera[2, :3])


def side_by_side(pixels: np.ndarray, views: int) -> np.ndarray:
    """Views that lie one below the other (views * H, W, 4), one beside the other (H, views * W, 4)."""
    return np.concatenate(np.split(pixels, views), axis=1) if views > 1 else pixels


def save_picture(path: str | Path, pixels: np.ndarray) -> None:
    """Write RGBA or RGB pixels (H, W, 3|4) uint8 as an opaque picture of the kind that the suffix says.

    Raises BadInput.
    """
    import cv2

    path = Path(path)
    check_picture_name(path)
    ok, data = cv2.imencode(path.suffix.lower(), np.ascontiguousarray(pixels[..., 2::-1]))
    if not ok:
        raise BadInput(f"{path}: cannot encode a picture of {pixels.shape[1]}x{pixels.shape[0]} pixels")
    with atomic_write(path) as beside:
        beside.write_bytes(data.tobytes())


def check_picture_name(path: Path) -> None:
    """Raise BadInput for a suffix of no kind of picture that can be written."""
    if path.suffix.lower() not in PICTURES:
        raise BadInput(f"{path}: a picture's name ends in {', '.join(PICTURES[:-1])} or {PICTURES[-1]}")


def fit(picture: tuple[int, int], frame: tuple[int, int]) -> tuple[int, int, int, int]:
    """Largest (left, top, width, height) in a frame of (width, height) with the picture's aspect, centred."""
    scale = min(frame[0] / picture[0], frame[1] / picture[1])
    width, height = round(picture[0] * scale), round(picture[1] * scale)
    return (frame[0] - width) // 2, (frame[1] - height) // 2, width, height


class PictureTexture:
    """The picture as an OpenGL texture of the current context, drawn to fill a window.

    `upload` is the one place where the picture leaves Taichi: on CUDA it stays on the device
    (display/window/gl_context.py), or passes through the host where OpenGL runs elsewhere, which is reported once.
    Of several `views`, one below the other, `draw` shows the first.
    """

    def __init__(self, gl, views: int = 1):
        self._gl, self._views = gl, views
        self._program = gl.program(vertex_shader=VERTEX, fragment_shader=FRAGMENT)
        self._triangle = gl.vertex_array(self._program, [])
        self._program["views"] = views
        self._texture = self._shared = None
        self.through_host: bool | None = None  # the picture passes through the host; None before the first

    @property
    def texture(self):
        """The whole picture as it was uploaded, row 0 on top; None before the first."""
        return self._texture

    @property
    def size(self) -> tuple[int, int] | None:
        """(width, height) [px] of the last picture, None before the first."""
        return self._texture.size if self._texture is not None else None

    def upload(self, picture) -> None:
        """Take over a finished picture, a ti.ndarray u32 (H, W); its size may change."""
        self._make(*picture.shape)
        if not self._share(picture):
            self._texture.write(pixels_of(picture))

    def upload_pixels(self, pixels: np.ndarray) -> None:
        """Take over a picture on the host, (H, W, 3) uint8 RGB."""
        height, width = pixels.shape[:2]
        self._make(height, width)
        opaque = np.full((height, width, 1), 255, np.uint8)
        self._texture.write(np.concatenate([pixels, opaque], axis=2).tobytes())

    def _make(self, height: int, width: int) -> None:
        """Make the texture of this size, unless it is that already."""
        if self.size != (width, height):
            self.release()
            self._texture = self._gl.texture((width, height), 4)
            self._texture.repeat_x = self._texture.repeat_y = False

    def _share(self, picture) -> bool:
        """Copy the picture on the device; False if that is impossible here."""
        import taichi as ti
        from taichi.lang import impl

        if self.through_host is None:
            self.through_host = ti.cfg.arch != ti.cuda
        if self.through_host:
            return False
        ti.sync()  # Taichi draws in a stream of its own
        try:
            self._shared = self._shared or CudaTexture(self._texture)
            self._shared.write(impl.get_runtime().prog.get_ndarray_data_ptr_as_int(picture.arr))
        except NoInterop as e:
            self.through_host = True
            print(f"pictures pass through the host: OpenGL does not share the GPU ({e})", file=sys.stderr, flush=True)
            return False
        return True

    def release(self) -> None:
        """Free the texture. Further calls do nothing."""
        if self._shared is not None:
            self._shared.close()
        if self._texture is not None:
            self._texture.release()
        self._texture = self._shared = None

    def draw(self, frame: tuple[int, int], place: tuple[int, int, int, int] | None = None) -> None:
        """Fill a framebuffer of `frame` (width, height) [px], bars at the sides if the aspect differs.

        place  (left, top, width, height) [px] of the picture, which may reach beyond the framebuffer
        """
        gl = self._gl
        gl.screen.use()
        gl.viewport = (0, 0, *frame)
        gl.clear(0.0, 0.0, 0.0)
        if self._texture is None:
            return
        left, top, width, height = place or fit((self.size[0], self.size[1] // self._views), frame)
        gl.viewport = (left, frame[1] - top - height, width, height)
        gl.disable(gl.BLEND | gl.DEPTH_TEST | gl.CULL_FACE)
        self._texture.use(0)
        self._triangle.render(gl.TRIANGLES, vertices=3)
