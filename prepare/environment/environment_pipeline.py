"""From the Gaussians of a room or a garden to a static environment to play in (`sandbox --stage`).

Nothing is simulated there: an asset without a cage whose distance grids collide, its support planes, the point where
bodies drop and the user's eye.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from assets.asset import Asset
from assets.environment import Environment
from assets.gaussians import Gaussians, normals_and_areas, robust_bounds
from assets.orientation import AXES, find_gravity, most_likely, support_plane, up_of_cameras, up_probabilities
from core.distance_grid import DistanceGrid
from core.errors import BadInput
from core.planes import LEVEL_COS
from core.rotation import rotation_between
from prepare.cleaning import MIN_GAUSSIANS, component_numbers, cut_out
from prepare.environment.support_planes import (
    EYE_HEIGHT,
    SupportPlane,
    drop_point,
    standing_eye,
    support_planes,
    with_floor_under,
)
from prepare.environment.surfels import (
    Surfels,
    VoxelGrid,
    haze,
    open_space,
    oriented,
    surfels,
    viewers_in,
    without_floaters,
)
from prepare.environment.winding_number import COARSENING, WindingNumber, signed_distance, winding_number
from prepare.progress import Progress, no_progress

ENVIRONMENT_VERSION = 7
ENVIRONMENT_STEPS = ("clean", "upright", "surface", "planes", "distance")
MAX_COARSE_CELLS = 16_000_000  # of the coarse grid: 64 MB on the device, and some 2 GB while it is made
USUAL_CELLS = 2_500_000  # of the coarse grid unless `cell` says otherwise
FINE_CELLS = 1_000_000  # of each fine grid
MAX_FINE_GRIDS = 6
BOARD_CELL = 0.025  # [m] in which planes are looked for: the boards of tables are 2 to 4 cm thick
MIN_CELL = 0.01  # [m]; below, only the noise of a capture is added
VOXEL_MARGIN = 4  # voxels around the scene
PLAUSIBLE_SIZE = (1.5, 60.0)  # [m] largest extent of a room or garden; files outside have arbitrary units
USUAL_SIZE = 6.0  # [m]
VIEWERS = 40  # cameras from which surfaces are oriented; more add nothing
CAMERA_REACH = 4.0  # [m] that a scene extends at most beyond its cameras; the rest is a backdrop
SIZE_RANGE = (0.5, 500.0)  # [m] that may be asked for
MAX_HEIGHT = 4.0  # [m] of the grids over the floor
MIN_HEIGHT = 0.2  # [m] of anything over the floor that was found
BELOW_FLOOR = 0.25  # [m] of the grids
FINE_MARGIN = (0.10, 0.12, 0.40)  # [m] of a fine grid beside, below and above its plane
FINE_MARGIN_CELLS = (4, 5, 0)  # and at least this many coarse cells: there, thinner boards are solid too deep down
FLOOR_FINE_RADIUS = 1.0  # [m] of the fine grid around a drop on the floor


@dataclass(frozen=True)
class EnvironmentOptions:
    """Options of the preparation of a static environment.

    up     axis of the file that points up, "+x" to "-z"; None: guessed; the floor's own normal refines it
    scale  largest extent [m]; None: the file's if a room could have that, else 6
    cell   spacing [m] of the coarse distance grid; None: as suits the size. Near tables and shelves it is finer
    cut    object ids that are taken out, to become bodies; what they stood on is closed under them
    poses  world-to-camera matrices (V, 4, 4) of its photographs, if known, which tell what is None of `up` and `scale`
    """

    up: str | None = None
    scale: float | None = None
    cell: float | None = None
    cut: tuple[int, ...] = ()
    poses: np.ndarray | None = None

    def check(self) -> None:
        """Raise BadInput for a size that cannot be used."""
        low, high = SIZE_RANGE
        if self.scale is not None and not low <= self.scale <= high:
            raise BadInput(f"a size of {self.scale:g} m is out of range for a scene ({low:g} to {high:g})")


@dataclass(frozen=True)
class Surface:
    """The oriented surface of a scene in the voxels of its coarse grid.

    solid    Gaussians that are opaque and no haze
    surfels  one a voxel, their normals towards open space
    voxels   those that hold surfels;  space: the open space over the floor
    viewers  points (V, 3) [m] in it
    origin, spacing, shape   of the coarse grid [m]
    """

    solid: Gaussians
    surfels: Surfels
    voxels: VoxelGrid
    space: VoxelGrid
    viewers: np.ndarray
    origin: np.ndarray
    spacing: float
    shape: tuple[int, int, int]


def prepare_environment(
    gaussians: Gaussians, options: EnvironmentOptions | None = None, *, progress: Progress = no_progress
) -> tuple[Asset, dict[int, Gaussians]]:
    """Make the splat of a room or a garden a static environment. Taichi must be running.

    Out.  the asset, +y up, floor at y = 0, the drop at x = z = 0; and the Gaussians of each id that was cut out
    Raises BadInput where there is no floor, and for too many cells.
    """
    begin = time.perf_counter()
    options = options or EnvironmentOptions()
    options.check()
    progress("clean", 0.0)
    main = main_component(gaussians)
    progress("upright", 0.0)
    level, (low, high), turned, eyes = stand_upright(gaussians, main, options)
    cut, rest = cut_out(level, options.cut)
    progress("surface", 0.0)
    surface = orient_surface(rest, low, high, options.cell, eyes[:: -(-len(eyes) // VIEWERS)] if len(eyes) else None)
    progress("planes", 0.0)
    points = surface.surfels.points
    planes = support_planes(*level_surface(surface, low, high))
    on, drop, clear = drop_point(planes, points)
    if on.kind == "table":
        planes = with_floor_under(planes, on)
    eye = standing_eye(planes[0], drop, on, points, surface.voxels)
    if len(eyes):  # as far from the drop as most
        away = np.linalg.norm(eyes - drop, axis=1)
        eye = eyes[np.abs(away - np.median(away)).argmin()]
    progress("distance", 0.0)
    grid, fine = distance_grids(surface, planes, fine_boxes(surface, planes, on, drop), progress)

    ground, unturned = planes[0].height, np.eye(3)
    to = -np.array([drop[0], ground, drop[2]])
    rows = tuple(map(plane_row, planes))
    environment = Environment(ground, tuple(drop), tuple(eye), clear, rows, tuple(fine)).transformed(unturned, to)
    provenance = {
        "made_by": f"vrgs prepare --static {ENVIRONMENT_VERSION}",
        "options": {"up": options.up, "scale": options.scale, "cell": options.cell, "cut": list(options.cut)},
        **turned,
        "drop_on": on.kind,
        **figures(surface, grid, fine),
        "seconds": round(time.perf_counter() - begin, 2),
    }
    progress("distance", 1.0)
    moved = {k: p.transformed(unturned, to) for k, p in cut.items()}
    grid = grid.transformed(unturned, to)
    return Asset(rest.transformed(unturned, to), sdf=grid, provenance=provenance, environment=environment), moved


def figures(surface: Surface, coarse: DistanceGrid, fine: list[DistanceGrid]) -> dict:
    """Sizes of the grids [cells], [m], and of the surface, for the provenance."""
    grids = [coarse, *fine]
    return {
        "cells": [int(grid.values.size) for grid in grids],
        "spacings": [grid.spacing for grid in grids],
        "surfels": len(surface.surfels.points),
    }


def main_component(gaussians: Gaussians) -> Gaussians:
    """Opaque Gaussians of the largest connected component. Raises BadInput where there is no scene."""
    solid = gaussians.opaque()
    if len(solid) < MIN_GAUSSIANS:
        raise BadInput(f"only {len(solid)} of {len(gaussians)} Gaussians are opaque; {MIN_GAUSSIANS} are needed")
    points = solid.means.astype(np.float64)
    low, high = robust_bounds(points)
    if not 1e-6 < (high - low).max() < 1e6:
        raise BadInput(f"the scene's extent is {(high - low).max():.3g}; this cannot be used")
    return solid.select(component_numbers(points, low, high) == 0)


def stand_upright(gaussians: Gaussians, main: Gaussians, options: EnvironmentOptions) -> tuple:
    """The scene with its floor at y = 0, in metres; corners (low, high) [m] of its extent, limited in height; how it
    was turned and scaled, for the provenance; and its cameras' places (V, 3) [m], none if they tell nothing.

    main  its Gaussians that are sure to belong to it
    """
    normals, areas = normals_and_areas(main)
    weights = np.minimum(areas, float(np.percentile(areas, 99)))  # a smear must not outweigh a floor
    chances = up_probabilities(main) if options.up is None else {options.up: 1.0}
    up, _ = most_likely(chances)
    floor, rotation = find_gravity(main.means.astype(np.float64), normals, weights, up)
    eyes, seen = np.zeros((0, 3)), None
    if options.poses is not None and options.up is None:
        eyes = -np.einsum("vij,vi->vj", options.poses[:, :3, :3], options.poses[:, :3, 3])
        seen = support_plane(main, eyes, *up_of_cameras(options.poses))
    if seen is not None:
        up = max(AXES, key=lambda axis: float(AXES[axis] @ seen[0]))
        floor, rotation, chances = seen[1], rotation_between(seen[0], (0.0, 1.0, 0.0)), {up: 1.0}
    level = main.means.astype(np.float64) @ rotation.T
    low, high = robust_bounds(level)
    longest = float((high - low).max())
    size = options.scale or (longest if PLAUSIBLE_SIZE[0] <= longest <= PLAUSIBLE_SIZE[1] else USUAL_SIZE)
    if seen is not None and options.scale is None:  # a standing person took the photographs
        size = longest * EYE_HEIGHT / (np.median(eyes @ seen[0]) - floor)
    factor = size / longest
    shift = -factor * np.array([0.0, floor, 0.0])
    low, high = factor * low + shift, factor * high + shift
    eyes = factor * eyes @ rotation.T + shift if seen is not None else eyes[:0]
    if len(eyes):
        low, high = np.maximum(low, eyes.min(0) - CAMERA_REACH), np.minimum(high, eyes.max(0) + CAMERA_REACH)
    high[1] = min(high[1], MAX_HEIGHT)
    low[1] = max(low[1], -BELOW_FLOOR)
    if high[1] < MIN_HEIGHT:
        raise BadInput("nothing stands above the floor that was found")
    turned = {
        "up": up,
        "up_sure": round(chances[up], 2),
        "up_probabilities": {} if seen is not None else {other: round(p, 3) for other, p in chances.items()},
        "lean": round(float(np.degrees(np.arccos(np.clip(rotation[1] @ AXES[up], -1, 1)))), 2),  # [degrees]
        "size": size,
        "metres_per_unit": factor,
    }
    return gaussians.transformed(rotation, shift, factor), (low, high), turned, eyes


def orient_surface(
    g: Gaussians, low: np.ndarray, high: np.ndarray, cell: float | None, cameras: np.ndarray | None = None
) -> Surface:
    """Surfels of a scene between corners (3,) [m], turned towards the open space that viewers over the floor see.

    cell     spacing [m] of the coarse grid; None: by size
    cameras  points (V, 3) [m] where photographs were taken, which are the viewers then; None: chosen over the floor
    """
    h = cell or max(float(np.cbrt((high - low).prod() / USUAL_CELLS)), 2 * MIN_CELL)
    origin, shape = grid_around(low, high, h)
    solid = g.opaque()
    solid = solid.select(~haze(solid, h))
    found = without_floaters(surfels(solid, origin, h, shape), shape, h)
    voxels = VoxelGrid.of(found.cells, origin, h, shape)
    if cameras is None:
        space = open_space(voxels, 0.0)
        viewers = viewers_in(space, low, high)
    else:
        space, viewers = open_space(voxels, float(low[1]), cameras), cameras
    return Surface(solid, oriented(found, viewers, voxels, voxels), voxels, space, viewers, origin, h, shape)


def level_surface(surface: Surface, low: np.ndarray, high: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Points and normals of level surfels, in voxels that tell the top of a board from its underside."""
    h = surface.spacing
    coarsening = max(1.0, float((high - low).prod() / (BOARD_CELL**3 * 0.7 * MAX_COARSE_CELLS)) ** (1 / 3))
    step = min(h, BOARD_CELL * coarsening)
    origin, shape = grid_around(low, high, step)
    found = in_voxels(surface.voxels, surfels(surface.solid, origin, step, shape))
    near = VoxelGrid.of(found.cells, origin, step, shape)
    found = oriented(found.select(np.abs(found.normals[:, 1]) > LEVEL_COS), surface.viewers, near, surface.voxels)
    return found.points, found.normals


