"""What the embedding needs to know of each Gaussian, prepared on the host: factors of its vertices (NumPy only)."""

from dataclasses import dataclass

import numpy as np

from assets.gaussians import Gaussians
from core.errors import BadInput
from core.point_location import TetLocator
from core.rotation import matrices_from_quaternions

LANES = 32  # Gaussians side by side in a slice: one warp reads 128 contiguous bytes at a time
WINDOW = 4096  # Gaussians sorted by their number of vertices within this many: full warps, writes stay close
CHUNK = 1 << 16  # Gaussians prepared at once: bounds the float64 intermediates to about 200 MB
FLATTEST = 1e-9  # 6 volumes over the longest edge cubed; below this float32 weights do not span space


@dataclass(frozen=True)
class EmbeddedBody:
    """The Gaussians of one body and how its cage holds them. Body frame: asset frame times scale.

    host           cage tet of each local corner, (N, 4)
    weights        barycentric weights of the corners in it, (N, 4, 4): row k = corner k
    gaussians      N Gaussians [m]
    rest           rest vertices of the cage [m], (V, 3)
    tets           (T, 4), indices into `rest`
    vertex_offset  index of the body's first vertex among the solver's
    gaussian_offset index of its first Gaussian among the splats
    """

    host: np.ndarray
    weights: np.ndarray
    gaussians: Gaussians
    rest: np.ndarray
    tets: np.ndarray
    vertex_offset: int = 0
    gaussian_offset: int = 0


def rest_covariances(gaussians: Gaussians) -> np.ndarray:
    """Sigma_0 = R S S R^T as (xx, xy, xz, yy, yz, zz) [m^2], float64 (N, 6)."""
    A = matrices_from_quaternions(gaussians.quats) * np.exp(np.asarray(gaussians.log_scales, np.float64))[:, None]
    S = A @ np.moveaxis(A, 1, 2)
    return S[:, [0, 0, 0, 1, 1, 2], [0, 1, 2, 1, 2, 2]]


def two_level(part: EmbeddedBody, rows: slice, locator: TetLocator | None):
    """Vertices (n, 16), weights m (n, 16) and gradients g [1/m] (n, 16, 3) of the local tetrahedra."""
    vertex = part.tets[part.host[rows]]
    W = np.asarray(part.weights[rows], np.float64)
    W = W / W.sum(2, keepdims=True)  # float32 rows sum to 1 only within rounding
    y = np.einsum("nkj,nkjc->nkc", W, np.asarray(part.rest, np.float64)[vertex])
    d1, d2, d3 = np.moveaxis(y[:, 1:] - y[:, :1], 1, 0)  # columns of D
    cofactors = np.stack([np.cross(d2, d3), np.cross(d3, d1), np.cross(d1, d2)], 1)
    volume = np.einsum("ni,ni->n", d1, cofactors[:, 0])
    longest = np.max([np.einsum("ni,ni->n", d, d) for d in (d1, d2, d3)], axis=0)
    flat = np.abs(volume) <= FLATTEST * longest**1.5
    if flat.any():
        where = rows.start + int(np.flatnonzero(flat)[0])
        raise BadInput(f"embedding: the local tetrahedron of Gaussian {where} (and {flat.sum() - 1} more) is flat")
    inverse = cofactors / volume[:, None, None]
    corner = np.concatenate([-inverse.sum(1, keepdims=True), inverse], 1)  # F = sum_k y_k corner_k^T
    g = (W[..., None] * corner[:, :, None]).reshape(len(W), 16, 3)
    offset = part.gaussians.means[rows] - y.mean(1)  # the centre need not be the centroid: clamped corners
    m = W.reshape(len(W), 16) / 4 + np.einsum("nvc,nc->nv", g, offset)
    return vertex.reshape(len(W), 16), m, g


