"""Seats of captured objects in the collider of their room: so each rests where it was photographed.

An object hides what it stands on: under its foot the collider is uncertain by the noise of the capture, and the object
would tilt or sink as soon as it is released. So the collider is filled there up to the plane on which the object can
stand, and the volume of all objects in their places is cut out of it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import distance_transform_edt, map_coordinates
from scipy.spatial import ConvexHull

from assets.asset import Asset
from assets.room_folder import RoomObject
from core.distance_grid import SKIN_VOXELS, DistanceGrid
from core.rotation import matrices_from_quaternions
from core.tetmesh import tet_volumes

IMPRINT = 0.02  # of an object's size, by which it presses into what it stands on: a foot on three points would sink in
SLOPE = 0.02  # of distances deeper than an object's skin


@dataclass(frozen=True)
class Base:
    """The base of an object in its asset's frame, +y up.

    normal, level   of the plane on which it stands by itself: x @ normal = level [m], normal (3,) upwards
    beside          (X, Z) distance [m] to the columns of the object's grid where it touches that plane, negative inside
    imprint         [m] over the plane, up to which it does
    depth           [m] under the plane, down to which its cage reaches, and a skin more
    """

    normal: np.ndarray
    level: float
    beside: np.ndarray
    imprint: float
    depth: float


def seated(background: Asset, bodies: Sequence[tuple[Asset, RoomObject]]) -> Asset:
    """The background with a seat for each body: what stands is borne, and nothing solid is where a body is.

    What hangs is held by itself: only its place is hollowed out.
    """
    grids = [background.sdf, *background.environment.fine_grids]
    for asset, thing in bodies:
        if thing.fixed_below is None:
            base = base_of(asset)
            k = finest_around(grids, *base_box(base, asset.sdf, thing))
            grids[k] = filled_under(grids[k], base, asset.sdf, thing)
    for asset, thing in bodies:
        grids = [without_solid(grid, asset.sdf, thing) for grid in grids]
    environment = replace(background.environment, fine_grids=tuple(grids[1:]))
    return replace(background, sdf=grids[0], environment=environment)


def base_of(body: Asset) -> Base:
    """The base on which a body stands by itself: the facet of its lower convex hull that is under its centre of mass.

    Three of the body's points are on it and none is below, so that it neither tilts nor slides there by its weight.
    """
    grid, volumes = body.sdf, tet_volumes(body.cage.vertices, body.cage.tets)
    centre = volumes @ body.cage.vertices[body.cage.tets].mean(axis=1) / volumes.sum()
    under = underside(grid)
    i, k = np.nonzero(np.isfinite(under))
    points = np.stack([grid.origin[0] + grid.spacing * i, under[i, k], grid.origin[2] + grid.spacing * k], axis=1)
    size = float(np.ptp(body.cage.vertices, axis=0).max())
    apex = centre + [0.0, 10.0 * size, 0.0]  # a flat underside has no hull of its own
    planes = ConvexHull(np.vstack([points, apex])).equations
    planes = planes[planes[:, 1] < -1e-3]
    heights = -(planes[:, [0, 2]] @ centre[[0, 2]] + planes[:, 3]) / planes[:, 1]
    plane = planes[np.argmax(heights)]
    normal, level, imprint = -plane[:3], float(plane[3]), IMPRINT * size
    touching = np.zeros(under.shape, bool)
    touching[i, k] = points @ normal - level < imprint
    beside = distance_transform_edt(~touching) - distance_transform_edt(touching)
    depth = level - float((body.cage.vertices @ normal).min()) + skin_of(grid)
    return Base(normal, level, grid.spacing * beside, imprint, depth)


def underside(grid: DistanceGrid) -> np.ndarray:
    """Height [m] of a body's lowest surface over each column of its grid, (X, Z); NaN where there is none."""
    values = np.asarray(grid.values, np.float64)
    solid = values < 0.0
    first = solid.argmax(axis=1)
    inside = np.take_along_axis(values, first[:, None], axis=1)[:, 0]
    below = np.take_along_axis(values, np.maximum(first - 1, 0)[:, None], axis=1)[:, 0]
    part = np.where(first > 0, inside / np.where(below > inside, inside - below, -1.0), 0.0)
    return np.where(solid.any(axis=1), grid.origin[1] + grid.spacing * (first - part), np.nan)


