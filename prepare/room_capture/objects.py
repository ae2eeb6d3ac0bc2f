"""Objects of a captured room as bodies: the support of each, its cage, its place, and its seat in the collider.

An object hides what it stands on: under its foot the collider is uncertain by the noise of the capture, and the object
would tilt or sink as soon as it is released. So the collider is filled there up to the plane on which the object can
stand, and the volume of all objects in their places is cut out of it: each rests where it was photographed.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import distance_transform_edt, map_coordinates
from scipy.spatial import ConvexHull, cKDTree

from assets.asset import Asset
from assets.gaussians import Gaussians, robust_bounds
from assets.room_folder import RoomObject
from core.distance_grid import SKIN_VOXELS, DistanceGrid
from core.errors import BadInput
from core.rotation import matrices_from_quaternions, quaternions_from_matrices, rotation_between
from prepare.pipeline import Options, of_first_sound_cage, prepare
from prepare.progress import Progress
from prepare.standing import holds_centre, liftable, resting_normal, steady

TOUCH = 0.06  # object sizes: a gap up to this is contact
NEIGHBOURS = 6  # nearest Gaussians of the rest tested for each of the object's
TOUCHES_MIN = 4  # Gaussians in contact; with fewer the object touches nothing
BASE = 0.2  # fraction of an object's height that counts as its foot
HELD = 0.15, 0.45  # least and most of a hanging object, from its support on, that is fixed; fractions of its extent


@dataclass(frozen=True)
class Support:
    """Support of an object: `direction` (3,) leads from there to the object; it stands if that is up.

    level  median of where the object touches it, along the direction [m]
    """

    direction: np.ndarray
    stands: bool
    level: float = 0.0


def support_of(gaussians: Gaussians, rest: Gaussians) -> Support:
    """The support that holds an object in the rest of a room [m], +y up. Raises BadInput if it touches nothing.

    It stands if its contacts near the foot surround its centre; else it hangs, as a trophy on a wall does.
    """
    gaussians, rest = gaussians.opaque(), rest.opaque()
    own, others = gaussians.means.astype(np.float64), rest.means.astype(np.float64)
    low, high = robust_bounds(own)
    size, touching = float((high - low).max()), own[:0]
    if len(others):
        away, at = cKDTree(others).query(own, k=range(1, 1 + min(NEIGHBOURS, len(others))))
        reach = TOUCH * size + widths(gaussians)[:, None] + widths(rest)[at]
        touching = own[(away < reach).any(axis=1)]
    if len(touching) < TOUCHES_MIN:
        raise BadInput("touches nothing that holds it up; photograph what it stands on, or mark it as background")
    centre = np.median(own, axis=0)
    foot = touching[touching[:, 1] < low[1] + BASE * (high[1] - low[1])][:, [0, 2]]
    if len(foot) >= TOUCHES_MIN and holds_centre(foot, middle_of(own)[[0, 2]]):
        return Support(np.array([0.0, 1.0, 0.0]), True)
    away = centre - touching.mean(0)
    if np.linalg.norm(away) < 1e-3 * size:
        return Support(np.array([0.0, 1.0, 0.0]), True)
    away /= np.linalg.norm(away)
    return Support(away, False, float(np.median(touching @ away)))


def middle_of(points: np.ndarray) -> np.ndarray:
    """Centre of mass (3,) of the convex hull of points (N, 3): their own is where most details are."""
    apex = points.mean(axis=0)  # within: the hull is a cone over each of its triangles
    triangles = points[ConvexHull(points, qhull_options="QJ").simplices]
    volumes = np.abs(np.linalg.det(triangles - apex))
    return 0.25 * apex + 0.75 * volumes @ triangles.mean(axis=1) / volumes.sum()


def widths(g: Gaussians) -> np.ndarray:
    """Two standard deviations [m] along the middle axis of each Gaussian, (N,): how far its disc is seen."""
    return 2.0 * np.exp(np.sort(g.log_scales, axis=1)[:, 1].astype(np.float64))


def object_body(
    name: str,
    file: str,
    gaussians: Gaussians,
    support: Support,
    *,
    vertices: Sequence[int],
    material: str | None,
    progress: Progress,
    say: Callable[[str], None],
) -> tuple[Asset, RoomObject]:
    """The body of an object's Gaussians in the room [m], and its place; +y of its asset leads away from what holds it.

    file      of its asset, in the room's folder
    vertices  of the cage; the next number where a shape finds no sound cage with one
    Raises BadInput if there is no cage for it.
    """
    turn = rotation_between(support.direction, (0.0, 1.0, 0.0))
    gaussians = replace(gaussians.transformed(turn), object_id=np.zeros(len(gaussians), np.uint16), objects=())

    def make(count: int) -> Asset:
        return prepare(gaussians, Options(count, up="+y", material=material, metres=True), progress=progress, say=say)

    asset = of_first_sound_cage(vertices, make, lambda line: say(f"{name}: {line}"))
    position = -turn.T @ np.array(asset.provenance["moved"])
    heights = asset.cage.vertices[:, 1]
    held = support.level + asset.provenance["moved"][1]  # of what touches: its farthest end may be a thin tail
    fixed = None if support.stands else float(np.clip(held, *(heights.min() + np.multiply(HELD, np.ptp(heights)))))
    if material is None:
        light = liftable(asset.material, float(asset.cage.volumes().sum()))
        held = None if fixed is None else heights < fixed
        light = steady(light, asset.cage.vertices, asset.cage.tets, turn @ [0.0, -1.0, 0.0], held)
        asset = replace(asset, material=light)
    rotation = tuple(map(float, quaternions_from_matrices(turn.T)))
    return asset, RoomObject(name, file, tuple(map(float, position)), rotation, fixed)


def turn_of(placed: RoomObject) -> np.ndarray:
    """Rotation (3, 3) from an object's asset into the room."""
    return matrices_from_quaternions(np.array(placed.rotation))


