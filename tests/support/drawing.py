"""One rasterizer for many sets of Gaussians, cameras and picture sizes, so that it is compiled once."""

import numpy as np

from assets.gaussians import Gaussians
from core.camera import Camera

UNTOUCHED = -12345.0  # no pixel's value


class Drawing:
    """Draws up to `capacity` Gaussians of `degree` from `views` cameras, in pictures of up to side x side [px]."""

    def __init__(self, capacity: int, views: int, side: int, *, degree: int, **options):
        from render.rasterizer import Rasterizer
        from render.renderer import FloatImages
        from render.splats import Splats

        full = np.ones((capacity, (degree + 1) ** 2, 3))  # so that the harmonics of all are evaluated
        self.splats = Splats(
            Gaussians.of(np.zeros((capacity, 3)), np.ones((capacity, 4)), np.zeros((capacity, 3)), full[:, 0, 0], full)
        )
        self.sink, self.views, self.degree = FloatImages(views, side, side), views, degree
        self.rasterizer = Rasterizer(self.splats, side, side, views=views, sink=self.sink, **options)

    def draw(self, g: Gaussians, cameras: list[Camera]) -> list[np.ndarray]:
        """rgb (V, H, W, 3), alpha and depth [m] (V, H, W)."""
        return self.draw_fields(g.means, g.covariances, g.opacities, g.with_sh_degree(self.degree).sh, cameras)

    def draw_fields(self, mean, cov, opacity, sh, cameras: list[Camera]) -> list[np.ndarray]:
        """As `draw`, of the values of the splats' fields. Every pixel is written, and none beyond the picture."""
        s = self.splats
        s.count = len(mean)
        for field, values in ((s.mean, mean), (s.cov, cov), (s.opacity, opacity), (s.sh, sh)):
            field.from_numpy(s.padded(values))
        height, width = cameras[0].height, cameras[0].width
        images = [self.sink.rgb, self.sink.alpha, self.sink.depth]
        for image in images:
            image.fill(UNTOUCHED)
        self.rasterizer.resize(width, height)
        self.rasterizer.set_cameras(cameras)
        self.rasterizer.draw(0)
        found = [image.to_numpy() for image in images]
        for image in found:
            inside = np.zeros(image.shape[:3], bool)
            inside[:, :height, :width] = True
            assert (image[~inside] == UNTOUCHED).all() and (image[inside] != UNTOUCHED).all()
        return [image[:, :height, :width] for image in found]

    def depth_order(self) -> np.ndarray:
        """Indices of the Gaussians that were drawn, front to back."""
        sorter = self.rasterizer.order.sorter
        return sorter.sorted_items.to_numpy()[: sorter.kept[None]] >> 32
