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
PLACES = 272  # for vertices of a patch, own ones and others
INDEX_BITS = 9
ALL_PLACES = RESIDENT * PLACES
VERTEX, SLOT, MU, LAM, LAG = range(0, 5 * ALL_PLACES, ALL_PLACES)  # words, for each place
COUNT = 5 * ALL_PLACES  # words: vertices of each resident patch
COLOR = COUNT + RESIDENT  # words: begin of each colour of each resident patch, COLOR_PLACES each
COLOR_PLACES = MAX_COLORS + 1
POINTS, WORDS = 3 * ALL_PLACES, COLOR + RESIDENT * COLOR_PLACES
VERTEX_BITS = 24  # of its index; its colour, plus one, in the others
assert PLACES <= 1 << INDEX_BITS and 8 * POINTS + 4 * WORDS <= 48 << 10 and MAX_COLORS < 1 << 7


@ti.data_oriented
class ColorPatches:
    """Tables of the patches. Fields over slots are one scalar each. Place `at` of vertex k of resident patch r is
    r PLACES + k.

    local i32[]: vertices of each patch, its own ones by colour first, local_begin i32[P+1], own_end i32[P] in it
    color_begin i32[P,COLOR_PLACES]: first own vertex of each colour, from the patch's first one on
    slot_begin i32[]: first slot of each own vertex, at its place in `local`;   color i32[]: of each vertex of `local`
    words i32[2][4T]: indices of a slot's corners in the patch, INDEX_BITS each, and which of them is the vertex
    gradient f32[9][4T]: D_m^-1 [1/m] of its tet
    awake i32[P], awake_count: the patches of bodies that are awake
    """

    def __init__(self, state: State, blocks: int):
        self.state, self.blocks, self._last = state, blocks, TablesOf()
        N = 4 * state.T
        self.max_count = blocks + MAX_BODIES + 16 * state.V // PLACES
        L = self.max_count * PLACES
        g = self._group = FieldGroup()
        self.local, self.slot_begin, self.color = (g.scalar(L + 1, dtype=ti.i32) for _ in range(3))
        self.local_begin, self.own_end = (g.scalar(self.max_count + 1, dtype=ti.i32) for _ in range(2))
        self.color_begin = g.scalar(self.max_count * COLOR_PLACES, dtype=ti.i32)
        self.awake = g.scalar(self.max_count, dtype=ti.i32)
        self.count, self.awake_count = (g.scalar(dtype=ti.i32) for _ in range(2))
        self.words = [g.scalar(N, dtype=ti.i32) for _ in range(2)]
        self.gradient = [g.scalar(N) for _ in range(9)]
        g.build()
        self._upload = Upload(
            [
                *(
                    self.local,
                    self.slot_begin,
                    self.color,
                    self.local_begin,
                    self.own_end,
                    self.color_begin,
                    self.count,
                ),
                *(*self.words, *self.gradient),
            ]
        )
        self.colors = 0

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
        gradients = stacked([s.inverse.reshape(-1, 9) for s in model.shapes], 9)[t["tet"]]
        c = t["corners"]
        words = c[:, 0] | c[:, 1] << INDEX_BITS | t["corner"] << (2 * INDEX_BITS), c[:, 2] | c[:, 3] << INDEX_BITS
        local = t["local"], t["slot_begin"], t["color"], t["local_begin"], t["own_end"], t["color_begin"].ravel()
        self._upload([*local, [len(t["own_end"])], *words, *gradients.T])
        self.colors = t["colors"]

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
        begin, at = self.local_begin[patch], own
        count, mine = self.local_begin[patch + 1] - begin, self.own_end[patch] - begin
        while at < count:
            self.stage_constants(begin + at, r * PLACES + at, words)
            self.stage(r * PLACES + at, points, words)
            at += block
        if own == 0:
            words[COUNT + r] = ti.bit_cast(count, ti.f32)
            self.set_slot(r * PLACES + mine, self.slot_begin[begin + mine], words)
        at = own
        while at <= colors:
            color_begin = self.color_begin[patch * COLOR_PLACES + at]
            words[COLOR + r * COLOR_PLACES + at] = ti.bit_cast(color_begin, ti.f32)
            at += block

    @ti.func
    def count_of(self, r, words: ti.template()):
        """Number of vertices of resident patch r, own ones and others."""
        return ti.bit_cast(words[COUNT + r], ti.i32)

    @ti.func
    def color_range(self, r, color, words: ti.template()):
        """Own vertices of a colour of resident patch r: the first one's place, and the end."""
        at = COLOR + r * COLOR_PLACES + color
        return r * PLACES + ti.bit_cast(words[at], ti.i32), r * PLACES + ti.bit_cast(words[at + 1], ti.i32)

    @ti.func
    def stage_constants(self, k, at, words: ti.template()):
        """Copy what does not change of vertex local[k] to place `at`."""
        s, i = self.state, self.local[k]
        b = s.body_of_vertex[i]
        words[VERTEX + at] = ti.bit_cast(i | (self.color[k] + 1) << VERTEX_BITS, ti.f32)
        self.set_slot(at, self.slot_begin[k], words)
        words[MU + at], words[LAM + at], words[LAG + at] = s.mu[b], s.lam[b], s.stress_lag[b]

    @ti.func
    def stage(self, at, points: ti.template(), words: ti.template()):
        """Copy the position in the substep in progress of the vertex at this place."""
        i = self.vertex(at, words)
        self.put(at, self.state.x[i], self.state.strain_increment(i, words[LAG + at]), points)

    @ti.func
    def put(self, at, x, d, points: ti.template()):
        """Show the others of the patch that the vertex at this place is at x + d [m], where its stress is evaluated."""
        for c in ti.static(range(3)):
            points[c * ALL_PLACES + at] = ti.cast(x[c], ti.f64) + ti.cast(d[c], ti.f64)

    @ti.func
    def vertex(self, at, words: ti.template()):
        """Index of the vertex at this place."""
        return ti.bit_cast(words[VERTEX + at], ti.i32) & ((1 << VERTEX_BITS) - 1)

    @ti.func
    def color_of(self, at, words: ti.template()):
        """Colour of the vertex at this place, -1 if it does not move."""
        return (ti.bit_cast(words[VERTEX + at], ti.i32) >> VERTEX_BITS) - 1

    @ti.func
    def set_slot(self, at, slot, words: ti.template()):
        words[SLOT + at] = ti.bit_cast(slot, ti.f32)

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
    own ones first; local_begin (P+1,), own_end (P,) in it; color: of each of `local`; color_begin (P, COLOR_PLACES):
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
    return np.r_[np.concatenate(parts), body_begin[-1]].astype(np.int64)


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
    outside, index = np.unique((owner[:, None] * n + at)[~own], return_inverse=True)
    outside_begin = np.searchsorted(outside, np.arange(blocks + 1) * n)
    sizes = np.diff(begin) + np.diff(outside_begin)
    if sizes.max(initial=0) >= PLACES:
        return None
    local_begin = np.r_[0, np.cumsum(sizes)]
    own_end = local_begin[:-1] + np.diff(begin)
    local, slot_begin = np.zeros(local_begin[-1], np.int64), np.zeros(local_begin[-1] + 1, np.int64)
    mine = np.arange(n) - begin[patch_at] + local_begin[patch_at]
    local[mine], slot_begin[mine] = order, ends[:-1]
    slot_begin[own_end] = ends[begin[1:]]  # the place after a patch's last own vertex
    of = outside // n
    theirs = np.arange(len(outside)) - outside_begin[of] + own_end[of]
    local[theirs] = order[outside % n]
    corners = at - begin[owner][:, None]
    corners[~own] = (theirs - local_begin[of])[index]
    color_begin = np.zeros((blocks, COLOR_PLACES), np.int64)
    counts = np.zeros((blocks, COLOR_PLACES), np.int64)
    np.add.at(counts, (patch_at, color[order] + 1), 1)
    color_begin[:] = np.cumsum(counts, axis=1)  # those of colour -1 come before the first
    return {
        "colors": int(color.max(initial=-1)) + 1,
        "local": local,
        "local_begin": local_begin,
        "own_end": own_end,
        "color": color[local],
        "color_begin": color_begin,
        "slot_begin": slot_begin,
        "tet": tet,
        "corner": corner,
        "corners": corners,
    }
