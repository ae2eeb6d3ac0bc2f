"""Surfels of a static scene: its surface as points with normals, one a voxel, however the Gaussians overlap."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np
from scipy.ndimage import find_objects, label

from assets.gaussians import Gaussians, normals_and_areas
from core.errors import BadInput
from core.rotation import matrices_from_quaternions

SURFACE_OPACITY = 0.3  # fainter Gaussians are haze
DISC_RADIUS = 1.5  # standard deviations that are covered with points
MAX_ACROSS = 7  # points across a disc: a huge Gaussian must not cost more than 49 others
HAZE_THICKNESS, HAZE_ROUNDNESS = 0.35, 0.3  # least thickness of haze in voxels, and over its width
HAZE_MIN = 0.012  # [m] least thickness of haze
MIN_FLOATER_LENGTH, MIN_FLOATER_AREA = (
    0.4,
    0.12,
)  # [m], [m^2]; an isolated component that is shorter or smaller is a floater


@dataclass(frozen=True)
class Surfels:
    """Points [m] (N, 3) of a surface, one a voxel, with unit normals (N, 3), areas [m^2] (N,) and voxels (N, 3) int."""

    points: np.ndarray
    normals: np.ndarray
    areas: np.ndarray
    cells: np.ndarray

    def select(self, which) -> Surfels:
        """The surfels of an index or a mask."""
        return Surfels(self.points[which], self.normals[which], self.areas[which], self.cells[which])


def disc_samples(g: Gaussians, spacing: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points (M, 3) on the discs of Gaussians at most about `spacing` apart, their weights (M,) and Gaussians (M,)."""
    scales = np.exp(g.log_scales.astype(np.float64))
    order = np.argsort(scales, 1)
    axes = np.take_along_axis(matrices_from_quaternions(g.quats), order[:, None, :], 2)  # columns, shortest first
    s = np.take_along_axis(scales, order, 1)
    across = np.ceil(2 * DISC_RADIUS * s[:, 1:] / spacing).clip(1, MAX_ACROSS).astype(int)
    points, weights, owner = [], [], []
    means, opacities = g.means.astype(np.float64), g.opacities
    for a, b in np.unique(across, axis=0):
        own = np.flatnonzero((across == (a, b)).all(1))
        for i, j in product(range(a), range(b)):
            u, v = (DISC_RADIUS * ((2 * k + 1) / n - 1) for k, n in ((i, a), (j, b)))
            if u * u + v * v <= DISC_RADIUS**2 * 1.02:
                offset = u * s[own, 1, None] * axes[own, :, 1] + v * s[own, 2, None] * axes[own, :, 2]
                points.append(means[own] + offset)
                weights.append(opacities[own] * np.exp(-0.5 * (u * u + v * v)))
                owner.append(own)
    return np.concatenate(points), np.concatenate(weights), np.concatenate(owner)


def surfels(g: Gaussians, origin: np.ndarray, spacing: float, shape: tuple[int, int, int]) -> Surfels:
    """One surfel for each voxel of a grid that the Gaussians touch, with normals of arbitrary sign.

    Voxel (i, j, k) has its corner at origin + spacing (i, j, k) [m].

    The normal is the direction of the least spread of the Gaussians of the voxel and of its 26 neighbours, with their
    own extents: sum w ((x - mean)(x - mean)^T + n-flattened Sigma). Area: that of a plane in a cube. Raises BadInput
    where there are no Gaussians.
    """
    if not len(g):
        raise BadInput("nothing is opaque and thin enough to be solid; there is no surface")
    x, w, owner = disc_samples(g, 0.7 * spacing)
    cell = np.floor((x - origin) / spacing).astype(np.int64)
    within = ((cell >= 0) & (cell < shape)).all(1)
    x, w, owner, cell = x[within], w[within], owner[within], cell[within]
    flat = np.ravel_multi_index(cell.T, shape)
    voxels, index = np.unique(flat, return_inverse=True)
    n = len(voxels)
    total = np.bincount(index, w, n)
    local = (x - origin) / spacing  # in voxels: small numbers for the moments
    first = np.stack([np.bincount(index, w * local[:, k], n) for k in range(3)], 1)
    mean = first / total[:, None]
    normal, _ = normals_and_areas(g)
    pairs = [(0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)]
    second = np.stack([np.bincount(index, w * local[:, a] * local[:, b], n) for a, b in pairs], 1)
    facing = np.stack([np.bincount(index, w * normal[owner, a] * normal[owner, b], n) for a, b in pairs], 1)
    cells = np.stack(np.unravel_index(voxels, shape), 1)
    around = [np.zeros_like(a) for a in (total, first, second, facing)]
    for step in product((-1, 0, 1), repeat=3):
        other = cells + step
        inside = ((other >= 0) & (other < shape)).all(1)
        key = np.where(inside, np.ravel_multi_index(other.T, shape, mode="clip"), -1)
        at = np.searchsorted(voxels, key).clip(0, n - 1)
        hit = voxels[at] == key
        for sums, own in zip(around, (total, first, second, facing), strict=True):
            sums[hit] += own[at[hit]]
    m, f, q, facing = around
    centre = f / m[:, None]
    spread = np.stack([q[:, k] / m - centre[:, a] * centre[:, b] for k, (a, b) in enumerate(pairs)], 1)
    # The own normals of flat Gaussians tell more than their positions: they are right within one voxel.
    spread = spread - facing / m[:, None]
    normals = np.linalg.eigh(spread[:, [0, 1, 2, 1, 3, 4, 2, 4, 5]].reshape(-1, 3, 3))[1][:, :, 0]
    areas = spacing**2 / np.abs(normals).max(1)
    return Surfels(origin + spacing * mean, normals, areas, cells)


def haze(g: Gaussians, h: float) -> np.ndarray:
    """Mask (N,) of haze: Gaussians that are round and thick for voxels of h [m]; flat or small ones cover a surface."""
    s = np.sort(np.exp(g.log_scales.astype(np.float64)), 1)
    return (s[:, 0] > max(HAZE_THICKNESS * h, HAZE_MIN)) & (s[:, 0] > HAZE_ROUNDNESS * s[:, 1])


def without_floaters(s: Surfels, shape: tuple[int, int, int], spacing: float) -> Surfels:
    """The surfels of components, connected across corners, of at least MIN_FLOATER_LENGTH and MIN_FLOATER_AREA."""
    grid = np.zeros(shape, bool)
    grid[tuple(s.cells.T)] = True
    labels, _ = label(grid, np.ones((3, 3, 3)))
    of = labels[tuple(s.cells.T)]
    long = [0, *(max(c.stop - c.start for c in box) for box in find_objects(labels))]
    keep = (spacing * np.array(long) >= MIN_FLOATER_LENGTH) & (
        spacing**2 * np.bincount(of, minlength=len(long)) >= MIN_FLOATER_AREA
    )
    return s.select(keep[of])
