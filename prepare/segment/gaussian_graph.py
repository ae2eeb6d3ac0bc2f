"""Graph of neighbouring Gaussians, and coarser graphs of it.

The weight of an edge is the likeness of its two Gaussians: overlap in space (they lie on one surface), equal colour and
equal width.
                                                                      after GaussianCut (arXiv 2411.07555)
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_matrix
from scipy.spatial import cKDTree

from assets.gaussians import Gaussians
from core.spherical_harmonics import C0

NEIGHBOURS = 12  # per Gaussian: about two rings on a surface
CHUNK = 1 << 19  # edges processed at a time, to bound memory
WEAKEST = 1e-4  # least weight of an edge: no cut is free
GAP_STRENGTH = 0.25  # half of 0.5: distances use the sum of two covariances, and ignore tails
CONTRAST_RANGE = 6.0  # mean squared contrasts of neighbours that divide the weight of an edge by e
PAIRED_LEAST = 0.02  # least share of clusters that find a partner in a round; else merging stops


def rgb_of(gaussians: Gaussians) -> np.ndarray:
    """View-independent colour of each Gaussian, 0..1, (N, 3)."""
    return (0.5 + C0 * gaussians.sh[:, 0]).clip(0.0, 1.0)


def neighbour_graph(gaussians: Gaussians) -> csr_matrix:
    """Symmetric matrix (N, N) of the likeness, 0..1, of each Gaussian and its nearest neighbours."""
    n = len(gaussians)
    points = gaussians.means.astype(np.float64)
    width = np.sort(gaussians.log_scales, axis=1)[:, 1:].mean(1)
    low, high, spacing = neighbours_of(points, width)
    colour, covariances = rgb_of(gaussians), gaussians.covariances
    gap, contrast = np.empty(len(low), np.float32), np.empty(len(low), np.float32)
    for begin in range(0, len(low), CHUNK):
        part = slice(begin, begin + CHUNK)
        a, b = low[part], high[part]
        rounding = (0.5 * np.minimum(spacing[a], spacing[b])) ** 2  # a surface is no thinner than it is sampled
        gap[part] = mahalanobis(points[b] - points[a], covariances[a] + covariances[b], rounding)
        contrast[part] = ((colour[a] - colour[b]) ** 2).sum(1)
    usual = max(CONTRAST_RANGE * float(contrast.mean()), 1e-4) if len(low) else 1.0
    unlike = np.abs(width[low] - width[high])  # logarithm of the ratio: ground under a foot is of wider Gaussians
    weight = np.maximum(np.exp(-GAP_STRENGTH * gap - contrast / usual - unlike), WEAKEST)
    half = csr_matrix((weight, (low, high)), (n, n))
    return (half + half.T).tocsr()


def neighbours_of(points: np.ndarray, width: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Pairs (E,), (E,) of indices, each once, of neighbours, and the spacing (N,) of the points (N, 3) around each.

    width (N,)  logarithms. The neighbours of a Gaussian are the nearest of those that are about as wide or wider: those
    nearest to a wide one of the floor under a thing are all of the thing, and it would be cut off from the floor.
    """
    n = len(points)
    k = min(NEIGHBOURS, n - 1)
    if k < 1:
        return np.zeros(0, np.int32), np.zeros(0, np.int32), np.ones(n)
    octave = np.floor(width / np.log(2.0))
    octave = np.minimum(octave, np.partition(octave, n - k - 1)[n - k - 1])  # the widest have enough neighbours, too
    index, spacing = np.empty((n, k), np.int32), np.empty(n)
    for least in np.unique(octave):
        there, own = np.flatnonzero(octave >= least), np.flatnonzero(octave == least)
        distance, near = cKDTree(points[there]).query(points[own], k + 1, workers=-1)
        itself = near == np.searchsorted(there, own)[:, None]
        itself[~itself.any(1), -1] = True  # of more points at one place than are found, one is left out
        index[own] = there[near[~itself].reshape(-1, k)]
        spacing[own] = np.maximum(distance[:, -1], 1e-9) / np.sqrt(k / np.pi)  # of a surface: k in a disc so large
    rows = np.arange(n, dtype=np.int32)[:, None]
    once = (rows < index) | ~np.stack([(index[index[:, j]] == rows).any(1) for j in range(k)], axis=1)
    return np.nonzero(once)[0].astype(np.int32), index[once], spacing


