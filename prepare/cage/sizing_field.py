"""How fine a cage's cells should be, place by place: fine where the shape is thin or curved, coarse deep inside.

All lengths are in cells of the grid of the signed distance, and Taichi must be running.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.ndimage import gaussian_filter, maximum_filter

from core.errors import BadInput
from prepare.cage.distance_transform import distance
from prepare.cage.graded_lattice import LATTICE_MAX, graded_lattice

POINTED = 0.75  # a thin part stands out this share of its half width; edges and corners do not
ACROSS = 1.6  # cells; what is thinner is made of smaller ones
GRADING = 0.6  # a cell may be as wide as this share of its depth
BAND = 1.3  # cells round the surface, and round what is thin, that are as fine as that
BEND = 1.6  # cells over radius of curvature (twice the mean) above which smaller ones are taken
NOISE = 0.4  # cells; what the surface does over less than this is not called curvature
NARROWEST = 1.5  # half width that is told apart from wider ones, and then in steps of
FINENESS = 2**0.5
RIDGE = 0.8  # a distance has slope 1 but on its ridges


class Shape:
    """A shape phi (X, Y, Z) < 0, and what of it does not depend on the lattice.

    half_width  (X, Y, Z) of the part that each place belongs to, one of `widths`; infinite outside, and above `widest`
    only        the places that are asked for, (N,) flat indices, or None: all. phi and what methods return is of these
    """

    def __init__(self, phi: np.ndarray, widest: float) -> None:
        self.phi, self.only = phi, None
        self._whole, self._kept = phi, {}
        inside = phi < 0
        self.half_width = np.full(phi.shape, np.inf, np.float32)
        steps = int(np.ceil(np.log(max(widest / NARROWEST, 1.0)) / np.log(FINENESS)))
        self.widths = np.array([NARROWEST * FINENESS**k for k in range(steps + 1)], np.float32)
        for k in reversed(range(steps + 1)):
            r = NARROWEST * FINENESS**k
            deep = phi < -r  # what a ball of this radius, pushed about inside, cannot reach is thinner
            reach = (1 + POINTED) * r
            self.half_width[inside & (distance(deep, reach) > reach) if deep.any() else inside] = r

    def halved(self, reach: float) -> Shape:
        """The shape at every other node, in cells twice as wide; only where phi is below `reach` of these."""
        half = object.__new__(Shape)
        half._whole, half._kept = self._whole[::2, ::2, ::2] / 2, {}
        half.half_width, half.widths = self.half_width[::2, ::2, ::2] / 2, self.widths / 2
        half.only = np.flatnonzero(half._whole < reach)
        half.phi = half._whole.reshape(-1)[half.only]
        return half

    def curvature(self, cell: float) -> np.ndarray:
        """Sum of the principal curvatures, absolute (X, Y, Z), of the shape smoothed over a share of a cell."""
        k = round(max(0.0, 2 * float(np.log2(NOISE * cell))))
        sigma = 2 ** (k / 2)

        def make() -> np.ndarray:
            smooth = gaussian_filter(self._whole.clip(-5 * sigma, 5 * sigma), sigma, truncate=3)
            return np.abs(laplacian(smooth))

        return self._once(k, make)

    def thinner(self, width: float) -> np.ndarray:
        """Which places (X, Y, Z) belong to parts whose half width is less than this."""
        return self.half_width < np.float32(width)

    def from_thin(self, width: float, reach: float) -> np.ndarray | None:
        """Distance (X, Y, Z) from what is `thinner`, infinite beyond `reach` or more; None where nothing is."""
        return self._distance("thin", width, reach, lambda: self.thinner(width))

    def from_ridge(self, width: float, reach: float) -> np.ndarray | None:
        """As from_thin, but from the middle of what is thinner: a distance has a ridge there."""

        def middle() -> np.ndarray:
            phi, where = self._whole, np.argwhere(self.thinner(width))
            slope = np.zeros(len(where))
            for axis in range(3):
                low, high = where.copy(), where.copy()
                low[:, axis] = (low[:, axis] - 1).clip(0)
                high[:, axis] = (high[:, axis] + 1).clip(max=phi.shape[axis] - 1)
                slope += (0.5 * (phi[tuple(high.T)] - phi[tuple(low.T)])) ** 2
            ridge = np.zeros(phi.shape, bool)
            ridge[tuple(where[slope < RIDGE**2].T)] = True
            return ridge

        return self._distance("ridge", width, reach, middle)

    def _distance(self, name: str, width: float, reach: float, mask_of: Callable[[], np.ndarray]) -> np.ndarray | None:
        """The distance from a mask that changes only where `width` passes one of the widths that are told apart."""
        octave = int(np.ceil(2 * np.log2(reach)))  # half of one: another cell of about the same width finds it made

        def make() -> np.ndarray | None:
            mask = mask_of()
            return distance(mask, 2 ** (octave / 2)) if mask.any() else None

        return self._once((name, int((self.widths < np.float32(width)).sum()), octave), make)

    def _once(self, key, make: Callable[[], np.ndarray | None]) -> np.ndarray | None:
        """What `make` makes, at the places that are asked for; made when it is first asked for."""
        if key not in self._kept:
            made = make()
            self._kept[key] = made if made is None or self.only is None else made.reshape(-1)[self.only]
        return self._kept[key]


def laplacian(f: np.ndarray) -> np.ndarray:
    """Laplacian (X, Y, Z) of smooth values, by differences of fourth order; 0 at the border, two nodes wide."""
    out = np.zeros_like(f)
    inner = out[2:-2, 2:-2, 2:-2]
    for axis in range(3):
        for step, weight in ((-2, -1 / 12), (-1, 4 / 3), (0, -5 / 2), (1, 4 / 3), (2, -1 / 12)):
            around = tuple(slice(2 + step * (a == axis), n - 2 + step * (a == axis)) for a, n in enumerate(f.shape))
            inner += np.float32(weight) * f[around]
    return out


def levels_of(shape: Shape, cell: float, finer: int, coarser: int) -> np.ndarray:
    """Level (X, Y, Z) int8 that each place asks for: `coarser` at a plain surface, less inside, more in thin parts.

    cell            width at a plain surface
    finer, coarser  how often it may be halved, and doubled
    """
    phi = shape.phi
    levels = np.full(phi.shape, coarser, np.int8)
    for k in range(coarser):  # a cell is doubled where it stays below its share of the depth
        levels -= phi <= -(2 ** (k + 1)) * cell / GRADING
    levels[phi > BAND * cell] = 0
    if finer:
        curved = (np.abs(phi) < cell) & (shape.curvature(cell) * cell > BEND)
        levels[curved] = coarser + 1
    for k in range(1, finer + 1):
        band = BAND * cell / 2**k
        away = shape.from_thin(0.5 * ACROSS * cell / 2 ** (k - 1), band)
        if away is None:
            break
        levels[(away < band) & (levels < coarser + k)] = coarser + k
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
