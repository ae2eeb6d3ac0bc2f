"""How a lattice tetrahedron is cut by the surface (Labelle and Shewchuk 2007, Fig. 3).

A tet of the BCC lattice has two long edges (between vertices of the same kind: cell corners or cell
centres) and four short ones. Its corners are inside, on the surface ("zero"), or outside; each edge
between inside and outside has one cut. Where a face of the lattice is cut to a quadrilateral, both
tets beside it must choose the same diagonal, and no prism may have three cyclic ones. One order of the
inside corners gives both: the diagonal starts at the corner that comes first, that with the shorter edge to the
outside corner, and of equal ones that of lower rank: in a BCC lattice, even before odd coordinates.
"""

from __future__ import annotations

import numpy as np

INSIDE, ZERO, OUTSIDE = 1, 0, -1


def prism(bottom, top, rows: np.ndarray | slice = slice(None)) -> np.ndarray:
    """Three tets of each prism whose corners are given in the order of their diagonals, (3 M, 4).

    The diagonals run from bottom[a] to top[b] for a < b.
    """
    a, b, c = (x[rows] for x in bottom)
    u, v, w = (x[rows] for x in top)
    return np.concatenate([np.stack(t, 1) for t in ((a, b, c, w), (a, b, v, w), (a, u, v, w))])


def cut_tets(tets: np.ndarray, sign: np.ndarray, at: np.ndarray, rank: np.ndarray, cuts, points) -> np.ndarray:
    """Tets (M, 4) of the inside part of lattice tets (T, 4); their orientation is arbitrary.

    sign, at, rank   of each lattice vertex: INSIDE/ZERO/OUTSIDE; integer coordinates (3,); a number of its own
    cuts(inside, outside) -> ids of the cut points of edges
    points                positions by id, to pick the shorter diagonal where both are free
    """
    tets = np.take_along_axis(tets, np.argsort(-sign[tets], axis=1, kind="stable"), axis=1)
    s = sign[tets]
    inside, zero = (s == INSIDE).sum(1), (s == ZERO).sum(1)

    def case(p: int, z: int) -> np.ndarray:
        return tets[(inside == p) & (zero == z)].T

    def precedes(p, q, n) -> np.ndarray:
        """Does inside corner p come before q on their face with the outside corner n?"""
        longer = ((at[p] - at[n]) ** 2).sum(1) - ((at[q] - at[n]) ** 2).sum(1)
        return (longer < 0) | ((longer == 0) & (rank[p] < rank[q]))

    def ordered(p, q, n) -> tuple[np.ndarray, np.ndarray]:
        first = precedes(p, q, n)
        return np.where(first, p, q), np.where(first, q, p)

    out = [tets[(inside > 0) & (inside + zero == 4)]]

    p, z, y, n = case(1, 2)
    out.append(np.stack([p, z, y, cuts(p, n)], 1))

    p, z, n, m = case(1, 1)
    out.append(np.stack([p, z, cuts(p, n), cuts(p, m)], 1))

    p, n, m, l = case(1, 0)
    out.append(np.stack([p, cuts(p, n), cuts(p, m), cuts(p, l)], 1))

    p, q, z, n = case(2, 1)  # a pyramid over the quadrilateral p, q, cut q, cut p
    p, q = ordered(p, q, n)
    out.append(np.stack([z, p, q, cuts(q, n)], 1))
    out.append(np.stack([z, p, cuts(q, n), cuts(p, n)], 1))

    p, q, r, n = case(3, 0)  # a prism: the corner of n is cut off; bubble p, q, r into their order
    p, q = ordered(p, q, n)
    q, r = ordered(q, r, n)
    p, q = ordered(p, q, n)
    out.append(prism((p, q, r), (cuts(p, n), cuts(q, n), cuts(r, n))))

    p, q, n, m = case(2, 0)  # a prism with the ends (p, cuts of p) and (q, cuts of q)
    by_n, by_m = precedes(p, q, n), precedes(p, q, m)
    swap = ~by_n & ~by_m
    p, q = np.where(swap, q, p), np.where(swap, p, q)
    by_n, by_m = by_n | swap, by_m | swap
    n, m = np.where(by_n, n, m), np.where(by_n, m, n)  # now p precedes q on the face of n
    both = by_n & by_m
    pn, pm, qn, qm = cuts(p, n), cuts(p, m), cuts(q, n), cuts(q, m)
    nm = np.linalg.norm(points[pn] - points[qm], axis=1) <= np.linalg.norm(points[pm] - points[qn], axis=1)
    out.append(prism((p, pn, pm), (q, qn, qm), both & nm))
    out.append(prism((p, pm, pn), (q, qm, qn), both & ~nm))
    # Here the face of m runs from cut pm to q, that of n from p to cut qn: only pm, p, pn is not cyclic.
    out.append(prism((pm, p, pn), (qm, q, qn), ~both))
    return np.concatenate(out)
