"""Cage of about a wished number of vertices that holds the Gaussians."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from assets.asset import Cage
from core.distance_grid import DistanceGrid
from core.errors import BadInput
from core.point_location import TetLocator
from core.tetmesh import tet_volumes
from prepare.cage.level_set import volume_of
from prepare.cage.mesh_quality import smallest_angle
from prepare.cage.relaxation import DESCENT_STEPS, relax
from prepare.cage.sizing_field import WIDTH_STEP, ShapeWidths, lattice_of, levels_of
from prepare.cage.stuffing import stuff

VERTEX_RANGE = (50, 100_000)
VERTEX_TOLERANCE = 0.15  # of the number of vertices
VERTEX_GOAL = 0.05  # of it; no better cell is looked for below this
MAX_STUFFINGS = 6  # to meet the number; one or two are usual
CERTAIN_EXCESS = 1.25  # an estimate may be a tenth too high: above this times the vertices, tolerance is exceeded
BISECTIONS = 9  # of the range of cells, per estimate
USUAL_RATIO = (1.2, 2.6, 2.3)  # vertices of a cage over those of the estimate, by how often cells are halved
LEAST_RATIO = (1.2, 1.8, 2.8)  # about the least, at the widest cells
OUTER_BAND = 0.3  # cells; the nodes out to there account for the vertices that cuts add
ANGLE_MIN = 12.0  # [degrees] smallest dihedral angle of an accepted cage
INSIDE_MIN = 0.995  # fraction of the points that must lie inside
VOLUME_MAX = 0.03  # relative difference between the volumes of cage and shape
EXACT_VERTICES = 10_000  # from which on the volume must be that right; fewer cannot hold thin features

CROP_MARGIN = 3  # grid cells around the shape
THIN_LIMIT = 1.3  # half width up to which a feature may count as thin, in cells of a uniform lattice
COARSEST = 1.6  # the cells of a plain surface may be wider than those by this factor
FINER, COARSER = 2, 2  # levels of an adaptive cage below and above the cell of a plain surface
TUBE_RADII = (0.45, 0.6)  # cells, tried in turn; features thinner than this are widened to it (a lattice misses them)
GROWTHS = (0.005, 0.005, 0.01, 0.018, 0.025)  # of the volume; tried in turn until enough is inside
INEXACT_GROWTHS = (0.05, 0.1, 0.2)  # where the volume need not be exact
CLEARANCE = 0.03  # of a tet's edge, beyond a point that is to be inside
INSIDE_HOPELESS = 0.95  # with fewer inside a feature is missing, which growing does not bring back
CELL_FACTORS = (1.0, 0.985, 1.02, 0.96)  # other lattices, tried in turn where one gave too small an angle


class NoSoundCage(BadInput):
    """Raised where a shape has no good cage of the number of vertices that was asked for; it may have one of more."""


def check_count(vertices: int) -> None:
    """Raise BadInput unless a cage can have this many vertices."""
    if not VERTEX_RANGE[0] <= vertices <= VERTEX_RANGE[1]:
        low, high = VERTEX_RANGE
        raise BadInput(f"a cage of {vertices} vertices was asked for; {low} to {high} are possible")


def widened(shape: ShapeWidths, cell: float, tube: float = TUBE_RADII[0]) -> np.ndarray:
    """Signed distance of the shape with its thinnest features widened so that a lattice of `cell` holds them.

    A thinner feature (a tail, a horn, a rim) becomes what lies within `tube` cells of its middle.
    """
    limit = (tube + 2) * cell  # farther out the widened feature is not nearer than two cells
    away = shape.distance_to_medial(WIDTH_STEP * tube * cell, limit)  # the true half width may be one step less
    return shape.phi if away is None else np.minimum(shape.phi, away - tube * cell)


@dataclass(frozen=True)
class Stuffed:
    """A cage before relaxation, the signed distance it was stuffed from, and the cell of its plain surface."""

    cage: Cage
    phi: np.ndarray
    cell: float


def stuffed(shape: ShapeWidths, cell: float, finer: int, coarser: int, tube: float) -> Stuffed:
    """Stuff the shape. Raises BadInput where the lattice is too coarse for it, or too large for the memory."""
    phi = widened(shape, cell / 2**finer, tube)
    levels = levels_of(shape, cell, finer, coarser)
    levels[(phi < 0) & (shape.phi >= 0)] = finer + coarser
    lattice = lattice_of(phi, levels, cell, finer, coarser)
    return Stuffed(stuff(lattice, DistanceGrid(phi, np.zeros(3), 1.0)), phi, cell)


def stuffed_to_count(shape: ShapeWidths, vertices: int, uniform_cell: float, finer: int, coarser: int, tube, report):
    """The Stuffed whose number of vertices is nearest to `vertices`, or None.

    A cell is guessed from an estimate at every other node, which the counts of actual cages correct.
    """
    low, high = 0.3 * uniform_cell, (COARSEST if finer else 2.0) * uniform_cell
    limit = high
    half, ratio = shape.halved(), USUAL_RATIO[finer]
    fewest = estimated_vertices(half, limit / 2, finer, coarser)
    best, best_error, tried_limit = None, np.inf, False
    for attempt in range(MAX_STUFFINGS):
        report(attempt / MAX_STUFFINGS)
        least_ratio = ratio if attempt else LEAST_RATIO[finer]
        excess = 1 + VERTEX_TOLERANCE if attempt else CERTAIN_EXCESS
        if finer and high == limit and least_ratio * fewest > excess * vertices:
            break  # even the widest cells give too many: another stuffing would only tell by how much
        a, b = low, high
        for _ in range(BISECTIONS):
            cell = (a * b) ** 0.5
            a, b = (cell, b) if ratio * estimated_vertices(half, cell / 2, finer, coarser) > vertices else (a, cell)
        if high == limit and cell > 0.95 * limit and not tried_limit:
            cell, tried_limit = limit, True  # that it gives too few is not yet known
        elif cell > 0.99 * high or cell < 1.01 * low:  # the estimate is off: halve what is known instead
            cell = (low * high) ** 0.5
        try:
            found = stuffed(shape, cell, finer, coarser, tube)
            count = len(found.cage.vertices)
        except BadInput:
            found, count = None, 1  # too coarse for the shape
        error = abs(np.log(count / vertices))
        if error < best_error and found is not None:
            best, best_error = found, error
        if best_error < np.log(1 + VERTEX_GOAL) or high / low < 1.002 or (cell == limit and count > vertices):
            break
        low, high = (cell, high) if count > vertices else (low, cell)
        if found is not None:
            ratio = count / estimated_vertices(half, cell / 2, finer, coarser)
    return best


def estimated_vertices(shape: ShapeWidths, cell: float, finer: int, coarser: int) -> float:
    """Rough number of vertices of a cage: two a cell, and a part of the cells that the surface cuts."""
    levels = levels_of(shape, cell, finer, coarser)
    width = cell * 2.0 ** (coarser - np.arange(finer + coarser + 1))
    return float((2 / width**3)[levels[shape.phi < (OUTER_BAND * width)[levels]]].sum())


def cage_of(
    phi: np.ndarray,
    points: np.ndarray,
    vertices: int,
    report: Callable[[float], None],
    *,
    adaptive: bool = True,
    exact: bool | None = None,
) -> Cage:
    """Cage of `vertices` vertices, within 15 %, around the shape where phi (X, Y, Z) [grid cells] is negative.

    points    centres that shall lie inside, (N, 3) [grid cells]
    report    is called with the fraction done
    adaptive  smaller cells where the shape is thin or curved, larger ones deep inside
    exact     whether its volume must be that of the shape; None: from EXACT_VERTICES on
    Out.      its vertices in grid cells: node (i, j, k) lies at (i, j, k). Raises NoSoundCage, with the reason.
    """
    uniform_cell = (2.8 * volume_of(phi) / vertices) ** (1 / 3)  # two vertices a cell, and those of the surface
    solid = np.argwhere(phi < 0)
    low = (solid.min(0) - np.ceil(uniform_cell).astype(int) - CROP_MARGIN).clip(0)
    high = solid.max(0) + np.ceil(uniform_cell).astype(int) + CROP_MARGIN + 1
    exact = vertices >= EXACT_VERTICES if exact is None else exact
    phi = phi[tuple(map(slice, low, high))]
    shape = ShapeWidths.of(phi, THIN_LIMIT * uniform_cell if adaptive else uniform_cell)
    points, filled, reason = points - low, volume_of(phi), ""
    for finer, coarser in ((FINER, COARSER), (1, COARSER), (0, COARSER)) if adaptive else ((0, 0),):
        for tube in TUBE_RADII:
            found = stuffed_to_count(shape, vertices, uniform_cell, finer, coarser, tube, report)
            if found is None or abs(len(found.cage.vertices) / vertices - 1) > VERTEX_TOLERANCE:
                closest = f" ({len(found.cage.vertices)} is the closest)" if found else ""
                reason = reason or (
                    f"no cage of about {vertices} vertices fits this shape{closest}; ask for another number"
                )
                break
            for factor in CELL_FACTORS:
                other = found if factor == 1 else stuffed(shape, found.cell * factor, finer, coarser, tube)
                if abs(len(other.cage.vertices) / vertices - 1) <= VERTEX_TOLERANCE:
                    cage, reason = fitted(other, filled, points, vertices, exact)
                if not reason:
                    return replace(cage, vertices=cage.vertices + low.astype(np.float32))
                if "not sound" not in reason:
                    break
    raise NoSoundCage(reason)


def fitted(found: Stuffed, filled: float, points: np.ndarray, vertices: int, exact: bool) -> tuple[Cage, str]:
    """The cage relaxed and grown until it holds the points, and its fault ("": none).

    filled  volume of the shape [grid cells]
    """
    whole = filled if exact else volume_of(found.phi)
    cage, steps, lift = found.cage, DESCENT_STEPS, None
    if not (tet_volumes(cage.vertices, cage.tets) > 0).all():
        return cage, fault(cage, filled, 0.0, vertices, exact)
    distance = DistanceGrid(found.phi, np.zeros(3), 1.0)
    for growth in GROWTHS + (() if exact else INEXACT_GROWTHS):
        cage = relax(cage, distance, whole * (1 + growth), lift=lift, steps=steps)
        locator = TetLocator(cage.vertices, cage.tets)
        outside = points[locator.find(points) < 0]
        inside = 1 - len(outside) / max(len(points), 1)
        reason = fault(cage, filled, inside, vertices, exact)
        if "inside" not in reason or inside < INSIDE_HOPELESS:
            break
        lift, steps = lift_over(locator, outside), DESCENT_STEPS // 3
    return cage, reason


def lift_over(cage: TetLocator, outside: np.ndarray) -> np.ndarray:
    """Distance each vertex (V,) should move outwards to take in the points (N, 3) that lie outside."""
    host, foot = cage.nearest(outside)
    edge = cage.edge_length(host, foot)
    depth = np.linalg.norm(outside - foot, axis=1) + edge * CLEARANCE
    lift = np.zeros(len(cage.vertices))
    np.maximum.at(lift, cage.tets[host].ravel(), np.repeat(depth, 4))
    return np.minimum(lift, 0.2 * edge.max(initial=0.0))


def fault(cage: Cage, filled: float, inside: float, vertices: int, exact: bool = False) -> str:
    """The fault of a cage that holds the fraction `inside` of the points, in one line; "" if it has none."""
    if abs(len(cage.vertices) - vertices) > VERTEX_TOLERANCE * vertices:
        return f"the cage has {len(cage.vertices)} vertices, {vertices} were asked for"
    volume = tet_volumes(cage.vertices, cage.tets)
    if not (volume > 0).all():
        return f"the cage is not sound: {int((volume <= 0).sum())} tets have no positive volume"
    angle = smallest_angle(cage.vertices, cage.tets)
    if angle < ANGLE_MIN:
        return f"the cage is not sound: its smallest dihedral angle is {angle:.1f} degrees"
    if inside < INSIDE_MIN:
        return f"only {inside:.2%} of the opaque Gaussians lie inside the cage of {vertices} vertices"
    off = volume.sum() / filled - 1
    if exact and abs(off) > VOLUME_MAX:
        return f"the cage's volume is {off:+.1%} off that of the shape, which is too thin for {vertices} vertices"
    return ""
