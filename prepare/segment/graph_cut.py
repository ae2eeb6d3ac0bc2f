"""Random walks and minimum cuts of a graph of Gaussians."""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_matrix, diags
from scipy.sparse.csgraph import breadth_first_order, maximum_flow
from scipy.sparse.linalg import cg

from prepare.segment.gaussian_graph import merge_matrix, merged

FLOW_LEVELS = 1_000  # capacity of an edge of weight 1: maximum_flow takes integers
FLOW_MAX = 1 << 28  # a capacity that is never saturated
WALK_TOLERANCE = 1e-4  # relative residual
WALK_STEPS = 2000
ISOLATED = 1e-9  # conductance of every node to the outside, which makes the system regular


def random_walk(
    graph: csr_matrix, inside: np.ndarray, outside: np.ndarray, likes: np.ndarray, dislikes: np.ndarray
) -> np.ndarray:
    """Probability (N,) that a random walker along the edges reaches an inside seed before an outside one.

    inside, outside   seeds (N,) bool;  likes, dislikes  weights (N,) of further edges, one to the inside, one to the
                      outside                                                        Grady 2006; with priors, 2005
    """
    p = inside.astype(np.float64)
    free = np.flatnonzero(~(inside | outside))
    if not len(free):
        return p
    degree = np.asarray(graph.sum(1)).ravel() + likes + dislikes + ISOLATED
    laplacian = (diags(degree) - graph).tocsr()[free]
    within = laplacian[:, free].tocsr()
    right = likes[free] - laplacian @ p
    p[free] = cg(within, right, rtol=WALK_TOLERANCE, maxiter=WALK_STEPS, M=diags(1.0 / within.diagonal()))[0]
    return p.clip(0.0, 1.0)


def min_cut(graph: csr_matrix, inside: np.ndarray, outside: np.ndarray) -> np.ndarray:
    """Nodes (N,) bool on the inner side of the least cut. A node that is left out costs `inside` (N,), one that is put
    in costs `outside` (N,), and each edge between them its weight; inf where that must not be."""
    n = graph.shape[0]
    both = np.minimum(inside, outside)  # is paid in any case
    inside, outside = inside - both, outside - both
    nodes, rows = np.arange(n), np.repeat(np.arange(n), np.diff(graph.indptr))
    values = np.concatenate([graph.data, inside, outside])
    capacity = np.minimum(np.round(FLOW_LEVELS * values), FLOW_MAX).astype(np.int32)
    edges = np.concatenate([rows, np.full(n, n), nodes]), np.concatenate([graph.indices, nodes, np.full(n, n + 1)])
    network = csr_matrix((capacity, edges), (n + 2, n + 2))
    network.eliminate_zeros()
    residual = network - maximum_flow(network, n, n + 1).flow
    residual.data[residual.data < 0] = 0
    residual.eliminate_zeros()
    cut = np.zeros(n + 2, bool)
    cut[breadth_first_order(residual, n, return_predecessors=False)] = True
    return cut[:n]


def banded_cut(graph: csr_matrix, inside: np.ndarray, outside: np.ndarray, clusters: np.ndarray) -> np.ndarray:
    """As `min_cut`, first among clusters (N,) of nodes, then among the nodes of those at its border.  Lombaert 2005"""
    merge = merge_matrix(clusters)
    coarse = merged(graph, clusters)
    rough = min_cut(coarse, merge @ inside, merge @ outside)
    border = rough & (coarse @ ~rough > 0) | ~rough & (coarse @ rough > 0)
    cut, free = rough[clusters], np.flatnonzero(border[clusters])
    if len(free) and len(rough) < len(clusters):
        fixed, own = ~border[clusters], graph[free]
        drawn_in, drawn_out = own @ (fixed & cut).astype(float), own @ (fixed & ~cut).astype(float)
        cut[free] = min_cut(own[:, free].tocsr(), inside[free] + drawn_in, outside[free] + drawn_out)
    return cut
