"""The loss of training: its value and its gradient against float64."""

import numpy as np
import pytest
import taichi as ti
from scipy.ndimage import gaussian_filter

from prepare.train.image_loss import ImageLoss

H, W, DSSIM = 20, 26, 0.3
C1, C2 = (0.01 * 1.0) ** 2, (0.03 * 1.0) ** 2  # (K L)^2 of Wang et al. (2004), for colours in 0..1


def blurred(image: np.ndarray) -> np.ndarray:
    """The window of Wang et al. (2004): 11 pixels of a Gaussian of 1.5; zeros outside of the picture."""
    return gaussian_filter(image, (1.5, 1.5, 0), radius=(5, 5, 0), mode="constant")


def exact(x: np.ndarray, y: np.ndarray, mask: np.ndarray) -> tuple[float, float]:
    """Loss and mean SSIM of images (H, W, 3) over the pixels of a mask."""
    x = np.where(mask[..., None], x, y)
    mx, my = blurred(x), blurred(y)
    xx, yy, xy = blurred(x * x) - mx * mx, blurred(y * y) - my * my, blurred(x * y) - mx * my
    ssim = (2 * mx * my + C1) * (2 * xy + C2) / ((mx * mx + my * my + C1) * (xx + yy + C2))
    similarity = ssim[mask].mean()
    return (1 - DSSIM) * np.abs(x - y)[mask].mean() + DSSIM * (1 - similarity), similarity


@pytest.mark.parametrize("masked", [False, True])
def test_the_loss_and_its_gradient_are_exact(ti_cpu, masked):
    rng = np.random.default_rng(2)
    truth = rng.integers(0, 256, (H, W, 4), dtype=np.uint8)
    truth[..., 3] = 255
    if masked:
        truth[:7, :9, 3], truth[12, 15, 3] = 0, 128
    mask, y = truth[..., 3] > 0, truth[..., :3] / 255.0
    x = (y + rng.normal(0.0, 0.2, y.shape)).astype(np.float32).astype(np.float64)
    loss = ImageLoss(H, W)
    rgb, d_rgb = ti.Vector.field(3, ti.f32, (1, H, W)), ti.Vector.field(3, ti.f32, (H, W))
    photograph = ti.ndarray(ti.u32, (H, W))
    photograph.from_numpy(truth.view("<u4")[..., 0])
    rgb.from_numpy(x[None].astype(np.float32))

    @ti.kernel
    def backward(photograph: ti.types.ndarray(ti.u32, 2), scale: ti.f32):
        loss.backward(rgb, photograph, d_rgb, H, W, scale, DSSIM)

    backward(photograph, 1.0 / (3 * mask.sum()))
    sums = loss.sums.to_numpy().sum(axis=0)
    value, similarity = exact(x, y, mask)
    values = 3 * mask.sum()
    assert sums[3] == mask.sum() and sums[2] / values == pytest.approx(similarity, abs=1e-5)
    assert (1 - DSSIM) * sums[0] / values + DSSIM * (1 - sums[2] / values) == pytest.approx(value, abs=1e-5)
    assert sums[1] / values == pytest.approx(((x - y) ** 2)[mask].mean(), rel=1e-4)
    gradient, step = d_rgb.to_numpy(), 1e-6
    loss.sums.fill(2.0**24)  # from here on float32 has even numbers only
    backward(photograph, 0.0)
    assert (loss.sums.to_numpy()[:, 3] - 2**24).sum() == mask.sum()
    assert not gradient[~mask].any()
    for k in rng.choice(H * W * 3, 60, replace=False):
        at = np.unravel_index(k, (H, W, 3))
        up, down = x.copy(), x.copy()
        up[at] += step
        down[at] -= step
        slope = (exact(up, y, mask)[0] - exact(down, y, mask)[0]) / (2 * step)
        assert float(gradient[at]) == pytest.approx(slope, abs=2e-3 * float(np.abs(gradient).max()))
