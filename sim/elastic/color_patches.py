"""Patches for the descent of vertices: the vertices of each block of threads by colour, with the tets of each.

A block keeps its vertices, and those that share a tet with them, in shared memory for many substeps, and after each
colour fetches only the others of that colour, which other blocks have moved.
"""

import numpy as np
import taichi as ti

from core.errors import BadInput
from core.fields import FieldGroup, Upload
from sim.capacity import stacked
from sim.elastic.patches import TablesOf, compact_order
from sim.elastic.vbd import MAX_COLORS, colors_of, tet_terms
from sim.model import Model
from sim.state import State

# 48 KB of shared memory, as much as every block may have: x + dx in double precision, and words
MAX_LOCAL = 1088  # vertices of a patch, own ones and others
INDEX_BITS = 11
VERTEX, SLOT, MU, LAM, LAG = range(0, 5 * MAX_LOCAL, MAX_LOCAL)  # words; mu is -1 asleep
COLOR = 5 * MAX_LOCAL  # words: begin of each colour
POINTS, WORDS = 3 * MAX_LOCAL, COLOR + MAX_COLORS + 1
VERTEX_BITS = 24  # of its index; its colour, plus one, in the others
assert MAX_LOCAL <= 1 << INDEX_BITS and 8 * POINTS + 4 * WORDS <= 48 << 10 and MAX_COLORS < 1 << 7


