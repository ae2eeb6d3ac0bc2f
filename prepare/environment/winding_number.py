"""Signed distance to a surface of oriented points that need not be closed, by the generalised winding number.

w(q) = sum_i a_i n_i . (p_i - q) / (4 pi |p_i - q|^3)  (Barill et al. 2018, eq. 5) jumps by one across the surface,
wherever it ends: under open ground it is 1/2 and above -1/2, in a closed room -1 and behind its walls 0. No single
threshold separates free from solid, but the mean of both sides does, which is the value of w on the surface itself: a
point is solid if its w exceeds that of the surface next to it. The sum is a convolution: a few FFTs on a coarse grid.
"""

from dataclasses import dataclass
from itertools import product

import numpy as np
import taichi as ti
from scipy.fft import irfftn, next_fast_len, rfftn
from scipy.ndimage import distance_transform_edt

from core.distance_grid import DistanceGrid, sample
from prepare.environment.surfels import Surfels, VoxelGrid

COARSENING = 2  # voxel size of the winding number over that of the distance: it is smooth off the surface
SOFTENING = 0.5  # of a coarse voxel; softens the kernel's pole
MIN_JUMP = 0.15  # of the jump of one; less above the surface's mean counts as free
SURFEL_SIGMA = 0.8  # voxels; standard deviation of a surfel's weight
BAND = 2  # voxels on each side of a surfel that its plane influences
MIN_WEIGHT = float(np.exp(-0.5 * (2.0 / SURFEL_SIGMA) ** 2))  # of one surfel two voxels off


@dataclass(frozen=True)
class WindingNumber:
    """Winding number (X, Y, Z) float32 at the nodes origin + spacing (i, j, k) [m]; on the surface, the mean."""

    values: np.ndarray
    origin: np.ndarray
    spacing: float


def winding_number(s: Surfels, origin: np.ndarray, spacing: float, shape: tuple[int, int, int]) -> WindingNumber:
    """Winding number of the surfels on a grid of this shape."""
    field = np.zeros((3, *shape), np.float32)
    local = (s.points - origin) / spacing
    base = np.floor(local).astype(int).clip(0, np.array(shape) - 2)
    f = (local - base).clip(0, 1)
    dipole = (s.areas / spacing**2)[:, None] * s.normals  # in voxels
    for corner in product((0, 1), repeat=3):
        w = np.where(corner, f, 1 - f).prod(1)
        at = np.ravel_multi_index((base + corner).T, shape)
        for c in range(3):
            field[c] += np.bincount(at, w * dipole[:, c], field[c].size).reshape(shape)
    size = [next_fast_len(2 * n - 1, real=True) for n in shape]
    axes = [np.where(np.arange(m) < n, np.arange(m), np.arange(m) - m) for n, m in zip(shape, size, strict=True)]
    x, y, z = (a.astype(np.float32).reshape([-1 if k == i else 1 for k in range(3)]) for i, a in enumerate(axes))
    scale = -((x * x + y * y + z * z + np.float32(SOFTENING**2)) ** np.float32(-1.5)) / np.float32(4 * np.pi)
    total = 0
    for c, a in enumerate((x, y, z)):
        total = total + rfftn(field[c], size, workers=-1) * rfftn(scale * a, size, workers=-1)
    values = irfftn(total, size, workers=-1)[tuple(slice(n) for n in shape)].astype(np.float32)
    return WindingNumber(values, origin, spacing)


def blended_planes(s: Surfels, means: np.ndarray, origin: np.ndarray, spacing: float, shape):
    """Weighted means over the surfels near a node, and the sum of the weights, (X, Y, Z) each.

    The means are of the distances [voxels] to the surfels' planes, and of a value `means` (N,) of each surfel.

    phi(q) = sum w n . (q - p) / sum w, w = exp(-|q - p|^2 / 2 SURFEL_SIGMA^2): smooth, and signed.
    """
    value, middle, weight = (np.zeros(shape, np.float32) for _ in range(3))
    if len(s.points):
        local = (s.points - origin) / spacing
        _gather(*(np.ascontiguousarray(a, np.float32) for a in (local, s.normals, means)), value, middle, weight)
    held = weight > MIN_WEIGHT
    value, middle = (np.where(held, a / np.maximum(weight, 1e-30), 0.0) for a in (value, middle))
    return value, middle, weight


@ti.kernel
def _gather(
    points: ti.types.ndarray(ti.f32, 2),
    normals: ti.types.ndarray(ti.f32, 2),
    means: ti.types.ndarray(ti.f32, 1),
    value: ti.types.ndarray(ti.f32, 3),
    middle: ti.types.ndarray(ti.f32, 3),
    weight: ti.types.ndarray(ti.f32, 3),
):
    """Out: the three sums of `blended_planes`; all in voxels."""
    for s in range(points.shape[0]):
        p = ti.Vector([points[s, 0], points[s, 1], points[s, 2]])
        n = ti.Vector([normals[s, 0], normals[s, 1], normals[s, 2]])
        base = ti.cast(ti.floor(p), ti.i32)
        for i, j, k in ti.ndrange((1 - BAND, 1 + BAND), (1 - BAND, 1 + BAND), (1 - BAND, 1 + BAND)):
            q = base + ti.Vector([i, j, k])
            if q.min() >= 0 and q[0] < value.shape[0] and q[1] < value.shape[1] and q[2] < value.shape[2]:
                r = ti.cast(q, ti.f32) - p
                w = ti.exp(-0.5 * r.norm_sqr() / SURFEL_SIGMA**2)
                value[q[0], q[1], q[2]] += w * n.dot(r)
                middle[q[0], q[1], q[2]] += w * means[s]
                weight[q[0], q[1], q[2]] += w


def signed_distance(
    s: Surfels, winding: WindingNumber, origin, spacing: float, shape, space: VoxelGrid | None = None
) -> DistanceGrid:
    """Signed distance [m] (X, Y, Z) float32, negative where solid, at the nodes origin + spacing (i, j, k).

    winding  on a coarser grid that covers this one
    space    open space, free in any case: as under a board too thin for its two sides to be told apart

    Near the surface the distance is that of the blended planes; farther off, that to the nearest node with one, on the
    side of the winding number.
    """
    on_surface = sample(winding.values, winding.origin, winding.spacing, s.points)
    phi, mean, weight = blended_planes(s, on_surface, origin, spacing, shape)
    held = weight > MIN_WEIGHT
    if not held.any():
        return DistanceGrid(np.full(shape, spacing * max(shape), np.float32), origin, spacing)
    away, nearest = distance_transform_edt(~held, return_indices=True)
    nodes = origin + spacing * np.moveaxis(np.indices(shape, np.float32), 0, -1)
    solid = sample(winding.values, winding.origin, winding.spacing, nodes) > mean[tuple(nearest)] + MIN_JUMP
    if space is not None:
        solid &= ~space.at(nodes.reshape(-1, 3) + 1e-3 * space.spacing).reshape(shape)
    # A node off the band lies `away` voxels from one that is itself |phi| off the surface.
    beyond = away + np.abs(phi[tuple(nearest)])
    far = np.where(solid, -beyond, beyond)
    return DistanceGrid((spacing * np.where(held, phi, far)).astype(np.float32), origin, spacing)
