"""Edges between neighbouring Gaussians.

Two neighbours are alike as far as they overlap in space (they lie on one surface) and have one colour and one width.
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
GAP_STRENGTH = 0.25  # half of 0.5: distances use the sum of two covariances, and ignore tails
WIDTH_STRENGTH = 2.0  # power of the ratio of two widths: ground under a foot is of wider Gaussians


def rgb_of(gaussians: Gaussians) -> np.ndarray:
    """View-independent colour of each Gaussian, 0..1, (N, 3)."""
    return (0.5 + C0 * gaussians.sh[:, 0]).clip(0.0, 1.0)


def neighbour_edges(gaussians: Gaussians) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Pairs (E,), (E,) of indices, each once, of neighbouring Gaussians, and their likeness (E,), 0..1."""
    points = gaussians.means.astype(np.float64)
    width = log_widths(gaussians)
    low, high, spacing = neighbours_of(points, width)
    colour, covariances = rgb_of(gaussians), gaussians.covariances
    gap, contrast = np.empty(len(low), np.float32), np.empty(len(low), np.float32)
    for begin in range(0, len(low), CHUNK):
        part = slice(begin, begin + CHUNK)
        a, b = low[part], high[part]
        rounding = (0.5 * np.minimum(spacing[a], spacing[b])) ** 2  # a surface is no thinner than it is sampled
        gap[part] = mahalanobis(points[b] - points[a], covariances[a] + covariances[b], rounding)
        contrast[part] = ((colour[a] - colour[b]) ** 2).sum(1)
    usual = max(float(contrast.mean()), 1e-4) if len(low) else 1.0
    unlike = np.abs(width[low] - width[high])
    return low, high, np.exp(-GAP_STRENGTH * gap - contrast / usual - WIDTH_STRENGTH * unlike)


def graph_of(low: np.ndarray, high: np.ndarray, weight: np.ndarray, count: int) -> csr_matrix:
    """Symmetric matrix (count, count) of the weights (E,) of edges, each given once."""
    half = csr_matrix((weight.astype(np.float64), (low, high)), (count, count))  # float32 stalls a solver
    return (half + half.T).tocsr()


def log_widths(gaussians: Gaussians) -> np.ndarray:
    """Logarithm (N,) of the width of each Gaussian in its surface: of the mean of its two larger scales."""
    return np.sort(gaussians.log_scales, axis=1)[:, 1:].mean(1)


def neighbours_of(points: np.ndarray, width: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Pairs (E,), (E,) of indices, each once, of neighbours, and the spacing (N,) of the points (N, 3) around each.

    width (N,)  logarithms. The neighbours of a Gaussian are the nearest of those that are about as wide or wider: those
    nearest to a wide one of the floor under a thing are all of the thing, and it would be cut off from the floor.
    """
    n = len(points)
    k = min(NEIGHBOURS, n - 1)
    if k < 1:
        return np.zeros(0, np.int32), np.zeros(0, np.int32), np.ones(n)
    near, distance = nearest_as_wide(points, width, np.arange(n, dtype=np.int32), k + 1)
    rows = np.arange(n, dtype=np.int32)[:, None]
    itself = near == rows
    itself[~itself.any(1), -1] = True  # of more points at one place than are found, one is left out
    index = near[~itself].reshape(n, k)
    spacing = np.maximum(distance[:, -1], 1e-9) / np.sqrt(k / np.pi)  # of a surface: k in a disc so large
    once = (rows < index) | ~np.stack([(index[index[:, j]] == rows).any(1) for j in range(k)], axis=1)
    return np.nonzero(once)[0].astype(np.int32), index[once], spacing


def nearest_as_wide(points: np.ndarray, width: np.ndarray, some: np.ndarray, k: int) -> tuple[np.ndarray, np.ndarray]:
    """The k nearest of `some` (M,) of the points that are about as wide as a point or wider, for each point.

    points (N, 3); width (N,), as a logarithm. Returns their indices among all, int32, and distances, (N, k) each. For
    the widest points narrower ones count, so that they have k, too.
    """
    octave = np.floor(width / np.log(2.0))
    octave = np.minimum(octave, np.partition(octave[some], len(some) - k)[len(some) - k])
    index, distance = np.empty((len(points), k), np.int32), np.empty((len(points), k))
    for least in np.unique(octave):
        there, own = some[octave[some] >= least], np.flatnonzero(octave == least)
        distance[own], near = cKDTree(points[there]).query(points[own], np.arange(1, k + 1), workers=-1)
        index[own] = there[near]
    return index, distance


def mahalanobis(d: np.ndarray, sigma: np.ndarray, added: np.ndarray) -> np.ndarray:
    """d^T (Sigma + added I)^-1 d for vectors (E, 3) and symmetric matrices (xx, xy, xz, yy, yz, zz), (E, 6)."""
    sigma = sigma + added[:, None] * np.array([1.0, 0.0, 0.0, 1.0, 0.0, 1.0])
    inverse = adjugate(sigma)
    return quadratic_form(inverse, d) / np.maximum((sigma[:, :3] * inverse[:, :3]).sum(1), 1e-30)


def adjugate(sigma: np.ndarray) -> np.ndarray:
    """Inverses times determinants of symmetric matrices (E, 6), in the same form."""
    xx, xy, xz, yy, yz, zz = sigma.T
    first = yy * zz - yz * yz, xz * yz - xy * zz, xy * yz - xz * yy
    return np.stack([*first, xx * zz - xz * xz, xy * xz - xx * yz, xx * yy - xy * xy], axis=1)


def quadratic_form(sigma: np.ndarray, d: np.ndarray) -> np.ndarray:
    """d^T Sigma d (E,) for symmetric matrices (E, 6) and vectors (E, 3), or one (3,)."""
    x, y, z = np.moveaxis(d, -1, 0)
    xx, xy, xz, yy, yz, zz = sigma.T
    return xx * x * x + yy * y * y + zz * z * z + 2.0 * (xy * x * y + xz * x * z + yz * y * z)
