"""Isosurface stuffing: tetrahedra from a signed distance grid (Labelle and Shewchuk 2007).

A body-centred cubic (BCC) lattice covers the shape. Lattice vertices close to the surface snap onto it ("warping");
lattice tets that the surface still cuts are split by stencils. On a uniform lattice dihedral angles stay above 10.7
degrees (the paper's bound); smooth shapes reach 15 to 20, white noise gave 9.6.

The lattice may be graded: its cells are the leaves of an octree in which neighbours across faces, edges and corners
differ by at most a factor of two. Tets join cell centres with the cell corners between them. Between equal cells these
are BCC tets, halved where a shared edge has a vertex at its midpoint; between a cell and four smaller ones, quarters of
BCC tets on one side and half-pyramids on the other. All lattice tets have dihedral angles of 45 to 120 degrees.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from assets.asset import Cage
from core.distance_grid import DistanceGrid
from core.errors import BadInput
from core.tetmesh import boundary_surface, face_components, tet_volumes
from prepare.cage.level_set import dilated_26
from prepare.cage.mesh_quality import non_manifold_vertices

# A cut closer to an edge's end than this fraction of the edge snaps the end onto the surface (the paper's Table 1).
ALPHA_LONG, ALPHA_SHORT = 0.24999, 0.41189
MIN_WARPED_VOLUME = 0.01  # of the tet's volume before warping; vertices that flatten a tet further snap back
MAX_LATTICE_CELLS = 20_000_000  # cells of the finest size; about 1 GB of host memory
INSIDE, ON_SURFACE, OUTSIDE = 1, 0, -1
SECANT_STEPS = 4


@dataclass(frozen=True)
class Lattice:
    """Vertices and tets of a lattice.

    coordinates  integer coordinates (L, 3) of the vertices; the finest cells are 2 wide
    tets         (T, 4), in either orientation
    width        width of the smallest cell at each vertex (L,), in the same unit
    origin       position of coordinate (0, 0, 0) [m]
    unit         length of one unit of the coordinates [m]
    """

    coordinates: np.ndarray
    tets: np.ndarray
    width: np.ndarray
    origin: np.ndarray
    unit: float


def divided_cells(wanted: np.ndarray, levels: int) -> list[np.ndarray]:
    """Masks of the divided cells of each level 0 .. levels - 1: `wanted` is met, neighbours differ by one level.

    wanted  least level (X, Y, Z) of each of the finest cells; each side a multiple of 2^levels
    """
    divided = []
    for level in reversed(range(levels)):
        wanted = _blocks(wanted).max((1, 3, 5))
        here = wanted > level
        if divided:  # the neighbours of divided cells must exist
            here |= _blocks(dilated_26(divided[-1])).any((1, 3, 5))
        divided.append(here)
    return divided[::-1]


def _blocks(a: np.ndarray) -> np.ndarray:
    x, y, z = (n // 2 for n in a.shape)
    return a.reshape(x, 2, y, 2, z, 2)


def graded_lattice(
    wanted: np.ndarray, levels: int, near: np.ndarray | None = None, *, origin=(0.0, 0.0, 0.0), unit: float = 1.0
) -> Lattice:
    """Lattice over cells of the wanted levels.

    wanted        as of `divided_cells`; level `levels` is the finest
    near          mask (X, Y, Z) of the finest cells that matter; tets between cells without any are left out
    origin, unit  as of Lattice
    Raises BadInput where there are too many cells.
    """
    if wanted.size > MAX_LATTICE_CELLS:
        raise BadInput(f"cage: a lattice of {wanted.shape} cells is too fine")
    divided = divided_cells(wanted, levels)
    matters = [near if near is not None else np.ones(wanted.shape, bool)]
    for _ in range(levels):
        matters.append(_blocks(matters[-1]).any((1, 3, 5)))
    matters = matters[::-1]
    found = []  # (corners as integer coordinates (n, 4, 3), width of their cell)
    exists = np.ones(divided[0].shape if levels else wanted.shape, bool)
    for level in range(levels + 1):
        split = divided[level] if level < levels else np.zeros(exists.shape, bool)
        found += _tets_of_level(exists & dilated_26(matters[level]), split, 2 << (levels - level))
        exists = split.repeat(2, 0).repeat(2, 1).repeat(2, 2)
    corners = np.concatenate([f[0] for f in found])
    cell_width = np.concatenate([np.full(len(f[0]), f[1]) for f in found])
    span = 2 * np.array(wanted.shape) + 1
    key = (corners[..., 0] * span[1] + corners[..., 1]) * span[2] + corners[..., 2]
    marked = np.zeros(span.prod(), bool)
    marked[key] = True
    used = np.flatnonzero(marked)
    number = np.empty(len(marked), np.int64)  # 64 bits: edges are numbered by products of these
    number[used] = np.arange(len(used))
    tets = number[key]
    coordinates = np.stack([used // (span[1] * span[2]), used // span[2] % span[1], used % span[2]], 1)
    width = np.full(len(coordinates), 2 << levels)
    for w in sorted(set(cell_width.tolist()), reverse=True):  # the smallest is written last
        width[tets[cell_width == w]] = w
    return Lattice(coordinates, tets, width, np.asarray(origin, np.float64), unit)


def _tets_of_level(exists: np.ndarray, split: np.ndarray, width: int) -> list[tuple[np.ndarray, int]]:
    """Tets across the faces between cells of one level, of which at least one is a leaf."""
    out, half = [], width // 2
    bordered = np.pad(split, 1)
    for axis in range(3):
        step, side, up = np.roll(np.eye(3, dtype=np.int64), -axis, axis=0)
        low = tuple(slice(0, -1) if i == axis else slice(None) for i in range(3))
        high = tuple(slice(1, None) if i == axis else slice(None) for i in range(3))
        both = exists[low] & exists[high]
        a = np.argwhere(both & ~split[low] & ~split[high])
        none = 0 * side
        # The face's four edges: start, direction, and offset to the two other cells that share the edge.
        for first, along, across in ((none, side, -up), (side, up, side), (up, side, up), (none, up, -side)):
            middle = bordered[tuple((a + 1 + across).T)] | bordered[tuple((a + 1 + step + across).T)]
            centre, other = width * a + half, width * (a + step) + half
            begin = width * (a + step + first)
            end = begin + width * along
            whole = ~middle
            out.append((np.stack([centre, other, begin, end], 1)[whole], width))
            mid = (begin + end) // 2
            out.append((np.stack([centre, other, begin, mid], 1)[middle], width))
            out.append((np.stack([centre, other, mid, end], 1)[middle], width))
        for leaf, rest, sign in ((low, high, 1), (high, low, -1)):
            a = np.argwhere(both & ~split[leaf] & split[rest])  # index of the lower cell
            coarse = width * (a if sign > 0 else a + step) + half
            face = width * (a + step) + half * (side + up)  # centre of the face
            for s in (-1, 1):
                for u in (-1, 1):
                    corner = face + half * (s * side + u * up)
                    fine = (face + corner) // 2 + sign * (half // 2) * step
                    for m in (face + half * s * side, face + half * u * up):
                        out.append((np.stack([coarse, face, corner, m], 1), width))
                        out.append((np.stack([fine, face, corner, m], 1), half))
    return out


def crossed_edges(tets: np.ndarray, phi: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Inside and outside ends of the lattice edges that the surface crosses, sorted by both, (E,) each."""
    a, b = tets[:, [0, 0, 0, 1, 1, 2]].reshape(-1), tets[:, [1, 2, 3, 2, 3, 3]].reshape(-1)
    within = phi[a] < 0
    a, b, within = (x[within != (phi[b] < 0)] for x in (a, b, within))
    key = np.unique(np.where(within, a, b) * len(phi) + np.where(within, b, a))
    return key // len(phi), key % len(phi)


