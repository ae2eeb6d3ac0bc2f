"""Film screens: flat Gaussians, one for each pixel of a film, that take the colours of one picture after the other."""

import numpy as np
import taichi as ti

from assets.gaussians import Gaussians
from core.fields import FieldGroup
from core.rotation import quaternions_from_matrices
from core.spherical_harmonics import C0
from core.vocabulary import Screen
from render.splats import Splats

WIDTH, THICKNESS = 0.6, 0.05  # standard deviations of a Gaussian, in pixels: neighbours leave no gaps
LOGIT_OPACITY = 5.0


def screen_gaussians(screen: Screen) -> Gaussians:
    """The Gaussians of a screen with its first picture, row by row from the top left."""
    height, width = screen.pictures.shape[1:3]
    right, down = np.divide(screen.right, width), np.divide(screen.down, height)  # of a pixel [m]
    rows, columns = np.indices((height, width)).reshape(2, -1, 1) + 0.5
    sides = np.linalg.norm([right, down], axis=1)
    axes = np.stack([right / sides[0], down / sides[1], np.cross(right, down) / sides.prod()], 1)
    count = height * width
    return Gaussians.of(
        screen.corner + columns * right + rows * down,
        np.tile(quaternions_from_matrices(axes), (count, 1)),
        np.tile(np.log([WIDTH * sides[0], WIDTH * sides[1], THICKNESS * sides[0]]), (count, 1)),
        np.full(count, LOGIT_OPACITY),
        (screen.pictures[0].reshape(count, 1, 3) / 255 - 0.5) / C0,
    )


@ti.data_oriented
class FilmScreen:
    """The colours of the splats from `first` on, which are those of a screen."""

    def __init__(self, splats: Splats, first: int, screen: Screen):
        self.splats, self.first, self.screen, self.shown = splats, first, screen, 0
        self.pixels = int(np.prod(screen.pictures.shape[1:3]))
        self.fields = f = FieldGroup()
        self.colours = f.vector(*screen.pictures.reshape(-1, self.pixels, 3).shape[:2], dtype=ti.u8)
        f.build()
        self.colours.from_numpy(screen.pictures.reshape(-1, self.pixels, 3))
        self._colour(0)  # compiled before the play

    def show(self, time: float) -> bool:
        """Show the picture nearest to a moment [s] since the film began; returns whether it is another."""
        times = self.screen.times
        picture = int(np.searchsorted(0.5 * (times[1:] + times[:-1]), time % self.screen.period))
        changes, self.shown = picture != self.shown, picture
        if changes:
            self._colour(picture)
        return changes

    @ti.kernel
    def _colour(self, picture: ti.i32):
        for k in range(self.pixels):
            self.splats.sh[self.first + k, 0] = (ti.cast(self.colours[picture, k], ti.f32) / 255.0 - 0.5) / C0
