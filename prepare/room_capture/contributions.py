"""Contributions of Gaussians to the photographs of a capture, and the pruning of those that no camera needs."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import taichi as ti

from assets.gaussians import Gaussians
from core.camera import Camera
from prepare.progress import Progress, no_progress
from render.blend_gradients import GEOMETRY, BlendGradients
from render.renderer import Renderer
from render.splats import Splats

SIDE = 320  # [px] longer side of the pictures in which contributions are summed
NEEDED = 0.5  # [px] least sum of a Gaussian's weights over all these pictures; below, it is pruned
DEPTH_PIXELS = 4  # a view's depth is the median over every DEPTH_PIXELS-th pixel along both axes
MIN_ALPHA = 0.5  # a pixel of lower opacity has no depth
NEAR_CAMERA = 0.12  # fraction of a view's depth: a Gaussian this near to the camera is a floater


@dataclass(frozen=True)
class Contributions:
    """Contributions of N Gaussians to V views, from pictures whose longer side is SIDE.

    weight  blending weight summed over all pixels of all views, (N,) [px]
    views   number of views to which it gives a tenth of a pixel or more, (N,)
    depth   median depth of what each view shows, in the Gaussians' unit, (V,); NaN where it shows nothing
    """

    weight: np.ndarray
    views: np.ndarray
    depth: np.ndarray


def contributions(
    gaussians: Gaussians, cameras: Sequence[Camera], *, sort: str = "radial", progress: Progress = no_progress
) -> Contributions:
    """Blending weights of the Gaussians, summed over views. Taichi must be running."""
    n, sums = len(gaussians), WeightSums(gaussians, cameras, sort=sort)
    weight, views, depths = np.zeros(n), np.zeros(n, np.int32), []
    for k in range(len(cameras)):
        of_view = sums.of(k)[:, 0]
        weight += of_view
        views += of_view >= 0.1
        depths.append(sums.depth())
        progress("views", (k + 1) / len(cameras))
    sums.destroy()
    return Contributions(weight, views, np.array(depths))


def weights_in_masks(
    gaussians: Gaussians,
    cameras: Sequence[Camera],
    masks: Sequence[np.ndarray | None],
    count: int,
    *,
    progress: Progress = no_progress,
) -> np.ndarray:
    """Blending weight [px] of each Gaussian in the pixels of the background and of each object, (N, count + 1).

    masks  ids of the pixels of each view, (H, W), in any size of its picture; 0 is the background, 1 to `count` are
           objects, others and None are unknown
    """
    import cv2

    known = [k for k, ids in enumerate(masks) if ids is not None]
    sums, total = WeightSums(gaussians, [cameras[k] for k in known]), np.zeros((len(gaussians), count + 1))
    for i, k in enumerate(known):
        size = sums.cameras[i].width, sums.cameras[i].height
        for first in range(0, count + 1, 3):
            maps = [(masks[k] == o).astype(np.float32) for o in range(first, first + 3)]
            maps = np.dstack([cv2.resize(m, size, interpolation=cv2.INTER_AREA) for m in maps])
            total[:, first : first + 3] += sums.of(i, maps)[:, : count + 1 - first]
        progress("masks", (i + 1) / len(known))
    sums.destroy()
    return total


def reduced(camera: Camera) -> Camera:
    """The camera with a picture whose longer side is SIDE, if it was longer."""
    s = min(1.0, SIDE / max(camera.width, camera.height))
    width, height = max(1, round(camera.width * s)), max(1, round(camera.height * s))
    sx, sy = width / camera.width, height / camera.height
    return Camera(width, height, camera.fx * sx, camera.fy * sy, camera.cx * sx, camera.cy * sy, camera.world_to_camera)


def needed(gaussians: Gaussians, cameras: Sequence[Camera], found: Contributions) -> np.ndarray:
    """Mask (N,) of the Gaussians that the photographs need, without floaters in front of cameras."""
    keep = found.weight >= NEEDED
    for camera, depth in zip(cameras, found.depth, strict=True):
        if np.isfinite(depth):
            keep &= np.linalg.norm(gaussians.means - camera.position, axis=1) > NEAR_CAMERA * depth
    return keep


class WeightSums:
    """Sums of the blending weights of Gaussians over the pixels of cameras' pictures, whose longer side is SIDE.

    With a map of pixels for dL/dC, the gradient with respect to a Gaussian's colour is the sum of its weights there:
        C = sum_i w_i c_i,   dL/dc_i = sum over pixels of w_i dL/dC.
    """

    def __init__(self, gaussians: Gaussians, cameras: Sequence[Camera], *, sort: str = "radial"):
        self.cameras, self.count = [reduced(c) for c in cameras], len(gaussians)
        height, width = max(c.height for c in self.cameras), max(c.width for c in self.cameras)
        self._splats = Splats(gaussians)
        self._renderer = Renderer(self._splats, width, height, outputs="float", sort=sort)
        self._backward: _BackwardPass | None = None
        self._camera = self.cameras[0]

    def of(self, k: int, maps: np.ndarray | None = None) -> np.ndarray:
        """Sums (N, 3) for camera k over three maps (H, W, 3), or over the whole picture."""
        camera, renderer = self.cameras[k], self._renderer
        if (camera.width, camera.height) != (renderer.width, renderer.height):
            renderer.rasterizer.resize(camera.width, camera.height)
            renderer.width, renderer.height = camera.width, camera.height
        renderer.render([camera])
        self._camera, bins = camera, renderer.rasterizer.tile_pass.bins
        if self._backward is None or self._backward.bins is not bins:
            if self._backward is not None:
                self._backward.destroy()
            self._backward = _BackwardPass(bins, renderer.sink)
        values = np.zeros((*self._backward.shape, 3), np.float32)
        values[: camera.height, : camera.width] = 1.0 if maps is None else maps
        return self._backward.sums(values, self.count)

    def depth(self) -> float:
        """Median depth of the picture that was drawn last; NaN where nothing is in it."""
        rows = slice(0, self._camera.height, DEPTH_PIXELS), slice(0, self._camera.width, DEPTH_PIXELS)
        alpha, depth = (field.to_numpy()[0][rows] for field in (self._renderer.alpha, self._renderer.depth))
        return float(np.median(depth[alpha > MIN_ALPHA])) if (alpha > MIN_ALPHA).any() else float("nan")

    def depth_at(self, u: float, v: float) -> float:
        """Depth at a place of the picture that was drawn last, in parts of its width and height; NaN: nothing there."""
        x, y = (min(int(t * n), n - 1) for t, n in ((u, self._camera.width), (v, self._camera.height)))
        alpha, depth = (field.to_numpy()[0, y, x] for field in (self._renderer.alpha, self._renderer.depth))
        return float(depth) if alpha > MIN_ALPHA else float("nan")

    def destroy(self) -> None:
        """Free the device memory."""
        if self._backward is not None:
            self._backward.destroy()
        self._renderer.destroy()
        self._splats.destroy()


@ti.data_oriented
class _BackwardPass:
    """The kernel that depends on the bins of a picture."""

    def __init__(self, bins, picture):
        self.bins, self.shape = bins, picture.alpha.shape[1:]
        self.gradients = BlendGradients(bins, picture, with_depth=False)

    def destroy(self) -> None:
        """Free the device memory."""
        self.gradients.destroy()

    def sums(self, maps: np.ndarray, count: int) -> np.ndarray:
        """Sums (count, 3) over maps (H, W, 3) float32."""
        self.gradients.d_rgb.from_numpy(maps)
        self._clear(count)
        self._add()
        return self.gradients.sums.to_numpy()[:count, GEOMETRY:].astype(np.float64)

    @ti.kernel
    def _clear(self, count: ti.i32):
        self.gradients.clear(0, count)

    @ti.kernel
    def _add(self):  # a kernel of its own, as it shares arrays
        self.gradients.backward()