def one_level(part: EmbeddedBody, rows: slice, locator: TetLocator):
    """The same of the single tet that holds the centre, or the nearest: (n, 4), (n, 4), (n, 4, 3)."""
    means = np.asarray(part.gaussians.means[rows], np.float64)
    host = locator.find(means)
    out = host < 0
    if out.any():
        host[out] = locator.nearest(means[out])[0]
    return locator.tets[host], locator.weights(host, means), locator.gradients(host)


def merge(part: EmbeddedBody, collect) -> tuple[np.ndarray, ...]:
    """Sum up the entries of equal vertices: row (E,) ascending, vertex (E,), factors (E, 4) = (g, m)."""
    locator = TetLocator(part.rest, part.tets) if collect is one_level else None
    found = []
    for start in range(0, len(part.gaussians), CHUNK):
        vertex, m, g = collect(part, slice(start, start + CHUNK), locator)
        n, width = vertex.shape
        order = np.argsort(vertex, 1, kind="stable")
        order = (order + width * np.arange(n)[:, None]).ravel()
        vertex = vertex.ravel()[order]
        factors = np.concatenate([g, m[..., None]], 2).reshape(-1, 4)[order]
        row = np.repeat(np.arange(n), width)
        first = np.flatnonzero(np.r_[True, (np.diff(vertex) != 0) | (np.diff(row) != 0)])
        found.append((row[first] + start, vertex[first], np.add.reduceat(factors, first, 0).astype(np.float32)))
    return tuple(np.concatenate(a) for a in zip(*found, strict=True))


def pack(part: EmbeddedBody, row: np.ndarray, vertex: np.ndarray, factors: np.ndarray) -> dict:
    """Lay the entries out in slices of LANES Gaussians, slot by slot: a sorted, sliced ELLPACK matrix."""
    n = len(part.gaussians)
    # The anchor, the vertex of the largest weight, needs no factors: the weights sum to 1, the gradients to 0.
    starts = np.searchsorted(row, np.arange(n))
    most = np.maximum.reduceat(factors[:, 3], starts)
    heaviest = np.flatnonzero(factors[:, 3] == most[row])
    heaviest = heaviest[np.searchsorted(row[heaviest], np.arange(n))]
    anchor = vertex[heaviest]
    row, vertex, factors = (np.delete(a, heaviest, 0) for a in (row, vertex, factors))
    counts = np.bincount(row, minlength=n)
    order = np.lexsort((counts, np.arange(n) // WINDOW))
    pieces = -(-n // LANES)
    target = np.full(pieces * LANES, -1)
    target[:n] = order
    padded = np.zeros(pieces * LANES, np.int64)
    padded[:n] = counts[order]
    begin = np.r_[0, padded.reshape(-1, LANES).max(1).cumsum()]
    place = np.empty(n, np.int64)
    place[order] = np.arange(n)
    at = place[row]  # where each entry's Gaussian stands
    rank = np.arange(len(row)) - (counts.cumsum() - counts)[row]
    slot, lane = begin[at // LANES] + rank, at % LANES
    anchors = np.where(target >= 0, anchor[target], 0)
    # An empty slot points at the anchor with factors 0.
    owner = np.repeat(np.arange(pieces), np.diff(begin))
    vertices = anchors.reshape(-1, LANES)[owner]
    vertices[slot, lane] = vertex
    table = np.zeros(begin[-1] * 4 * LANES, np.float32)
    for c in range(4):
        table[slot * (4 * LANES) + c * LANES + lane] = factors[:, c]
    cov = np.zeros((pieces * LANES, 6), np.float32)
    cov[:n] = rest_covariances(part.gaussians)[order]
    shift = np.where(target >= 0, part.gaussian_offset, 0)
    return {
        "target": (target + shift).astype(np.int32),
        "anchor": (anchors + part.vertex_offset).astype(np.int32),
        "begin": begin,
        "vertex": (vertices + part.vertex_offset).astype(np.int32).ravel(),
        "factor": table,
        "rest_cov": np.ascontiguousarray(np.moveaxis(cov.reshape(-1, LANES, 6), 1, 2)).ravel(),
    }
