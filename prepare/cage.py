"""A cage of about a wished number of vertices that holds the Gaussians."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.ndimage import distance_transform_edt

from assets.asset import Cage
from assets.errors import BadInput
from assets.locate import Locator
from prepare.quality import dihedral_angles
from prepare.relax import relax
from prepare.stuffing import stuff

COUNTS = (50, 100_000)
TOLERANCE = 0.15  # of the number of vertices
CLOSE = 0.05  # stop looking for a better cell here
TRIES = 10  # stuffings; three or four are usual
ANGLE_MIN = 10.0  # [degrees] the smallest dihedral angle of a cage that is taken
INSIDE_MIN = 0.992  # of the points; the cage is widened until that many are inside

# In lattice cells:
THIN = 0.4  # half the width below which a part slips between the lattice's vertices
POINTED = 0.75  # it must stand out this share of THIN; edges and corners do not
# Half the width that thin parts are given, and how far the cage lies outside of the surface, since its flat faces cut
# off what is round; tried in turn. 0.11 is about one grid cell at 2,000 vertices.
# Wider parts would need a larger cell, which would need wider parts.
WIDENING = ((0.45, 0.11), (0.55, 0.14), (0.5, 0.2), (0.6, 0.2))


def check_count(vertices: int) -> None:
    """Raise BadInput unless a cage can have so many vertices."""
    if not COUNTS[0] <= vertices <= COUNTS[1]:
        raise BadInput(f"a cage of {vertices} vertices was asked for; {COUNTS[0]} to {COUNTS[1]} are possible")


def widened(phi: np.ndarray, cell: float, tube: float, margin: float) -> np.ndarray:
    """Signed distance [grid cells] of the shape grown by `margin`, and so much at thin parts that a lattice holds them.

    phi, cell     signed distance and the lattice's cell, both in grid cells
    tube, margin  half the width of thin parts (a tail, a horn, a rim), and the growth [lattice cells]
    """
    deep = phi < -THIN * cell
    opened = distance_transform_edt(~deep) if deep.any() else np.full(phi.shape, np.inf)
    thin = (phi < 0) & (opened > (1 + POINTED) * THIN * cell)
    if thin.any():
        phi = np.minimum(phi, distance_transform_edt(~thin) - tube * cell)
    return phi - margin * cell


def sized(phi: np.ndarray, vertices: int, cell: float, widening: tuple, report: Callable[[float], None]):
    """Cage of `vertices` vertices round phi < 0 [grid cells], the shape it was stuffed from and its cell.

    Raises BadInput where no cell near the first guess `cell` gives that number, give or take 15 %.
    """
    low, high = 0.0, np.inf
    best, best_error = None, np.inf
    for attempt in range(TRIES):
        report(attempt / TRIES)
        shape = widened(phi, cell, *widening)
        try:
            cage = stuff(shape, np.zeros(3), 1.0, cell=cell)
            count = len(cage.vertices)
        except BadInput:
            cage, count = None, 1  # too coarse for the shape
        error = abs(np.log(count / vertices))
        if cage is not None and error < best_error and dihedral_angles(cage.vertices, cage.tets).min() >= ANGLE_MIN:
            best, best_error = (cage, shape, cell), error
        if best_error < np.log(1 + CLOSE):
            break
        low, high = (cell, high) if count > vertices else (low, cell)
        guess = cell * np.clip((count / vertices) ** (1 / 2.7), 0.5, 2.0)  # vertices grow as about cell^-2.7
        middle = (low + high) / 2 if np.isfinite(high) else 2 * cell
        cell = guess if low < guess < high and attempt < TRIES // 2 else middle
    if best is None or abs(len(best[0].vertices) - vertices) > TOLERANCE * vertices:
        found = f" ({len(best[0].vertices)} is the closest)" if best else ""
        raise BadInput(f"no sound cage of about {vertices} vertices fits this shape{found}; ask for another number")
    return best


def cage_of(phi: np.ndarray, points: np.ndarray, vertices: int, report: Callable[[float], None]) -> Cage:
    """Cage of `vertices` vertices, give or take 15 %, round the shape where phi (X, Y, Z) [grid cells] is negative.

    points  what shall lie inside, (N, 3) [grid cells]
    report  is called with the share done
    Out.    its vertices in grid cells: node (i, j, k) lies at (i, j, k). Raises BadInput.
    """
    cell = (2.8 * float((phi < 0.5).sum()) / vertices) ** (1 / 3)  # two a cell, and those of the surface
    best, best_share = None, -1.0
    for widening in WIDENING:
        cage, shape, cell = sized(phi, vertices, cell, widening, report)
        cage = relax(cage, shape, np.zeros(3), 1.0, cell=cell)
        share = share_inside(cage, points)
        if share > best_share:
            best, best_share = cage, share
        if share >= INSIDE_MIN:
            break
    return best


def share_inside(cage: Cage, points: np.ndarray) -> float:
    """Share of the points (N, 3) that lie in a tet."""
    return float((Locator(cage.vertices, cage.tets).find(points) >= 0).mean()) if len(points) else 1.0
