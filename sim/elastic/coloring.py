"""Colours for the vertices of tet meshes: two vertices of one tet never share one (NumPy only).

All vertices of a colour can be moved at the same time, each to the minimum of its own energy (sim/elastic/vbd.py).
"""

import numpy as np
import scipy.sparse as sp

from sim.body_model import RestShape


def color_vertices(tets: np.ndarray, movable: np.ndarray) -> np.ndarray:
    """Colour of each vertex, (V,); -1 for what does not move (movable (V,) bool).

    Greedy, from the vertex with most neighbours to that with fewest, each into the least used of the colours that its
    neighbours leave: about as many vertices in each colour, 8 to 12 colours for meshes met in practice.
    """
    n = len(movable)
    corners = np.asarray(tets, np.int64)
    pairs = corners[:, [0, 0, 0, 1, 1, 2]].ravel(), corners[:, [1, 2, 3, 2, 3, 3]].ravel()
    graph = sp.coo_matrix((np.ones(len(pairs[0]), bool), pairs), shape=(n, n))
    graph = (graph + graph.T).tocsr()
    begin, neighbor = graph.indptr, graph.indices
    color, used = np.full(n, -1), []
    for i in np.argsort(-np.diff(begin), kind="stable"):
        if movable[i]:
            taken = {*color[neighbor[begin[i] : begin[i + 1]]].tolist()}
            usable = [c for c in range(len(used)) if c not in taken]
            if not usable:
                usable = [len(used)]
                used.append(0)
            color[i] = min(usable, key=lambda c: (used[c], c))
            used[color[i]] += 1
    return color


def color_ranges(color: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Vertices ordered by colour (n,), and where each colour begins in them (colours + 1,); -1 is left out."""
    order = np.argsort(color, kind="stable")
    order = order[color[order] >= 0]
    return order, np.concatenate([[0], np.cumsum(np.bincount(color[color >= 0], minlength=1))])


def colors_of(shape: RestShape, pinned: tuple) -> np.ndarray:
    """color_vertices of a shape, `pinned` saying of each vertex whether it stays."""
    return color_vertices(shape.tets, ~np.array(pinned))
