"""Tetrahedra straight from a signed distance grid: isosurface stuffing (Labelle and Shewchuk 2007).

A body-centred cubic lattice is laid over the shape. Where the surface passes close by a lattice vertex,
the vertex moves onto it; the lattice tets that the surface still cuts are cut by stencils. Dihedral angles
stay above 10.7 degrees (the paper's bound); smooth shapes have 15 to 20, white noise had 9.6.
"""

from __future__ import annotations

import numpy as np
from scipy.ndimage import map_coordinates

from assets.asset import Cage
from assets.errors import BadInput
from prepare.quality import boundary, non_manifold_vertices, pieces, volumes
from prepare.stencils import INSIDE, OUTSIDE, ZERO, cut_tets

# A cut within this share of an edge pulls the edge's end onto the surface (Labelle and Shewchuk, Table 1).
ALPHA_LONG, ALPHA_SHORT = 0.24999, 0.41189
LATTICE_MAX = 20_000_000  # vertices; about 1 GB of host memory


def sample(values: np.ndarray, origin, spacing: float, points: np.ndarray) -> np.ndarray:
    """Signed distance [m] at points (M, 3), trilinear; beyond the grid the way back to it is added."""
    u = (np.asarray(points) - origin) / spacing
    inner = u.clip(0, np.array(values.shape) - 1.0)
    found = map_coordinates(np.asarray(values, np.float64), inner.T, order=1, mode="nearest")
    away = np.linalg.norm(u - inner, axis=1) * spacing
    return np.where(away > 0, np.maximum(found, 0) + away, found)  # so that a shape cut by the border is closed


def lattice(low: np.ndarray, high: np.ndarray, cell: float):
    """BCC lattice over a box, centred on it: doubled integer coordinates (L, 3) and tets (T, 4).

    Corners have even coordinates, centres odd ones.
    """
    n = np.ceil((high - low) / cell).astype(int) + 3  # cells; one spare on each side
    if (2 * (n + 1)).prod() > LATTICE_MAX:
        raise BadInput(f"cage: a cell of {cell:.3g} m is too fine for a body of {(high - low).max():.3g} m")
    corner = np.stack(np.meshgrid(*(np.arange(k + 1) for k in n), indexing="ij"), -1).reshape(-1, 3)
    centre = np.stack(np.meshgrid(*(np.arange(k) for k in n), indexing="ij"), -1).reshape(-1, 3)

    def corner_id(i):
        return (i[:, 0] * (n[1] + 1) + i[:, 1]) * (n[2] + 1) + i[:, 2]

    def centre_id(i):
        return len(corner) + (i[:, 0] * n[1] + i[:, 1]) * n[2] + i[:, 2]

    tets = []
    for axis in range(3):
        step, side, up = np.roll(np.eye(3, dtype=int), -axis, axis=0)
        a = centre[centre[:, axis] < n[axis] - 1]  # the face between cells a and a + step, whose corners go round
        ring = [a + step, a + step + side, a + step + side + up, a + step + up]
        for k in range(4):
            ends = corner_id(ring[k]), corner_id(ring[(k + 1) % 4])
            tets.append(np.stack([centre_id(a), centre_id(a + step), *ends], 1))
    origin = (low + high) / 2 - n * cell / 2
    return np.concatenate([2 * corner, 2 * centre + 1]), np.concatenate(tets), origin


