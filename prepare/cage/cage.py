"""A cage of about a wished number of vertices that holds the Gaussians."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from assets.asset import Cage
from core.errors import BadInput
from core.point_location import TetLocator
from core.tetmesh import tet_volumes
from prepare.cage.containing_tet import Points
from prepare.cage.level_set import volume_of
from prepare.cage.mesh_quality import smallest_angle
from prepare.cage.quality_descent import Descent
from prepare.cage.relaxation import STEPS, relax
from prepare.cage.sizing_field import FINENESS, Shape, lattice_of, levels_of
from prepare.cage.stuffing import stuff_lattice

COUNTS = (50, 100_000)
TOLERANCE = 0.15  # of the number of vertices
CLOSE = 0.05  # stop looking for a better cell here
TRIES = 6  # stuffings; one or two are usual
SURELY = 1.25  # times the vertices, by an estimate that may be a tenth too high: more than TOLERANCE too many
HALVINGS = 9  # of the range of cells
PRIOR = (1.2, 2.6, 2.3)  # vertices of a cage over those of the estimate, by how often cells are halved
FEWEST = (1.2, 1.8, 2.8)  # and of the widest cells, about the least
OUTSIDE = 0.3  # cells; nodes up to there have about as many vertices as the cuts add
ANGLE_MIN = 12.0  # [degrees] the smallest dihedral angle of a cage that is taken
INSIDE_MIN = 0.995  # of the points must lie in it
VOLUME_MAX = 0.03  # by which the cage's volume may differ from the shape's
EXACT = 10_000  # vertices from which on the volume must be that right; fewer cannot hold what is thin

FREE = 3  # grid cells left round the shape
WIDEST = 1.3  # half width up to which a part may be called thin, in cells of a uniform lattice
COARSEST = 1.6  # and the cells of a plain surface may be so much wider than those
FINER, COARSER = 2, 2  # levels of an adaptive cage below and above the cell of a plain surface
THIN = 0.45  # cells; half the width below which a part slips between the lattice's vertices: it is made so wide
GROWTH = (0.005, 0.005, 0.01, 0.018, 0.025)  # of the volume; tried in turn until enough is inside
MORE_GROWTH = (0.05, 0.1, 0.2)  # where the volume need not be exact
BESIDE = 0.03  # of a tet's edge: so far beyond a point that is to be inside
LOST = 0.95  # of the points: with fewer inside a part is missing, which growing does not bring back
TUBES = (THIN, 0.6)  # cells; tried in turn where parts of the shape are lost
OTHER_CELLS = (1.0, 0.985, 1.02, 0.96)  # of the cell: another lattice where one gave too small an angle


def check_count(vertices: int) -> None:
    """Raise BadInput unless a cage can have so many vertices."""
    if not COUNTS[0] <= vertices <= COUNTS[1]:
        raise BadInput(f"a cage of {vertices} vertices was asked for; {COUNTS[0]} to {COUNTS[1]} are possible")


def widened(shape: Shape, cell: float, tube: float = THIN) -> np.ndarray:
    """Signed distance of the shape with its thinnest parts made so wide that a lattice of `cell` holds them.

    What is thinner (a tail, a horn, a rim) becomes what lies within `tube` cells of its middle.
    """
    reach = (tube + 2) * cell  # farther out the wider part is not nearer than two cells
    away = shape.from_ridge(FINENESS * tube * cell, reach)  # the true half width may be one step less
    return shape.phi if away is None else np.minimum(shape.phi, away - tube * cell)


@dataclass(frozen=True)
class Stuffed:
    """A cage before it is relaxed, the signed distance it was stuffed from, and the cell of its plain surface."""

    cage: Cage
    phi: np.ndarray
    cell: float


def stuffed(shape: Shape, cell: float, finer: int, coarser: int, tube: float = THIN) -> Stuffed:
    """Raises BadInput where the lattice is too coarse for the shape, or too large for the memory."""
    phi = widened(shape, cell / 2**finer, tube)
    levels = levels_of(shape, cell, finer, coarser)
    levels[(phi < 0) & (shape.phi >= 0)] = finer + coarser
    lattice, start, unit = lattice_of(phi, levels, cell, finer, coarser)
    return Stuffed(stuff_lattice(lattice, start, unit, phi, np.zeros(3), 1.0), phi, cell)


def sized(shape: Shape, vertices: int, first: float, finer: int, coarser: int, tube: float, report):
    """The Stuffed with the number of vertices next to `vertices`, or None; `first` is a uniform lattice's cell.

    A cell is guessed from an estimate at every other node, which the counts of real cages correct.
    """
    low, high = 0.3 * first, (COARSEST if finer else 2.0) * first
    limit = high
    half, ratio = shape.halved(OUTSIDE * limit / 2 * 2**coarser), PRIOR[finer]
    fewest = estimate(half, limit / 2, finer, coarser)
    best, best_error, tried = None, np.inf, False
    for attempt in range(TRIES):
        report(attempt / TRIES)
        sure = ratio if attempt else FEWEST[finer]
        if finer and high == limit and sure * fewest > (1 + TOLERANCE if attempt else SURELY) * vertices:
            break  # even the widest cells are too many: a stuffing more would only tell by how much
        a, b = low, high
        for _ in range(HALVINGS):
            cell = (a * b) ** 0.5
            a, b = (cell, b) if ratio * estimate(half, cell / 2, finer, coarser) > vertices else (a, cell)
        if high == limit and cell > 0.95 * limit and not tried:
            cell, tried = limit, True  # too few there is not yet known
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
        if best_error < np.log(1 + CLOSE) or high / low < 1.002 or (cell == limit and count > vertices):
            break
        low, high = (cell, high) if count > vertices else (low, cell)
        if found is not None:
            ratio = count / estimate(half, cell / 2, finer, coarser)
    return best


def estimate(shape: Shape, cell: float, finer: int, coarser: int) -> float:
    """About how many vertices a cage will have: two a cell, and some of the cells that the surface cuts."""
    levels = levels_of(shape, cell, finer, coarser)
    width = cell * 2.0 ** (coarser - np.arange(finer + coarser + 1))
    return float((2 / width**3)[levels[shape.phi < (OUTSIDE * width)[levels]]].sum())


def cage_of(
    phi: np.ndarray,
    points: np.ndarray,
    vertices: int,
    report: Callable[[float], None],
    *,
    adaptive: bool = True,
    exact: bool | None = None,
) -> Cage:
    """Cage of `vertices` vertices, give or take 15 %, round the shape where phi (X, Y, Z) [grid cells] is negative.

    points    what shall lie inside, (N, 3) [grid cells]
    report    is called with the share done
    adaptive  smaller cells where the shape is thin or curved, larger ones deep inside
    exact     whether its volume must be that of the shape; None: from EXACT vertices on
    Out.      its vertices in grid cells: node (i, j, k) lies at (i, j, k). Raises BadInput, with the reason.
    """
    filled = volume_of(phi)
    cell = (2.8 * filled / vertices) ** (1 / 3)  # two a cell, and those of the surface
    solid = np.argwhere(phi < 0)
    low = (solid.min(0) - np.ceil(cell).astype(int) - FREE).clip(0)
    high = solid.max(0) + np.ceil(cell).astype(int) + FREE + 1
    exact = vertices >= EXACT if exact is None else exact
    cage = _cage_of(phi[tuple(map(slice, low, high))], points - low, vertices, cell, report, adaptive, exact)
    return replace(cage, vertices=cage.vertices + low.astype(np.float32))


def _cage_of(phi, points, vertices: int, first: float, report, adaptive: bool, exact: bool) -> Cage:
    """As cage_of; `first` is about the cell of a uniform lattice."""
    shape, filled = Shape(phi, WIDEST * first if adaptive else first), volume_of(phi)
    reason = ""
    for finer, coarser in ((FINER, COARSER), (1, COARSER), (0, COARSER)) if adaptive else ((0, 0),):
        for tube in TUBES:
            found = sized(shape, vertices, first, finer, coarser, tube, report)
            if found is None or abs(len(found.cage.vertices) / vertices - 1) > TOLERANCE:
                closest = f" ({len(found.cage.vertices)} is the closest)" if found else ""
                none = f"no cage of about {vertices} vertices fits this shape{closest}; ask for another number"
                reason = reason or none
                break
            for share in OTHER_CELLS:
                other = found if share == 1 else stuffed(shape, found.cell * share, finer, coarser, tube)
                if abs(len(other.cage.vertices) / vertices - 1) <= TOLERANCE:
                    cage, reason = fitted(other, filled, points, vertices, exact)
                if not reason:
                    return cage
                if "not sound" not in reason:
                    break
    raise BadInput(reason)


def fitted(found: Stuffed, filled: float, points: np.ndarray, vertices: int, exact: bool) -> tuple[Cage, str]:
    """The cage relaxed and made large enough to hold the points, and what is wrong with it ("": nothing)."""
    whole = filled if exact else volume_of(found.phi)
    cage, steps = found.cage, STEPS
    if not (tet_volumes(cage.vertices, cage.tets) > 0).all():
        return cage, fault(cage, filled, 0.0, vertices, exact)
    lift, held, place = None, Points(points), (found.phi, np.zeros(3), 1.0)
    descent = Descent(cage.tets, len(cage.vertices), *place)
    for growth in GROWTH + (() if exact else MORE_GROWTH):
        cage = relax(cage, *place, volume=whole * (1 + growth), lift=lift, steps=steps, descent=descent)
        outside = points[held.hosts(cage.vertices, cage.tets) < 0]
        share = 1 - len(outside) / max(len(points), 1)
        reason = fault(cage, filled, share, vertices, exact)
        if "inside" not in reason or share < LOST:
            break
        lift, steps = lifted(cage, outside), STEPS // 3
    return cage, reason


def lifted(cage: Cage, outside: np.ndarray) -> np.ndarray:
    """How far out each vertex (V,) should go to take in the points (N, 3) that lie outside."""
    locator = TetLocator(cage.vertices, cage.tets)
    host, foot = locator.nearest(outside)
    depth = np.linalg.norm(outside - foot, axis=1) + locator.edge_length(host, foot) * BESIDE
    lift = np.zeros(len(cage.vertices))
    np.maximum.at(lift, cage.tets[host].ravel(), np.repeat(depth, 4))
    return np.minimum(lift, 0.2 * locator.edge_length(host, foot).max(initial=0.0))


def fault(cage: Cage, filled: float, share: float, vertices: int, exact: bool | None = None) -> str:
    """What is wrong with a cage that holds a `share` of the points, in one line; "" if nothing is."""
    exact = vertices >= EXACT if exact is None else exact
    if abs(len(cage.vertices) - vertices) > TOLERANCE * vertices:
        return f"the cage has {len(cage.vertices)} vertices, {vertices} were asked for"
    volume = tet_volumes(cage.vertices, cage.tets)
    if not (volume > 0).all():
        return f"the cage is not sound: {int((volume <= 0).sum())} tets have no positive volume"
    angle = smallest_angle(cage.vertices, cage.tets)
    if angle < ANGLE_MIN:
        return f"the cage is not sound: its smallest dihedral angle is {angle:.1f} degrees"
    if share < INSIDE_MIN:
        return f"only {share:.2%} of the opaque Gaussians lie inside the cage; ask for more vertices"
    off = volume.sum() / filled - 1
    if exact and abs(off) > VOLUME_MAX:
        return f"the cage's volume is {off:+.1%} off that of the shape, which is too thin for {vertices} vertices"
    return ""


def share_inside(cage: Cage, points: np.ndarray) -> float:
    """Share of the points (N, 3) that lie in a tet. Taichi must be running."""
    return Points(points).share(cage.vertices, cage.tets)
