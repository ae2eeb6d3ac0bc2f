"""Vertex factors of embedded Gaussians, computed on the host and packed for the device (NumPy only)."""

from dataclasses import dataclass

import numpy as np

from assets.gaussians import Gaussians
from core.errors import BadInput
from core.point_location import TetLocator

SLICE_LANES = 32  # Gaussians side by side in a slice: one warp reads 128 contiguous bytes at a time
SORT_WINDOW = 4096  # Gaussians, within which they are sorted by number of vertices: full warps, writes stay close
CHUNK = 1 << 16  # Gaussians prepared at once: bounds the float64 intermediates to about 200 MB
MIN_FLATNESS = 1e-9  # 6 volumes over the longest edge cubed; below it float32 weights do not span space


@dataclass(frozen=True)
class EmbeddedBody:
    """The Gaussians of one body and their embedding in its cage. Body frame: asset frame times scale.

    host             cage tet of each local corner, (N, 4)
    weights          barycentric weights of the corners in it, (N, 4, 4): row k = corner k
    gaussians        N Gaussians [m]
    rest             rest vertices of the cage [m], (V, 3)
    tets             (T, 4), indices into `rest`
    vertex_offset    index of the body's first vertex among the solver's
    gaussian_offset  index of its first Gaussian among the splats
    """

    host: np.ndarray
    weights: np.ndarray
    gaussians: Gaussians
    rest: np.ndarray
    tets: np.ndarray
    vertex_offset: int = 0
    gaussian_offset: int = 0


@dataclass(frozen=True)
class PackedBody:
    """Vertex factors of one body as the device holds them: a sorted, sliced ELLPACK matrix.

    Gaussians lie in slices of SLICE_LANES; a slice has a slot for each vertex of its Gaussian with the most vertices.
    Indices count from the body's first vertex and first Gaussian.

    target    Gaussian of each lane, -1 if none, (slices * SLICE_LANES,) int32
    anchor    its anchor vertex, (slices * SLICE_LANES,) int32
    begin     first slot of each slice, and the end of the last, (slices + 1,) int32
    rest_cov  rest covariances [m^2], a component of all lanes after the other, (slices * 6 * SLICE_LANES,) float32
    vertex    vertices, slot by slot, (slots * SLICE_LANES,) int32
    factor    gradient [1/m] and weight, a component of all lanes after the other, (slots * 4 * SLICE_LANES,) float32
    """

    target: np.ndarray
    anchor: np.ndarray
    begin: np.ndarray
    rest_cov: np.ndarray
    vertex: np.ndarray
    factor: np.ndarray

    @classmethod
    def empty(cls) -> "PackedBody":
        """A body without Gaussians."""
        none, begin = np.zeros(0, np.int32), np.zeros(1, np.int32)
        return cls(none, none, begin, none.astype(np.float32), none, none.astype(np.float32))

    @property
    def slices(self) -> int:
        """Number of slices."""
        return len(self.target) // SLICE_LANES

    @property
    def slots(self) -> int:
        """Number of slots of all slices."""
        return len(self.vertex) // SLICE_LANES

    @property
    def count(self) -> int:
        """Number of Gaussians."""
        return int((self.target >= 0).sum())


def two_level_factors(body: EmbeddedBody, rows: slice, locator: TetLocator | None):
    """Vertices (n, 16), weights m (n, 16) and gradients g [1/m] (n, 16, 3) of the local tetrahedra."""
    vertex = body.tets[body.host[rows]]
    W = np.asarray(body.weights[rows], np.float64)
    W = W / W.sum(2, keepdims=True)  # float32 rows sum to 1 only within rounding
    y = np.einsum("nkj,nkjc->nkc", W, np.asarray(body.rest, np.float64)[vertex])
    d1, d2, d3 = np.moveaxis(y[:, 1:] - y[:, :1], 1, 0)  # columns of D
    cofactors = np.stack([np.cross(d2, d3), np.cross(d3, d1), np.cross(d1, d2)], 1)
    volume = np.einsum("ni,ni->n", d1, cofactors[:, 0])
    longest = np.max([np.einsum("ni,ni->n", d, d) for d in (d1, d2, d3)], axis=0)
    flat = np.abs(volume) <= MIN_FLATNESS * longest**1.5
    if flat.any():
        where = rows.start + int(np.flatnonzero(flat)[0])
        raise BadInput(f"embedding: the local tetrahedron of Gaussian {where} (and {flat.sum() - 1} more) is flat")
    inverse = cofactors / volume[:, None, None]
    corner = np.concatenate([-inverse.sum(1, keepdims=True), inverse], 1)  # F = sum_k y_k corner_k^T
    g = (W[..., None] * corner[:, :, None]).reshape(len(W), 16, 3)
    offset = body.gaussians.means[rows] - y.mean(1)  # the centre need not be the centroid: clamped corners
    m = W.reshape(len(W), 16) / 4 + np.einsum("nvc,nc->nv", g, offset)
    return vertex.reshape(len(W), 16), m, g


