"""Surfels of a static scene: its surface as points with normals, one a voxel, however the Gaussians overlap.

Lines of sight from points in the open space tell which side of the surface is free.
"""

from dataclasses import dataclass
from itertools import product

import numpy as np
import taichi as ti
from scipy.ndimage import binary_dilation, find_objects, label

from assets.gaussians import Gaussians, normals_and_areas, symmetric_matrices
from core.errors import BadInput
from core.rotation import matrices_from_quaternions

DISC_RADIUS = 1.5  # standard deviations that are covered with points
MAX_ACROSS = 7  # points across a disc: a huge Gaussian must not cost more than 49 others
HAZE_THICKNESS, HAZE_ROUNDNESS = 0.35, 0.3  # least thickness of haze in voxels, and over its width
HAZE_MIN = 0.012  # [m] least thickness of haze
MIN_LENGTH, MIN_AREA = 0.4, 0.12  # [m], [m^2]; an isolated component that is shorter or smaller is a floater


@dataclass(frozen=True)
class Surfels:
    """Points [m] (N, 3) of a surface, one a voxel, with unit normals (N, 3), areas [m^2] (N,) and voxels (N, 3) int."""

    points: np.ndarray
    normals: np.ndarray
    areas: np.ndarray
    cells: np.ndarray

    def select(self, which) -> "Surfels":
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

    Voxel (i, j, k) has its corner at origin + spacing (i, j, k) [m]. The normal is the direction of the least spread of
    the Gaussians of the voxel and of its 26 neighbours, with their own extents: sum w ((x - mean)(x - mean)^T
    + n-flattened Sigma). Area: that of a plane in a cube. Raises BadInput where there are no Gaussians.
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
    normals = np.linalg.eigh(symmetric_matrices(spread))[1][:, :, 0]
    areas = spacing**2 / np.abs(normals).max(1)
    return Surfels(origin + spacing * mean, normals, areas, cells)


def haze(g: Gaussians, h: float) -> np.ndarray:
    """Mask (N,) of haze: Gaussians that are round and thick for voxels of h [m]; flat or small ones cover a surface."""
    s = np.sort(np.exp(g.log_scales.astype(np.float64)), 1)
    return (s[:, 0] > max(HAZE_THICKNESS * h, HAZE_MIN)) & (s[:, 0] > HAZE_ROUNDNESS * s[:, 1])


def without_floaters(s: Surfels, shape: tuple[int, int, int], spacing: float) -> Surfels:
    """The surfels of components, connected across corners, of at least MIN_LENGTH and MIN_AREA."""
    grid = np.zeros(shape, bool)
    grid[tuple(s.cells.T)] = True
    labels, _ = label(grid, np.ones((3, 3, 3)))
    of = labels[tuple(s.cells.T)]
    length = spacing * np.array([0, *(max(c.stop - c.start for c in box) for box in find_objects(labels))])
    area = spacing**2 * np.bincount(of, minlength=len(length))
    return s.select(((length >= MIN_LENGTH) & (area >= MIN_AREA))[of])


VIEWERS = 28
VIEWER_HEIGHTS = (0.15, 2.0)  # [m] above the floor; low viewers see tables from below
RAY_OFFSET = 1.5  # voxels off the surface where a line of sight begins
SELF_OCCLUSION = 0.035  # [m] off the surface within which its own noise does not hide it
FINE_LENGTH = 16.0  # voxels of a line of sight in which the finer grid is looked up
RAY_STEP = 0.7  # voxels
MIN_COSINE = 0.1  # flatter lines of sight are ambiguous


@dataclass(frozen=True)
class VoxelGrid:
    """Occupied voxels (X, Y, Z) bool of a grid with its corner at `origin` (3,) [m]."""

    occupied: np.ndarray
    origin: np.ndarray
    spacing: float

    @classmethod
    def of(cls, voxels: np.ndarray, origin, spacing: float, shape) -> "VoxelGrid":
        """Grid in which the given voxels (N, 3) are occupied."""
        occupied = np.zeros(shape, bool)
        occupied[tuple(voxels.T)] = True
        return cls(occupied, np.asarray(origin, np.float64), float(spacing))

    def at(self, points: np.ndarray) -> np.ndarray:
        """Mask (N,) of points (N, 3) [m] in occupied voxels; outside of the grid there are none."""
        i = np.floor((points - self.origin) / self.spacing).astype(np.int32)
        found = ((i >= 0) & (i < self.occupied.shape)).all(1)
        found[found] = self.occupied[tuple(i[found].T)]
        return found


