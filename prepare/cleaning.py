"""Leave out the Gaussians of a splat that are no part of its object."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import binary_dilation, generate_binary_structure, label
from scipy.spatial import cKDTree

from assets.gaussians import Gaussians
from assets.up_axis import robust_bounds
from core.errors import BadInput

OPACITY_MIN = 0.01  # at most 2.5 of 255 grey levels
SIGMA_MAX = 0.12  # of the longest extent: a Gaussian whose 2 sigma span half the object is a smear, not surface
CELLS = 96  # on the longest side, for the search of pieces
REACH = 2  # cells; pieces that come closer than 4 % of the extent count as one
SAMPLE = 5000  # points whose neighbours tell how densely the others lie
FEWEST = 30  # Gaussians; fewer have no inside
FLATTEST = 0.02  # thickness over width of a plane that cannot be told from noise
LEAST = 0.01  # of the largest piece's Gaussians; what has fewer is a floater


def piece_numbers(points: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Piece (N,) of each point: cells of a grid, joined across small gaps; 0 has the most points, -1 lies far off."""
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
    rank = np.argsort(np.argsort(-np.bincount(of_point), kind="stable"), kind="stable")
    numbers = np.full(len(points), -1)
    numbers[within] = rank[of_point]
    return numbers


def largest_piece(points: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Mask (N,) of the points in the piece with most of them."""
    return piece_numbers(points, low, high) == 0


def seen_of(gaussians: Gaussians) -> Gaussians:
    """The Gaussians that are not transparent. Raises BadInput where there is none."""
    n = len(gaussians)
    if n == 0:
        raise BadInput("the splat holds no Gaussians")
    opaque = gaussians.opacities >= OPACITY_MIN
    if not opaque.any():
        raise BadInput(f"all {n} Gaussians are transparent (opacity below {OPACITY_MIN})")
    return gaussians.select(opaque)


def box_of(g: Gaussians) -> tuple[np.ndarray, np.ndarray]:
    """Lower and upper corner (3,) of what is solid. Raises BadInput where that is no extent to work with."""
    solid = g.opacities > 0.5
    if solid.sum() < FEWEST:
        solid[:] = True
    low, high = robust_bounds(g.means[solid].astype(np.float64))
    longest = (high - low).max()
    if not 1e-6 < longest < 1e6:
        raise BadInput(f"the splat's extent is {longest:.3g}; nothing to be made of that (expected 1e-6 to 1e6)")
    return low, high


def is_flat(points: np.ndarray) -> bool:
    """Whether points (N, 3) lie on a plane or a line."""
    spread = np.sqrt(np.linalg.eigvalsh(np.cov(points.astype(np.float64).T)).clip(0))
    return bool(spread[0] <= FLATTEST * spread[1] + 1e-6 * spread[2])


def clean(gaussians: Gaussians) -> tuple[Gaussians, dict[str, int]]:
    """The object's own Gaussians, and how many were left out: transparent, huge, apart.

    Raises BadInput where no solid object is left: too few, all transparent, all on a plane, in a point.
    """
    n, g = len(gaussians), seen_of(gaussians)
    low, high = box_of(g)
    small = np.exp(g.log_scales.astype(np.float64)).max(1) <= SIGMA_MAX * (high - low).max()
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
    if is_flat(g_kept.means):
        raise BadInput("all Gaussians lie on a plane or a line; there is nothing to fill")
    return g_kept, counts


def clean_pieces(gaussians: Gaussians) -> tuple[Gaussians, np.ndarray, dict[str, int]]:
    """As `clean`, but of each piece: the Gaussians, the number of each one's piece (N,), 0 the one with most, counts.

    Each piece is judged by its own extent, and looked at again for pieces within. What has too few Gaussians for a
    body, or lies on a plane, is left out: `specks` counts such pieces of FEWEST Gaussians or more. Raises BadInput.
    """
    n, g = len(gaussians), seen_of(gaussians)
    box_of(g)
    widest = np.exp(g.log_scales.astype(np.float64)).max(1)
    left, found, huge, specks = [np.arange(len(g))], [], 0, 0
    while left:
        mine = left.pop()
        try:
            low, high = box_of(g.select(mine))
        except BadInput:
            specks += 1
            continue
        small = mine[widest[mine] <= SIGMA_MAX * (high - low).max()]
        huge += len(mine) - len(small)
        number = piece_numbers(g.means[small].astype(np.float64), low, high) if len(small) else small
        sizes = np.bincount(number[number >= 0], minlength=1)
        large = np.flatnonzero(sizes >= max(FEWEST, LEAST * sizes[0]))
        specks += int((sizes >= FEWEST).sum()) - len(large)
        pieces = [small[number == k] for k in large]
        if len(pieces) != 1:
            left += pieces
        elif is_flat(g.means[pieces[0]]):
            specks += 1
        else:
            found += pieces
    if not found:
        clean(gaussians)  # knows what to say
        raise BadInput("no piece of the splat is a solid object")
    found.sort(key=len, reverse=True)
    fewest = max(FEWEST, LEAST * len(found[0]))
    specks += sum(len(f) < fewest for f in found)
    found = [f for f in found if len(f) >= fewest]
    number = np.repeat(np.arange(len(found)), [len(f) for f in found])
    kept = g.select(np.concatenate(found))
    apart = len(g) - huge - len(kept)
    counts = {"read": n, "transparent": n - len(g), "huge": huge, "apart": apart, "kept": len(kept), "specks": specks}
    return kept, number, counts


def cut_out(g: Gaussians, ids: tuple[int, ...]) -> tuple[dict[int, Gaussians], Gaussians]:
    """The Gaussians of each object id, and the rest. Raises BadInput for an id that is not there."""
    there = np.unique(g.object_id)
    for k in ids:
        if k not in there:
            found = ", ".join(map(str, there[:20])) + (" ..." if len(there) > 20 else "")
            raise BadInput(f"no Gaussian has the object id {k}; there are: {found}")
    return {k: g.select(g.object_id == k) for k in ids}, g.select(~np.isin(g.object_id, ids))