def crossings(phi: np.ndarray, position: np.ndarray, inside: np.ndarray, outside: np.ndarray, distance: DistanceGrid):
    """Fraction from the inside to the outside end where phi = 0, (E,): bracketed secant steps (Illinois)."""
    a, b = np.zeros(len(inside)), np.ones(len(inside))
    fa, fb = np.minimum(phi[inside], -1e-300), np.maximum(phi[outside], 1e-300)  # a lattice may lie on the surface
    last = np.zeros(len(inside))
    for _ in range(SECANT_STEPS):
        t = a - fa * (b - a) / (fb - fa)
        points = position[inside] + t[:, None] * (position[outside] - position[inside])
        f = distance.sample_extended(points)
        within = f < 0
        a, b = np.where(within, t, a), np.where(within, b, t)
        now = np.where(within, -1.0, 1.0)
        fa = np.where(within, f, np.where(now == last, fa / 2, fa))
        fb = np.where(within, np.where(now == last, fb / 2, fb), np.maximum(f, 1e-300))
        last = now
    return (a - fa * (b - a) / (fb - fa)).clip(0, 1)


def stuff(lattice: Lattice, distance: DistanceGrid) -> Cage:
    """Cage of the largest connected part of the shape where the trilinear signed distance is negative.

    Features thinner than about a cell of the lattice may vanish. Volumes are positive, the surface is a closed outward
    2-manifold, and every vertex is used.
    Raises BadInput where no part of the shape meets the lattice, or a value is not finite.
    """
    if not np.isfinite(distance.values).all():
        raise BadInput("cage: the signed distance is not finite")
    coordinates = lattice.coordinates
    rest = lattice.origin + coordinates * lattice.unit
    rank = ((coordinates // lattice.width[:, None]).sum(1) % 2) * len(coordinates) + np.arange(len(coordinates))

    phi = distance.sample_extended(rest)
    tets = lattice.tets[(phi[lattice.tets] < 0).any(1)]
    inside, outside = crossed_edges(tets, phi)
    fraction = crossings(phi, rest, inside, outside, distance)
    alpha_in, alpha_out = _snap_fractions(lattice, inside, outside)
    snapped, warped = _warped(rest, inside, outside, fraction, alpha_in, alpha_out)
    sign = np.where(phi < 0, INSIDE, OUTSIDE)
    sign[snapped] = ON_SURFACE

    key = inside * len(phi) + outside
    fraction = fraction.clip(alpha_in, 1 - alpha_out)  # changes only cuts beside vertices that snap back below
    middle = (rest[inside] + rest[outside]) / 2

    def cut_ids(p, n):
        return len(phi) + np.searchsorted(key, p * len(phi) + n)

    snap_back = np.zeros(0, int)
    while True:
        sign[snap_back] = np.where(phi[snap_back] < 0, INSIDE, OUTSIDE)
        position = np.where((sign == ON_SURFACE)[:, None], warped, rest)
        cuts = position[inside] + fraction[:, None] * (position[outside] - position[inside])
        points = np.concatenate([position, cuts])
        cage = split_by_stencils(tets, sign, coordinates, rank, cut_ids, points)
        unmoved = tet_volumes(np.concatenate([rest, middle]), cage)  # so that an inversion stays visible
        flipped = unmoved < 0
        cage[flipped] = cage[flipped][:, [0, 1, 3, 2]]
        # Beside smaller cells, warping may flatten a tet: its warped vertices snap back.
        flat = np.unique(cage[tet_volumes(points, cage) < MIN_WARPED_VOLUME * np.abs(unmoved)])
        flat = flat[flat < len(phi)]
        snap_back = flat[sign[flat] == ON_SURFACE]
        if len(snap_back):
            continue
        if len(cage):
            cage = cage[face_components(cage) == 0]
        if not len(cage):
            widest = lattice.width.max() * lattice.unit
            raise BadInput(f"cage: the shape is thinner than a lattice of {widest:.3g} m")
        surface = boundary_surface(cage)
        pinched = non_manifold_vertices(surface)
        if not len(pinched):
            break
        # A surface through strictly signed vertices is always a manifold; warped vertices can pinch it.
        # These snap back until none is left.
        snap_back = pinched[pinched < len(phi)]
    used, flat = np.unique(cage, return_inverse=True)
    number = np.zeros(len(points), np.int32)
    number[used] = np.arange(len(used))
    return Cage(points[used].astype(np.float32), flat.reshape(-1, 4).astype(np.int32), number[surface])


def _snap_fractions(lattice: Lattice, inside: np.ndarray, outside: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Fractions of each crossed edge within which its inside and its outside end snap to the cut, (E,) each."""
    offset = np.abs(lattice.coordinates[outside] - lattice.coordinates[inside])
    straight = (offset > 0).sum(1) == 1  # along an axis: a long edge
    length = np.linalg.norm(offset, axis=1)
    alpha = np.where(straight, ALPHA_LONG, ALPHA_SHORT)
    regular = np.where(straight, 1.0, 0.75**0.5)  # edge length of a BCC tet over the cell's width
    at_inside = alpha * np.minimum(1, regular * lattice.width[inside] / length)  # less beside smaller cells
    at_outside = alpha * np.minimum(1, regular * lattice.width[outside] / length)
    return at_inside, at_outside


def _warped(rest: np.ndarray, inside, outside, fraction, alpha_in, alpha_out) -> tuple[np.ndarray, np.ndarray]:
    """Vertices that snap (with repetitions), and all positions (L, 3) with each of these at its nearest cut."""
    along = rest[outside] - rest[inside]
    near_in, near_out = fraction < alpha_in, fraction > 1 - alpha_out
    snapped = np.concatenate([inside[near_in], outside[near_out]])
    move = np.concatenate([(fraction[:, None] * along)[near_in], ((fraction - 1)[:, None] * along)[near_out]])
    order = np.argsort(-np.linalg.norm(move, axis=1), kind="stable")  # the last writer, the nearest, wins
    warped = rest.copy()
    warped[snapped[order]] = rest[snapped[order]] + move[order]
    return snapped, warped


def _prism(bottom, top, rows: np.ndarray | slice = slice(None)) -> np.ndarray:
    """Three tets of each prism, (3 M, 4); the diagonals of its sides run from bottom[a] to top[b] for a < b."""
    a, b, c = (x[rows] for x in bottom)
    u, v, w = (x[rows] for x in top)
    return np.concatenate([np.stack(t, 1) for t in ((a, b, c, w), (a, b, v, w), (a, u, v, w))])


def split_by_stencils(tets, sign: np.ndarray, coordinates: np.ndarray, rank: np.ndarray, cut_ids, points) -> np.ndarray:
    """Tets (M, 4) of the inside part of lattice tets (T, 4), in arbitrary orientation (the paper's Fig. 3).

    A BCC tet has two long edges (between vertices of the same kind: cell corners or cell centres) and four short ones.
    Where a lattice face is cut to a quadrilateral, both tets beside it must choose the same diagonal, and no prism may
    have three cyclic ones. An order of the inside corners ensures both: the diagonal starts at the corner with the
    shorter edge to the outside corner, and of equal ones at that of lower rank (even before odd coordinates).

    sign, coordinates, rank    of each lattice vertex: INSIDE/ON_SURFACE/OUTSIDE; (3,) integers; its place in the order
    cut_ids(inside, outside)   point ids of the cuts of edges
    points                     positions by id, to pick the shorter diagonal where both are free
    """
    tets = np.take_along_axis(tets, np.argsort(-sign[tets], axis=1, kind="stable"), axis=1)
    s = sign[tets]
    inside, zero = (s == INSIDE).sum(1), (s == ON_SURFACE).sum(1)

    def case(p: int, z: int) -> np.ndarray:
        return tets[(inside == p) & (zero == z)].T

    def precedes(p, q, n) -> np.ndarray:
        """Mask of where inside corner p comes before q on their face with the outside corner n."""
        longer = ((coordinates[p] - coordinates[n]) ** 2).sum(1) - ((coordinates[q] - coordinates[n]) ** 2).sum(1)
        return (longer < 0) | ((longer == 0) & (rank[p] < rank[q]))

    def ordered(p, q, n) -> tuple[np.ndarray, np.ndarray]:
        first = precedes(p, q, n)
        return np.where(first, p, q), np.where(first, q, p)

    out = [tets[(inside > 0) & (inside + zero == 4)]]

    p, z, y, n = case(1, 2)
    out.append(np.stack([p, z, y, cut_ids(p, n)], 1))

    p, z, n, m = case(1, 1)
    out.append(np.stack([p, z, cut_ids(p, n), cut_ids(p, m)], 1))

    p, n, m, l = case(1, 0)
    out.append(np.stack([p, cut_ids(p, n), cut_ids(p, m), cut_ids(p, l)], 1))

    p, q, z, n = case(2, 1)  # a pyramid over the quadrilateral p, q, cut q, cut p
    p, q = ordered(p, q, n)
    out.append(np.stack([z, p, q, cut_ids(q, n)], 1))
    out.append(np.stack([z, p, cut_ids(q, n), cut_ids(p, n)], 1))

    p, q, r, n = case(3, 0)  # a prism: the corner of n is cut off; bubble p, q, r into their order
    p, q = ordered(p, q, n)
    q, r = ordered(q, r, n)
    p, q = ordered(p, q, n)
    out.append(_prism((p, q, r), (cut_ids(p, n), cut_ids(q, n), cut_ids(r, n))))

    p, q, n, m = case(2, 0)  # a prism with the ends (p, cuts of p) and (q, cuts of q)
    by_n, by_m = precedes(p, q, n), precedes(p, q, m)
    swap = ~by_n & ~by_m
    p, q = np.where(swap, q, p), np.where(swap, p, q)
    by_n, by_m = by_n | swap, by_m | swap
    n, m = np.where(by_n, n, m), np.where(by_n, m, n)  # now p precedes q on the face of n
    both = by_n & by_m
    pn, pm, qn, qm = cut_ids(p, n), cut_ids(p, m), cut_ids(q, n), cut_ids(q, m)
    nm = np.linalg.norm(points[pn] - points[qm], axis=1) <= np.linalg.norm(points[pm] - points[qn], axis=1)
    out.append(_prism((p, pn, pm), (q, qn, qm), both & nm))
    out.append(_prism((p, pm, pn), (q, qm, qn), both & ~nm))
    # Here the face of m runs from cut pm to q, that of n from p to cut qn: only pm, p, pn is not cyclic.
    out.append(_prism((pm, p, pn), (qm, q, qn), ~both))
    return np.concatenate(out)