@ti.data_oriented
class ColorPatches:
    """Tables of the patches, one for each block, or several. Fields over slots are one scalar each.

    local i32[]: vertices of each patch, its own ones by colour first, local_begin i32[P+1], own_end i32[P] in it
    color_begin i32[P,MAX_COLORS+1]: first own vertex of each colour, from the patch's first one on
    slot_begin i32[]: first slot of each own vertex, at its place in `local`;   color i32[]: of each vertex of `local`
    words i32[2][4T]: indices of a slot's corners in the patch, INDEX_BITS each, and which of them is the vertex
    gradient f32[9][4T]: D_m^-1 [1/m] of its tet
    """

    def __init__(self, state: State, blocks: int):
        self.state, self.blocks, self._last = state, blocks, TablesOf()
        N = 4 * state.T
        self.max_count = blocks * (1 + 4 * state.V // (blocks * MAX_LOCAL))
        L = self.max_count * MAX_LOCAL
        g = self._group = FieldGroup()
        self.local, self.slot_begin, self.color = (g.scalar(L + 1, dtype=ti.i32) for _ in range(3))
        self.local_begin, self.own_end = (g.scalar(self.max_count + 1, dtype=ti.i32) for _ in range(2))
        self.color_begin = g.scalar(self.max_count * (MAX_COLORS + 1), dtype=ti.i32)
        self.count = g.scalar(dtype=ti.i32)
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
        most = self.max_count
        t = self._last.get(orders + colors, lambda: divide_by_color(model.tets, order, color, self.blocks, most))
        gradients = stacked([s.inverse.reshape(-1, 9) for s in model.shapes], 9)[t["tet"]]
        c = t["corners"]
        words = c[:, 0] | c[:, 1] << INDEX_BITS | t["corner"] << (2 * INDEX_BITS), c[:, 2] | c[:, 3] << INDEX_BITS
        local = t["local"], t["slot_begin"], t["color"], t["local_begin"], t["own_end"], t["color_begin"].ravel()
        self._upload([*local, [len(t["own_end"])], *words, *gradients.T])
        self.colors = t["colors"]

    @ti.func
    def stage_constants(self, k, first, words: ti.template()):
        """Copy what does not change of vertex local[k] of the patch that begins at `first`."""
        s, i = self.state, self.local[k]
        b, at = s.body_of_vertex[i], k - first
        words[VERTEX + at] = ti.bit_cast(i | (self.color[k] + 1) << VERTEX_BITS, ti.f32)
        self.set_slot(at, self.slot_begin[k], words)
        words[MU + at], words[LAM + at], words[LAG + at] = s.mu[b], s.lam[b], s.stress_lag[b]
        if s.asleep[b]:
            words[MU + at] = -1.0

    @ti.func
    def stage(self, at, points: ti.template(), words: ti.template()):
        """Copy the position in the substep in progress of the patch's vertex `at`."""
        i = self.vertex(at, words)
        self.put(at, self.state.x[i], self.state.strain_increment(i, words[LAG + at]), points)

    @ti.func
    def put(self, at, x, d, points: ti.template()):
        """Show the other vertices of the patch that its vertex `at` is at x + d [m], where its stress is evaluated."""
        for c in ti.static(range(3)):
            points[c * MAX_LOCAL + at] = ti.cast(x[c], ti.f64) + ti.cast(d[c], ti.f64)

    @ti.func
    def vertex(self, at, words: ti.template()):
        """Index of the patch's vertex `at`."""
        return ti.bit_cast(words[VERTEX + at], ti.i32) & ((1 << VERTEX_BITS) - 1)

    @ti.func
    def color_of(self, at, words: ti.template()):
        """Colour of the patch's vertex `at`, -1 if it does not move."""
        return (ti.bit_cast(words[VERTEX + at], ti.i32) >> VERTEX_BITS) - 1

    @ti.func
    def set_slot(self, at, slot, words: ti.template()):
        words[SLOT + at] = ti.bit_cast(slot, ti.f32)

    @ti.func
    def slot(self, at, words: ti.template()):
        """First slot of own vertex `at`; that of the next one is its end."""
        return ti.bit_cast(words[SLOT + at], ti.i32)

    @ti.func
    def terms(self, slot, mu, lam, points: ti.template()):
        """`tet_terms` of a slot's tet for its vertex, and V lam."""
        w0, w1 = self.words[0][slot], self.words[1][slot]
        R = ti.static(self.gradient)
        B = ti.Matrix([[R[3 * r + c][slot] for c in range(3)] for r in range(3)])
        mask = ti.static((1 << INDEX_BITS) - 1)
        x0, x1 = self._at(w0 & mask, points), self._at((w0 >> INDEX_BITS) & mask, points)
        x2, x3 = self._at(w1 & mask, points), self._at((w1 >> INDEX_BITS) & mask, points)
        V = 1.0 / (6.0 * B.determinant())
        f, a, c, dJ = tet_terms(x1 - x0, x2 - x0, x3 - x0, B, (w0 >> (2 * INDEX_BITS)) & 3, V, mu, lam)
        return f, a, c, dJ, V * lam

    @ti.func
    def _at(self, at, points: ti.template()):
        return ti.Vector([points[at], points[at + MAX_LOCAL], points[at + 2 * MAX_LOCAL]])

    def destroy(self) -> None:
        self._group.destroy()


def divide_by_color(tets: np.ndarray, order: np.ndarray, color: np.ndarray, blocks: int, most: int) -> dict:
    """Divide vertices in this order (V,) into the fewest equal patches that fit, and those of each by colour, -1 first.

    The number of patches is a multiple of `blocks`, `most` at most (else BadInput); color (V,).
    Returns colors, their number; local: vertices of the patches,
    own ones first; local_begin (P+1,), own_end (P,) in it; color: of each of `local`; color_begin (P, MAX_COLORS+1):
    from a patch's first vertex on; slot_begin: of each own vertex, at its place in `local`, and one more;
    of each slot: tet, corner: which of its corners is the vertex; corners (4T, 4): their indices in the patch.
    """
    for patches in range(blocks, most + 1, blocks):
        tables = _divided(tets, order, color, patches)
        if tables is not None:
            return tables
    raise BadInput(f"{len(order)} vertices, whose neighbours are too far apart, make patches too large for this GPU")


def _divided(tets, order, color, blocks) -> dict | None:
    """The tables of `divide_by_color` for this number of patches; None if one has MAX_LOCAL vertices or more."""
    n = len(order)
    begin = np.linspace(0, n, blocks + 1).astype(np.int64)
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
    if sizes.max(initial=0) >= MAX_LOCAL:
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
    color_begin = np.zeros((blocks, MAX_COLORS + 1), np.int64)
    counts = np.zeros((blocks, MAX_COLORS + 1), np.int64)
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
