"""Spawn points of a static scene: where bodies drop, and where the user stands."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import distance_transform_edt

from prepare.environment.support_planes import CELL, SupportPlane
from prepare.environment.visibility import VoxelGrid

DROP_SPACE = (0.035, 0.35)  # [m] over a table that must be empty where a body drops
FLOOR_DROP_TOP = 1.0  # [m] the same over the floor
USER_RADIUS, USER_SPACE = 0.15, (0.035, 1.75)  # [m] of a user's body, and the heights over the floor that it fills
MIN_CLEARANCE = 0.10  # [m] radius of a free disc on a table for that table to be used
AMPLE_CLEARANCE = 0.25  # [m]; of tables with as much, the largest is taken
AMPLE_FLOOR = 0.5  # [m] of free floor; more is no better
EYE_HEIGHT = 1.5  # [m] above the floor, slightly bent over
EYES, EYES_APART = 8, 0.3  # places that are compared, and [m] between them
ARM_LENGTH = 0.75  # [m] from the user to the drop


def clearance(plane: SupportPlane, points: np.ndarray, above: tuple[float, float]) -> np.ndarray:
    """Radius [m] (X, Z) of the free disc around each cell of a plane.

    It is bounded by the plane's edge and by `points` [m] (N, 3) between two heights over it.
    """
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
    """Plane, point (3,) [m] and radius [m] of free space: on the table with most of it, else on the floor.

    planes: the floor first; points [m] (N, 3) of the surface.
    """
    tables = []
    for plane in planes:
        if plane.kind == "table":
            radius = clearance(plane, points, DROP_SPACE)
            tables.append((float(radius.max()), plane, radius))
    if tables:
        most, plane, radius = max(tables, key=lambda t: min(t[0], AMPLE_CLEARANCE) + 0.02 * min(t[1].area, 2.0))
        if most >= MIN_CLEARANCE:
            x, z = cell_centres(plane)[np.unravel_index(radius.argmax(), radius.shape)]
            return plane, np.array([x, plane.height, z]), most
    floor = planes[0]
    radius = clearance(floor, points, (DROP_SPACE[0], FLOOR_DROP_TOP))
    at = cell_centres(floor)
    middle = at[floor.mask].mean(0)
    score = np.minimum(radius, AMPLE_FLOOR) - 0.1 * np.linalg.norm(at - middle, axis=2)
    best = np.unravel_index(np.where(floor.mask, score, -np.inf).argmax(), score.shape)
    x, z = at[best]
    return floor, np.array([x, floor.height, z]), max(float(radius[best]), CELL)


def standing_eyes(
    floor: SupportPlane, drop: np.ndarray, on: SupportPlane, points: np.ndarray, voxels: VoxelGrid
) -> list[np.ndarray]:
    """Places of the user's eye (3,) [m], the best first and well apart: over free floor, near the drop, with nothing in
    between.

    Where there is no such place, at arm's length from the drop, all around it.
    """
    radius = clearance(floor, points, USER_SPACE)
    at = cell_centres(floor)
    away = np.linalg.norm(at - drop[[0, 2]], axis=2)
    wanted = ARM_LENGTH if on.kind == "table" else 1.4 * ARM_LENGTH
    score = -np.abs(away - wanted) + 0.5 * np.minimum(radius, 0.4) - 10 * (away < 0.8 * wanted)
    score = np.where(floor.mask & (radius >= USER_RADIUS), score, -np.inf)
    height = max(EYE_HEIGHT + floor.height, drop[1] + 0.5)
    found: list[np.ndarray] = []
    for flat in np.argsort(-score, axis=None)[:400:4]:
        if not np.isfinite(score.flat[flat]) or len(found) == EYES:
            break
        x, z = at.reshape(-1, 2)[flat]
        eye = np.array([x, height, z])
        apart = all(np.linalg.norm(eye - other) > EYES_APART for other in found)
        if apart and unobstructed(voxels, eye, drop + [0, 0.12, 0]):
            found.append(eye)
    turns = np.arange(EYES) * 2 * np.pi / EYES
    around = [np.array([drop[0] + wanted * np.sin(t), height, drop[2] + wanted * np.cos(t)]) for t in turns]
    return found or around


def unobstructed(voxels: VoxelGrid, a: np.ndarray, b: np.ndarray) -> bool:
    """True if no occupied voxel lies between two points (3,) [m]."""
    count = max(2, int(np.linalg.norm(b - a) / (0.5 * voxels.spacing)))
    p = a + np.linspace(0, 1, count)[:, None] * (b - a)
    i = np.floor((p - voxels.origin) / voxels.spacing).astype(int)
    i = i[((i >= 0) & (i < voxels.occupied.shape)).all(1)]
    return not voxels.occupied[tuple(i.T)].any()
