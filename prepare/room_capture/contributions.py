"""Contributions of Gaussians to the photographs of a capture, and the pruning of those that no camera needs."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from assets.gaussians import Gaussians
from core.camera import Camera
from core.errors import BadInput
from prepare.blending_weights import BlendingWeights
from prepare.progress import Progress, no_progress

SIDE = 320  # [px] longer side of the pictures in which contributions are summed
NEEDED = 0.5  # [px] least sum of a Gaussian's weights over all these pictures; below, it is pruned
DEPTH_PIXELS = 4  # a view's depth is the median over every DEPTH_PIXELS-th pixel along both axes
MIN_ALPHA = 0.5  # a pixel of lower opacity has no depth
NEAR_CAMERA = 0.12  # fraction of a view's depth: a Gaussian this near to the camera is a floater


@dataclass(frozen=True)
class Contributions:
    """Contributions of N Gaussians to V views, from pictures whose longer side is SIDE.

    weight  blending weight summed over all pixels of all views, (N,) [px]
    depth   median depth of what each view shows, in the Gaussians' unit, (V,); NaN where it shows nothing
    """

    weight: np.ndarray
    depth: np.ndarray


def contributions(gaussians: Gaussians, cameras: Sequence[Camera], progress: Progress = no_progress) -> Contributions:
    """Blending weights of the Gaussians, summed over views. Taichi must be running. Raises BadInput if no view shows
    anything."""
    drawing, weight, depths = BlendingWeights(gaussians, sort="radial"), np.zeros(len(gaussians)), []
    for k, camera in enumerate(map(reduced, cameras)):
        weight += drawing.sums(camera, [np.ones((camera.height, camera.width))])[:, 0]
        _, depth, alpha = (a[::DEPTH_PIXELS, ::DEPTH_PIXELS] for a in drawing.drawn())
        opaque = alpha > MIN_ALPHA
        depths.append(float(np.median(depth[opaque])) if opaque.any() else np.nan)
        progress("views", (k + 1) / len(cameras))
    drawing.destroy()
    if not np.isfinite(depths).any():
        raise BadInput("the photographs show nothing: the training has failed")
    return Contributions(weight, np.array(depths))


def reduced(camera: Camera) -> Camera:
    """The camera with a picture whose longer side is SIDE, if it was longer."""
    s = min(1.0, SIDE / max(camera.width, camera.height))
    return camera.resized(max(1, round(camera.width * s)), max(1, round(camera.height * s)))


def needed(gaussians: Gaussians, cameras: Sequence[Camera], found: Contributions) -> np.ndarray:
    """Mask (N,) of the Gaussians that the photographs need, without floaters in front of cameras."""
    keep = found.weight >= NEEDED
    for camera, depth in zip(cameras, found.depth, strict=True):
        if np.isfinite(depth):
            keep &= np.linalg.norm(gaussians.means - camera.position, axis=1) > NEAR_CAMERA * depth
    return keep


def depth_at(gaussians: Gaussians, camera: Camera, x: float, y: float) -> float:
    """Depth of what a pixel of a camera's picture shows; NaN: nothing. Taichi must be running."""
    small = reduced(camera)
    drawing = BlendingWeights(gaussians, sort="radial")
    _, depth, alpha = drawing.picture(small)
    drawing.destroy()
    row, column = int(y / camera.height * small.height), int(x / camera.width * small.width)
    return float(depth[row, column]) if alpha[row, column] > MIN_ALPHA else float("nan")
