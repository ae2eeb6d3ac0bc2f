"""Shares of Gaussians that can be seen from views all around them.

A Gaussian that no view shows, inside a thing or between it and what it stands on, looks like anything: training leaves
its colour to chance, and it is no evidence of where one thing ends and another begins.
"""

from __future__ import annotations

import numpy as np

from assets.gaussians import Gaussians
from core.camera import Camera, look_at, perspective
from prepare.blending_weights import BlendingWeights
from prepare.segment.gaussian_graph import adjugate, quadratic_form
from render.projection import DILATION

VIEWS = 24  # 40 degrees apart
PICTURE = 200  # [px] across that ball
ROOM = 1 << 18  # least number of Gaussians for which there is room: another needs other kernels
DISTANCE = 4.0  # radii of a ball that holds the Gaussians: so far away that parallel rays describe the views


class ViewsAround:
    """Views of Gaussians from all sides, drawn again and again: to start takes seconds. Taichi must be running."""

    def __init__(self):
        self._room, self._weights = 0, None

    def shares(self, gaussians: Gaussians) -> np.ndarray:
        """Share (VIEWS, N) float32, 0..1, of each Gaussian that each view shows: the rest is hidden by others."""
        n = len(gaussians)
        self._load(gaussians)
        middle = 0.5 * (gaussians.means.min(axis=0) + gaussians.means.max(axis=0)).astype(np.float64)
        radius = np.linalg.norm(gaussians.means - middle, axis=1).max()
        k = np.arange(VIEWS) + 0.5
        height, turn = 1.0 - 2.0 * k / VIEWS, np.pi * (1 + 5**0.5) * k
        level = np.sqrt(1.0 - height**2)
        ways = np.stack([level * np.cos(turn), height, level * np.sin(turn)], axis=1)
        everywhere = [np.ones((PICTURE, PICTURE), np.float32)]
        sigma, means = gaussians.covariances, gaussians.means.astype(np.float64)
        shares = np.empty((VIEWS, n), np.float32)
        for view, way in enumerate(ways):
            eye = middle + DISTANCE * radius * way
            camera = perspective(PICTURE, PICTURE, 2.0 * np.arcsin(1.0 / DISTANCE), look_at(eye, middle))
            seen = self._weights.sums(camera, everywhere)[:n, 0]
            shares[view] = seen / free_weights(means, sigma, gaussians.opacities, camera, way)
        return shares.clip(0.0, 1.0, out=shares)

    def _load(self, gaussians: Gaussians) -> None:
        """Draw these Gaussians."""
        plain = gaussians.with_sh_degree(0)
        if len(plain) <= self._room:
            self._weights.replace(plain)
        else:
            self.destroy()
            self._room = max(ROOM, 1 << (len(plain) - 1).bit_length())
            self._weights = BlendingWeights(plain, capacity=self._room)

    def destroy(self) -> None:
        """Free the device memory."""
        if self._weights is not None:
            self._weights.destroy()
        self._room, self._weights = 0, None


def free_weights(means: np.ndarray, sigma: np.ndarray, opacities: np.ndarray, camera: Camera, way: np.ndarray):
    """Weights (N,) [px] in the picture of a far camera with nothing in front of the Gaussians; it looks along -way.

    means (N, 3), sigma (N, 6) covariances, opacities (N,)
    The projection along a unit vector d has det Sigma_2D = d^T adj(Sigma) d and tr Sigma_2D = tr Sigma - d^T Sigma d;
    a splat weighs 2 pi opacity sqrt(det(s^2 Sigma_2D + dilation I)), s = f / z.
    """
    scale2 = (camera.fx / ((camera.position - means) @ way).clip(1e-9, None)) ** 2
    flat = quadratic_form(adjugate(sigma), way).clip(0.0, None)
    trace = sigma[:, [0, 3, 5]].sum(1) - quadratic_form(sigma, way)
    det = scale2**2 * flat + DILATION * scale2 * trace + DILATION**2
    return 2.0 * np.pi * opacities * np.sqrt(det)
