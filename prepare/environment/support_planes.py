"""Support planes of a static scene, floor, tables and shelves; where bodies drop, and where the player stands."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import binary_closing, binary_dilation, binary_fill_holes, distance_transform_edt, label

from core.errors import BadInput
from core.planes import LEVEL_COS
from prepare.environment.surfels import VoxelGrid

CELL = 0.04  # [m] of a plane's mask
BIN = 0.01  # [m] of the histogram of heights
THICKNESS = 0.025  # [m]; points this near a plane belong to it
MIN_PLANE_AREA = 0.06  # [m^2] of a plane that can carry something
HEIGHTS = (0.08, 2.2)  # [m] above the floor, of tables and shelves
MAX_BOARD = 0.09  # [m] thickness; a plane this little under another is its underside
GROUND_AREA, GROUND_DEPTH = 2.0, 0.3  # [m^2] of a plane that a table stands on, and [m] under it at least
TABLE_HEIGHTS, TABLE_AREA = (0.3, 1.2), 0.25  # [m], and [m^2] at least; other planes are shelves


@dataclass(frozen=True)
class SupportPlane:
    """A level plane that can carry a body. `mask` (X, Z) bool: cells of CELL from `corner` (x, z) [m] that it fills."""

    kind: str  # "floor", "table", "shelf"
    height: float  # [m]
    corner: np.ndarray
    mask: np.ndarray

    @property
    def area(self) -> float:
        """Area of the mask [m^2]."""
        return float(self.mask.sum()) * CELL**2

    @property
    def low(self) -> np.ndarray:
        """Corner of its bounding rectangle (x, z) [m]."""
        return self.corner + CELL * np.argwhere(self.mask).min(0)

    @property
    def high(self) -> np.ndarray:
        """The opposite corner (x, z) [m]."""
        return self.corner + CELL * (np.argwhere(self.mask).max(0) + 1)

    def covers(self, points: np.ndarray) -> np.ndarray:
        """Mask (N,) of points (N, 2) (x, z) [m] that lie over or under it."""
        i = np.floor((points - self.corner) / CELL).astype(np.int64)
        within = ((i >= 0) & (i < self.mask.shape)).all(1)
        found = np.zeros(len(points), bool)
        found[within] = self.mask[tuple(i[within].T)]
        return found


def support_planes(points: np.ndarray, normals: np.ndarray, floor: float = 0.0) -> list[SupportPlane]:
    """The floor and, largest first, the tables and shelves.

    points [m] (N, 3) of the surface, evenly spread, +y up; normals (N, 3) that point into free space.
    Peaks of a histogram of heights are split into connected components. Raises BadInput.
    """
    up = normals[:, 1] > LEVEL_COS
    p = points[up]
    near = np.abs(p[:, 1] - floor) < 2 * THICKNESS
    if not near.any():
        raise BadInput("no floor was found under the scene")
    floors = planes_at(p[near], float(np.median(p[near, 1])), "floor")
    if not floors:
        raise BadInput("no floor was found under the scene")
    left = p[(p[:, 1] > floor + HEIGHTS[0]) & (p[:, 1] < floor + HEIGHTS[1])]
    tried, planes = set(), []
    while len(left):
        bins = ((left[:, 1] - floor) / BIN).astype(int)
        count = np.convolve(np.bincount(bins), np.ones(3), "same")
        count[[b for b in tried if b < len(count)]] = 0
        peak = int(count.argmax())
        if count[peak] < 8:
            break
        tried.add(peak)
        height = floor + BIN * (peak + 0.5)
        slab = np.abs(left[:, 1] - height) < THICKNESS
        here = planes_at(left[slab], height, "shelf")
        planes += here
        taken = np.zeros(len(left), bool)
        for plane in here:
            taken |= slab & plane.covers(left[:, [0, 2]])
        left = left[~taken]
    boards = [p for p in planes if not is_underside(p, planes)]
    return [max(floors, key=lambda s: s.area), *sorted(boards, key=lambda s: -s.area)]


def with_floor_under(planes: list[SupportPlane], table: SupportPlane) -> list[SupportPlane]:
    """The planes with the one under a table as the floor, which may be another than the one found, as in a garden.

    The floor comes first; planes that are not above it are left out.
    """
    cells = cell_centres(table)[binary_dilation(table.mask, iterations=8)]
    below = [p for p in planes if p.area >= GROUND_AREA and p.height < table.height - GROUND_DEPTH]
    below = [p for p in below if p.covers(cells).mean() > 0.3]
    floor = max(below, key=lambda p: p.height, default=planes[0])
    others = [replace(p, kind=kind_of(p.height - floor.height, p.area)) for p in planes if p is not floor]
    others = [p for p in others if HEIGHTS[0] < p.height - floor.height < HEIGHTS[1]]
    return [replace(floor, kind="floor"), *others]


def kind_of(height: float, area: float) -> str:
    """Kind, "table" or "shelf", by the height over the floor [m] and the area [m^2]."""
    return "table" if TABLE_HEIGHTS[0] <= height <= TABLE_HEIGHTS[1] and area >= TABLE_AREA else "shelf"


def is_underside(plane: SupportPlane, planes: list[SupportPlane]) -> bool:
    """True for a plane that is just the underside of another plane's board."""
    over = [p.covers(cell_centres(plane)[plane.mask]) for p in planes if 0 < p.height - plane.height < MAX_BOARD]
    return bool(over) and np.any(over, axis=0).mean() >= 0.5


