"""From the Gaussians of a room or a garden to a stage: what is solid, where the tables are, where to stand.

Nothing is simulated there: an asset without a cage whose distance grids collide, and what `sandbox --stage` must know.
"""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np

from assets.asset import Asset
from assets.environment import Environment
from assets.gaussians import Gaussians
from assets.level_planes import LEVEL_COS
from assets.up_axis import robust_bounds
from core.distance_grid import DistanceGrid
from core.errors import BadInput
from prepare.cleaning import FEWEST, cut_out, largest_piece
from prepare.room.spawn_points import drop_place, stand_place
from prepare.room.support_planes import Support, floor_under, gravity, on_floor, supports
from prepare.room.surfels import OPAQUE, Surfels, haze, normals_and_areas, surfels, without_floaters
from prepare.room.visibility import Cells, cells_of, open_space, oriented, viewers_in
from prepare.room.winding_number import COARSENING, signed_distance, winding

VERSION = 2
STAGES = ("clean", "upright", "surface", "planes", "distance")
MOST_CELLS = 16_000_000  # of the whole grid: 64 MB on the device, and some 2 GB while it is made
USUAL_CELLS = 2_500_000  # as many are made unless --cell says otherwise
FINE_CELLS = 1_000_000  # of each finer grid
MOST_FINE = 6
BOARD_CELL = 0.025  # [m] in which planes are looked for: the boards of tables are 2 to 4 cm thick
FINEST = 0.01  # [m] below that, the noise of a capture is all that is added
MARGIN = 4  # voxels round the scene
PLAUSIBLE = (1.5, 60.0)  # [m] largest extent of a room or garden; files outside have arbitrary units
USUAL_SIZE = 6.0  # [m]
SIZES = (0.5, 500.0)  # [m] that may be asked for
TALLEST = 4.0  # [m] over the floor that the grids reach
AROUND = (0.10, 0.12, 0.40)  # [m] of a finer grid beside, below and above its plane
MISSED = (4, 5, 0)  # and at least so many coarse cells: boards thinner than these are solid too far down there
Progress = Callable[[str, float], None]


