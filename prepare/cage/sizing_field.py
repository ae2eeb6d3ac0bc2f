"""Cell size of a cage from place to place: fine where the shape is thin or curved, coarse deep inside.

All lengths are in cells of the signed distance grid.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.ndimage import gaussian_filter, maximum_filter

from core.errors import BadInput
from prepare.cage.level_set import distance_to
from prepare.cage.stuffing import MAX_LATTICE_CELLS, Lattice, graded_lattice

PROTRUSION = 0.75  # of its half width that a thin feature must stand out; edges and corners do not
THIN_WIDTH = 1.6  # lattice cells; thinner features get smaller cells
GRADING = 0.6  # a cell may be as wide as this fraction of its depth
FINE_BAND = 1.3  # lattice cells around the surface and around thin features that are as fine as these
MAX_CURVATURE = 1.6  # cell width over radius of curvature (twice the mean) above which smaller cells are taken
NOISE_SCALE = 0.4  # lattice cells; variation of the surface over less than this does not count as curvature
MIN_HALF_WIDTH = 1.5  # smallest half width that is told apart from wider ones, and then in steps of
WIDTH_STEP = 2**0.5
RIDGE_SLOPE = 0.8  # a distance field has slope 1 but on its ridges


class ShapeWidths:
    """A shape phi (X, Y, Z) < 0 with its local half widths and curvature, cached where they do not depend on a lattice.

    phi         signed distance (X, Y, Z)
    half_width  (X, Y, Z) of the feature each place belongs to, one of `widths`; infinite outside, and above `widest`
    """

    def __init__(self, phi: np.ndarray, half_width: np.ndarray, widths: np.ndarray):
        self.phi, self.half_width, self.widths = phi, half_width, widths
        self._cached: dict = {}

    @classmethod
    def of(cls, phi: np.ndarray, widest: float) -> ShapeWidths:
        """Measure the half widths of phi up to `widest`."""
        steps = int(np.ceil(np.log(max(widest / MIN_HALF_WIDTH, 1.0)) / np.log(WIDTH_STEP)))
        widths = np.array([MIN_HALF_WIDTH * WIDTH_STEP**k for k in range(steps + 1)], np.float32)
        inside = phi < 0
        half_width = np.full(phi.shape, np.inf, np.float32)
        for k in reversed(range(steps + 1)):
            r = MIN_HALF_WIDTH * WIDTH_STEP**k
            deep = phi < -r  # opening: points that no inner ball of this radius covers lie in thinner parts
            limit = (1 + PROTRUSION) * r
            half_width[inside & (distance_to(deep, limit) > limit) if deep.any() else inside] = r
        return cls(phi, half_width, widths)

    def halved(self) -> ShapeWidths:
        """The shape at every other node, in cells twice as wide."""
        return ShapeWidths(self.phi[::2, ::2, ::2] / 2, self.half_width[::2, ::2, ::2] / 2, self.widths / 2)

    def curvature(self, cell: float) -> np.ndarray:
        """Absolute sum of the principal curvatures (X, Y, Z) of the shape smoothed over NOISE_SCALE of a cell."""
        k = round(max(0.0, 2 * float(np.log2(NOISE_SCALE * cell))))
        sigma = 2 ** (k / 2)

        def make() -> np.ndarray:
            smooth = gaussian_filter(self.phi.clip(-5 * sigma, 5 * sigma), sigma, truncate=3)
            return np.abs(laplacian(smooth))

        return self._once(k, make)

    def distance_to_thin(self, width: float, limit: float) -> np.ndarray | None:
        """Distance (X, Y, Z) from features whose half width is less than `width`, infinite beyond `limit` or more.

        None where there are none.
        """
        return self._distance("thin", width, limit, lambda: self.half_width < np.float32(width))

    def distance_to_medial(self, width: float, limit: float) -> np.ndarray | None:
        """Distance as in `distance_to_thin`, but from the middle of the features, where the distance has a ridge."""

        def middle() -> np.ndarray:
            phi, where = self.phi, np.argwhere(self.half_width < np.float32(width))
            slope = np.zeros(len(where))
            for axis in range(3):
                low, high = where.copy(), where.copy()
                low[:, axis] = (low[:, axis] - 1).clip(0)
                high[:, axis] = (high[:, axis] + 1).clip(max=phi.shape[axis] - 1)
                slope += (0.5 * (phi[tuple(high.T)] - phi[tuple(low.T)])) ** 2
            ridge = np.zeros(phi.shape, bool)
            ridge[tuple(where[slope < RIDGE_SLOPE**2].T)] = True
            return ridge

        return self._distance("ridge", width, limit, middle)

    def _distance(self, name: str, width: float, limit: float, mask_of: Callable[[], np.ndarray]) -> np.ndarray | None:
        """Distance from a mask that changes only where `width` passes one of `widths`."""
        octave = int(np.ceil(2 * np.log2(limit)))  # half octaves: cells of about the same width share an entry

        def make() -> np.ndarray | None:
            mask = mask_of()
            return distance_to(mask, 2 ** (octave / 2)) if mask.any() else None

        return self._once((name, int((self.widths < np.float32(width)).sum()), octave), make)

    def _once(self, key, make: Callable[[], np.ndarray | None]) -> np.ndarray | None:
        """Result of `make`, computed at the first request."""
        if key not in self._cached:
            self._cached[key] = make()
        return self._cached[key]


def laplacian(f: np.ndarray) -> np.ndarray:
    """Laplacian (X, Y, Z) of smooth values, by differences of fourth order; 0 at the border, two nodes wide."""
    out = np.zeros_like(f)
    inner = out[2:-2, 2:-2, 2:-2]
    for axis in range(3):
        for step, weight in ((-2, -1 / 12), (-1, 4 / 3), (0, -5 / 2), (1, 4 / 3), (2, -1 / 12)):
            around = tuple(slice(2 + step * (a == axis), n - 2 + step * (a == axis)) for a, n in enumerate(f.shape))
            inner += np.float32(weight) * f[around]
    return out


def levels_of(shape: ShapeWidths, cell: float, finer: int, coarser: int) -> np.ndarray:
    """Lattice level (X, Y, Z) int8 each place asks for: `coarser` at a plain surface, less inside, more if thin.

    cell            width at a plain surface
    finer, coarser  how often it may be halved, and doubled
    """
    phi = shape.phi
    levels = np.full(phi.shape, coarser, np.int8)
    for k in range(coarser):  # a cell is doubled where it stays below GRADING of the depth
        levels -= phi <= -(2 ** (k + 1)) * cell / GRADING
    levels[phi > FINE_BAND * cell] = 0
    if finer:
        curved = (np.abs(phi) < cell) & (shape.curvature(cell) * cell > MAX_CURVATURE)
        levels[curved] = coarser + 1
    for k in range(1, finer + 1):
        band = FINE_BAND * cell / 2**k
        away = shape.distance_to_thin(0.5 * THIN_WIDTH * cell / 2 ** (k - 1), band)
        if away is None:
            break
        levels[(away < band) & (levels < coarser + k)] = coarser + k
    return levels


def lattice_of(phi: np.ndarray, levels: np.ndarray, cell: float, finer: int, coarser: int) -> Lattice:
    """Lattice that meets `levels` around phi < 0. Raises BadInput where it has too many cells."""
    depth, finest = finer + coarser, cell / 2**finer
    solid = np.argwhere(phi < 0)
    low, high = solid.min(0) - 1, solid.max(0) + 1
    widest = finest * 2**depth
    n = (np.ceil((high - low) / widest).astype(int) + 2) * 2**depth
    if n.prod() > MAX_LATTICE_CELLS:
        raise BadInput(f"cage: {n.prod()} cells are too many")
    start = (low + high) / 2 - n * finest / 2
    radius = int(np.ceil(finest / 2)) if finest > 1 else 0
    if radius:  # a cell is as fine as any node in it asks for
        levels = maximum_filter(levels, size=2 * radius + 1)
    index = [np.rint(start[a] + (np.arange(n[a]) + 0.5) * finest).astype(int) for a in range(3)]
    inner = [(i >= 0) & (i < size) for i, size in zip(index, phi.shape, strict=True)]
    within = inner[0][:, None, None] & inner[1][:, None] & inner[2]
    nodes = np.ix_(*(i.clip(0, size - 1) for i, size in zip(index, phi.shape, strict=True)))
    wanted = np.where(within, levels[nodes], 0)
    return graded_lattice(wanted, depth, within & (phi[nodes] < finest), origin=start, unit=finest / 2)