def crossing_edges(tets: np.ndarray, phi: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Inside and outside ends of the lattice's edges that the surface crosses, sorted by both, (E,) each."""
    a, b = tets[:, [0, 0, 0, 1, 1, 2]].reshape(-1), tets[:, [1, 2, 3, 2, 3, 3]].reshape(-1)
    within = phi[a] < 0
    a, b, within = (x[within != (phi[b] < 0)] for x in (a, b, within))
    key = np.unique(np.where(within, a, b) * len(phi) + np.where(within, b, a))
    return key // len(phi), key % len(phi)


def crossings(phi: np.ndarray, position: np.ndarray, inside: np.ndarray, outside: np.ndarray, values, origin, spacing):
    """Share of the way from inside to outside ends where phi = 0, (E,): bracketed secant steps (Illinois)."""
    a, b = np.zeros(len(inside)), np.ones(len(inside))
    fa, fb = phi[inside].copy(), phi[outside].copy()
    last = np.zeros(len(inside))
    for _ in range(4):
        t = a - fa * (b - a) / (fb - fa)
        f = sample(values, origin, spacing, position[inside] + t[:, None] * (position[outside] - position[inside]))
        within = f < 0
        a, b = np.where(within, t, a), np.where(within, b, t)
        now = np.where(within, -1.0, 1.0)
        fa = np.where(within, f, np.where(now == last, fa / 2, fa))
        fb = np.where(within, np.where(now == last, fb / 2, fb), np.maximum(f, 1e-300))
        last = now
    return (a - fa * (b - a) / (fb - fa)).clip(0, 1)


def stuff(values: np.ndarray, origin, spacing: float, *, cell: float, whole: bool = True) -> Cage:
    """Cage of the shape where the trilinear signed distance `values` (X, Y, Z) [m] is negative.

    values    node (i, j, k) lies at origin + spacing (i, j, k) [m]
    cell      edge of the lattice's cubes [m]; features thinner than about one cell may vanish
    whole     keep the largest piece only
    Out.      a Cage: positive volumes, closed outward 2-manifold surface, no unused vertex
    Raises    BadInput where nothing of the shape meets the lattice.
    """
    values, origin = np.asarray(values, np.float64), np.asarray(origin, np.float64)
    if not np.isfinite(values).all():
        raise BadInput("cage: the signed distance is not finite")
    solid = np.argwhere(values < 0)
    if not len(solid):
        raise BadInput("cage: the shape is empty")
    low, high = origin + spacing * (solid.min(0) - 1), origin + spacing * (solid.max(0) + 1)
    doubled, tets, start = lattice(low, high, cell)
    at_rest = start + doubled * (cell / 2)
    kind, parity = doubled[:, 0] % 2, (doubled // 2).sum(1) % 2

    phi = sample(values, origin, spacing, at_rest)
    tets = tets[(phi[tets] < 0).any(1)]
    inside, outside = crossing_edges(tets, phi)
    share = crossings(phi, at_rest, inside, outside, values, origin, spacing)
    alpha = np.where(kind[inside] == kind[outside], ALPHA_LONG, ALPHA_SHORT)

    # Each vertex moves to the nearest of the cuts that crowd it.
    along = at_rest[outside] - at_rest[inside]
    near_in, near_out = share < alpha, share > 1 - alpha
    who = np.concatenate([inside[near_in], outside[near_out]])
    move = np.concatenate([(share[:, None] * along)[near_in], ((share - 1)[:, None] * along)[near_out]])
    order = np.argsort(-np.linalg.norm(move, axis=1), kind="stable")  # the last writer, the nearest, wins
    warped = at_rest.copy()
    warped[who[order]] = at_rest[who[order]] + move[order]
    sign = np.where(phi < 0, INSIDE, OUTSIDE)
    sign[who] = ZERO

    key = inside * len(phi) + outside
    share = share.clip(alpha, 1 - alpha)  # changes only cuts beside vertices that are put back below
    middle = (at_rest[inside] + at_rest[outside]) / 2

    def cuts(p, n):
        return len(phi) + np.searchsorted(key, p * len(phi) + n)

    while True:
        position = np.where((sign == ZERO)[:, None], warped, at_rest)
        points = np.concatenate([position, position[inside] + share[:, None] * (position[outside] - position[inside])])
        cage = cut_tets(tets, sign, kind, parity, cuts, points)
        flipped = volumes(np.concatenate([at_rest, middle]), cage) < 0  # unmoved, so that an inversion stays visible
        cage[flipped] = cage[flipped][:, [0, 1, 3, 2]]
        if whole:
            cage = cage[pieces(cage) == 0]
        if not len(cage):
            raise BadInput(f"cage: the shape is thinner than a lattice of {cell:.3g} m")
        surface = boundary(cage)
        pinched = non_manifold_vertices(surface)
        if not len(pinched):
            break
        # A surface through strictly signed vertices is always a manifold; vertices that moved onto it can
        # pinch it. Put these back to the side they came from, until none is left.
        pinched = pinched[pinched < len(phi)]
        sign[pinched] = np.where(phi[pinched] < 0, INSIDE, OUTSIDE)
    used, flat = np.unique(cage, return_inverse=True)
    number = np.zeros(len(points), np.int32)
    number[used] = np.arange(len(used))
    return Cage(points[used].astype(np.float32), flat.reshape(-1, 4).astype(np.int32), number[surface])