def planes_at(points: np.ndarray, height: float, kind: str) -> list[SupportPlane]:
    """The connected planes of enough area among points [m] (N, 3) near one height."""
    xz = points[:, [0, 2]]
    corner = xz.min(0) - 4 * CELL
    cell = np.floor((xz - corner) / CELL).astype(int)
    mask = np.zeros(cell.max(0) + 5, bool)
    mask[tuple(cell.T)] = True
    labels, count = label(binary_closing(mask, np.ones((3, 3)), iterations=2))
    found = []
    for k in range(1, count + 1):
        filled = binary_fill_holes(labels == k)  # under objects on it nothing was seen
        own = filled[tuple(cell.T)]
        exact = float(np.median(points[own, 1])) if own.any() else height
        name = kind if kind == "floor" else kind_of(exact, filled.sum() * CELL**2)
        if filled.sum() * CELL**2 >= MIN_PLANE_AREA:
            found.append(SupportPlane(name, exact, corner, filled))
    return found


DROP_SPACE = (0.035, 0.35)  # [m] over a table that must be empty where a body drops
FLOOR_DROP_TOP = 1.0  # [m] the same over the floor
USER_RADIUS, USER_SPACE = 0.15, (0.035, 1.75)  # [m] of a user's body, and the heights over the floor that it fills
MIN_CLEARANCE = 0.10  # [m] radius of a free disc on a table for that table to be used
AMPLE_CLEARANCE = 0.25  # [m]; of tables with as much, the largest is taken
AMPLE_FLOOR = 0.5  # [m] of free floor; more is no better
EYE_HEIGHT = 1.5  # [m] above the floor, slightly bent over
PLACES_TRIED = 400  # to stand, best first
ARM_LENGTH = 0.75  # [m] from the user to the drop


def clearance(plane: SupportPlane, points: np.ndarray, above: tuple[float, float]) -> np.ndarray:
    """Radius [m] (X, Z) of the disc around each cell of a plane that its edge, and points (N, 3) [m] between two
    heights over it, leave free."""
    over = points[:, 1] - plane.height
    p = points[(over > above[0]) & (over < above[1])][:, [0, 2]]
    blocked = np.zeros(plane.mask.shape, bool)
    i = np.floor((p - plane.corner) / CELL).astype(int)
    i = i[((i >= 0) & (i < plane.mask.shape)).all(1)]
    blocked[tuple(i.T)] = True
    free = np.pad(plane.mask & ~blocked, 1)
    return CELL * (distance_transform_edt(free)[1:-1, 1:-1] - 0.5).clip(0)


def cell_centres(plane: SupportPlane) -> np.ndarray:
    """Centre (x, z) [m] of each cell, (X, Z, 2)."""
    return plane.corner + CELL * (np.moveaxis(np.indices(plane.mask.shape), 0, -1) + 0.5)


def drop_point(planes: list[SupportPlane], points: np.ndarray) -> tuple[SupportPlane, np.ndarray, float]:
    """Plane, point (3,) [m] and radius [m] of free space: on the table with most of it, else on the floor, which is the
    first of the planes. points [m] (N, 3) of the surface."""
    tables = [(plane, clearance(plane, points, DROP_SPACE)) for plane in planes if plane.kind == "table"]
    if tables:
        plane, radius = max(tables, key=lambda t: min(t[1].max(), AMPLE_CLEARANCE) + 0.02 * min(t[0].area, 2.0))
        if radius.max() >= MIN_CLEARANCE:
            x, z = cell_centres(plane)[np.unravel_index(radius.argmax(), radius.shape)]
            return plane, np.array([x, plane.height, z]), float(radius.max())
    floor = planes[0]
    radius = clearance(floor, points, (DROP_SPACE[0], FLOOR_DROP_TOP))
    at = cell_centres(floor)
    middle = at[floor.mask].mean(0)
    score = np.minimum(radius, AMPLE_FLOOR) - 0.1 * np.linalg.norm(at - middle, axis=2)
    best = np.unravel_index(np.where(floor.mask, score, -np.inf).argmax(), score.shape)
    x, z = at[best]
    return floor, np.array([x, floor.height, z]), max(float(radius[best]), CELL)


def standing_eye(
    floor: SupportPlane, drop: np.ndarray, on: SupportPlane, points: np.ndarray, voxels: VoxelGrid
) -> np.ndarray:
    """Place of the player's eye (3,) [m]: over free floor, near the drop, with nothing in between; else at arm's length
    from the drop."""
    radius = clearance(floor, points, USER_SPACE)
    at = cell_centres(floor)
    away = np.linalg.norm(at - drop[[0, 2]], axis=2)
    wanted = ARM_LENGTH if on.kind == "table" else 1.4 * ARM_LENGTH
    score = -np.abs(away - wanted) + 0.5 * np.minimum(radius, 0.4) - 10 * (away < 0.8 * wanted)
    score = np.where(floor.mask & (radius >= USER_RADIUS), score, -np.inf)
    height = max(EYE_HEIGHT + floor.height, drop[1] + 0.5)
    best = np.argsort(-score, axis=None)[:PLACES_TRIED]
    for flat in best[np.isfinite(score.flat[best])]:
        x, z = at.reshape(-1, 2)[flat]
        eye = np.array([x, height, z])
        way = drop + [0, 0.12, 0] - eye
        count = max(2, int(np.linalg.norm(way) / (0.5 * voxels.spacing)))
        if not voxels.at(eye + np.linspace(0, 1, count)[:, None] * way).any():
            return eye
    return np.array([drop[0], height, drop[2] + wanted])
