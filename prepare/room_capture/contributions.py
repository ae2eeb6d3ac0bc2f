"""Contributions of Gaussians to the photographs of a capture, and the pruning of those that no camera needs."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import taichi as ti

from assets.gaussians import Gaussians
from core.camera import Camera
from render.blend_gradients import BlendGradients
from render.renderer import Renderer
from render.splats import Splats

SIDE = 320  # [px] of the longer side of the pictures in which contributions are summed
NEEDED = 0.5  # [px] that a Gaussian fills in all pictures of that size together, at least: below, nobody would miss it
DEPTH_PIXELS = 4  # every so many-th pixel on both axes tells the depth of a view
MIN_ALPHA = 0.5  # of a pixel that has a depth
NEAR_CAMERA = 0.12  # of a view's depth: where a camera was there is air; what lies so near to it is a floater


@dataclass(frozen=True)
class Contributions:
    """Contributions of N Gaussians to V views, from pictures whose longer side is SIDE.

    weight  sum over all pixels of all views of the blending weight, (N,) [px]
    views   number of views to which it gives a tenth of a pixel or more, (N,)
    depth   median depth of what each view shows, in the Gaussians' unit, (V,); NaN where it shows nothing
    """

    weight: np.ndarray
    views: np.ndarray
    depth: np.ndarray


def contributions(gaussians: Gaussians, cameras: Sequence[Camera], *, sort: str = "radial") -> Contributions:
    """Blending weights of the Gaussians, summed over views. Taichi must be running.

    With dL/dC = (1, 1, 1) at each pixel the gradient by a Gaussian's colour is the sum of its weights:
        C = sum_i w_i c_i,   dL/dc_i = sum over pixels of w_i.
    """
    cameras = [reduced(c) for c in cameras]
    height, width = max(c.height for c in cameras), max(c.width for c in cameras)
    splats = Splats(gaussians)
    renderer = Renderer(splats, width, height, outputs="float", sort=sort)
    n, rasterizer, backward = len(gaussians), renderer.rasterizer, None
    weight, views, depths = np.zeros(n), np.zeros(n, np.int32), []
    for camera in cameras:
        if (camera.width, camera.height) != (renderer.width, renderer.height):
            rasterizer.resize(camera.width, camera.height)
            renderer.width, renderer.height = camera.width, camera.height
        renderer.render([camera])
        bins = rasterizer.tile_pass.bins
        if backward is None or backward.bins is not bins:
            if backward is not None:
                backward.destroy()
            backward = _WeightSums(bins, renderer.sink)
        of_view = backward.weights(n)
        weight += of_view
        views += of_view >= 0.1
        rows = slice(0, camera.height, DEPTH_PIXELS), slice(0, camera.width, DEPTH_PIXELS)
        alpha, depth = (field.to_numpy()[0][rows] for field in (renderer.alpha, renderer.depth))
        depths.append(float(np.median(depth[alpha > MIN_ALPHA])) if (alpha > MIN_ALPHA).any() else np.nan)
    if backward is not None:
        backward.destroy()
    renderer.destroy()
    splats.destroy()
    return Contributions(weight, views, np.array(depths))


def reduced(camera: Camera) -> Camera:
    """The camera with a picture whose longer side is SIDE, if it was longer."""
    s = min(1.0, SIDE / max(camera.width, camera.height))
    width, height = max(1, round(camera.width * s)), max(1, round(camera.height * s))
    sx, sy = width / camera.width, height / camera.height
    return Camera(width, height, camera.fx * sx, camera.fy * sy, camera.cx * sx, camera.cy * sy, camera.world_to_camera)


def needed(gaussians: Gaussians, cameras: Sequence[Camera], found: Contributions) -> np.ndarray:
    """Mask (N,) of the Gaussians that the photographs need and that do not float where a camera was."""
    keep = found.weight >= NEEDED
    for camera, depth in zip(cameras, found.depth, strict=True):
        if np.isfinite(depth):
            keep &= np.linalg.norm(gaussians.means - camera.position, axis=1) > NEAR_CAMERA * depth
    return keep


@ti.data_oriented
class _WeightSums:
    """Blending weights of the Gaussians of a picture, by the backward pass of its blending."""

    def __init__(self, bins, picture):
        self.bins = bins
        self.gradients = BlendGradients(bins, picture)
        self.gradients.d_rgb.fill(1.0)
        self.gradients.d_alpha.fill(0.0)
        self.gradients.d_depth.fill(0.0)

    def destroy(self) -> None:
        """Free the device memory."""
        self.gradients.destroy()

    def weights(self, count: int) -> np.ndarray:
        """Sums (count,) for the picture that was drawn last."""
        self._sum(count)
        return self.gradients.d_color.to_numpy()[:count, 0].astype(np.float64)

    @ti.kernel
    def _sum(self, count: ti.i32):
        self.gradients.clear(0, count)
        self.gradients.backward()
