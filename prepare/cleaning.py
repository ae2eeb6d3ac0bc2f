"""Cleaning: remove the Gaussians of a splat that do not belong to its object."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import binary_dilation, generate_binary_structure, label
from scipy.spatial import cKDTree

from assets.gaussians import Gaussians, robust_bounds
from core.errors import BadInput

OPACITY_MIN = 0.01  # at most 2.5 of 255 grey levels
SIGMA_MAX = 0.12  # of the longest extent: a Gaussian whose 2 sigma span half the object is a smear, not surface
SEARCH_CELLS = 96  # on the longest side, for the search of connected components
DILATION = 2  # cells; components closer than 4 % of the extent count as one
SAMPLE = 5000  # points whose neighbours tell the density of the others
MIN_GAUSSIANS = 30  # fewer have no inside
MIN_FLATNESS = 0.02  # thickness over width; below, a plane with noise
MIN_FRACTION = 0.01  # of the largest component's Gaussians; with fewer it is a floater


def component_numbers(points: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Component (N,) of each point: cells of a grid, joined across small gaps; 0 has the most points, -1: far off."""
    if len(points) < 2:
        return np.full(len(points), -1)
    sample = points[:: len(points) // SAMPLE + 1]
    neighbours = cKDTree(points).query(sample, k=min(8, len(points)))[0][:, -1]
    # Sparse Gaussians need larger cells.
    cell = max((high - low).max() / SEARCH_CELLS, float(np.median(neighbours)) / DILATION)
    low, high = low - 0.3 * (high - low).max(), high + 0.3 * (high - low).max()  # thin ends hold few points
    within = ((points >= low) & (points <= high)).all(1)
    index = ((points[within] - low) / cell).astype(int)
    shape = tuple(((high - low) / cell).astype(int) + 1)
    grid = np.zeros(shape, bool)
    grid[tuple(index.T)] = True
    near = generate_binary_structure(3, 1)
    labels, _ = label(binary_dilation(grid, near, iterations=DILATION), generate_binary_structure(3, 3))
    of_point = labels[tuple(index.T)]
    rank = np.argsort(np.argsort(-np.bincount(of_point), kind="stable"), kind="stable")
    numbers = np.full(len(points), -1)
    numbers[within] = rank[of_point]
    return numbers


def visible(gaussians: Gaussians) -> Gaussians:
    """The Gaussians that are not transparent. Raises BadInput where there are none."""
    n = len(gaussians)
    if n == 0:
        raise BadInput("the splat holds no Gaussians")
    opaque = gaussians.opacities >= OPACITY_MIN
    if not opaque.any():
        raise BadInput(f"all {n} Gaussians are transparent (opacity below {OPACITY_MIN})")
    return gaussians.select(opaque)


def solid_box(g: Gaussians) -> tuple[np.ndarray, np.ndarray]:
    """Lower and upper corner (3,) of the opaque Gaussians. Raises BadInput for an extent that cannot be worked with."""
    solid = g.opacities > 0.5
    if solid.sum() < MIN_GAUSSIANS:
        solid[:] = True
    low, high = robust_bounds(g.means[solid].astype(np.float64))
    longest = (high - low).max()
    if not 1e-6 < longest < 1e6:
        raise BadInput(f"the splat's extent is {longest:.3g}; this cannot be used (expected 1e-6 to 1e6)")
    return low, high


def is_flat(points: np.ndarray) -> bool:
    """True if points (N, 3) lie on a plane or a line."""
    spread = np.sqrt(np.linalg.eigvalsh(np.cov(points.astype(np.float64).T)).clip(0))
    return bool(spread[0] <= MIN_FLATNESS * spread[1] + 1e-6 * spread[2])


def clean(gaussians: Gaussians) -> tuple[Gaussians, dict[str, int]]:
    """The object's own Gaussians, and how many were left out as transparent, huge or apart.

    Raises BadInput where no solid object is left: too few, all transparent, all on a plane, in a point.
    """
    n, g = len(gaussians), visible(gaussians)
    small, number = parts_of(g)
    kept = g.select(small[number == 0])
    if len(kept) < MIN_GAUSSIANS:
        raise BadInput(f"only {len(kept)} of {n} Gaussians belong to a solid object; {MIN_GAUSSIANS} are needed")
    if is_flat(kept.means):
        raise BadInput("all Gaussians lie on a plane or a line; there is nothing to fill")
    huge, apart = len(g) - len(small), len(small) - len(kept)
    return kept, {"read": n, "transparent": n - len(g), "huge": huge, "apart": apart, "kept": len(kept)}


def parts_of(g: Gaussians) -> tuple[np.ndarray, np.ndarray]:
    """Indices (M,) of the Gaussians that are no smears, and the component of each, as of `component_numbers`."""
    low, high = solid_box(g)
    small = np.flatnonzero(np.exp(g.log_scales.astype(np.float64)).max(1) <= SIGMA_MAX * (high - low).max())
    return small, component_numbers(g.means[small].astype(np.float64), low, high)


def clean_components(gaussians: Gaussians) -> tuple[Gaussians, np.ndarray, dict[str, int]]:
    """Clean each connected component by itself: the Gaussians, the component of each (N,), largest first, and counts.

    Each component is judged by its own extent and searched again for components within. Those with too few Gaussians
    for a body, or on a plane, are left out: `specks` counts such of MIN_GAUSSIANS or more. Raises BadInput.
    """
    n, g = len(gaussians), visible(gaussians)
    solid_box(g)
    left, found, huge, specks = [np.arange(len(g))], [], 0, 0
    while left:
        own = left.pop()
        try:
            small, number = parts_of(g.select(own))
        except BadInput:
            specks += 1
            continue
        small = own[small]
        huge += len(own) - len(small)
        sizes = np.bincount(number[number >= 0], minlength=1)
        large = np.flatnonzero(sizes >= max(MIN_GAUSSIANS, MIN_FRACTION * sizes[0]))
        specks += int((sizes >= MIN_GAUSSIANS).sum()) - len(large)
        parts = [small[number == k] for k in large]
        if len(parts) != 1:
            left += parts
        elif is_flat(g.means[parts[0]]):
            specks += 1
        else:
            found += parts
    if not found:
        clean(gaussians)  # raises with the reason
        raise BadInput("no component of the splat is a solid object")
    found.sort(key=len, reverse=True)
    least = max(MIN_GAUSSIANS, MIN_FRACTION * len(found[0]))
    specks += sum(len(f) < least for f in found)
    found = [f for f in found if len(f) >= least]
    number = np.repeat(np.arange(len(found)), [len(f) for f in found])
    kept = g.select(np.concatenate(found))
    apart = len(g) - huge - len(kept)
    counts = {"read": n, "transparent": n - len(g), "huge": huge, "apart": apart, "kept": len(kept), "specks": specks}
    return kept, number, counts


def cut_out(g: Gaussians, ids: tuple[int, ...]) -> tuple[dict[int, Gaussians], Gaussians]:
    """Gaussians of each object id, and the rest. Raises BadInput for an id that does not occur."""
    there = np.unique(g.object_id)
    for k in ids:
        if k not in there:
            found = ", ".join(map(str, there[:20])) + (" ..." if len(there) > 20 else "")
            raise BadInput(f"no Gaussian has the object id {k}; there are: {found}")
    return {k: g.select(g.object_id == k) for k in ids}, g.select(~np.isin(g.object_id, ids))
