"""Visibility of surfels from points in the open space: it tells which side of the surface is free."""

from dataclasses import dataclass

import numpy as np
import taichi as ti
from scipy.ndimage import binary_dilation, label

from prepare.environment.surfels import Surfels

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


def viewers_in(
    space: VoxelGrid, low: np.ndarray, high: np.ndarray, floor: float, rng: np.random.Generator
) -> np.ndarray:
    """Points [m] (V, 3) in an open space, at VIEWER_HEIGHTS over the floor, between x, z `low` and `high` (2,)."""
    at = [space.origin[k] + space.spacing * (np.arange(n) + 0.5) for k, n in enumerate(space.occupied.shape)]
    limits = (low[0], high[0]), (floor + VIEWER_HEIGHTS[0], floor + VIEWER_HEIGHTS[1]), (low[1], high[1])
    x, y, z = ((p > a) & (p < b) for p, (a, b) in zip(at, limits, strict=True))
    inside = np.argwhere(space.occupied & x[:, None, None] & y[:, None] & z)
    chosen = rng.choice(len(inside), min(VIEWERS, len(inside)), replace=False)
    return space.origin + space.spacing * (inside[chosen] + 0.5)


@ti.func
def occupied_at(grid: ti.template(), origin, spacing, p):
    """Value of the voxel at p: 1 occupied, 0 free, -1 outside of the grid."""
    i = ti.cast(ti.floor((p - origin) / spacing), ti.i32)
    n = ti.Vector([grid.shape[0], grid.shape[1], grid.shape[2]])
    found = -1
    if i.min() >= 0 and (n - i).min() > 0:
        found = ti.cast(grid[i[0], i[1], i[2]], ti.i32)
    return found


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
    lead = ti.max(SELF_OCCLUSION - RAY_OFFSET * h, 0.0)
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
                x = p + (RAY_OFFSET * h) * ti.math.sign(cosine) * n
                travelled, left, clear = 0.0, False, True
                while travelled < length - 2.0 * RAY_OFFSET * h and clear:
                    step, found = h, -1
                    if travelled < FINE_LENGTH * h:
                        found = occupied_at(near, near_origin, h, x)
                    if found < 0:
                        step, found = far_h, occupied_at(far, far_origin, far_h, x)
                    if found == 1 and (left or travelled > lead):
                        clear = False
                    left = left or found <= 0
                    x += RAY_STEP * step * direction
                    travelled += RAY_STEP * step
                if clear:
                    total += cosine
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
