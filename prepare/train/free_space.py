"""Free space around the cameras of a training: what hangs there is a floater.

A Gaussian beside a camera, outside its picture, is denied by none of the photographs that see it from afar, and hides
everything from whoever looks from there in another direction.
"""

from collections.abc import Sequence

import numpy as np

from core.camera import Camera

NEAR_SHARE = 0.1  # of a view's pixels that may show something nearer than the depth which counts for it
FREE_SHARE = 0.25  # of that depth: nobody photographs a thing from so near that all else is four times as far
MIN_ALPHA = 0.5  # a pixel of lower opacity has no depth


def near_depth(depth: np.ndarray, alpha: np.ndarray) -> float:
    """Depth that all but NEAR_SHARE of a picture's opaque pixels lie beyond; NaN if it has none."""
    opaque = alpha > MIN_ALPHA
    return float(np.quantile(depth[opaque], NEAR_SHARE)) if opaque.any() else float("nan")


def free_radii(cameras: Sequence[Camera], depths: np.ndarray) -> np.ndarray:
    """Radii (V,) of the balls around the cameras where nothing was photographed; depths: the views' near depths (V,).

    They reach to the next camera at most: the photographer walked there. So where photographs are dense, a wall close
    behind the cameras stays. 0 where a view shows nothing.
    """
    positions = np.array([c.position for c in cameras])
    apart = np.linalg.norm(positions[:, None] - positions, axis=2)
    np.fill_diagonal(apart, np.inf)
    return np.minimum(FREE_SHARE * np.nan_to_num(depths), apart.min(axis=1))


def in_free_space(means: np.ndarray, cameras: Sequence[Camera], radii: np.ndarray) -> np.ndarray:
    """Mask (N,) of the points (N, 3) in one of the balls."""
    inside = np.zeros(len(means), bool)
    for camera, radius in zip(cameras, radii, strict=True):
        inside |= np.linalg.norm(means - camera.position, axis=1) < radius
    return inside