def open_space(room: VoxelGrid, floor: float, viewers: np.ndarray | None = None) -> VoxelGrid:
    """The largest connected empty space over the floor [m], or that with most of the viewers (V, 3) [m], as the
    occupied voxels of a grid."""
    free = ~binary_dilation(room.occupied, np.ones((3, 3, 3)))  # holes in a surface are closed
    free &= (room.origin[1] + room.spacing * (np.arange(free.shape[1]) + 0.5) > floor)[None, :, None]
    labels, count = label(free)
    here = np.zeros(0, int)
    if viewers is not None:
        i = np.floor((viewers - room.origin) / room.spacing).astype(int)
        here = labels[tuple(i[((i >= 0) & (i < free.shape)).all(1)].T)]
    if (here > 0).any():
        free = labels == np.bincount(here[here > 0]).argmax()
    elif count:
        free = labels == np.bincount(labels.ravel())[1:].argmax() + 1
    return VoxelGrid(free, room.origin, room.spacing)


def viewers_in(space: VoxelGrid, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Points (V, 3) [m] in an open space over the floor y = 0, at VIEWER_HEIGHTS, between corners (3,) in x and z."""
    centres = space.origin + space.spacing * (np.argwhere(space.occupied) + 0.5)
    low, high = (np.array([end[0], y, end[2]]) for end, y in zip((low, high), VIEWER_HEIGHTS, strict=True))
    inside = centres[((centres > low) & (centres < high)).all(1)]
    return inside[np.random.default_rng(0).choice(len(inside), min(VIEWERS, len(inside)), replace=False)]


@ti.func
def occupied_at(grid: ti.template(), origin, spacing, p):
    """Value of the voxel at p: 1 occupied, 0 free, -1 outside of the grid."""
    i = ti.cast(ti.floor((p - origin) / spacing), ti.i32)
    n = ti.Vector([grid.shape[0], grid.shape[1], grid.shape[2]])
    found = -1
    if i.min() >= 0 and (n - i).min() > 0:
        found = ti.cast(grid[i[0], i[1], i[2]], ti.i32)
    return found


@ti.func
def is_clear(x, direction, length, near: ti.template(), near_origin, h, far: ti.template(), far_origin, far_h):
    """1 if no voxel is occupied on the line of sight from x; `near` is the finer grid, beyond which `far` is asked.

    The surface's own voxels around x do not count until the line has left them, or SELF_OCCLUSION.
    """
    lead = ti.max(SELF_OCCLUSION - RAY_OFFSET * h, 0.0)
    travelled, left, clear = 0.0, False, 1
    while travelled < length - 2.0 * RAY_OFFSET * h and clear == 1:
        step, found = h, -1
        if travelled < FINE_LENGTH * h:
            found = occupied_at(near, near_origin, h, x)
        if found < 0:
            step, found = far_h, occupied_at(far, far_origin, far_h, x)
        if found == 1 and (left or travelled > lead):
            clear = 0
        left = left or found <= 0
        x += RAY_STEP * step * direction
        travelled += RAY_STEP * step
    return clear


@ti.kernel
def count_votes(
    points: ti.types.ndarray(ti.f32, 2),
    normals: ti.types.ndarray(ti.f32, 2),
    viewers: ti.types.ndarray(ti.f32, 2),
    near: ti.types.ndarray(ti.u8, 3),
    near_origin: ti.types.vector(3, ti.f32),
    h: ti.f32,
    far: ti.types.ndarray(ti.u8, 3),
    far_origin: ti.types.vector(3, ti.f32),
    far_h: ti.f32,
    votes: ti.types.ndarray(ti.f32, 1),
):
    """Out: votes = sum over the viewers that see point p of the cosine between its normal and their direction."""
    for s in range(points.shape[0]):
        p = ti.Vector([points[s, 0], points[s, 1], points[s, 2]])
        n = ti.Vector([normals[s, 0], normals[s, 1], normals[s, 2]])
        total = 0.0
        for v in range(viewers.shape[0]):
            direction = ti.Vector([viewers[v, 0], viewers[v, 1], viewers[v, 2]]) - p
            length = direction.norm()
            direction /= ti.max(length, 1e-6)
            cosine = n.dot(direction)
            if ti.abs(cosine) > MIN_COSINE and length > 3.0 * RAY_OFFSET * h:
                start = p + (RAY_OFFSET * h) * ti.math.sign(cosine) * n  # on the viewer's side of the surface
                total += cosine * is_clear(start, direction, length, near, near_origin, h, far, far_origin, far_h)
        votes[s] = total


def oriented(s: Surfels, viewers: np.ndarray, near: VoxelGrid, far: VoxelGrid) -> Surfels:
    """The visible surfels, their normals towards the viewers that see them. Taichi must be running."""
    votes = np.zeros(len(s.points), np.float32)
    if len(votes) and len(viewers):
        f32 = [np.ascontiguousarray(a, np.float32) for a in (s.points, s.normals, viewers)]
        grids = [np.ascontiguousarray(c.occupied, np.uint8) for c in (near, far)]
        origins = [ti.Vector([float(o) for o in c.origin]) for c in (near, far)]
        count_votes(*f32, grids[0], origins[0], near.spacing, grids[1], origins[1], far.spacing, votes)
    facing = s.normals * np.sign(votes)[:, None]
    return Surfels(s.points, facing, s.areas, s.cells).select(votes != 0)
