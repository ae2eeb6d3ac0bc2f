"""Borders in a graph of Gaussians: random walks from seeds, the clearest border among what they reach, and forests."""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_matrix, diags
from scipy.sparse.csgraph import breadth_first_order, minimum_spanning_tree

WALK_TOLERANCE = 1e-4  # relative residual
WALK_STEPS = 5000
ISOLATED = 1e-9  # conductance of every node to the outside, which makes the system regular


def random_walk(graph: csr_matrix, inside: np.ndarray, outside: np.ndarray) -> np.ndarray:
    """Probability (N,) that a random walker along the edges reaches an inside seed before an outside one.

    inside, outside   seeds (N,) bool                                                             Grady 2006
    """
    p = inside.astype(np.float64)
    free = np.flatnonzero(~(inside | outside))
    if not len(free):
        return p
    degree = np.asarray(graph.sum(1)).ravel() + ISOLATED
    laplacian = (diags(degree) - graph).tocsr()[free]
    within = laplacian[:, free].tocsr()
    p[free] = solved(within, -(laplacian @ p))
    return p.clip(0.0, 1.0)


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
    """Nodes (N,) bool of the set {p > t}, with the seeds inside and without those outside, of least conductance over t.

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
    """A cut (N,) bool in which nodes that are not `fixed` (N,) join the side that they are most alike with.

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
