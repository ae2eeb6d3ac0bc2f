"""Pictures of a body that its cage carries, for finding it in a clip and for showing what was fitted."""

from __future__ import annotations

import cv2
import numpy as np
import scipy.sparse as sp

from assets.asset import Asset
from core.camera import Camera
from core.rotation import best_fit_rotation, quaternions_from_matrices
from prepare.fit.clip_masks import Clip
from prepare.fit.marker_tracks import MarkerTracks

ALIGNED_SIDE = 200  # [px] of a square picture in which a pose is refined: it is always small enough
SHOWN = 6  # pictures of a clip in a report
OUTLINE, DOT = (230, 60, 40), (40, 200, 60)


class DrawnBody:
    """The Gaussians of an asset, drawn where its cage's vertices are, at first at rest. Taichi must be running.

    y_k = sum_j W_kj x_j,   F = [y1-y0, y2-y0, y3-y0] D^-1,   mu = mean(y) + F d,   Sigma = F Sigma_0 F^T,
    d = mu_0 - mean(y_0)                                                                       VR-GS, Sec. 4.3.2
    """

    def __init__(self, asset: Asset, width: int, height: int):
        from render.renderer import Renderer
        from render.splats import Splats

        self.gaussians, cage, embedding = asset.gaussians, asset.cage, asset.embedding
        weights = np.asarray(embedding.weights, np.float64)
        weights = weights / weights.sum(2, keepdims=True)
        rows = np.repeat(np.arange(4 * len(weights)), 4)
        shape = (4 * len(weights), len(cage.vertices))
        self._corners = sp.csr_matrix((weights.ravel(), (rows, cage.tets[embedding.host].ravel())), shape)
        y = self._at(np.asarray(cage.vertices, np.float64))
        self._inverse = np.linalg.inv(edges_of(y))
        self._offset = self.gaussians.means - y.mean(1)
        xx, xy, xz, yy, yz, zz = self.gaussians.covariances.astype(np.float64).T
        self._cov = np.stack([xx, xy, xz, xy, yy, yz, xz, yz, zz], 1).reshape(-1, 3, 3)
        self._splats = Splats(self.gaussians)
        how = {"sort": self.gaussians.sort or "radial", "antialias": self.gaussians.antialias}
        self._largest = max(height, ALIGNED_SIDE), max(width, ALIGNED_SIDE)
        self._renderer = Renderer(self._splats, *self._largest[::-1], outputs="float", **how)

    def _at(self, x: np.ndarray) -> np.ndarray:
        """Corners of the local tets (N, 4, 3)."""
        return (self._corners @ x).reshape(-1, 4, 3)

    def move(self, x: np.ndarray) -> None:
        """Be where the vertices are at x (V, 3) [m]."""
        y = self._at(x)
        F = edges_of(y) @ self._inverse
        mean = y.mean(1) + np.einsum("nij,nj->ni", F, self._offset)
        S = F @ self._cov @ F.transpose(0, 2, 1)
        s = self._splats
        for field, values in (
            (s.mean, mean),
            (s.cov, S[:, [0, 0, 0, 1, 1, 2], [0, 1, 2, 1, 2, 2]]),
            (s.rotation, quaternions_from_matrices(best_fit_rotation(F))),
        ):
            field.from_numpy(s.padded(values.astype(np.float32)))

    def picture(self, camera: Camera) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Colours (H, W, 3) 0..1 on black, opacity and depth [m] (H, W); at most as large as said at the start."""
        if camera.height > self._largest[0] or camera.width > self._largest[1]:
            raise ValueError(f"a picture of {camera.width}x{camera.height} is larger than was said")
        if (self._renderer.height, self._renderer.width) != (camera.height, camera.width):
            self._renderer.resize(camera.width, camera.height)
        self._renderer.render([camera])
        part = np.s_[0, : camera.height, : camera.width]
        rgb, alpha, depth = (getattr(self._renderer, name).to_numpy()[part] for name in ("rgb", "alpha", "depth"))
        return rgb.clip(0, 1), alpha.clip(0, 1), depth

    def over(self, behind: np.ndarray, camera: Camera) -> np.ndarray:
        """The body before a picture (H, W, 3) uint8, as that is."""
        rgb, alpha, _ = self.picture(camera)
        return (255 * rgb + (1 - alpha[..., None]) * behind + 0.5).clip(0, 255).astype(np.uint8)

    def destroy(self) -> None:
        """Free the device memory."""
        self._renderer.destroy()
        self._splats.destroy()


def edges_of(y: np.ndarray) -> np.ndarray:
    """Matrices (N, 3, 3) whose columns are the edges from the first corner of tets (N, 4, 3)."""
    return (y[:, 1:] - y[:, :1]).transpose(0, 2, 1)


def mask_pictures(clip: Clip, masks: np.ndarray, tracks: MarkerTracks) -> dict[str, np.ndarray]:
    """Some pictures of a clip with the outline of the thing and the markers that are followed, by their names."""
    shown = {}
    for k in np.linspace(0, len(masks) - 1, SHOWN).round().astype(int):
        picture = clip.pictures[k].copy()
        lines, _ = cv2.findContours(masks[k].astype(np.uint8), cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)
        cv2.drawContours(picture, lines, -1, OUTLINE, 1)
        for place in tracks.points[k][tracks.seen[k]] / tracks.metres:
            cv2.circle(picture, tuple(np.floor(place).astype(int).tolist()), 1, DOT, -1)
        shown[f"frame_{clip.first + k:04d}, {clip.times[k]:.2f} s"] = picture
    return shown


def backdrop_of(pictures: np.ndarray, masks: np.ndarray) -> np.ndarray:
    """The picture behind the thing, (H, W, 3) uint8: medians over time, and what it always hides filled in."""
    around = np.stack([cv2.dilate(m.astype(np.uint8), np.ones((7, 7), np.uint8)) for m in masks]) > 0
    seen = np.ma.masked_array(pictures, np.broadcast_to(around[..., None], pictures.shape))
    middle = np.ma.median(seen, axis=0).filled(0).astype(np.uint8)
    return cv2.inpaint(middle, around.all(0).astype(np.uint8), 5, cv2.INPAINT_TELEA)