def placed_points(points: np.ndarray, placed: RoomObject) -> np.ndarray:
    """Points (N, 3) of an object's asset in the room [m]."""
    return points @ turn_of(placed).T + placed.position


def object_files(names: Sequence[str]) -> list[str]:
    """File names of objects in a room's folder, for any names."""
    files = []
    for k, name in enumerate(names):
        stem = "".join(c if c.isascii() and (c.isalnum() or c in "_-") else "_" for c in name)[:60]
        stem = stem if stem.strip("_-") else f"object_{k + 1}"
        files.append(f"objects/{stem}.h5" if f"objects/{stem}.h5" not in files else f"objects/{stem}_{k + 1}.h5")
    return files


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
    """The background with a seat for each body: what stands is borne, and nothing solid is where a body is. What hangs
    is held by itself: only its place is hollowed out."""
    grids = [background.sdf, *background.environment.fine_grids]
    for asset, placed in bodies:
        if placed.fixed_below is None:
            base = base_of(asset)
            low, high = base_box(base, asset.sdf, placed)
            around = [k for k, g in enumerate(grids) if (g.origin <= low).all() and (g.upper >= high).all()]
            k = min(around, key=lambda k: grids[k].spacing, default=0)  # the finest
            grids[k] = filled_under(grids[k], base, asset.sdf, placed)
    for asset, placed in bodies:
        grids = [without_solid(grid, asset.sdf, placed) for grid in grids]
    environment = replace(background.environment, fine_grids=tuple(grids[1:]))
    return replace(background, sdf=grids[0], environment=environment)