def one_level_factors(body: EmbeddedBody, rows: slice, locator: TetLocator):
    """As `two_level_factors`, of the tet that contains the centre, or the nearest: (n, 4), (n, 4), (n, 4, 3)."""
    means = np.asarray(body.gaussians.means[rows], np.float64)
    host = locator.find(means)
    out = host < 0
    if out.any():
        host[out] = locator.nearest(means[out])[0]
    return locator.tets[host], locator.weights(host, means), locator.gradients(host)


def vertex_factors(body: EmbeddedBody, scheme: str) -> tuple[np.ndarray, ...]:
    """Entries of all Gaussians, equal vertices summed: row (E,) ascending, vertex (E,), factors (E, 4) = (g, m)."""
    collect, locator = two_level_factors, None
    if scheme == "one-level":
        collect, locator = one_level_factors, TetLocator(body.rest, body.tets)
    found = []
    for start in range(0, len(body.gaussians), CHUNK):
        vertex, m, g = collect(body, slice(start, start + CHUNK), locator)
        n, width = vertex.shape
        order = np.argsort(vertex, 1, kind="stable")
        order = (order + width * np.arange(n)[:, None]).ravel()
        vertex = vertex.ravel()[order]
        factors = np.concatenate([g, m[..., None]], 2).reshape(-1, 4)[order]
        row = np.repeat(np.arange(n), width)
        first = np.flatnonzero(np.r_[True, (np.diff(vertex) != 0) | (np.diff(row) != 0)])
        found.append((row[first] + start, vertex[first], np.add.reduceat(factors, first, 0).astype(np.float32)))
    return tuple(np.concatenate(a) for a in zip(*found, strict=True))


def pack(body: EmbeddedBody, scheme: str) -> PackedBody:
    """Arrange the entries in slices of SLICE_LANES Gaussians. Raises BadInput if a local tetrahedron is flat."""
    n = len(body.gaussians)
    if n == 0:
        return PackedBody.empty()
    row, vertex, factors = vertex_factors(body, scheme)
    # The anchor, the vertex of the largest weight, needs no factors: the weights sum to 1, the gradients to 0.
    starts = np.searchsorted(row, np.arange(n))
    largest = np.maximum.reduceat(factors[:, 3], starts)
    heaviest = np.flatnonzero(factors[:, 3] == largest[row])
    heaviest = heaviest[np.searchsorted(row[heaviest], np.arange(n))]
    anchor = vertex[heaviest]
    row, vertex, factors = (np.delete(a, heaviest, 0) for a in (row, vertex, factors))
    counts = np.bincount(row, minlength=n)
    order = np.lexsort((counts, np.arange(n) // SORT_WINDOW))
    slices = -(-n // SLICE_LANES)
    target = np.full(slices * SLICE_LANES, -1)
    target[:n] = order
    padded = np.zeros(slices * SLICE_LANES, np.int64)
    padded[:n] = counts[order]
    begin = np.r_[0, padded.reshape(-1, SLICE_LANES).max(1).cumsum()]
    position = np.empty(n, np.int64)
    position[order] = np.arange(n)
    at = position[row]  # of each entry's Gaussian
    rank = np.arange(len(row)) - (counts.cumsum() - counts)[row]
    slot, lane = begin[at // SLICE_LANES] + rank, at % SLICE_LANES
    anchors = np.where(target >= 0, anchor[target], 0)
    # An empty slot points at the anchor with factors 0.
    owner = np.repeat(np.arange(slices), np.diff(begin))
    vertices = anchors.reshape(-1, SLICE_LANES)[owner]
    vertices[slot, lane] = vertex
    table = np.zeros(begin[-1] * 4 * SLICE_LANES, np.float32)
    for c in range(4):
        table[slot * (4 * SLICE_LANES) + c * SLICE_LANES + lane] = factors[:, c]
    cov = np.zeros((slices * SLICE_LANES, 6), np.float32)
    cov[:n] = body.gaussians.covariances[order]
    return PackedBody(
        target=target.astype(np.int32),
        anchor=anchors.astype(np.int32),
        begin=begin.astype(np.int32),
        rest_cov=np.ascontiguousarray(np.moveaxis(cov.reshape(-1, SLICE_LANES, 6), 1, 2)).ravel(),
        vertex=vertices.astype(np.int32).ravel(),
        factor=table,
    )
