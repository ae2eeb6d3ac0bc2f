"""Pictures of a scene's Gaussians for the screen, the headset or a measurement."""

import numpy as np
import taichi as ti

from core.camera import Camera
from core.fields import FieldGroup
from render.per_pixel_sort import BUFFER_SIZE
from render.rasterizer import Rasterizer
from render.splats import Splats

DEPTH_NEAR, DEPTH_FAR = 0.2, 100.0  # [m] of a depth of 0 and of 1; nearer surfaces are stored at DEPTH_NEAR
MIN_SURFACE_ALPHA = 0.5  # opacity from which a pixel has a depth; a pixel below it is stored at DEPTH_FAR


@ti.data_oriented
class Picture:
    """Sink of 8-bit pixels over a background colour, R | G << 8 | B << 16 | A << 24, views one below the other.

    A is 255, or with `depth` the depth of the surface:

    A = 255 d,   d = far / (far - near) (1 - near / z),   z = (sum w z) / (sum w)          as OpenGL's depth buffer

    One step of 8 bits is 0.02 in 1 / z: for a head that has moved by 2 cm half a step shifts a point by 0.0002 of the
    distance to the picture's plane, 0.2 px where an eye has 1000 px to it.
    """

    def __init__(self, views: int, background, *, depth: bool = False):
        self.views, self.with_depth = views, depth
        self.fields = f = FieldGroup()
        self.background = f.vector(1)
        f.build()
        self.set_background(background)

    def set_background(self, colour) -> None:
        """Draw over another colour, each channel 0..1."""
        self.background.from_numpy(np.array([colour], np.float32))

    def destroy(self) -> None:
        """Free the device memory. The picture is the renderer's, and lives as long as it is shown."""
        self.fields.destroy()

    @ti.func
    def write(self, out: ti.template(), v, y, x, rgb, depth, alpha):
        c = rgb + (1.0 - alpha) * self.background[0]
        packed = ti.u32(4278190080)  # alpha 255
        if ti.static(self.with_depth):
            d = 1.0
            if alpha >= MIN_SURFACE_ALPHA:
                d = DEPTH_FAR / (DEPTH_FAR - DEPTH_NEAR)
                d *= 1.0 - DEPTH_NEAR * alpha / ti.max(depth, DEPTH_NEAR * alpha)
                d = ti.min(ti.max(d, 0.0), 1.0)
            packed = ti.cast(d * 255.0 + 0.5, ti.u32) << ti.u32(24)
        for k in ti.static(range(3)):
            level = ti.cast(ti.min(ti.max(c[k], 0.0), 1.0) * 255.0 + 0.5, ti.u32)
            packed |= level << (8 * k)
        out[v * (out.shape[0] // self.views) + y, x] = packed


@ti.data_oriented
class FloatImages:
    """Sink of unclamped float32 images without a background: rgb, alpha, and depth [m], 0 where alpha is 0."""

    def __init__(self, views: int, height: int, width: int):
        self.fields = f = FieldGroup()
        self.rgb = f.vector(views, height, width)
        self.alpha, self.depth = f.scalar(views, height, width), f.scalar(views, height, width)
        f.build()

    def destroy(self) -> None:
        """Free the device memory."""
        self.fields.destroy()

    @ti.func
    def write(self, out: ti.template(), v, y, x, rgb, depth, alpha):
        self.rgb[v, y, x] = rgb
        self.alpha[v, y, x] = alpha
        self.depth[v, y, x] = depth / ti.max(alpha, 1e-10)


class Renderer:
    """Renders `splats` at width x height [px] from `views` cameras.

    `sort`: the order of blending, one of render.SORTS; for "pixel", `buffer_size` splats are sorted in each pixel.
    Two views are the two eyes: they share one depth sort, by the mean of their depths, and one
    colour per Gaussian, seen from between them. Unrelated views are rendered one by one.

    linear: splats are EWA's, as in training, see `Projection`.

    still: number of Gaussians at the beginning of which only the visibility ever changes; while the cameras stay where
    they are too, they are not projected again.

    outputs="rgba8": `picture`, ti.ndarray u32 (views * height, width), row 0 on top, over `background`.
    outputs="deep": the same with depth in place of alpha, see `Picture`.
    outputs="float": fields `rgb` vec3, `alpha`, `depth` [m] of shape (views, height, width), no background.
    """

    def __init__(
        self,
        splats: Splats,
        width: int,
        height: int,
        *,
        views: int = 1,
        antialias: bool = False,
        background=(0.0, 0.0, 0.0),
        outputs: str = "rgba8",
        sort: str = "z",
        buffer_size: int = BUFFER_SIZE,
        still: int = 0,
        linear: bool = False,
    ):
        self.width, self.height, self.views = width, height, views
        if outputs != "float":
            self.picture = ti.ndarray(ti.u32, (views * height, width))
            self.sink = Picture(views, background, depth=outputs == "deep")
            self._out = self.picture
        else:
            self.sink, self._out = FloatImages(views, height, width), 0
            self.rgb, self.alpha, self.depth = self.sink.rgb, self.sink.alpha, self.sink.depth
        self.rasterizer = Rasterizer(
            splats,
            width,
            height,
            views=views,
            sink=self.sink,
            antialias=antialias,
            depth=outputs != "rgba8",
            sort=sort,
            buffer_size=buffer_size,
            still=still,
            keeps=outputs != "float",
            fast=outputs != "float",
            linear=linear,
        )

    def resize(self, width: int, height: int) -> None:
        """Draw another size [px] from now on: into a new `picture`, or a part of float images of at least that size."""
        self.width, self.height = width, height
        if isinstance(self.sink, Picture):
            self.picture = self._out = ti.ndarray(ti.u32, (self.views * height, width))
        self.rasterizer.resize(width, height)

    def set_background(self, colour) -> None:
        """Draw over another colour from now on, each channel 0..1; not for outputs="float"."""
        self.sink.set_background(colour)
        self.rasterizer.resize(self.width, self.height)  # nothing is left of the last picture

    def forget(self) -> None:
        """Draw all anew: what was said to stand still has moved."""
        self.rasterizer.forget()

    def render(self, cameras: list[Camera], *, wait: bool = True) -> None:
        """Draw one picture per camera; it is complete on return, or without `wait` after `finish`."""
        if len(cameras) != self.views:
            raise ValueError(f"expected {self.views} cameras, got {len(cameras)}")
        for v, camera in enumerate(cameras):
            if (camera.width, camera.height) != (self.width, self.height):
                raise ValueError(
                    f"camera {v} is {camera.width}x{camera.height}, the renderer {self.width}x{self.height}"
                )
        self.rasterizer.set_cameras(cameras)
        self.rasterizer.draw(self._out, wait=wait)

    def finish(self) -> None:
        """Wait for the last picture, and complete it."""
        self.rasterizer.finish(self._out)

    def destroy(self) -> None:
        """Free the device memory."""
        self.rasterizer.destroy()
        self.sink.destroy()

    def pixels(self) -> np.ndarray:
        """The picture as (views, height, width, 4) uint8 RGBA on the host."""
        return self.picture.to_numpy().view(np.uint8).reshape(self.views, self.height, self.width, 4)
