"""Weights with which the Gaussians of a splat are blended into pixels of its pictures, summed over maps of pixels."""

from collections.abc import Sequence

import numpy as np
import taichi as ti

from assets.gaussians import Gaussians
from core.camera import Camera
from render.blend_gradients import GEOMETRY, BlendGradients
from render.projection import camera_values
from render.renderer import Renderer
from render.splats import Splats

CHANNELS = 3  # maps of pixels that one pass sums over: a picture has so many colours


class BlendingWeights:
    """Draws `gaussians` and sums their blending weights over maps of pixels. Taichi must be running.

    A picture is linear in the colours, C = sum_i w_i c_i, so dL/dc_i = sum over pixels of w_i dL/dC: with a map for
    dL/dC, the backward pass of blending sums the weights over the map.
    """

    def __init__(self, gaussians: Gaussians, cameras: Sequence[Camera] = (), *, sort: str = "", capacity: int = 0):
        """Draw for some cameras, and others.

        cameras   whose pictures there is room for from the start, not for one size after the other
        sort      order of blending; by default that which the Gaussians were trained for, "radial" if not known
        capacity  for at least so many Gaussians
        """
        self._sort, self._antialias = sort or gaussians.sort or "radial", gaussians.antialias
        self._degree = gaussians.sh_degree
        self._size = (0, 0)  # of the largest picture until now, for which there is room
        self._first = max((c.width for c in cameras), default=1), max((c.height for c in cameras), default=1)
        self._renderer: Renderer | None = None
        self._backward: _BackwardPass | None = None
        self._camera: tuple | None = None  # of the last picture, if it shows the Gaussians where they are
        self._hold(gaussians, capacity)

    def _hold(self, gaussians: Gaussians, capacity: int) -> None:
        self._splats = Splats(gaussians, capacity=capacity)
        if capacity:
            self._splats.sh_range = (0, self._splats.capacity)  # of those that follow, any may depend on the view

    def replace(self, gaussians: Gaussians) -> None:
        """Draw other Gaussians from now on, in the same order; nothing is compiled anew as long as there is room."""
        gaussians = gaussians.with_sh_degree(self._degree)
        if len(gaussians) > self._splats.capacity:
            self.destroy()
            self._first, self._size = tuple(map(max, self._first, self._size)), (0, 0)
            self._hold(gaussians, 2 * len(gaussians))
        self._splats.replace(gaussians)
        self._camera = None

    def recolour(self, sh: np.ndarray) -> None:
        """Draw the Gaussians with these spherical harmonics (N, K, 3) from now on."""
        self._splats.sh.from_numpy(self._splats.padded(sh))

    def picture(self, camera: Camera) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Picture for a camera on black: rgb (H, W, 3), depth [m] and opacity (H, W), float32."""
        self._draw(camera)
        return self.drawn()

    def drawn(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The picture that was drawn last, also by `sums`: as `picture`."""
        r = self._renderer
        return tuple(field.to_numpy()[0, : r.height, : r.width] for field in (r.rgb, r.depth, r.alpha))

    def sums(self, camera: Camera, maps: Sequence[np.ndarray]) -> np.ndarray:
        """Sum of each Gaussian's weights over each of up to three maps of pixels (H, W): (N, len(maps)) [px]."""
        if self._camera != numbers_of(camera):
            self._draw(camera)
        bins = self._renderer.rasterizer.tile_pass.bins
        if self._backward is None or self._backward.bins is not bins:
            if self._backward is not None:
                self._backward.destroy()
            self._backward = _BackwardPass(bins, self._renderer.sink)
        stack = np.zeros((*self._size[::-1], CHANNELS), np.float32)
        for k, pixels in enumerate(maps):
            stack[: camera.height, : camera.width, k] = pixels
        return self._backward.sums(stack, self._splats.count)[:, : len(maps)]

    def _draw(self, camera: Camera) -> None:
        size, renderer = (camera.width, camera.height), self._renderer
        if size[0] > self._size[0] or size[1] > self._size[1]:
            self._release()
            self._size = tuple(max(sides) for sides in zip(size, self._size, self._first, strict=True))
            how = {"outputs": "float", "sort": self._sort, "antialias": self._antialias}
            self._renderer = renderer = Renderer(self._splats, *self._size, **how)
        if (renderer.width, renderer.height) != size:
            renderer.resize(*size)
        renderer.render([camera])
        self._camera = numbers_of(camera)

    def _release(self) -> None:
        for part in (self._backward, self._renderer):
            if part is not None:
                part.destroy()
        self._backward = self._renderer = None

    def destroy(self) -> None:
        """Free the device memory."""
        self._release()
        self._splats.destroy()


def numbers_of(camera: Camera) -> tuple[float, ...]:
    """All that the picture of a camera depends on."""
    return (camera.width, camera.height, *camera_values(camera))


@ti.data_oriented
class _BackwardPass:
    """The backward pass through the bins of a picture."""

    def __init__(self, bins, picture):
        self.bins = bins
        self.gradients = BlendGradients(bins, picture, with_depth=False, with_geometry=False)

    def destroy(self) -> None:
        """Free the device memory."""
        self.gradients.destroy()

    def sums(self, maps: np.ndarray, count: int) -> np.ndarray:
        """Sums (count, 3) over maps (H, W, 3) float32."""
        self.gradients.d_rgb.from_numpy(maps)
        self._clear(count)
        self._add()
        sums = np.empty((count, CHANNELS), np.float32)
        self._read(sums)
        return sums.astype(np.float64)

    @ti.kernel
    def _clear(self, count: ti.i32):
        self.gradients.clear(0, count)

    @ti.kernel
    def _read(self, out: ti.types.ndarray(ti.f32, 2)):
        for g in range(out.shape[0]):
            for c in ti.static(range(CHANNELS)):
                out[g, c] = self.gradients.sums[g, GEOMETRY + c]

    @ti.kernel
    def _add(self):  # a kernel of its own, as it shares arrays
        self.gradients.backward()