def mahalanobis(d: np.ndarray, sigma: np.ndarray, added: np.ndarray) -> np.ndarray:
    """d^T (Sigma + added I)^-1 d for vectors (E, 3) and symmetric matrices (xx, xy, xz, yy, yz, zz), (E, 6)."""
    xx, xy, xz, yy, yz, zz = sigma.T
    xx, yy, zz = xx + added, yy + added, zz + added
    x, y, z = d.T
    a, b, c = yy * zz - yz * yz, xz * yz - xy * zz, xy * yz - xz * yy  # first row of the adjugate
    e, f, h = xx * zz - xz * xz, xy * xz - xx * yz, xx * yy - xy * xy
    form = a * x * x + e * y * y + h * z * z + 2 * (b * x * y + c * x * z + f * y * z)
    return form / np.maximum(xx * a + xy * b + xz * c, 1e-30)


def border_graph(graph: csr_matrix, width: np.ndarray) -> csr_matrix:
    """Graph in which a border costs as much per length among wide Gaussians as among narrow ones, of widths (N,).

    Fewer edges cross it among wide ones: without this, least cuts run through the support, not around the thing.
    """
    root = np.sqrt(width)
    data = graph.data * np.repeat(root, np.diff(graph.indptr)) * root[graph.indices]
    return csr_matrix((data, graph.indices, graph.indptr), graph.shape)


class Clusters:
    """Ever larger clusters of the nodes of a graph: the most similar neighbours are merged in pairs, repeatedly."""

    def __init__(self, graph: csr_matrix, least: int):
        """Merges until there are at most `least` clusters."""
        self._levels = [np.arange(graph.shape[0], dtype=np.int32)]
        size = np.ones(graph.shape[0])
        while (n := graph.shape[0]) > least:
            nodes, rows = np.arange(n), np.repeat(np.arange(n), np.diff(graph.indptr))
            pull = graph.data / np.sqrt(size[rows] * size[graph.indices])  # else large clusters take all
            best = best_of_rows(pull, graph.indptr, graph.indices)
            mutual = (best >= 0) & (best[best] == nodes)
            first = np.where(mutual, np.minimum(best, nodes), nodes)
            group = (np.cumsum(first == nodes, dtype=np.int32) - 1)[first]
            if group[-1] + 1 > (1.0 - PAIRED_LEAST) * n:
                break
            graph, size = merged(graph, group), np.bincount(group, size)
            self._levels.append(group[self._levels[-1]])

    def of(self, index: np.ndarray, count: int, kind: np.ndarray) -> np.ndarray:
        """Number of the cluster of each node of `index` (M,), about `count` or fewer in all, by the finest such level.

        Nodes of different kinds (M,), small whole numbers, are never in one.
        """
        for level in self._levels:
            numbers = numbered(level[index])
            if numbers.max(initial=-1) < count:
                break
        return numbered(numbers * (kind.max(initial=0) + 1) + kind)


def numbered(values: np.ndarray) -> np.ndarray:
    """Whole numbers (N,) from 0 on instead of values >= 0, in their order, without gaps."""
    there = np.zeros(values.max(initial=-1) + 1, bool)
    there[values] = True
    return (np.cumsum(there) - 1)[values]


def best_of_rows(values: np.ndarray, indptr: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """Column of the largest positive value of each row of a CSR matrix, -1 where there is none."""
    n = len(indptr) - 1
    filled = np.flatnonzero(np.diff(indptr))
    largest, best = np.zeros(n), np.full(n, -1)
    largest[filled] = np.maximum.reduceat(values, indptr[filled])
    rows = np.repeat(np.arange(n), np.diff(indptr))
    at = np.flatnonzero((values == largest[rows]) & (values > 0))
    best[rows[at]] = columns[at]
    return best


def merge_matrix(groups: np.ndarray) -> csr_matrix:
    """Matrix (G, N) that sums over the nodes of each group (N,)."""
    n = len(groups)
    return csr_matrix((np.ones(n), (groups, np.arange(n))), (int(groups.max(initial=-1)) + 1, n))


def merged(graph: csr_matrix, groups: np.ndarray) -> csr_matrix:
    """Graph of groups (N,): edges between groups are summed, those within dropped."""
    one, two = np.repeat(groups, np.diff(graph.indptr)), groups[graph.indices]
    between = one != two
    count = int(groups.max(initial=-1)) + 1
    return csr_matrix((graph.data[between], (one[between], two[between])), (count, count))
