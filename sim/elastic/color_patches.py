"""Patches for the descent of vertices: compact parts of the bodies' vertices by colour, with the tets of each vertex.

A block of threads takes some patches of bodies that are awake. It keeps their vertices, and those that share a tet with
them, in shared memory for many substeps, and after each colour fetches only the others of that colour, which other
blocks have moved. A patch is of one body, so that the patches of those that are awake are spread over all blocks.
"""

from bisect import bisect_left

import numpy as np
import taichi as ti

from core.errors import BadInput
from core.fields import FieldGroup, Upload
from sim.capacity import MAX_BODIES, stacked
from sim.elastic.patches import TablesOf, compact_order
from sim.elastic.vbd import MAX_COLORS, colors_of, tet_terms
from sim.model import Model
from sim.state import State

# 48 KB of shared memory, as much as every block may have: x + dx in double precision, and words
RESIDENT = 4  # patches that a block holds at once
PLACES = 366  # for vertices of a patch, own ones and others
INDEX_BITS = 9
ALL_PLACES = RESIDENT * PLACES
VERTEX, SLOT = 0, ALL_PLACES  # words, for each place
MU, LAM, LAG, COUNT = range(2 * ALL_PLACES, 2 * ALL_PLACES + 4 * RESIDENT, RESIDENT)  # words, for each resident patch
COLOR_PLACES = MAX_COLORS + 1
OWN = 2 * ALL_PLACES + 4 * RESIDENT  # words: begin of each colour of each resident patch, COLOR_PLACES each ...
OTHERS = OWN + RESIDENT * COLOR_PLACES  # ... and the same among the vertices that belong to other patches
POINTS, WORDS = 3 * ALL_PLACES, OTHERS + RESIDENT * COLOR_PLACES
assert PLACES <= 1 << INDEX_BITS and 8 * POINTS + 4 * WORDS <= 48 << 10


