"""A body drawn where its cage is put, outside of play: as it may stand in a clip, or as it was found to move."""

import numpy as np

from assets.asset import Asset
from core.camera import Camera
from core.fields import FieldGroup
from render.renderer import Renderer
from render.splats import Splats
from sim.embedding import EmbeddedBody, Embedding


class DrawnBody:
    """The Gaussians of an asset, drawn where its cage's vertices are, at first at rest. Taichi must be running."""

    def __init__(self, asset: Asset, width: int, height: int):
        """width, height: [px] of the largest picture."""
        g, cage, e = asset.gaussians, asset.cage, asset.embedding
        self._embedding = Embedding([EmbeddedBody(e.host, e.weights, g, cage.vertices, cage.tets)])
        self._group = FieldGroup()
        self._x = self._group.vector(len(cage.vertices))
        self._group.build()
        self._splats, self._largest = Splats(g), (width, height)
        how = {"sort": g.sort or "radial", "antialias": g.antialias}
        self._renderer = Renderer(self._splats, width, height, outputs="float", **how)

    def move(self, x: np.ndarray) -> None:
        """Be where the vertices are at x (V, 3) [m]."""
        s = self._splats
        self._x.from_numpy(x.astype(np.float32))
        self._embedding.deform(self._x, s.mean, s.cov, s.rotation)

    def picture(self, camera: Camera) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Colours (H, W, 3) 0..1 on black, opacity and depth [m] (H, W); at most as large as said at the start."""
        if camera.width > self._largest[0] or camera.height > self._largest[1]:
            raise ValueError(f"a picture of {camera.width}x{camera.height} is larger than was said")
        if (self._renderer.width, self._renderer.height) != (camera.width, camera.height):
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
        for part in (self._renderer, self._splats, self._embedding, self._group):
            part.destroy()