def skin_of(body: DistanceGrid) -> float:
    """Distance [m] from a body's visible surface up to which contact allows for its cage being wider."""
    return SKIN_VOXELS * body.spacing


def base_box(base: Base, body: DistanceGrid, thing: RoomObject) -> tuple[np.ndarray, np.ndarray]:
    """Corners [m] of the box around a base in the room."""
    i, k = np.nonzero(base.beside < skin_of(body))
    x, z = body.origin[0] + body.spacing * i, body.origin[2] + body.spacing * k
    y = (base.level - np.stack([x, z], axis=1) @ base.normal[[0, 2]]) / base.normal[1]
    low, high = (np.stack([x, y + up, z], axis=1) for up in (-base.depth, base.imprint))
    turn = matrices_from_quaternions(np.array(thing.rotation))
    placed = np.vstack([low, high]) @ turn.T + thing.position
    return placed.min(0), placed.max(0)


def finest_around(grids: Sequence[DistanceGrid], low: np.ndarray, high: np.ndarray) -> int:
    """Index of the finest grid that holds a box, else of the first."""
    holding = [k for k, g in enumerate(grids) if (g.origin <= low).all() and (g.upper >= high).all()]
    return min(holding, key=lambda k: grids[k].spacing, default=0)


def filled_under(grid: DistanceGrid, base: Base, body: DistanceGrid, thing: RoomObject) -> DistanceGrid:
    """A room's distance grid with what an object stands on: below the plane of its base, as wide as its skin, and up to
    the imprint where it touches."""

    def seat(points: np.ndarray) -> np.ndarray:
        cells = (points[..., [0, 2]] - np.asarray(body.origin)[[0, 2]]) / body.spacing
        beside = map_coordinates(base.beside, np.moveaxis(cells, -1, 0), order=1, mode="constant", cval=np.inf)
        over = points @ base.normal - base.level
        top = np.minimum(np.maximum(over, beside - skin_of(body)), np.maximum(over - base.imprint, beside))
        return np.maximum(top, -over - base.depth)

    low, high = base_box(base, body, thing)
    return _changed(grid, low, high, thing, lambda values, points: np.minimum(values, seat(points)))


def without_solid(grid: DistanceGrid, body: DistanceGrid, thing: RoomObject) -> DistanceGrid:
    """A room's distance grid less a body at its place: the maximum of the one and minus the other.

    Contact takes the distance less the body's own, but not more of that than its skin: where the body's cage is wider,
    the room is that deep at most (with a slope left, which tells the direction). So contact is at zero all over.
    """
    skin = skin_of(body)

    def hollow(values: np.ndarray, points: np.ndarray) -> np.ndarray:
        depth = body.sample_extended(points)
        return np.maximum(values, np.maximum(-depth, -skin - SLOPE * (depth - skin)))

    turn = matrices_from_quaternions(np.array(thing.rotation))
    corners = np.where(np.indices((2, 2, 2)).reshape(3, -1).T.astype(bool), body.upper, body.origin) @ turn.T
    return _changed(grid, corners.min(0) + thing.position, corners.max(0) + thing.position, thing, hollow)


def _changed(grid: DistanceGrid, low: np.ndarray, high: np.ndarray, thing: RoomObject, change) -> DistanceGrid:
    """A room's grid with `change(values, points)` made to its nodes in a box, at points in an object's own frame."""
    first = np.floor((low - grid.origin) / grid.spacing).astype(int).clip(0, grid.shape)
    last = (np.ceil((high - grid.origin) / grid.spacing).astype(int) + 1).clip(0, grid.shape)
    if (last <= first).any():
        return grid
    part = tuple(slice(a, b) for a, b in zip(first, last, strict=True))
    nodes = grid.origin + grid.spacing * (np.moveaxis(np.indices(tuple(last - first)), 0, -1) + first)
    points = (nodes - thing.position) @ matrices_from_quaternions(np.array(thing.rotation))
    values = np.array(grid.values)
    values[part] = change(values[part], points).astype(values.dtype)
    return replace(grid, values=values)