@ti.data_oriented
class ColorPatches:
    """Tables of the patches. Fields over slots are one scalar each. Place `at` of vertex k of resident patch r is
    r PLACES + k.

    local i32[]: vertices of each patch, its own ones by colour first, then the others by colour
    local_begin i32[P+1], own_end i32[P]: where they begin in `local`
    own_begin, others_begin i32[P,COLOR_PLACES]: first of each colour, from the patch's first vertex on
    slot_begin i32[]: first slot of each own vertex, at its place in `local`
    words i32[2][4T]: indices of a slot's corners in the patch, INDEX_BITS each, and which of them is the vertex
    tet i32[4T]: of a slot;   gradient f32[9][4T]: D_m^-1 [1/m] of its tet
    awake i32[P], awake_count: the patches of bodies that are awake
    """

    def __init__(self, state: State, blocks: int):
        self.state, self.blocks, self._last = state, blocks, TablesOf()
        N = 4 * state.T
        self.max_count = blocks + MAX_BODIES + 16 * state.V // PLACES
        L = self.max_count * PLACES
        g = self._group = FieldGroup()
        self.local, self.slot_begin = (g.scalar(L + 1, dtype=ti.i32) for _ in range(2))
        self.local_begin, self.own_end = (g.scalar(self.max_count + 1, dtype=ti.i32) for _ in range(2))
        self.own_begin, self.others_begin = (g.scalar(self.max_count * COLOR_PLACES, dtype=ti.i32) for _ in range(2))
        self.awake = g.scalar(self.max_count, dtype=ti.i32)
        self.count, self.awake_count = (g.scalar(dtype=ti.i32) for _ in range(2))
        self.words, self.tet = [g.scalar(N, dtype=ti.i32) for _ in range(2)], g.scalar(N, dtype=ti.i32)
        self.gradient = [g.scalar(N) for _ in range(9)]
        g.build()
        self._upload = Upload(
            [
                *(
                    self.local,
                    self.slot_begin,
                    self.local_begin,
                    self.own_end,
                    self.own_begin,
                    self.others_begin,
                    self.count,
                ),
                *self.words,
                self.tet,
            ]
        )
        self.colors = 0
        self._tables: dict | None = None  # those on the device

    def load(self, model: Model) -> None:
        """Take the rest shapes of these bodies."""
        orders = [s.root.once(compact_order) for s in model.shapes]
        order = stacked([o + b for o, b in zip(orders, model.vertex_begin, strict=False)])
        colors = [p.shape.root.once(colors_of, tuple((p.inv_mass == 0.0).tolist())) for p in model.bodies]
        color = stacked(colors)
        if color.max(initial=-1) >= MAX_COLORS:
            raise BadInput(f"a vertex has too many neighbours: {color.max() + 1} colours, the limit is {MAX_COLORS}")
        begin, sizes = model.vertex_begin, (self.blocks, self.max_count)
        t = self._last.get(orders + colors, lambda: divide_by_color(model.tets, order, color, begin, *sizes))
        if t is not self._tables:
            c = t["corners"]
            words = c[:, 0] | c[:, 1] << INDEX_BITS | t["corner"] << (2 * INDEX_BITS), c[:, 2] | c[:, 3] << INDEX_BITS
            local = t["local"], t["slot_begin"], t["local_begin"], t["own_end"]
            colors_begin = t["own_begin"].ravel(), t["others_begin"].ravel()
            self._upload([*local, *colors_begin, [len(t["own_end"])], *words, t["tet"]])
            self.colors, self._tables = t["colors"], t
        if len(t["tet"]):
            inverse = np.concatenate([s.inverse.reshape(-1, 9) for s in model.shapes])
            self._set_gradients(inverse.astype(np.float32), len(t["tet"]))

    @ti.kernel
    def _set_gradients(self, inverse: ti.types.ndarray(ti.f32, 2), slots: ti.i32):
        """D_m^-1 of each slot's tet, from those of all tets (T, 9)."""
        for slot in range(slots):
            for c in ti.static(range(9)):
                self.gradient[c][slot] = inverse[self.tet[slot], c]

    @ti.func
    def list_awake(self):
        """List the patches of bodies that are awake. Outermost level of a kernel."""
        self.awake_count[None] = 0
        for patch in range(self.max_count):
            if patch < self.count[None] and self.state.awake_vertex(self.local[self.local_begin[patch]]):
                self.awake[ti.atomic_add(self.awake_count[None], 1)] = patch

    @ti.func
    def enter(self, patch, r, own, block, colors, points: ti.template(), words: ti.template()):
        """Fetch all of a patch as resident r, by thread `own` of a block of so many."""
        s, begin, at = self.state, self.local_begin[patch], own
        count, lag = self.local_begin[patch + 1] - begin, s.stress_lag[s.body_of_vertex[self.local[begin]]]
        while at < count:
            i, place = self.local[begin + at], r * PLACES + at
            words[VERTEX + place] = ti.bit_cast(i, ti.f32)
            words[SLOT + place] = ti.bit_cast(self.slot_begin[begin + at], ti.f32)
            self.put(place, s.x[i], s.strain_increment(i, lag), points)
            at += block
        if own == 0:
            b = s.body_of_vertex[self.local[begin]]
            words[MU + r], words[LAM + r], words[LAG + r] = s.mu[b], s.lam[b], lag
            words[COUNT + r] = ti.bit_cast(count, ti.f32)
            mine = self.own_end[patch] - begin  # the end of the last own vertex's slots
            words[SLOT + r * PLACES + mine] = ti.bit_cast(self.slot_begin[begin + mine], ti.f32)
        at = own
        while at <= colors:
            k = patch * COLOR_PLACES + at
            words[OWN + r * COLOR_PLACES + at] = ti.bit_cast(self.own_begin[k], ti.f32)
            words[OTHERS + r * COLOR_PLACES + at] = ti.bit_cast(self.others_begin[k], ti.f32)
            at += block

    @ti.func
    def count_of(self, r, words: ti.template()):
        """Number of vertices of resident patch r, own ones and others."""
        return ti.bit_cast(words[COUNT + r], ti.i32)

    @ti.func
    def color_range(self, first: ti.template(), r, color, words: ti.template()):
        """Vertices of a colour of resident patch r: the first one's place, and the end; `first` is OWN or OTHERS."""
        at = first + r * COLOR_PLACES + color
        return r * PLACES + ti.bit_cast(words[at], ti.i32), r * PLACES + ti.bit_cast(words[at + 1], ti.i32)

    @ti.func
    def stage(self, at, r, points: ti.template(), words: ti.template()):
        """Copy the position in the substep in progress of the vertex at this place of resident patch r."""
        i = self.vertex(at, words)
        self.put(at, self.state.x[i], self.state.strain_increment(i, words[LAG + r]), points)

    @ti.func
    def put(self, at, x, d, points: ti.template()):
        """Show the others of the patch that the vertex at this place is at x + d [m], where its stress is evaluated."""
        for c in ti.static(range(3)):
            points[c * ALL_PLACES + at] = ti.cast(x[c], ti.f64) + ti.cast(d[c], ti.f64)

    @ti.func
    def vertex(self, at, words: ti.template()):
        """Index of the vertex at this place."""
        return ti.bit_cast(words[VERTEX + at], ti.i32)

    @ti.func
    def slot(self, at, words: ti.template()):
        """First slot of the own vertex at this place; that of the next one is its end."""
        return ti.bit_cast(words[SLOT + at], ti.i32)

    @ti.func
    def terms(self, slot, r, mu, lam, points: ti.template()):
        """`tet_terms` of a slot's tet for its vertex in resident patch r, and V lam."""
        w0, w1 = self.words[0][slot], self.words[1][slot]
        R = ti.static(self.gradient)
        B = ti.Matrix([[R[3 * r + c][slot] for c in range(3)] for r in range(3)])
        first, mask = r * PLACES, ti.static((1 << INDEX_BITS) - 1)
        x0, x1 = self._at(first + (w0 & mask), points), self._at(first + ((w0 >> INDEX_BITS) & mask), points)
        x2, x3 = self._at(first + (w1 & mask), points), self._at(first + ((w1 >> INDEX_BITS) & mask), points)
        V = 1.0 / (6.0 * B.determinant())
        f, a, c, dJ = tet_terms(x1 - x0, x2 - x0, x3 - x0, B, (w0 >> (2 * INDEX_BITS)) & 3, V, mu, lam)
        return f, a, c, dJ, V * lam

    @ti.func
    def _at(self, at, points: ti.template()):
        return ti.Vector([points[at], points[at + ALL_PLACES], points[at + 2 * ALL_PLACES]])

    def destroy(self) -> None:
        self._group.destroy()


