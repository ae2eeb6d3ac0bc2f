"""Graphs of neighbouring points or Gaussians, and borders in them: random walks, sweep cuts, watersheds."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse import csr_matrix, diags
from scipy.sparse.csgraph import breadth_first_order, minimum_spanning_tree
from scipy.spatial import cKDTree

from assets.gaussians import Gaussians
from core.spherical_harmonics import C0

WALK_TOLERANCE = 1e-4  # relative residual
WALK_STEPS = 5000
ISOLATED = 1e-9  # conductance of every node to the outside, which makes the system regular
NEIGHBOURS = 12  # per Gaussian: about two rings on a surface
CHUNK = 1 << 19  # edges processed at a time, to bound memory
GAP_STRENGTH = 0.25  # half of 0.5: distances use the sum of two covariances, and ignore tails
WIDTH_STRENGTH = 2.0  # power of the ratio of two widths: ground under a foot is of wider Gaussians


def random_walk(graph: csr_matrix, seeds: np.ndarray, labels: int, *, leak: float = 0.0) -> np.ndarray:
    """Probability (N, labels) that a random walker along the edges meets a seed of each label first.   Grady 2006

    seeds  labels (N,) of the seeds, -1: none
    leak   of a node's weights, to label 0: decides where no seed is connected
    """
    result = np.zeros((len(seeds), labels))
    fixed = seeds >= 0
    result[fixed, seeds[fixed]] = 1.0
    free = np.flatnonzero(~fixed)
    if not len(free):
        return result
    edges = graph[free]
    degree = np.asarray(edges.sum(axis=1)).ravel() * (1.0 + leak) + ISOLATED
    within, outwards = (diags(degree) - edges[:, free]).tocsr(), edges[:, np.flatnonzero(fixed)]
    for k in range(1, labels):
        result[free, k] = solved(within, outwards @ result[fixed, k]).clip(0.0, 1.0)
    result[free, 0] = (1.0 - result[free, 1:].sum(axis=1)).clip(0.0, 1.0)
    return result / result.sum(axis=1, keepdims=True)


def solved(matrix: csr_matrix, right: np.ndarray) -> np.ndarray:
    """Solution (N,) of a symmetric positive definite system: conjugate gradients, preconditioned by the diagonal.

    SciPy's took 10 to 40 times as long for 30,000 unknowns: its products of vectors wait for the threads of BLAS.
    """
    x, r, scale = np.zeros(len(right)), right.copy(), 1.0 / matrix.diagonal()
    way = scale * r
    now, least = inner(r, way), WALK_TOLERANCE**2 * inner(r, r)
    for _ in range(WALK_STEPS):
        if inner(r, r) <= least:
            break
        ahead = matrix @ way
        step = now / inner(way, ahead)
        x += step * way
        r -= step * ahead
        z = scale * r
        before, now = now, inner(r, z)
        way = z + now / before * way
    return x


def inner(a: np.ndarray, b: np.ndarray) -> float:
    """Inner product of vectors (N,), by one thread."""
    return float(np.einsum("i,i", a, b))


def clearest_level(graph: csr_matrix, p: np.ndarray, inside: np.ndarray, outside: np.ndarray) -> np.ndarray:
    """The set {p > t} (N,) bool of least conductance over all t, with the seeds inside and without those outside.

    Conductance: the weights of the edges that leave a set, over those of all edges at its nodes or at the others,
    whichever is less.                        Sweep cut of Andersen, Chung and Lang, Local graph partitioning, 2006

    By the maximum principle such a set has no holes without a seed, and no part without one.
    """
    n = len(p)
    order = np.argsort(np.where(inside, -2.0, np.where(outside, 1.0, -p)), kind="stable")
    rank = np.empty(n, np.int64)
    rank[order] = np.arange(n)
    one, two = np.repeat(rank, np.diff(graph.indptr)), rank[graph.indices]
    up = one < two  # each edge once: it leaves the sets that end between its nodes
    enters, leaves = (np.bincount(end[up], graph.data[up], n) for end in (one, two))
    cut = np.cumsum(enters - leaves)
    size = np.cumsum(np.asarray(graph.sum(1)).ravel()[order])
    least, most = int(inside.sum()), int((inside | (p > 0.0) & ~outside).sum())
    choice = slice(least - 1, most)
    conductance = cut[choice] / np.maximum(np.minimum(size, size[-1] - size)[choice], 1e-30)
    found = np.zeros(n, bool)
    found[order[: least + int(conductance.argmin())]] = True
    return found


def most_alike(low: np.ndarray, high: np.ndarray, likeness: np.ndarray, cut: np.ndarray, fixed: np.ndarray):
    """The cut (N,) bool after nodes that are not `fixed` (N,) join the side that they are most alike with.

    low, high, likeness  (E,) edges, each once, 0..1. Most alike is the side to which a path leads whose least likeness
    is largest: each node is in its side's tree of the maximum spanning forest.    Cousty et al., Watershed cuts, 2009
    """
    n, free = len(cut), ~(fixed[low] & fixed[high])
    own, nodes = n + (~cut[fixed]).astype(np.int64), np.flatnonzero(fixed)  # a root for each side joins its fixed nodes
    # The roots are joined at the least cost, so that each tree holds one of them when that edge is gone.
    cost = np.concatenate([2.0 - likeness[free], np.full(len(nodes), 0.5), [0.25]])
    edges = np.concatenate([low[free], nodes, [n]]), np.concatenate([high[free], own, [n + 1]])
    tree = minimum_spanning_tree(csr_matrix((cost, edges), (n + 2, n + 2)))
    tree[n, n + 1] = 0.0
    tree.eliminate_zeros()
    reached = np.zeros(n + 2, bool)
    reached[breadth_first_order(tree, n, directed=False, return_predecessors=False)] = True
    return np.where(fixed, cut, reached[:n])


def neighbour_edges(gaussians: Gaussians) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Pairs (E,), (E,) of indices, each once, of neighbouring Gaussians, and their likeness (E,), 0..1."""
    points = gaussians.means.astype(np.float64)
    width = log_widths(gaussians)
    low, high, spacing = neighbours_of(points, width)
    colour, covariances = (0.5 + C0 * gaussians.sh[:, 0]).clip(0.0, 1.0), gaussians.covariances
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

    width (N,)  logarithms. The neighbours of a Gaussian are the nearest that are about as wide or wider: all that are
    nearest to a wide one of the floor under an object belong to the object, and would cut it off from the floor.
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
    """The k nearest points among `some` (M,) that are about as wide as each point, or wider.

    points (N, 3); width (N,), as a logarithm. Returns their indices, int32, and distances, (N, k) each. The
    widest points may have narrower ones, so that they have k, too.
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


@dataclass(frozen=True)
class Thinned:
    """Some of N Gaussians: indices `some` (M,), these widened, and which of them stands for each, `cell` (N,)."""

    some: np.ndarray
    gaussians: Gaussians
    cell: np.ndarray


def thinned(gaussians: Gaussians, most: int) -> Thinned:
    """At most `most` of Gaussians in Morton order; the nearest that is about as wide stands for each."""
    step = -(-len(gaussians) // most)
    points = gaussians.means.astype(np.float64)
    some = np.arange(step // 2, len(points), step, dtype=np.int32)
    width = log_widths(gaussians)
    place = np.empty(len(points), np.int32)
    place[some] = np.arange(len(some))
    cell = place[nearest_as_wide(points, width, some, 1)[0][:, 0]]
    fewer = gaussians.select(some)
    scales = fewer.log_scales.copy()  # `step` times the area: the two larger grow, the surface gets no thicker
    scales += np.float32(0.5 * np.log(step)) * (scales > scales.min(axis=1, keepdims=True))
    return Thinned(some, replace(fewer, log_scales=scales), cell)
