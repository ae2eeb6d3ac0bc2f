"""A body-centred cubic lattice, fine where that is asked for (Labelle and Shewchuk 2007, on graded meshes).

The cells are the leaves of an octree, in which neighbours across faces, edges and corners differ by at most a factor
of two. Tets join the centres of cells with the corners between them. Between equal cells these are BCC tets, halved
where an edge between them has a vertex in its middle; between a cell and four smaller ones, quarters of BCC tets on
one side and half-pyramids on the other. All have dihedral angles of 45 to 120 degrees.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from core.errors import BadInput
from prepare.cage.morphology import all_around

LATTICE_MAX = 20_000_000  # cells of the finest size; about 1 GB of host memory


@dataclass(frozen=True)
class Lattice:
    """Vertices and tets of a lattice.

    at     integer coordinates (L, 3) of the vertices; the finest cells are 2 wide
    tets   (T, 4), in either orientation
    size   width of the smallest cell at each vertex (L,), in the same unit
    """

    at: np.ndarray
    tets: np.ndarray
    size: np.ndarray


def refined(want: np.ndarray, levels: int) -> list[np.ndarray]:
    """Which cells of each level 0 .. levels - 1 are divided, so that `want` is met and neighbours differ by one level.

    want  level (X, Y, Z) that is wanted at least in each of the finest cells; each side a multiple of 2^levels
    """
    divided = []
    for level in reversed(range(levels)):
        want = _blocks(want).max((1, 3, 5))
        here = want > level
        if divided:  # the neighbours of what is divided further must exist
            here |= _blocks(all_around(divided[-1])).any((1, 3, 5))
        divided.append(here)
    return divided[::-1]


def _blocks(a: np.ndarray) -> np.ndarray:
    x, y, z = (n // 2 for n in a.shape)
    return a.reshape(x, 2, y, 2, z, 2)


def _twice(a: np.ndarray) -> np.ndarray:
    for axis in range(3):
        a = np.repeat(a, 2, axis)
    return a


def graded_lattice(want: np.ndarray, levels: int, near: np.ndarray | None = None) -> Lattice:
    """The lattice over cells of the levels wanted.

    want   as of `refined`; level `levels` is the finest
    near   mask (X, Y, Z) of the finest cells that matter; tets between cells without any are left out
    Raises BadInput where there are too many cells.
    """
    if want.size > LATTICE_MAX:
        raise BadInput(f"cage: a lattice of {want.shape} cells is too fine")
    divided = refined(want, levels)
    matters = [near if near is not None else np.ones(want.shape, bool)]
    for _ in range(levels):
        matters.append(_blocks(matters[-1]).any((1, 3, 5)))
    matters = matters[::-1]
    found = []  # corners as integer coordinates, (n, 4, 3), and the width of their cell
    exists = np.ones(divided[0].shape if levels else want.shape, bool)
    for level in range(levels + 1):
        split = divided[level] if level < levels else np.zeros(exists.shape, bool)
        found += _level(exists & all_around(matters[level]), split, 2 << (levels - level))
        exists = _twice(split)
    corners = np.concatenate([f[0] for f in found])
    width = np.concatenate([np.full(len(f[0]), f[1]) for f in found])
    span = 2 * np.array(want.shape) + 1
    key = (corners[..., 0] * span[1] + corners[..., 1]) * span[2] + corners[..., 2]
    marked = np.zeros(span.prod(), bool)
    marked[key] = True
    used = np.flatnonzero(marked)
    number = np.empty(len(marked), np.int64)  # edges are numbered by products of these; only what is used takes memory
    number[used] = np.arange(len(used))
    tets = number[key]
    at = np.stack([used // (span[1] * span[2]), used // span[2] % span[1], used % span[2]], 1)
    size = np.full(len(at), 2 << levels)
    for w in sorted(set(width.tolist()), reverse=True):  # the smallest is written last
        size[tets[width == w]] = w
    return Lattice(at, tets, size)


def _level(exists: np.ndarray, split: np.ndarray, width: int) -> list[tuple[np.ndarray, int]]:
    """Tets across the faces between cells of one level, of which one at least is a leaf."""
    out, half = [], width // 2
    bordered = np.pad(split, 1)
    for axis in range(3):
        step, side, up = np.roll(np.eye(3, dtype=np.int64), -axis, axis=0)
        low = tuple(slice(0, -1) if i == axis else slice(None) for i in range(3))
        high = tuple(slice(1, None) if i == axis else slice(None) for i in range(3))
        both = exists[low] & exists[high]
        a = np.argwhere(both & ~split[low] & ~split[high])
        none = 0 * side
        # The face's four edges: where they begin and run, and the way to the two other cells that share each.
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
            face = width * (a + step) + half * (side + up)  # its middle
            for s in (-1, 1):
                for u in (-1, 1):
                    corner = face + half * (s * side + u * up)
                    fine = (face + corner) // 2 + sign * (half // 2) * step
                    for m in (face + half * s * side, face + half * u * up):
                        out.append((np.stack([coarse, face, corner, m], 1), width))
                        out.append((np.stack([fine, face, corner, m], 1), half))
    return out