def divide_by_color(
    tets: np.ndarray, order: np.ndarray, color: np.ndarray, body_begin: np.ndarray, blocks: int, most: int
) -> dict:
    """Divide each body's vertices into patches that fit, about equal ones, and those of each by colour, -1 first.

    order (V,) of the vertices, in which each body's begin at body_begin (B+1,); color (V,). There are `blocks` patches
    or the least multiple of that, or somewhat fewer; `most` at most (else BadInput).
    Returns colors, their number; local: vertices of the patches,
    own ones first; local_begin (P+1,), own_end (P,) in it; own_begin, others_begin (P, COLOR_PLACES): of each colour,
    from a patch's first vertex on; slot_begin: of each own vertex, at its place in `local`, and one more;
    of each slot: tet, corner: which of its corners is the vertex; corners (4T, 4): their indices in the patch.
    """
    least = blocks * -(-len(order) // (blocks * PLACES))
    for total in range(max(least, blocks), most + 1, blocks):
        begin = patch_begins(np.asarray(body_begin), total)
        tables = None if begin is None else _divided(tets, order, color, begin)
        if tables is not None:
            return tables
    raise BadInput(f"{len(order)} vertices, whose neighbours are too far apart, make patches too large for this GPU")


def patch_begins(body_begin: np.ndarray, total: int) -> np.ndarray | None:
    """First vertex of each patch (P+1,), at most `total` patches of bodies from body_begin (B+1,) on; None: too few."""
    sizes = np.diff(body_begin)

    def counts(size: int) -> np.ndarray:
        return -(-sizes // size)

    size = 1 + bisect_left(range(1, int(sizes.max(initial=1)) + 1), True, key=lambda q: counts(q).sum() <= total)
    if counts(size).sum() > total:
        return None
    ranges = zip(body_begin[:-1], body_begin[1:], counts(size), strict=True)
    parts = [np.linspace(a, b, n + 1).astype(np.int64)[:-1] for a, b, n in ranges]
    return np.concatenate([*parts, body_begin[-1:]]).astype(np.int64)


def _divided(tets: np.ndarray, order: np.ndarray, color: np.ndarray, begin: np.ndarray) -> dict | None:
    """The tables of `divide_by_color` for patches from `begin` (P+1,) on; None if one has PLACES vertices or more."""
    n, blocks = len(order), len(begin) - 1
    patch_at = np.repeat(np.arange(blocks), np.diff(begin))
    order = order[np.lexsort((color[order], patch_at))]
    place = np.empty(n, np.int64)
    place[order] = np.arange(n)
    by_vertex = np.argsort(place[tets].ravel(), kind="stable")  # slots: corners in the order of their vertices
    tet, corner = by_vertex // 4, by_vertex % 4
    ends = np.r_[0, np.cumsum(np.bincount(place[tets].ravel(), minlength=n))]
    owner = patch_at[place[tets[tet, corner]]] if len(tet) else np.zeros(0, np.int64)
    at = place[tets[tet]]
    own = patch_at[at] == owner[:, None]
    by_color = (owner[:, None] * COLOR_PLACES + color[order][at] + 1) * n + at
    outside, index = np.unique(by_color[~own], return_inverse=True)
    of, outside_color, outside = outside // (COLOR_PLACES * n), outside // n % COLOR_PLACES, outside % n
    outside_begin = np.searchsorted(of, np.arange(blocks + 1))
    sizes = np.diff(begin) + np.diff(outside_begin)
    if sizes.max(initial=0) >= PLACES:
        return None
    local_begin = np.r_[0, np.cumsum(sizes)]
    own_end = local_begin[:-1] + np.diff(begin)
    local, slot_begin = np.zeros(local_begin[-1], np.int64), np.zeros(local_begin[-1] + 1, np.int64)
    mine = np.arange(n) - begin[patch_at] + local_begin[patch_at]
    local[mine], slot_begin[mine] = order, ends[:-1]
    slot_begin[own_end] = ends[begin[1:]]  # the place after a patch's last own vertex
    theirs = np.arange(len(outside)) - outside_begin[of] + own_end[of]
    local[theirs] = order[outside]
    corners = at - begin[owner][:, None]
    corners[~own] = (theirs - local_begin[of])[index]
    counts, others = (np.zeros((blocks, COLOR_PLACES), np.int64) for _ in range(2))  # of colour -1 first
    np.add.at(counts, (patch_at, color[order] + 1), 1)
    np.add.at(others, (of, outside_color), 1)
    return {
        "colors": int(color.max(initial=-1)) + 1,
        "local": local,
        "local_begin": local_begin,
        "own_end": own_end,
        "own_begin": np.cumsum(counts, axis=1),
        "others_begin": np.cumsum(others, axis=1) + (own_end - local_begin[:-1])[:, None],
        "slot_begin": slot_begin,
        "tet": tet,
        "corner": corner,
        "corners": corners,
    }