def prepare_static(
    gaussians: Gaussians,
    *,
    up: str | None = None,
    scale: float | None = None,
    cell: float | None = None,
    cut: tuple[int, ...] = (),
    progress: Progress | None = None,
) -> tuple[Asset, dict[int, Gaussians]]:
    """Make the splat of a room or a garden a stage. Taichi must be running.

    up     axis of the file that points up, "+x" to "-z"; None: guessed; the floor's own normal refines it
    scale  largest extent [m]; None: the file's if a room could have that, else 6
    cell   spacing [m] of the whole distance grid; None: as suits the size. Near tables and shelves it is finer
    cut    object ids that are taken out, to become bodies; what they stood on is closed under them
    Out.   the asset, +y up, floor at y = 0, the drop at x = z = 0; and the Gaussians of each id that was cut out
    Raises BadInput where there is no floor, or for too many cells.
    """
    begin = time.perf_counter()
    report = progress or (lambda stage, done: None)
    if scale is not None and not SIZES[0] <= scale <= SIZES[1]:
        raise BadInput(f"a size of {scale:g} m is out of range for a scene ({SIZES[0]:g} to {SIZES[1]:g})")
    report("clean", 0.0)
    solid = gaussians.select(gaussians.opacities > OPAQUE)
    if len(solid) < FEWEST:
        raise BadInput(f"only {len(solid)} of {len(gaussians)} Gaussians are opaque; {FEWEST} are needed")
    points = solid.means.astype(np.float64)
    low, high = robust_bounds(points)
    if not 1e-6 < (high - low).max() < 1e6:
        raise BadInput(f"the scene's extent is {(high - low).max():.3g}; nothing to be made of that")
    main = solid.select(largest_piece(points, low, high))

    report("upright", 0.0)
    normals, areas = normals_and_areas(main)
    weights = np.minimum(areas, cap(areas))
    named, floor, rotation, sure = gravity(main.means.astype(np.float64), normals, weights, up)
    level = main.means.astype(np.float64) @ rotation.T
    low, high = robust_bounds(level)
    longest = float((high - low).max())
    size = scale or (longest if PLAUSIBLE[0] <= longest <= PLAUSIBLE[1] else USUAL_SIZE)
    factor = size / longest
    shift = -factor * np.array([0.0, floor, 0.0])
    g = gaussians.transformed(rotation, shift, factor)
    pieces, g = cut_out(g, cut)
    low, high = factor * low + shift, factor * high + shift
    high[1] = min(high[1], TALLEST)
    low[1] = max(low[1], -0.25)
    if high[1] < 0.2:
        raise BadInput("nothing stands above the floor that was found; name the axis that points up with --up")

    report("surface", 0.0)
    h = cell or max(float(np.cbrt((high - low).prod() / USUAL_CELLS)), 2 * FINEST)
    origin, shape = box_of(low, high, h)
    solid = g.select((g.opacities > OPAQUE) & ~haze(g, h))
    near = without_floaters(surfels(solid, origin, h, shape), shape, h)
    room = cells_of(near, origin, h, shape)
    rng = np.random.default_rng(0)
    space = open_space(room, 0.0)
    viewers = viewers_in(space, low[[0, 2]], high[[0, 2]], 0.0, rng)
    near = oriented(near, viewers, room, room)

    report("planes", 0.0)
    planes = supports(*level_surface(solid, low, high, h, viewers, room))
    on, drop, clear = drop_place(planes, near.points)
    planes = on_floor(planes, floor_under(planes, on)) if on.kind == "table" else planes
    eye = stand_place(planes[0], drop, on, near.points, room)

    report("distance", 0.0)
    coarse = COARSENING * h
    nodes = tuple(-(-n // COARSENING) + 1 for n in shape)
    w = winding(near, origin, coarse, nodes), origin, coarse
    phi = flattened(signed_distance(near, w, origin, h, shape, space), origin, h, planes)
    fine = []
    boxes = [box_round(p, h) for p in planes[1 : 1 + MOST_FINE]]
    if on.kind == "floor":
        boxes = [(drop - [1.0, AROUND[1], 1.0], drop + [1.0, AROUND[2], 1.0]), *boxes[: MOST_FINE - 1]]
    for k, (a, b) in enumerate(boxes):
        report("distance", k / len(boxes))
        a, b = np.maximum(a, origin), np.minimum(b, origin + h * (np.array(shape) - 1))
        step = max(FINEST, float(np.cbrt((b - a).prod() / FINE_CELLS)))
        if (b - a).min() < 8 * step or step > 0.7 * h:
            continue
        fine.append(fine_grid(solid, a, b, step, w, planes, viewers, room, space))
        phi = np.maximum(phi, inside_box(origin, h, shape, a + 1.5 * h, b - 1.5 * h))
    ground = planes[0].height
    to = -np.array([drop[0], ground, drop[2]])
    environment = Environment(
        0.0,
        tuple(map(float, drop + to)),
        tuple(map(float, eye + to)),
        clear,
        tuple(row_of(p, to) for p in planes),
        tuple(DistanceGrid(f.values, f.origin + to, f.spacing) for f in fine),
    )
    g = g.transformed(np.eye(3), to)
    provenance = {
        "made_by": f"vrgs prepare --static {VERSION}",
        "options": {"up": up, "scale": scale, "cell": cell, "cut": list(cut)},
        "up": named,
        "up_sure": round(sure, 2),
        "lean": round(float(np.degrees(np.arccos(np.clip(rotation[1] @ axis_of(named), -1, 1)))), 2),
        "size": size,
        "metres_per_unit": factor,
        "drop_on": on.kind,
        "cells": [int(phi.size), *(int(f.values.size) for f in fine)],
        "spacings": [h, *(f.spacing for f in fine)],
        "surfels": len(near.points),
        "seconds": round(time.perf_counter() - begin, 2),
    }
    report("distance", 1.0)
    grid = DistanceGrid(phi.astype(np.float16), origin + to, h)
    moved = {k: p.transformed(np.eye(3), to) for k, p in pieces.items()}
    return Asset(g, sdf=grid, provenance=provenance, environment=environment), moved


def cap(areas: np.ndarray) -> float:
    """The largest area that a Gaussian counts for: a smear must not outweigh a floor."""
    return float(np.percentile(areas, 99))


def axis_of(name: str) -> np.ndarray:
    """Unit vector of an axis by its name."""
    return np.eye(3)["xyz".index(name[1])] * (1 if name[0] == "+" else -1)


def box_of(low: np.ndarray, high: np.ndarray, h: float) -> tuple[np.ndarray, tuple[int, int, int]]:
    """Origin [m] and number of nodes an axis of the grid of spacing h [m] round a box. Raises BadInput for too many."""
    count = np.ceil((high - low) / h).clip(1, 1e6).astype(int) + 2 * MARGIN
    total = int(count.prod())
    if total > MOST_CELLS:
        least = h * (total / MOST_CELLS) ** (1 / 3)
        sides = " x ".join(map(str, count))
        raise BadInput(f"a grid of {sides} = {total:,} cells, the limit is {MOST_CELLS:,}: ask for --cell {least:.2g}")
    return low - MARGIN * h, tuple(map(int, count))


def box_round(plane: Support, h: float) -> tuple[np.ndarray, np.ndarray]:
    """The box of the finer grid of a plane, where the others have cells of h [m]."""
    side, below, above = np.maximum(AROUND, np.multiply(MISSED, h))
    low, high = plane.low - side, plane.high + side
    return (
        np.array([low[0], plane.height - below, low[1]]),
        np.array([high[0], plane.height + above, high[1]]),
    )


def level_surface(solid: Gaussians, low, high, h: float, viewers, room: Cells) -> tuple[np.ndarray, np.ndarray]:
    """Points and normals of what is level, in voxels that tell the top of a board from its underside."""
    step = min(h, BOARD_CELL * max(1.0, float((high - low).prod() / (BOARD_CELL**3 * 0.7 * MOST_CELLS)) ** (1 / 3)))
    origin, shape = box_of(low, high, step)
    found = seen_by(room, surfels(solid, origin, step, shape))
    occupied = cells_of(found, origin, step, shape)
    found = oriented(found.select(np.abs(found.normals[:, 1]) > LEVEL_COS), viewers, occupied, room)
    return found.points, found.normals


def seen_by(room: Cells, s: Surfels) -> Surfels:
    """The surfels in voxels that are occupied in the whole grid: no floaters."""
    i = np.floor((s.points - room.origin) / room.spacing).astype(int).clip(0, np.array(room.occupied.shape) - 1)
    return s.select(room.occupied[tuple(i.T)])


def fine_grid(solid: Gaussians, low, high, step, w, planes, viewers, room: Cells, space: Cells) -> DistanceGrid:
    """The distance grid of a box, from the Gaussians in and round it."""
    origin, shape = low - 0.0, tuple(map(int, np.ceil((high - low) / step) + 1))
    pad = 3 * step
    mine = ((solid.means > low - 0.1) & (solid.means < high + 0.1)).all(1)
    corner, many = origin - pad, tuple(n + 6 for n in shape)
    found = seen_by(room, surfels(solid.select(mine), corner, step, many))
    found = oriented(found, viewers, cells_of(found, corner, step, many), room)
    phi = flattened(signed_distance(found, w, origin, step, shape, space), origin, step, planes)
    return DistanceGrid(phi.astype(np.float16), origin, float(step))


def flattened(phi: np.ndarray, origin: np.ndarray, h: float, planes: list[Support]) -> np.ndarray:
    """The distance [m] where a level plane was found: its noise smoothed away, its holes closed under what was cut."""
    y = origin[1] + h * np.arange(phi.shape[1])
    x, z = (origin[k] + h * np.arange(phi.shape[k]) for k in (0, 2))
    columns = np.stack(np.meshgrid(x, z, indexing="ij"), -1).reshape(-1, 2)
    phi = phi.copy()
    for plane in planes:
        rows = np.flatnonzero(np.abs(y - plane.height) < 2.5 * h)
        where = plane.over(columns).reshape(len(x), len(z))
        if not len(rows) or not where.any():
            continue
        rows = slice(rows[0], rows[-1] + 1)
        part = phi[:, rows]
        height = np.broadcast_to((y[rows] - plane.height)[None, :, None], part.shape)
        own = where[:, None, :] & (np.abs(part - height) < 0.6 * h + 0.01)
        slab = np.maximum(height, -2.5 * h - height)
        part = np.where(own, height, part)
        phi[:, rows] = np.where(where[:, None, :], np.minimum(part, slab), part)
    return phi


def inside_box(origin, h: float, shape, low, high) -> np.ndarray:
    """How deep [m] each node lies in a box, negative outside: what takes a piece out of a solid."""
    nodes = np.meshgrid(*(origin[k] + h * np.arange(shape[k]) for k in range(3)), indexing="ij", sparse=True)
    return np.min(np.broadcast_arrays(*(np.minimum(n - low[k], high[k] - n) for k, n in enumerate(nodes))), axis=0)


def row_of(plane: Support, to: np.ndarray) -> tuple:
    """A plane as it lies in the file."""
    (x0, z0), (x1, z1) = plane.low, plane.high
    places = (plane.height + to[1], x0 + to[0], z0 + to[2], x1 + to[0], z1 + to[2])
    return (plane.kind, *map(float, places))