def fine_boxes(
    surface: Surface,
    planes: list[SupportPlane],
    on: SupportPlane | None,
    drop: np.ndarray,
    near: Sequence[tuple[np.ndarray, np.ndarray]] = (),
) -> list[tuple[np.ndarray, np.ndarray]]:
    """Corners (low, high) [m] of the boxes with fine grids: around those of objects `near`, a drop on the floor, tables
    and shelves."""
    (side, below, above), r = FINE_MARGIN, FLOOR_FINE_RADIUS
    boxes = [(low - side, high + side) for low, high in near]
    if on is not None and on.kind == "floor":
        boxes.append((drop - [r, below, r], drop + [r, above, r]))
    side, below, above = np.maximum(FINE_MARGIN, np.multiply(FINE_MARGIN_CELLS, surface.spacing))
    for p in planes:
        if p.kind != "floor":
            (x0, z0), (x1, z1) = p.low - side, p.high + side
            boxes.append((np.array([x0, p.height - below, z0]), np.array([x1, p.height + above, z1])))
    return boxes


def distance_grids(
    surface: Surface, planes: list[SupportPlane], boxes: list[tuple[np.ndarray, np.ndarray]], progress: Progress
) -> tuple[DistanceGrid, list[DistanceGrid]]:
    """The coarse distance grid, and fine grids of the first MAX_FINE_GRIDS boxes (low, high) [m] with a surface, all in
    float16. Inside a fine grid the coarse one is empty."""
    origin, h, shape = surface.origin, surface.spacing, surface.shape
    nodes = tuple(-(-n // COARSENING) + 1 for n in shape)
    winding = winding_number(surface.surfels, origin, COARSENING * h, nodes)
    coarse = signed_distance(surface.surfels, winding, origin, h, shape, surface.space)
    phi = flattened(coarse, planes).values
    means, boxes, fine = surface.solid.means, boxes[:MAX_FINE_GRIDS], []
    for k, (low, high) in enumerate(boxes):
        progress("distance", k / len(boxes))
        low, high = np.maximum(low, origin), np.minimum(high, origin + h * (np.array(shape) - 1))
        if (high - low).min() <= 0 or not ((means > low) & (means < high)).all(1).any():
            continue
        step = max(MIN_CELL, float(np.cbrt((high - low).prod() / FINE_CELLS)))
        if (high - low).min() < 8 * step or step > 0.7 * h:
            continue
        fine.append(fine_grid(surface, winding, low, high, step, planes))
        phi = np.maximum(phi, depth_in_box(coarse, low + 1.5 * h, high - 1.5 * h))
    return replace(coarse, values=phi.astype(np.float16)), fine


def fine_grid(
    surface: Surface, winding: WindingNumber, low: np.ndarray, high: np.ndarray, step: float, planes: list[SupportPlane]
) -> DistanceGrid:
    """Distance grid of the box low to high (3,) [m], from the Gaussians in and around it."""
    shape = tuple(map(int, np.ceil((high - low) / step) + 1))
    own = ((surface.solid.means > low - 0.1) & (surface.solid.means < high + 0.1)).all(1)
    corner, padded = low - 3 * step, tuple(n + 6 for n in shape)
    found = in_voxels(surface.voxels, surfels(surface.solid.select(own), corner, step, padded))
    near = VoxelGrid.of(found.cells, corner, step, padded)
    found = oriented(found, surface.viewers, near, surface.voxels)
    grid = flattened(signed_distance(found, winding, low, step, shape, surface.space), planes)
    return replace(grid, values=grid.values.astype(np.float16))


def grid_around(low: np.ndarray, high: np.ndarray, h: float) -> tuple[np.ndarray, tuple[int, int, int]]:
    """Origin [m] and nodes an axis of the grid of spacing h [m] around a box. Raises BadInput for too many."""
    count = np.ceil((high - low) / h).clip(1, 1e6).astype(int) + 2 * VOXEL_MARGIN
    total = int(count.prod())
    if total > MAX_COARSE_CELLS:
        least = h * (total / MAX_COARSE_CELLS) ** (1 / 3)
        sides = " x ".join(map(str, count))
        raise BadInput(
            f"a grid of {sides} = {total:,} cells, the limit is {MAX_COARSE_CELLS:,}: ask for --cell {least:.2g}"
        )
    return low - VOXEL_MARGIN * h, tuple(map(int, count))


def in_voxels(voxels: VoxelGrid, s: Surfels) -> Surfels:
    """The surfels in occupied voxels of the coarse grid: no floaters."""
    return s.select(voxels.at(s.points))


def flattened(grid: DistanceGrid, planes: list[SupportPlane]) -> DistanceGrid:
    """The distance near level planes: their noise smoothed away, holes under objects that were cut out closed."""
    phi, origin, h = grid.values.copy(), grid.origin, grid.spacing
    x, y, z = (origin[k] + h * np.arange(phi.shape[k]) for k in range(3))
    columns = np.stack(np.meshgrid(x, z, indexing="ij"), -1).reshape(-1, 2)
    for plane in planes:
        rows = np.flatnonzero(np.abs(y - plane.height) < 2.5 * h)
        where = plane.covers(columns).reshape(len(x), len(z))
        if not len(rows) or not where.any():
            continue
        rows = slice(rows[0], rows[-1] + 1)
        part = phi[:, rows]
        height = np.broadcast_to((y[rows] - plane.height)[None, :, None], part.shape)
        own = where[:, None, :] & (np.abs(part - height) < 0.6 * h + 0.01)
        slab = np.maximum(height, -2.5 * h - height)
        part = np.where(own, height, part)
        phi[:, rows] = np.where(where[:, None, :], np.minimum(part, slab), part)
    return replace(grid, values=phi)


def depth_in_box(grid: DistanceGrid, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Depth [m] (X, Y, Z) of each node in a box, negative outside: the maximum with it removes the box from a solid."""
    axes = (grid.origin[k] + grid.spacing * np.arange(n) for k, n in enumerate(grid.shape))
    nodes = np.meshgrid(*axes, indexing="ij", sparse=True)
    return np.min(np.broadcast_arrays(*(np.minimum(n - low[k], high[k] - n) for k, n in enumerate(nodes))), axis=0)


def plane_row(plane: SupportPlane) -> tuple:
    """A plane as the file holds it."""
    (x0, z0), (x1, z1) = plane.low, plane.high
    return (plane.kind, *map(float, (plane.height, x0, z0, x1, z1)))
