"""One renderer for many sets of Gaussians, cameras and sizes of picture, so that it is compiled once."""

from __future__ import annotations

import numpy as np

from assets.gaussians import Gaussians
from core.camera import Camera

UNTOUCHED = -12345.0  # what no pixel's value is


class Drawing:
    """Draws up to `capacity` Gaussians of `degree` from `views` cameras, in pictures of up to side x side [px]."""

    def __init__(self, capacity: int, views: int, side: int, *, degree: int, **options):
        from render.rasterizer import Rasterizer
        from render.renderer import FloatImages
        from render.splats import Splats

        full = np.ones((capacity, (degree + 1) ** 2, 3))  # so that the bands of all are looked at
        self.splats = Splats(
            Gaussians.of(np.zeros((capacity, 3)), np.ones((capacity, 4)), np.zeros((capacity, 3)), full[:, 0, 0], full)
        )
        self.sink, self.views = FloatImages(views, side, side), views
        self.raster = Rasterizer(self.splats, side, side, views=views, sink=self.sink, **options)

    def draw(self, g: Gaussians, cameras: list[Camera]) -> list[np.ndarray]:
        """rgb (V, H, W, 3), alpha and depth [m] (V, H, W)."""
        from render.splats import covariances

        return self.draw_fields(g.means, covariances(g), g.opacities, g.sh, cameras)

    def draw_fields(self, mean, cov, opacity, sh, cameras: list[Camera]) -> list[np.ndarray]:
        """The same of what the device's fields are to hold. Every pixel is written, and none beyond the picture."""
        self.splats.count = len(mean)
        for name, values in (("mean", mean), ("cov", cov), ("opacity", opacity), ("sh", sh)):
            getattr(self.splats, name).from_numpy(self.splats._padded(values))
        height, width = cameras[0].height, cameras[0].width
        images = [self.sink.rgb, self.sink.alpha, self.sink.depth]
        for image in images:
            image.fill(UNTOUCHED)
        self.raster.resize(width, height)
        for v, camera in enumerate(cameras):
            self.raster.set_camera(v, camera)
        self.raster.draw(0)
        found = [image.to_numpy() for image in images]
        for image in found:
            inside = np.zeros(image.shape[:3], bool)
            inside[:, :height, :width] = True
            assert (image[~inside] == UNTOUCHED).all() and (image[inside] != UNTOUCHED).all()
        return [image[:, :height, :width] for image in found]
