"""Tetrahedra straight from a signed distance grid: isosurface stuffing (Labelle and Shewchuk 2007).

A body-centred cubic lattice is laid over the shape. Where the surface passes close by a lattice vertex,
the vertex moves onto it; the lattice tets that the surface still cuts are cut by stencils. Dihedral angles
stay above 10.7 degrees (the paper's bound); smooth shapes have 15 to 20, white noise had 9.6.
"""

from __future__ import annotations

import numpy as np
from scipy.ndimage import map_coordinates

from assets.asset import Cage
from core.errors import BadInput
from core.tetmesh import boundary_surface, face_components, tet_volumes
from prepare.cage.graded_lattice import LATTICE_MAX, Lattice, graded_lattice
from prepare.cage.mesh_quality import non_manifold_vertices
from prepare.cage.stencils import INSIDE, OUTSIDE, ZERO, cut_tets

# A cut within this share of an edge pulls the edge's end onto the surface (Labelle and Shewchuk, Table 1).
ALPHA_LONG, ALPHA_SHORT = 0.24999, 0.41189

FLAT = 0.01  # of a tet's volume before its corners moved; below this they must not move


def sample(values: np.ndarray, origin, spacing: float, points: np.ndarray) -> np.ndarray:
    """Signed distance [m] at points (M, 3), trilinear; beyond the grid the way back to it is added."""
    u = (np.asarray(points) - origin) / spacing
    inner = u.clip(0, np.array(values.shape) - 1.0)
    found = map_coordinates(values, inner.T, order=1, mode="nearest", output=np.float64)
    away = np.linalg.norm(u - inner, axis=1) * spacing
    return np.where(away > 0, np.maximum(found, 0) + away, found)  # so that a shape cut by the border is closed


def uniform(values: np.ndarray, origin: np.ndarray, spacing: float, cell: float) -> tuple[Lattice, np.ndarray, float]:
    """BCC lattice round where `values` are negative: it, its origin [m] and the unit of its coordinates [m]."""
    solid = np.argwhere(values < 0)
    if not len(solid):
        raise BadInput("cage: the shape is empty")
    low, high = origin + spacing * (solid.min(0) - 1), origin + spacing * (solid.max(0) + 1)
    n = np.ceil((high - low) / cell).astype(int) + 3  # cells; one spare on each side
    if n.prod() > LATTICE_MAX:
        raise BadInput(f"cage: a cell of {cell:.3g} m is too fine for a body of {(high - low).max():.3g} m")
    return graded_lattice(np.zeros(n, np.int8), 0), (low + high) / 2 - n * cell / 2, cell / 2


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
    fa, fb = np.minimum(phi[inside], -1e-300), np.maximum(phi[outside], 1e-300)  # a lattice may lie on the surface
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
    values, origin = np.asarray(values), np.asarray(origin, np.float64)
    if not np.isfinite(values).all():
        raise BadInput("cage: the signed distance is not finite")
    return stuff_lattice(*uniform(values, origin, spacing, cell), values, origin, spacing, whole=whole)


def stuff_lattice(lattice: Lattice, start, unit: float, values, origin, spacing: float, *, whole: bool = True) -> Cage:
    """As `stuff`, with a given lattice, whose coordinate (i, j, k) lies at start + unit (i, j, k) [m]."""
    at = lattice.at
    at_rest = start + at * unit
    rank = ((at // lattice.size[:, None]).sum(1) % 2) * len(at) + np.arange(len(at))

    phi = sample(values, origin, spacing, at_rest)
    tets = lattice.tets[(phi[lattice.tets] < 0).any(1)]
    inside, outside = crossing_edges(tets, phi)
    share = crossings(phi, at_rest, inside, outside, values, origin, spacing)
    offset = np.abs(at[outside] - at[inside])
    straight = (offset > 0).sum(1) == 1
    length = np.linalg.norm(offset, axis=1)
    alpha = np.where(straight, ALPHA_LONG, ALPHA_SHORT)
    usual = np.where(straight, 1.0, 0.75**0.5)  # of a cell is an edge of a BCC tet long
    alpha_in = alpha * np.minimum(1, usual * lattice.size[inside] / length)  # beside smaller cells less
    alpha_out = alpha * np.minimum(1, usual * lattice.size[outside] / length)

    # Each vertex moves to the nearest of the cuts that crowd it.
    along = at_rest[outside] - at_rest[inside]
    near_in, near_out = share < alpha_in, share > 1 - alpha_out
    who = np.concatenate([inside[near_in], outside[near_out]])
    move = np.concatenate([(share[:, None] * along)[near_in], ((share - 1)[:, None] * along)[near_out]])
    order = np.argsort(-np.linalg.norm(move, axis=1), kind="stable")  # the last writer, the nearest, wins
    warped = at_rest.copy()
    warped[who[order]] = at_rest[who[order]] + move[order]
    sign = np.where(phi < 0, INSIDE, OUTSIDE)
    sign[who] = ZERO

    key = inside * len(phi) + outside
    share = share.clip(alpha_in, 1 - alpha_out)  # changes only cuts beside vertices that are put back below
    middle = (at_rest[inside] + at_rest[outside]) / 2

    def cuts(p, n):
        return len(phi) + np.searchsorted(key, p * len(phi) + n)

    while True:
        position = np.where((sign == ZERO)[:, None], warped, at_rest)
        points = np.concatenate([position, position[inside] + share[:, None] * (position[outside] - position[inside])])
        cage = cut_tets(tets, sign, at, rank, cuts, points)
        unmoved = tet_volumes(np.concatenate([at_rest, middle]), cage)  # so that an inversion stays visible
        flipped = unmoved < 0
        cage[flipped] = cage[flipped][:, [0, 1, 3, 2]]
        # Beside smaller cells a move may flatten a tet: whoever moved there goes back, too.
        flat = np.unique(cage[tet_volumes(points, cage) < FLAT * np.abs(unmoved)])
        flat = flat[flat < len(phi)]
        flat = flat[sign[flat] == ZERO]
        if len(flat):
            sign[flat] = np.where(phi[flat] < 0, INSIDE, OUTSIDE)
            continue
        if whole and len(cage):
            cage = cage[face_components(cage) == 0]
        if not len(cage):
            raise BadInput(f"cage: the shape is thinner than a lattice of {lattice.size.max() * unit:.3g} m")
        surface = boundary_surface(cage)
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
