"""Seeds of the patch over a hole: a level square of texels, 1 m wide, whose inner half is the hole."""

import numpy as np
import pytest

from assets.gaussians import Gaussians
from prepare.inpaint.hole_patch import seed_patch
from prepare.inpaint.support_surface import SupportSurface, SurfaceTexture
from tests.support.samples import discs


def seeds(background_spacing: float, texels: int = 96) -> Gaussians:
    """The seeds beside a background with this distance [m] between its Gaussians."""
    hole = np.zeros((texels, texels), bool)
    hole[texels // 4 : -texels // 4, texels // 4 : -texels // 4] = True
    color, plane = np.full((texels, texels, 3), 0.5, np.float32), SupportSurface(np.zeros(3), np.eye(3), 0.001)
    texture = SurfaceTexture(plane, np.full(2, -0.5), 1.0 / texels, color, ~hole, hole)
    x, y = (a.ravel() for a in np.mgrid[-0.5:0.5:background_spacing, -0.5:0.5:background_spacing])
    return seed_patch(texture, discs(np.stack([x, y, 0.0 * x], axis=1), 0.007), 0)


@pytest.mark.parametrize(("spacing", "texels", "least", "most"), [(0.3, 96, 350, 800), (0.0015, 400, 15_000, 25_000)])
def test_a_patch_has_neither_too_few_nor_too_many(spacing, texels, least, most):
    assert least < len(seeds(spacing, texels)) < most


def test_a_patch_is_closed_sharp_and_flat():
    patch = seeds(0.03)
    scale, places = np.exp(patch.log_scales[0]), np.random.default_rng(0).uniform(-0.2, 0.2, (500, 2))
    squares = ((places[:, None] - patch.means[None, :, :2]) ** 2).sum(axis=2)
    alpha = patch.opacities * np.exp(-0.5 * squares / scale[0] ** 2)
    assert (1.0 - alpha).prod(axis=1).max() < 0.12
    assert scale[0] < 0.03 and 0.001 < scale[2] < 0.006
