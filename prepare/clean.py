"""Leave out the Gaussians of a splat that are no part of its object."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import binary_dilation, generate_binary_structure, label
from scipy.spatial import cKDTree

from assets.errors import BadInput
from assets.gaussians import Gaussians
from assets.orient import extent

OPACITY_MIN = 0.01  # at most 2.5 of 255 grey levels
SIGMA_MAX = 0.12  # of the longest extent: a Gaussian whose 2 sigma span half the object is a smear, not surface
CELLS = 96  # on the longest side, for the search of pieces
REACH = 2  # cells; pieces that come closer than 4 % of the extent count as one
SAMPLE = 5000  # points whose neighbours tell how densely the others lie
FEWEST = 30  # Gaussians; fewer have no inside
FLATTEST = 0.02  # thickness over width of a plane that cannot be told from noise


def largest_piece(points: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Mask (N,) of the points in the piece with most of them: cells of a grid, joined across small gaps."""
    sample = points[:: len(points) // SAMPLE + 1]
    neighbours = cKDTree(points).query(sample, k=min(8, len(points)))[0][:, -1]
    cell = max((high - low).max() / CELLS, float(np.median(neighbours)) / REACH)  # few Gaussians lie far apart
    low, high = low - 0.3 * (high - low).max(), high + 0.3 * (high - low).max()  # thin ends hold few points
    within = ((points >= low) & (points <= high)).all(1)
    index = ((points[within] - low) / cell).astype(int)
    shape = tuple(((high - low) / cell).astype(int) + 1)
    grid = np.zeros(shape, bool)
    grid[tuple(index.T)] = True
    near = generate_binary_structure(3, 1)
    pieces, _ = label(binary_dilation(grid, near, iterations=REACH), generate_binary_structure(3, 3))
    of_point = pieces[tuple(index.T)]
    keep = np.zeros(len(points), bool)
    keep[within] = of_point == np.bincount(of_point).argmax()
    return keep


def clean(gaussians: Gaussians) -> tuple[Gaussians, dict[str, int]]:
    """The object's own Gaussians, and how many were left out: transparent, huge, apart.

    Raises BadInput where no solid object is left: too few, all transparent, all on a plane, in a point.
    """
    n = len(gaussians)
    if n == 0:
        raise BadInput("the splat holds no Gaussians")
    opaque = gaussians.opacities >= OPACITY_MIN
    if not opaque.any():
        raise BadInput(f"all {n} Gaussians are transparent (opacity below {OPACITY_MIN})")
    g = gaussians.select(opaque)
    solid = g.opacities > 0.5
    if solid.sum() < FEWEST:
        solid[:] = True
    low, high = extent(g.means[solid].astype(np.float64))
    longest = (high - low).max()
    if not 1e-6 < longest < 1e6:
        raise BadInput(f"the splat's extent is {longest:.3g}; nothing to be made of that (expected 1e-6 to 1e6)")
    small = np.exp(g.log_scales.astype(np.float64)).max(1) <= SIGMA_MAX * longest
    g_small = g.select(small)
    keep = largest_piece(g_small.means.astype(np.float64), low, high) if len(g_small) else np.zeros(0, bool)
    g_kept = g_small.select(keep)
    counts = {
        "read": n,
        "transparent": n - len(g),
        "huge": len(g) - len(g_small),
        "apart": len(g_small) - len(g_kept),
        "kept": len(g_kept),
    }
    if len(g_kept) < FEWEST:
        raise BadInput(f"only {len(g_kept)} of {n} Gaussians belong to a solid object; {FEWEST} are needed")
    spread = np.sqrt(np.linalg.eigvalsh(np.cov(g_kept.means.astype(np.float64).T)).clip(0))
    if spread[0] <= FLATTEST * spread[1] + 1e-6 * spread[2]:
        raise BadInput("all Gaussians lie on a plane or a line; there is nothing to fill")
    return g_kept, counts


def cut_out(g: Gaussians, ids: tuple[int, ...]) -> tuple[dict[int, Gaussians], Gaussians]:
    """The Gaussians of each object id, and the rest. Raises BadInput for an id that is not there."""
    there = np.unique(g.object_id)
    for k in ids:
        if k not in there:
            found = ", ".join(map(str, there[:20])) + (" ..." if len(there) > 20 else "")
            raise BadInput(f"no Gaussian has the object id {k}; there are: {found}")
    return {k: g.select(g.object_id == k) for k in ids}, g.select(~np.isin(g.object_id, ids))