def base_of(body: Asset) -> Base:
    """The base on which a body stands by itself: the facet of the hull of its underside that bears its centre of mass.

    Three of the body's points are on it and none is below, so that it neither tilts nor slides there by its weight.
    """
    grid, volumes = body.sdf, body.cage.volumes()
    centre = volumes @ body.cage.vertices[body.cage.tets].mean(axis=1) / volumes.sum()
    under = underside(grid)
    i, k = np.nonzero(np.isfinite(under))
    points = np.stack([grid.origin[0] + grid.spacing * i, under[i, k], grid.origin[2] + grid.spacing * k], axis=1)
    size = float(np.ptp(body.cage.vertices, axis=0).max())
    apex = centre + [0.0, 10.0 * size, 0.0]  # a flat underside has no hull of its own
    normal = -resting_normal(np.vstack([points, apex]), centre)
    level, imprint = float((points @ normal).min()), IMPRINT * size
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


def base_box(base: Base, body: DistanceGrid, placed: RoomObject) -> tuple[np.ndarray, np.ndarray]:
    """Corners [m] of the box around a base in the room."""
    i, k = np.nonzero(base.beside < skin_of(body))
    x, z = body.origin[0] + body.spacing * i, body.origin[2] + body.spacing * k
    y = (base.level - np.stack([x, z], axis=1) @ base.normal[[0, 2]]) / base.normal[1]
    low, high = (np.stack([x, y + up, z], axis=1) for up in (-base.depth, base.imprint))
    corners = placed_points(np.vstack([low, high]), placed)
    return corners.min(0), corners.max(0)


def filled_under(grid: DistanceGrid, base: Base, body: DistanceGrid, placed: RoomObject) -> DistanceGrid:
    """A room's distance grid, filled below the plane of an object's base, as wide as its skin, and up to the imprint
    where it touches."""

    def seat(points: np.ndarray) -> np.ndarray:
        cells = (points[..., [0, 2]] - np.asarray(body.origin)[[0, 2]]) / body.spacing
        beside = map_coordinates(base.beside, np.moveaxis(cells, -1, 0), order=1, mode="constant", cval=np.inf)
        over = points @ base.normal - base.level
        top = np.minimum(np.maximum(over, beside - skin_of(body)), np.maximum(over - base.imprint, beside))
        return np.maximum(top, -over - base.depth)

    low, high = base_box(base, body, placed)
    return _changed(grid, low, high, placed, lambda values, points: np.minimum(values, seat(points)))


def without_solid(grid: DistanceGrid, body: DistanceGrid, placed: RoomObject) -> DistanceGrid:
    """A room's distance grid less a body at its place: the maximum of the one and minus the other.

    Contact takes the distance less the body's own, but not more of that than its skin: where the body's cage is wider,
    the room is that deep at most (with a slope left, which tells the direction). So contact is at zero all over.
    """
    skin = skin_of(body)

    def hollow(values: np.ndarray, points: np.ndarray) -> np.ndarray:
        depth = body.sample_extended(points)
        return np.maximum(values, np.maximum(-depth, -skin - SLOPE * (depth - skin)))

    corners = np.where(np.indices((2, 2, 2)).reshape(3, -1).T.astype(bool), body.upper, body.origin)
    corners = placed_points(corners, placed)
    return _changed(grid, corners.min(0), corners.max(0), placed, hollow)


def _changed(grid: DistanceGrid, low: np.ndarray, high: np.ndarray, placed: RoomObject, change) -> DistanceGrid:
    """A room's grid with `change(values, points)` made to its nodes in a box, at points in an object's own frame."""
    first = np.floor((low - grid.origin) / grid.spacing).astype(int).clip(0, grid.shape)
    last = (np.ceil((high - grid.origin) / grid.spacing).astype(int) + 1).clip(0, grid.shape)
    if (last <= first).any():
        return grid
    part = tuple(slice(a, b) for a, b in zip(first, last, strict=True))
    nodes = grid.origin + grid.spacing * (np.moveaxis(np.indices(tuple(last - first)), 0, -1) + first)
    points = (nodes - placed.position) @ turn_of(placed)
    values = np.array(grid.values)
    values[part] = change(values[part], points).astype(values.dtype)
    return replace(grid, values=values)
