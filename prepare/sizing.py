"""How fine a cage's cells should be, place by place: fine where the shape is thin or curved, coarse deep inside.

All lengths are in cells of the grid of the signed distance, and Taichi must be running.
"""

from __future__ import annotations

import numpy as np
from scipy.ndimage import gaussian_laplace, maximum_filter

from assets.errors import BadInput
from prepare.distance import distance
from prepare.graded import LATTICE_MAX, graded_lattice

POINTED = 0.75  # a thin part stands out this share of its half width; edges and corners do not
ACROSS = 1.6  # cells; what is thinner is made of smaller ones
GRADING = 0.6  # a cell may be as wide as this share of its depth
BAND = 1.3  # cells round the surface, and round what is thin, that are as fine as that
BEND = 1.6  # cells over radius of curvature (twice the mean) above which smaller ones are taken
NOISE = 0.4  # cells; what the surface does over less than this is not called curvature
NARROWEST = 1.5  # half width that is told apart from wider ones, and then in steps of
FINENESS = 2**0.5


class Shape:
    """A shape phi (X, Y, Z) < 0, and what of it does not depend on the lattice.

    half_width  (X, Y, Z) of the part that each place belongs to; infinite outside, and where it is above `widest`
    """

    def __init__(self, phi: np.ndarray, widest: float) -> None:
        self.phi = phi
        self._curvature = {}
        inside = phi < 0
        self.half_width = np.full(phi.shape, np.inf, np.float32)
        steps = int(np.ceil(np.log(max(widest / NARROWEST, 1.0)) / np.log(FINENESS)))
        for k in reversed(range(steps + 1)):
            r = NARROWEST * FINENESS**k
            deep = phi < -r  # what a ball of this radius, pushed about inside, cannot reach is thinner
            self.half_width[inside & (distance(deep) > (1 + POINTED) * r) if deep.any() else inside] = r

    def halved(self) -> Shape:
        """The shape at every other node, in cells twice as wide."""
        half = object.__new__(Shape)
        half.phi, half.half_width, half._curvature = self.phi[::2, ::2, ::2] / 2, self.half_width[::2, ::2, ::2] / 2, {}
        return half

    def curvature(self, cell: float) -> np.ndarray:
        """Sum of the principal curvatures, absolute (X, Y, Z), of the shape smoothed over a share of a cell."""
        k = round(max(0.0, 2 * float(np.log2(NOISE * cell))))
        if k not in self._curvature:
            sigma = 2 ** (k / 2)
            self._curvature[k] = np.abs(gaussian_laplace(self.phi.clip(-5 * sigma, 5 * sigma), sigma, truncate=3))
        return self._curvature[k]


def levels_of(shape: Shape, cell: float, finer: int, coarser: int) -> np.ndarray:
    """Level (X, Y, Z) int8 that each place asks for: `coarser` at a plain surface, less inside, more in thin parts.

    cell            width at a plain surface
    finer, coarser  how often it may be halved, and doubled
    """
    phi = shape.phi
    depth = np.maximum(1.0, -phi * (GRADING / cell))
    levels = (coarser - np.floor(np.log2(depth))).clip(0, coarser).astype(np.int8)
    levels[phi > BAND * cell] = 0
    if finer:
        curved = (np.abs(phi) < cell) & (shape.curvature(cell) * cell > BEND)
        levels[curved] = coarser + 1
    for k in range(1, finer + 1):
        thin = shape.half_width < 0.5 * ACROSS * cell / 2 ** (k - 1)
        if not thin.any():
            break
        levels[(distance(thin) < BAND * cell / 2**k) & (levels < coarser + k)] = coarser + k
    return levels


def lattice_of(phi: np.ndarray, levels: np.ndarray, cell: float, finer: int, coarser: int):
    """The lattice that meets `levels` round phi < 0: it, its origin (3,) and the unit of its coordinates.

    Raises BadInput where it has too many cells.
    """
    depth, finest = finer + coarser, cell / 2**finer
    solid = np.argwhere(phi < 0)
    low, high = solid.min(0) - 1, solid.max(0) + 1
    widest = finest * 2**depth
    n = (np.ceil((high - low) / widest).astype(int) + 2) * 2**depth
    if n.prod() > LATTICE_MAX:
        raise BadInput(f"cage: {n.prod()} cells are too many")
    start = (low + high) / 2 - n * finest / 2
    reach = int(np.ceil(finest / 2)) if finest > 1 else 0
    if reach:  # a cell is as fine as any node in it asks for
        levels = maximum_filter(levels, size=2 * reach + 1)
    index = [np.rint(start[a] + (np.arange(n[a]) + 0.5) * finest).astype(int) for a in range(3)]
    inner = [(i >= 0) & (i < size) for i, size in zip(index, phi.shape, strict=True)]
    within = inner[0][:, None, None] & inner[1][:, None] & inner[2]
    nodes = np.ix_(*(i.clip(0, size - 1) for i, size in zip(index, phi.shape, strict=True)))
    want = np.where(within, levels[nodes], 0)
    lattice = graded_lattice(want, depth, within & (phi[nodes] < finest))
    return lattice, start, finest / 2
