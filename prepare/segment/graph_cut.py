"""Borders in a graph of Gaussians: random walks from seeds, the clearest border among what they reach, and forests."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from scipy.sparse import csr_matrix, diags
from scipy.sparse.csgraph import breadth_first_order, minimum_spanning_tree
from scipy.sparse.linalg import cg

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
    p[free] = cg(within, -(laplacian @ p), rtol=WALK_TOLERANCE, maxiter=WALK_STEPS, M=diags(1.0 / within.diagonal()))[0]
    return p.clip(0.0, 1.0)


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
    cost = np.concatenate([2.0 - likeness[free], np.full(len(nodes), 0.5)])
    edges = np.concatenate([low[free], nodes]), np.concatenate([high[free], own])
    tree = minimum_spanning_tree(csr_matrix((cost, edges), (n + 2, n + 2)))
    tree = (tree + tree.T).tolil()
    before = breadth_first_order(tree.tocsr(), n, directed=False)[1]
    if before[n + 1] >= 0:  # one tree holds both roots: it is cut where its path between them is weakest
        path = [n + 1]
        while path[-1] != n:
            path.append(int(before[path[-1]]))
        weakest = max(pairwise(path), key=lambda edge: tree[edge])
        tree[weakest] = tree[weakest[::-1]] = 0.0
    reached = np.zeros(n + 2, bool)
    reached[breadth_first_order(tree.tocsr(), n, directed=False, return_predecessors=False)] = True
    return np.where(fixed, cut, reached[:n])
