"""Solid cells of a grid: the dense shell of the Gaussians and what it encloses (PhysGaussian, Sec. 3.5).

A splat is a shell with a hole where no camera looked, mostly the underside. A cell is interior if rays along the axes
hit the shell in five of six directions and one of them crosses it an odd number of times.
"""

import numpy as np
import taichi as ti

from assets.gaussians import Gaussians
from core.rotation import matrices_from_quaternions
from prepare.cage.level_set import dilated_18

DENSE = 0.5  # summed opacity; the visible surface is about where half of the light is absorbed
BLUR = 0.5  # cells; standard deviation added to each Gaussian, so that none falls between the nodes
CUTOFF = 3.0  # standard deviations splatted
MAX_CUTOFF_CELLS = 12.0  # a smear must not cost more than thousands of other Gaussians


@ti.kernel
def _add(
    mean: ti.types.ndarray(dtype=ti.f32, ndim=2),
    inverse: ti.types.ndarray(dtype=ti.f32, ndim=2),
    opacity: ti.types.ndarray(dtype=ti.f32, ndim=1),
    radius: ti.types.ndarray(dtype=ti.f32, ndim=2),
    density: ti.types.ndarray(dtype=ti.f32, ndim=3),
):
    """density(x) += sum_g o_g exp(-1/2 (x - mu)^T Sigma^-1 (x - mu)); all in cells, node (i, j, k) at (i, j, k)."""
    for g in range(opacity.shape[0]):
        mu = ti.Vector([mean[g, 0], mean[g, 1], mean[g, 2]])
        r = ti.Vector([radius[g, 0], radius[g, 1], radius[g, 2]])
        last = ti.Vector([density.shape[0], density.shape[1], density.shape[2]]) - 1.0
        low = ti.cast(ti.ceil(ti.math.clamp(mu - r, 0.0, last)), ti.i32)  # clamped as floats: no integer overflow
        high = ti.cast(ti.floor(ti.math.clamp(mu + r, -1.0, last)), ti.i32)
        for i in range(low[0], high[0] + 1):
            for j in range(low[1], high[1] + 1):
                for k in range(low[2], high[2] + 1):
                    d = ti.Vector([i, j, k]) - mu
                    q = inverse[g, 0] * d[0] * d[0] + inverse[g, 3] * d[1] * d[1] + inverse[g, 5] * d[2] * d[2]
                    q += 2 * (inverse[g, 1] * d[0] * d[1] + inverse[g, 2] * d[0] * d[2] + inverse[g, 4] * d[1] * d[2])
                    if q < CUTOFF * CUTOFF:
                        density[i, j, k] += opacity[g] * ti.exp(-0.5 * q)


def density_of(gaussians: Gaussians, origin: np.ndarray, spacing: float, shape: tuple[int, int, int]) -> np.ndarray:
    """Summed opacity (X, Y, Z) float32 at the nodes origin + spacing (i, j, k) [m]. Taichi must be running."""
    variances = (np.exp(gaussians.log_scales.astype(np.float64)) / spacing) ** 2 + BLUR**2
    axes = matrices_from_quaternions(gaussians.quats)
    spread = np.einsum("nik,nk->ni", axes**2, variances)
    radius = np.minimum(CUTOFF * np.sqrt(spread), MAX_CUTOFF_CELLS)
    scaled = axes / variances[:, None]
    inverse = np.stack([(scaled[:, i] * axes[:, j]).sum(1) for i in range(3) for j in range(i, 3)], 1)
    means, density = (gaussians.means - origin) / spacing, np.zeros(shape, np.float32)
    _add(*(np.ascontiguousarray(a, np.float32) for a in (means, inverse, gaussians.opacities, radius)), density)
    return density


def interior(shell: np.ndarray, *, up: tuple[int, int] | None = (1, 1)) -> np.ndarray:
    """Cells (X, Y, Z) bool that the shell (X, Y, Z) bool encloses, up to a hole on one side.

    up  axis and sign of the direction that must hit, so that a cup is not filled to its rim; None: any may miss
    """
    hits = np.zeros(shell.shape, np.uint8)
    odd = np.zeros(shell.shape, bool)
    capped = np.ones(shell.shape, bool)
    for axis in range(3):
        for sign in (1, -1):
            ray = np.flip(shell, axis) if sign > 0 else shell  # accumulates from the ray's end
            enters = ray.copy()
            np.moveaxis(enters, axis, 0)[1:] &= ~np.moveaxis(ray, axis, 0)[:-1]
            crossings = np.cumsum(enters, axis, dtype=np.uint8)  # at most 128: grids are below 256
            crossings = np.flip(crossings, axis) if sign > 0 else crossings
            hits += crossings > 0
            odd |= (crossings & 1).view(bool)
            if up == (axis, sign):
                capped = crossings > 0
    return ~shell & (hits >= 5) & odd & capped


def solid_cells(density: np.ndarray) -> np.ndarray:
    """Solid cells (X, Y, Z) bool: the dense shell with its hairline gaps closed, and its interior."""
    shell = np.pad(density > DENSE, 2)  # closing must not see the border
    shell = ~dilated_18(~dilated_18(shell))[2:-2, 2:-2, 2:-2]
    return shell | interior(shell)
