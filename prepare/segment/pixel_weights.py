"""Blending weights of a splat's Gaussians in marked pixels of its pictures."""

from collections.abc import Sequence

import numpy as np
import taichi as ti

from assets.gaussians import Gaussians
from core.camera import Camera
from render.blend_gradients import BlendGradients
from render.renderer import Renderer
from render.splats import Splats

CHANNELS = 3  # maps of pixels summed in one pass: one per colour channel


class PixelWeights:
    """Draws `gaussians` and sums their blending weights over maps of pixels. Taichi must be running.

    A picture is linear in the colours, C = sum_i w_i c_i, so dL/dc_i = sum over pixels of w_i dL/dC: with a map for
    dL/dC, the backward pass of blending sums the weights over the map.
    """

    def __init__(self, gaussians: Gaussians):
        self._splats = Splats(gaussians)
        self._renderer: Renderer | None = None
        self._sums = None

    def replace(self, gaussians: Gaussians) -> None:
        """Draw other Gaussians from now on, as many and of the same SH degree."""
        self._splats.replace(gaussians)

    def picture(self, camera: Camera) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Picture for a camera on black: rgb (H, W, 3), depth [m] and opacity (H, W), float32."""
        self._draw(camera)
        r = self._renderer
        return r.rgb.to_numpy()[0], r.depth.to_numpy()[0], r.alpha.to_numpy()[0]

    def sums(self, camera: Camera, maps: Sequence[np.ndarray]) -> np.ndarray:
        """Sum of each Gaussian's weights over each of up to three maps of pixels (H, W): (N, len(maps)) [px]."""
        self._draw(camera)
        bins = self._renderer.rasterizer.tile_pass.bins
        if self._sums is None or self._sums.bins is not bins:
            if self._sums is not None:
                self._sums.destroy()
            self._sums = _WeightSums(bins, self._renderer.sink)
        stack = np.zeros((camera.height, camera.width, CHANNELS), np.float32)
        for k, pixels in enumerate(maps):
            stack[..., k] = pixels
        return self._sums.of(stack, self._splats.count)[:, : len(maps)]

    def _draw(self, camera: Camera) -> None:
        size = (camera.width, camera.height)
        if self._renderer is None or (self._renderer.width, self._renderer.height) != size:
            self._release()
            self._renderer = Renderer(self._splats, *size, outputs="float")
        self._renderer.render([camera])

    def _release(self) -> None:
        for part in (self._sums, self._renderer):
            if part is not None:
                part.destroy()
        self._sums = self._renderer = None

    def destroy(self) -> None:
        """Free the device memory."""
        self._release()
        self._splats.destroy()


@ti.data_oriented
class _WeightSums:
    """The backward pass through the bins of a picture."""

    def __init__(self, bins, picture):
        self.bins = bins
        self.blend = BlendGradients(bins, picture, with_depth=False)

    def of(self, maps: np.ndarray, count: int) -> np.ndarray:
        """Sums over maps (H, W, 3), (count, 3)."""
        self.blend.d_rgb.from_numpy(maps)
        out = np.zeros((count, CHANNELS), np.float32)
        self._backward(count)
        self._read(out)
        return out

    def destroy(self) -> None:
        """Free the device memory."""
        self.blend.destroy()

    @ti.kernel
    def _backward(self, count: ti.i32):
        self.blend.clear(0, count)
        self.blend.backward()

    @ti.kernel
    def _read(self, out: ti.types.ndarray(ti.f32, 2)):
        for g in range(out.shape[0]):
            sums = self.blend.d_color(g)
            for k in ti.static(range(CHANNELS)):
                out[g, k] = sums[k]
