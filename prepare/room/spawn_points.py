"""Where in a static scene a body is dropped, and where the user stands to play with it."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import binary_dilation, distance_transform_edt

from prepare.room.support_planes import CELL, Support
from prepare.room.visibility import Cells

ROOM_ABOVE = (0.035, 0.35)  # [m] over a plane that must be empty where a body is dropped
BODY = (0.15, 0.035, 1.75)  # [m] radius of a user's body, and the heights over the floor that it fills
LEAST = 0.10  # [m] radius of a free disc on a table for that table to be used
AMPLE = 0.25  # [m]; of tables with as much, the largest is taken
ENOUGH = 0.5  # [m] of free floor; more is no better
EYE = 1.5  # [m] above the floor, a little bent over
ARM = 0.75  # [m] from the user to the drop; less is too near, and what is on a table is as far as its rim asks


def clearance(plane: Support, points: np.ndarray, above: tuple[float, float], reach: float = 0.0) -> np.ndarray:
    """Radius [m] (X, Z) of the free disc round each cell of a plane: up to its rim and to `points` [m] (N, 3) that
    stand between two heights over it. `reach` [m] is added around these."""
    over = points[:, 1] - plane.height
    p = points[(over > above[0]) & (over < above[1])][:, [0, 2]]
    blocked = np.zeros(plane.mask.shape, bool)
    i = np.floor((p - plane.corner) / CELL).astype(int)
    i = i[((i >= 0) & (i < plane.mask.shape)).all(1)]
    blocked[tuple(i.T)] = True
    if reach > 0:
        blocked = binary_dilation(blocked, iterations=max(1, round(reach / CELL)))
    free = np.pad(plane.mask & ~blocked, 1)
    return CELL * (distance_transform_edt(free)[1:-1, 1:-1] - 0.5).clip(0)


def centres(plane: Support) -> np.ndarray:
    """Middle (x, z) [m] of each cell, (X, Z, 2)."""
    return plane.corner + CELL * (np.moveaxis(np.indices(plane.mask.shape), 0, -1) + 0.5)


def drop_place(supports: list[Support], points: np.ndarray) -> tuple[Support, np.ndarray, float]:
    """The plane, the point (3,) [m] and the radius [m] of free space: on the table with most of it, else the floor.

    supports: the floor first; points [m] (N, 3) of the surface.
    """
    tables = []
    for plane in supports:
        if plane.kind == "table":
            radius = clearance(plane, points, ROOM_ABOVE)
            tables.append((float(radius.max()), plane, radius))
    if tables:
        most, plane, radius = max(tables, key=lambda t: min(t[0], AMPLE) + 0.02 * min(t[1].area, 2.0))
        if most >= LEAST:
            x, z = centres(plane)[np.unravel_index(radius.argmax(), radius.shape)]
            return plane, np.array([x, plane.height, z]), most
    floor = supports[0]
    radius = clearance(floor, points, (ROOM_ABOVE[0], 1.0))
    at = centres(floor)
    middle = at[floor.mask].mean(0)
    score = np.minimum(radius, ENOUGH) - 0.1 * np.linalg.norm(at - middle, axis=2)
    best = np.unravel_index(np.where(floor.mask, score, -np.inf).argmax(), score.shape)
    x, z = at[best]
    return floor, np.array([x, floor.height, z]), max(float(radius[best]), CELL)


def stand_place(floor: Support, drop: np.ndarray, on: Support, points: np.ndarray, cells: Cells) -> np.ndarray:
    """The user's eye (3,) [m]: over free floor, near the drop, with nothing between. Where there is no such place, at
    arm's length of the drop in any case."""
    radius = clearance(floor, points, BODY[1:])
    at = centres(floor)
    away = np.linalg.norm(at - drop[[0, 2]], axis=2)
    wanted = ARM if on.kind == "table" else 1.4 * ARM
    score = -np.abs(away - wanted) + 0.5 * np.minimum(radius, 0.4) - 10 * (away < 0.8 * wanted)
    score = np.where(floor.mask & (radius >= BODY[0]), score, -np.inf)
    height = max(EYE + floor.height, drop[1] + 0.5)
    for flat in np.argsort(-score, axis=None)[:400:4]:
        if not np.isfinite(score.flat[flat]):
            break
        x, z = at.reshape(-1, 2)[flat]
        eye = np.array([x, height, z])
        if sees(cells, eye, drop + [0, 0.12, 0]):
            return eye
    return np.array([drop[0], height, drop[2] + wanted])


def sees(cells: Cells, a: np.ndarray, b: np.ndarray) -> bool:
    """Whether no occupied voxel lies between two points (3,) [m]."""
    count = max(2, int(np.linalg.norm(b - a) / (0.5 * cells.spacing)))
    p = a + np.linspace(0, 1, count)[:, None] * (b - a)
    i = np.floor((p - cells.origin) / cells.spacing).astype(int)
    i = i[((i >= 0) & (i < cells.occupied.shape)).all(1)]
    return not cells.occupied[tuple(i.T)].any()
