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
    k = min(NEIGHBOURS, n - 1)
    points = gaussians.means.astype(np.float64)
    distance, index = cKDTree(points).query(points, k + 1, workers=-1)
    spacing = np.maximum(distance[:, -1], 1e-9) / np.sqrt(k / np.pi)  # of a surface with k in a disc of that radius
    rows, columns = np.repeat(np.arange(n, dtype=np.int32), k + 1), index.astype(np.int32).ravel()
    low, high = np.minimum(rows, columns), np.maximum(rows, columns)
    keys = np.unique((low.astype(np.int64) * n + high)[low != high])
    low, high = (keys // n).astype(np.int32), (keys % n).astype(np.int32)
    width = np.sort(gaussians.log_scales, axis=1)[:, 1:].mean(1)
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


def mahalanobis(d: np.ndarray, sigma: np.ndarray, added: np.ndarray) -> np.ndarray:
    """d^T (Sigma + added I)^-1 d for vectors (E, 3) and symmetric matrices (xx, xy, xz, yy, yz, zz), (E, 6)."""
    xx, xy, xz, yy, yz, zz = sigma.T
    xx, yy, zz = xx + added, yy + added, zz + added
    x, y, z = d.T
    a, b, c = yy * zz - yz * yz, xz * yz - xy * zz, xy * yz - xz * yy  # first row of the adjugate
    e, f, h = xx * zz - xz * xz, xy * xz - xx * yz, xx * yy - xy * xy
    form = a * x * x + e * y * y + h * z * z + 2 * (b * x * y + c * x * z + f * y * z)
    return form / np.maximum(xx * a + xy * b + xz * c, 1e-30)


def clusters_of(graph: csr_matrix, count: int, kind: np.ndarray) -> np.ndarray:
    """Cluster (N,) of each node, about `count` in all: the most similar neighbours are merged in pairs, again and
    again. Nodes of different kinds (N,) are never joined."""
    own, size = np.arange(graph.shape[0]), np.ones(graph.shape[0])
    while graph.shape[0] > count:
        n = graph.shape[0]
        rows, columns = np.repeat(np.arange(n), np.diff(graph.indptr)), graph.indices
        pull = graph.data / np.sqrt(size[rows] * size[columns])  # else large clusters take all
        pull[kind[rows] != kind[columns]] = 0.0
        best = best_of_rows(pull, graph.indptr, columns)
        mutual = (best >= 0) & (best[best] == np.arange(n))
        kept, group = np.unique(np.where(mutual, np.minimum(best, np.arange(n)), np.arange(n)), return_inverse=True)
        if len(kept) > (1.0 - PAIRED_LEAST) * n:
            break
        graph = merged(graph, merge_matrix(group))
        size, kind, own = np.bincount(group, size), kind[kept], group[own]
    return own


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


def merged(graph: csr_matrix, merge: csr_matrix) -> csr_matrix:
    """Graph of groups: edges between groups are summed, those within dropped."""
    coarse = (merge @ graph @ merge.T).tocsr()
    coarse.setdiag(0.0)
    coarse.eliminate_zeros()
    return coarse
