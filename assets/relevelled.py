"""The floor, level planes and places of a room that has been tilted: found again where the turn has brought them."""

from __future__ import annotations

import numpy as np

from assets.environment import Environment
from assets.gaussians import Gaussians, normals_and_areas
from core.distance_grid import DistanceGrid
from core.errors import BadInput
from core.planes import LEVEL_COS, weighted_percentile

OPAQUE = 0.3  # fainter Gaussians are haze
PLANE_REACH = 0.3  # [m] over and under a tilted plane's middle in which its level part is looked for
PLANE_LAYER = 0.03  # [m] half the thickness of a level plane
PLANE_SHARE = 0.3  # of a rectangle's area, at least, that must be level for it to be a plane still
PLACES = 25  # along each side of the floor, that are tried for a drop
HEADROOM = (0.3, 0.6, 0.9)  # [m] over a drop at which there must be room
EYE_FREE = 0.2  # [m] between the eye and what is solid


def relevelled(turned: Environment, gaussians: Gaussians, grid: DistanceGrid, eye_height: float) -> Environment:
    """The environment of a room whose floor is at y = 0, with what the turn has made of its planes and places.

    turned      planes are the bounding boxes (low, high) of the tilted ones, by kind; drop and eye are turned
    eye_height  [m] of the user's eye over the floor
    """
    solid = gaussians.select(gaussians.opacities > OPAQUE)
    normals, areas = normals_and_areas(solid)
    points, level = solid.means.astype(np.float64), np.abs(normals[:, 1]) > LEVEL_COS
    near = level & (np.abs(points[:, 1]) < PLANE_LAYER)
    low, high = np.percentile(points[near][:, [0, 2]], [1, 99], axis=0)
    floor = ("floor", 0.0, *map(float, (low[0], low[1], high[0], high[1])))
    others = [found for plane in turned.planes[1:] if (found := _level_part(plane, points[level], areas[level]))]
    drop, clear = _drop(turned, [floor, *others], grid)
    eye = _eye(np.array(turned.eye_position), np.array(drop), eye_height, grid)
    return Environment(0.0, drop, eye, clear, (floor, *others), turned.fine_grids, turned.target)


def _level_part(plane: tuple, points: np.ndarray, areas: np.ndarray) -> tuple | None:
    """The plane at the height at which most of its rectangle lies; None: too little of it is level."""
    kind, height, x0, z0, x1, z1 = plane
    x, y, z = points.T
    own = (x > x0) & (x < x1) & (z > z0) & (z < z1) & (np.abs(y - height) < PLANE_REACH)
    if not own.any():
        return None
    order = np.sort(y[own])
    count = np.searchsorted(order, order + 2 * PLANE_LAYER, side="right") - np.arange(len(order))
    middle = order[count.argmax()] + PLANE_LAYER
    own &= np.abs(y - middle) < PLANE_LAYER
    if areas[own].sum() < PLANE_SHARE * (x1 - x0) * (z1 - z0) or middle < PLANE_REACH / 2:
        return None
    found = weighted_percentile(y[own], areas[own], (50,))[0]
    low, high = np.percentile(points[own][:, [0, 2]], [2, 98], axis=0)
    return (kind, float(found), *map(float, (low[0], low[1], high[0], high[1])))


def _drop(turned: Environment, planes: list[tuple], grid: DistanceGrid) -> tuple[tuple, float]:
    """The turned drop if it is still over a plane with free space above, else the freest place of the floor."""
    x, _, z = turned.drop_point
    under = [p for p in planes if p[2] <= x <= p[4] and p[3] <= z <= p[5]]
    for _, height, *_ in sorted(under, key=lambda p: abs(p[1] - turned.drop_point[1])):
        free = _free(np.array([[x, height, z]]), grid)[0]
        if free > 0.5 * turned.clear_radius:
            return (x, height, z), float(min(free, turned.clear_radius))
    _, height, x0, z0, x1, z1 = planes[0]
    places = np.stack(np.meshgrid(np.linspace(x0, x1, PLACES), [height], np.linspace(z0, z1, PLACES)), -1).reshape(
        -1, 3
    )
    free = _free(places, grid)
    best = int(free.argmax())
    if free[best] <= 0.0:
        raise BadInput("there is no free place on its floor as it stands now")
    return tuple(places[best].tolist()), float(free[best])


def _free(places: np.ndarray, grid: DistanceGrid) -> np.ndarray:
    """Least distance [m] to what is solid over places (N, 3) on a plane, (N,)."""
    over = [grid.sample(places + np.array([0.0, h, 0.0])).clip(None, h) for h in HEADROOM]
    return np.min(over, axis=0)


def _eye(eye: np.ndarray, drop: np.ndarray, height: float, grid: DistanceGrid) -> tuple[float, float, float]:
    """The eye at its height over the floor, moved towards the drop as far as it must be to be free."""
    level = np.array([eye[0], height, eye[2]])
    to = np.array([drop[0], height, drop[2]])
    way = level + np.linspace(0.0, 0.8, 9)[:, None] * (to - level)
    free = grid.sample(way) > EYE_FREE
    return tuple(way[int(free.argmax())].tolist())
