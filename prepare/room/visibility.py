"""Which side of a surface is free: the one from which somebody who stands in the scene sees it."""

from dataclasses import dataclass

import numpy as np
import taichi as ti
from scipy.ndimage import binary_dilation, label

from prepare.room.surfels import Surfels

VIEWERS = 28
HEIGHTS = (0.15, 2.0)  # [m] above the floor, of viewers: low ones see tables from below
LIFT = 1.5  # voxels off the surface where a line of sight begins
NOISE = 0.035  # [m] off the surface within which its own noise does not hide it
CLOSE = 16.0  # voxels within which a line of sight looks at the finer grid
PACE = 0.7  # voxels from one look to the next
GRAZING = 0.1  # cosine; flatter lines of sight tell nothing


@dataclass(frozen=True)
class Cells:
    """Occupied voxels (X, Y, Z) bool of a grid with its corner at `origin` (3,) [m]."""

    occupied: np.ndarray
    origin: np.ndarray
    spacing: float


def cells_of(s: Surfels, origin, spacing: float, shape) -> Cells:
    """The voxels that hold surfels."""
    occupied = np.zeros(shape, bool)
    occupied[tuple(s.cells.T)] = True
    return Cells(occupied, np.asarray(origin, np.float64), float(spacing))


def open_space(room: Cells, floor: float) -> Cells:
    """The largest connected space over the floor [m] with nothing in it: `occupied` says where it is."""
    free = ~binary_dilation(room.occupied, np.ones((3, 3, 3)))  # holes in a surface are closed
    free &= (room.origin[1] + room.spacing * (np.arange(free.shape[1]) + 0.5) > floor)[None, :, None]
    pieces, count = label(free)
    if count:
        free = pieces == np.bincount(pieces.ravel())[1:].argmax() + 1
    return Cells(free, room.origin, room.spacing)


def viewers_in(space: Cells, low: np.ndarray, high: np.ndarray, floor: float, rng: np.random.Generator) -> np.ndarray:
    """Places [m] (V, 3) in an open space, at HEIGHTS over the floor, between x, z `low` and `high` (2,)."""
    at = [space.origin[k] + space.spacing * (np.arange(n) + 0.5) for k, n in enumerate(space.occupied.shape)]
    limits = (low[0], high[0]), (floor + HEIGHTS[0], floor + HEIGHTS[1]), (low[1], high[1])
    x, y, z = ((p > a) & (p < b) for p, (a, b) in zip(at, limits, strict=True))
    mine = np.argwhere(space.occupied & x[:, None, None] & y[:, None] & z)
    chosen = rng.choice(len(mine), min(VIEWERS, len(mine)), replace=False)
    return space.origin + space.spacing * (mine[chosen] + 0.5)


@ti.func
def occupied_at(grid: ti.template(), origin, spacing, p):
    """1 in an occupied voxel, 0 in a free one, -1 outside of the grid."""
    i = ti.cast(ti.floor((p - origin) / spacing), ti.i32)
    n = ti.Vector([grid.shape[0], grid.shape[1], grid.shape[2]])
    found = -1
    if i.min() >= 0 and (n - i).min() > 0:
        found = ti.cast(grid[i[0], i[1], i[2]], ti.i32)
    return found


@ti.kernel
def look(
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
    lead = ti.max(NOISE - LIFT * h, 0.0)
    for s in range(points.shape[0]):
        p = ti.Vector([points[s, 0], points[s, 1], points[s, 2]])
        n = ti.Vector([normals[s, 0], normals[s, 1], normals[s, 2]])
        total = 0.0
        for v in range(viewers.shape[0]):
            way = ti.Vector([viewers[v, 0], viewers[v, 1], viewers[v, 2]]) - p
            length = way.norm()
            way /= ti.max(length, 1e-6)
            cosine = n.dot(way)
            if ti.abs(cosine) > GRAZING and length > 3.0 * LIFT * h:
                x = p + (LIFT * h) * ti.math.sign(cosine) * n
                gone, left, clear = 0.0, False, True
                while gone < length - 2.0 * LIFT * h and clear:
                    step, found = h, -1
                    if gone < CLOSE * h:
                        found = occupied_at(near, near_origin, h, x)
                    if found < 0:
                        step, found = far_h, occupied_at(far, far_origin, far_h, x)
                    if found == 1 and (left or gone > lead):
                        clear = False
                    left = left or found <= 0
                    x += PACE * step * way
                    gone += PACE * step
                if clear:
                    total += cosine
        votes[s] = total


def oriented(s: Surfels, viewers: np.ndarray, near: Cells, far: Cells) -> Surfels:
    """The surfels that are seen, their normals turned to those who see them. Taichi must be running."""
    votes = np.zeros(len(s.points), np.float32)
    if len(votes) and len(viewers):
        f32 = [np.ascontiguousarray(a, np.float32) for a in (s.points, s.normals, viewers)]
        grids = [np.ascontiguousarray(c.occupied, np.uint8) for c in (near, far)]
        origins = [ti.Vector([float(o) for o in c.origin]) for c in (near, far)]
        look(*f32, grids[0], origins[0], near.spacing, grids[1], origins[1], far.spacing, votes)
    seen = votes != 0
    turned = s.normals * np.sign(votes)[:, None]
    return Surfels(s.points, turned, s.areas, s.cells).select(seen)
