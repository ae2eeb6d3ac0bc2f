"""Patches: the vertices divided into compact groups, one for each block of threads, with all tets that touch a group.

A block copies the vertices of its patch, and those just outside that its tets need, to shared memory, and sums the
corrections of its own vertices there: random reads of global memory cost more than the arithmetic. A tet at a border
belongs to several patches and is projected by each of them, from the same numbers in the same order, so that the
corrections of its corners cancel to the bit: otherwise rounding would push the whole body.

For the descent of vertices (ColorPatches) the vertices of a patch are of one body, by colour, with the tets of each
vertex. A block takes some patches of bodies that are awake, keeps their vertices in shared memory for many substeps,
and after each colour fetches only the others of that colour, which other blocks have moved.
"""

from bisect import bisect_left
from collections.abc import Callable

import numpy as np
import taichi as ti

from core.errors import BadInput
from core.fields import FieldGroup, Upload
from sim.elastic.energy import CRUSHED_DJ, STRETCHED_I1, Elasticity, row, shortened_step, stress
from sim.elastic.vbd import MAX_COLORS, body_colors, tet_terms
from sim.model import MAX_BODIES, Model, RestShape, stacked
from sim.state import State

# 48 KB of shared memory, as much as every block may have: x and dx of a patch's vertices, and its slots
MAX_LOCAL = 512  # vertices of a patch, own ones and others
MAX_SLOTS = 3072  # corners of a patch's own vertices
SHARED_WORDS = 6 * MAX_LOCAL + 3 * MAX_SLOTS
SLOT_BITS = 12  # of the slot of a corner
NO_SLOT = (1 << SLOT_BITS) - 1  # of a corner that is another patch's vertex
LEAF = 8  # vertices that `compact_order` leaves as they are
assert MAX_SLOTS <= NO_SLOT and MAX_BODIES <= 1 << (32 - 2 * SLOT_BITS)


@ti.data_oriented
class RestShapes:
    """Copies of the rest shapes of the tets that patches hold: `gradient` of `tet`, by `elasticity`."""

    @ti.kernel
    def take_rest_shapes(self):
        """D_m^-1 of the tets as plastic flow has left them."""
        for k in self.tet:
            B = self.elasticity.rest_inverse[self.tet[k]]
            for c in ti.static(range(9)):
                self.gradient[c][k] = B[c // 3, c % 3]


@ti.data_oriented
class Patches(RestShapes):
    """Tables of the patches. Fields over tets of patches are one scalar each: neighbouring threads read neighbours.

    local i32[]: vertices of each patch, its own ones first, local_begin i32[P+1]; own_end i32[P] in `local`
    slot_begin, slot_end i32[]: slots of each own vertex, at its place in `local`
    tet_begin i32[P+1]: range of the tets of each patch
    corners i32[2][N]: four indices into the patch's vertices, 16 bits each
    slots i32[2][N]: four slots of SLOT_BITS, and the body in the first word's highest bits
    gradient f32[9][N] [1/m] = D_m^-1, tet i32[N]: index of each of these tets
    published vec4[2,V,3]: of each vertex in even and in odd substeps, x, the increment at which its stress is
    evaluated, and dx [m]; vec4, so that one load fetches each
    """

    def __init__(self, state: State, elasticity: Elasticity, blocks: int):
        """For this many blocks that run at once."""
        self.state, self.elasticity, self.blocks, self._last = state, elasticity, blocks, TablesOf()
        N, V = 4 * state.T, state.V
        self.max_count = max(V, blocks)
        g = self._group = FieldGroup()
        self.local, self.slot_begin, self.slot_end = (g.scalar(V + N, dtype=ti.i32) for _ in range(3))
        self.local_begin = g.scalar(self.max_count + 1, dtype=ti.i32)
        self.own_end = g.scalar(self.max_count, dtype=ti.i32)
        self.tet_begin = g.scalar(self.max_count + 1, dtype=ti.i32)
        self.count = g.scalar(dtype=ti.i32)
        self.corners = [g.scalar(N, dtype=ti.i32) for _ in range(2)]
        self.slots = [g.scalar(N, dtype=ti.i32) for _ in range(2)]
        self.gradient = [g.scalar(N) for _ in range(9)]
        self.tet = g.scalar(N, dtype=ti.i32)
        self.published = g.vector(2, V, 3, n=4)
        g.build()
        patches = [self.local, self.slot_begin, self.slot_end, self.local_begin, self.own_end, self.tet_begin]
        self._upload = Upload([*patches, self.count, *self.corners, *self.slots, self.tet])

    def load(self, model: Model) -> None:
        """Take the rest shapes of these bodies."""
        orders = [s.root.once(compact_order) for s in model.shapes]
        order = stacked([o + b for o, b in zip(orders, model.vertex_begin, strict=False)])
        t = self._last.get(orders, lambda: divide(model.tets, order, self.blocks))
        tets, corner = t["tet"], t["corner"]
        body = np.repeat(np.arange(len(model.shapes)), np.diff(model.tet_begin))[tets]
        slot = np.where(t["slot"] < 0, NO_SLOT, t["slot"])
        corners = corner[:, 0] | corner[:, 1] << 16, corner[:, 2] | corner[:, 3] << 16
        slots = slot[:, 0] | slot[:, 1] << SLOT_BITS | body << (2 * SLOT_BITS), slot[:, 2] | slot[:, 3] << SLOT_BITS
        words = (w.astype(np.uint32).view(np.int32) for w in (*corners, *slots))
        local = t["local"], t["slot_begin"], t["slot_end"], t["local_begin"], t["own_end"], t["tet_begin"]
        self._upload([*local, [len(t["own_end"])], *words, tets])
        self.take_rest_shapes()

    @ti.func
    def publish(self, i, x, v, dx, parity):
        """Show the neighbours of vertex i its position, velocity and increment, in substeps of this parity."""
        d = self.state.lagging(dx, v, self.state.stress_lag[self.state.body_of_vertex[i]])
        self.published[parity, i, 0] = ti.Vector([x.x, x.y, x.z, 0.0])
        self.published[parity, i, 1] = ti.Vector([d.x, d.y, d.z, 0.0])
        self.published[parity, i, 2] = ti.Vector([dx.x, dx.y, dx.z, 0.0])

    @ti.func
    def stage(self, k, first, parity, shared: ti.template()):
        """Copy vertex `local[k]` of the patch whose vertices begin at `first` to shared memory."""
        i = self.local[k]
        x, d = self.published[parity, i, 0], self.published[parity, i, 1]
        for c in ti.static(range(3)):
            shared[c * MAX_LOCAL + k - first] = x[c]
            shared[(3 + c) * MAX_LOCAL + k - first] = d[c]

    @ti.func
    def project(self, k, parity, shared: ti.template()):
        """Write the corrections (without the inverse mass) of patch tet k to the slots of its patch's own corners.

        The step is that of Elasticity.project_tet.
        """
        s = self.state
        R = ti.static(self.gradient)
        B = ti.Matrix([[R[3 * r + c][k] for c in range(3)] for r in range(3)])
        low, high = self.corners[0][k], self.corners[1][k]
        packed, packed_2 = self.slots[0][k], self.slots[1][k]
        a = ti.Vector([low & 0xFFFF, (low >> 16) & 0xFFFF, high & 0xFFFF, (high >> 16) & 0xFFFF])
        body = (packed >> (2 * SLOT_BITS)) & ((1 << (32 - 2 * SLOT_BITS)) - 1)
        x0, d0 = self._triple(a[0], shared), self._triple(a[0] + 3 * MAX_LOCAL, shared)
        d1, d2 = self._triple(a[1] + 3 * MAX_LOCAL, shared), self._triple(a[2] + 3 * MAX_LOCAL, shared)
        d3 = self._triple(a[3] + 3 * MAX_LOCAL, shared)
        e1 = (self._triple(a[1], shared) - x0) + (d1 - d0)
        e2 = (self._triple(a[2], shared) - x0) + (d2 - d0)
        e3 = (self._triple(a[3], shared) - x0) + (d3 - d0)
        g1, g2, g3 = row(B, 0), row(B, 1), row(B, 2)
        mu, lam = s.mu[body], s.lam[body]
        V = 1.0 / (6.0 * g1.dot(g2.cross(g3)))
        F = e1.outer_product(g1) + e2.outer_product(g2) + e3.outer_product(g3)
        P, I1, dJ = stress(F, mu, lam)
        dt2 = s.dt[None] * s.dt[None]
        step = V * dt2
        h1, h2, h3 = P @ g1, P @ g2, P @ g3
        h0 = -(h1 + h2 + h3)
        if I1 > STRETCHED_I1 or dJ < CRUSHED_DJ:
            if dJ < -1.0 and not s.asleep[body]:
                s.inverted[body] = 1
            t = self.tet[k]
            v = s.tets[t]
            w = ti.Vector([s.inv_mass[v[0]], s.inv_mass[v[1]], s.inv_mass[v[2]], s.inv_mass[v[3]]])
            g0 = -(g1 + g2 + g3)
            g = ti.static([g0, g1, g2, g3])
            h = ti.static([h0, h1, h2, h3])
            W, motion = 0.0, 0.0
            for c in ti.static(range(4)):
                dx = self.published[parity, v[c], 2]
                W += w[c] * h[c].norm_sqr()
                motion += h[c].dot(ti.Vector([dx.x, dx.y, dx.z]))
            step = shortened_step(F, g, w, W, motion, V, I1, dJ, self.elasticity.kappa[t], mu, lam, dt2)
        self._put(packed & NO_SLOT, -step * h0, shared)
        self._put((packed >> SLOT_BITS) & NO_SLOT, -step * h1, shared)
        self._put(packed_2 & NO_SLOT, -step * h2, shared)
        self._put((packed_2 >> SLOT_BITS) & NO_SLOT, -step * h3, shared)

    @ti.func
    def _triple(self, at, shared: ti.template()):
        return ti.Vector([shared[at], shared[at + MAX_LOCAL], shared[at + 2 * MAX_LOCAL]])

    @ti.func
    def _put(self, slot, d, shared: ti.template()):
        if slot < NO_SLOT:
            for c in ti.static(range(3)):
                shared[6 * MAX_LOCAL + c * MAX_SLOTS + slot] = d[c]

    @ti.func
    def gather(self, k, shared: ti.template()):
        """Sum the slots of own vertex local[k]."""
        total = ti.Vector([0.0, 0.0, 0.0])
        for slot in range(self.slot_begin[k], self.slot_end[k]):
            for c in ti.static(range(3)):
                total[c] += shared[6 * MAX_LOCAL + c * MAX_SLOTS + slot]
        return total


class TablesOf:
    """The tables of the last bodies, kept while the bodies' arrays are the same objects: a scaled body has those of the
    unscaled one, and dividing a scene takes a tenth of a second and more."""

    def __init__(self):
        self._arrays: list[np.ndarray] = []
        self._tables: dict | None = None

    def get(self, arrays: list[np.ndarray], divide: Callable[[], dict]) -> dict:
        """The tables that `divide` makes of these arrays of all bodies in turn."""
        same = len(arrays) == len(self._arrays) and all(a is b for a, b in zip(arrays, self._arrays, strict=True))
        if self._tables is None or not same:
            self._tables = divide()
            self._arrays = list(arrays)
        return self._tables


def compact_order(shape: RestShape) -> np.ndarray:
    """Order of a shape's vertices (V,) in which every run is a compact region: halved again and again."""
    x, order = shape.vertices, np.arange(len(shape.vertices))
    todo = [(0, len(order))]
    while todo:
        a, b = todo.pop()
        if b - a > LEAF:
            at = x[order[a:b]]
            axis, middle = int(np.argmax(np.ptp(at, axis=0))), (b - a) // 2
            order[a:b] = order[a:b][np.argpartition(at[:, axis], middle)]
            todo += [(a, a + middle), (a + middle, b)]
    return order


def divide(tets: np.ndarray, order: np.ndarray, blocks: int) -> dict[str, np.ndarray]:
    """Divide vertices in this order (V,) into the fewest equal patches, a multiple of `blocks`, that fit.

    Returns, for P patches: local: vertices of the patches, own ones first; local_begin (P+1,), own_end (P,) in it;
    slot_begin, slot_end: slots of each own vertex, at its place in `local`; tet_begin (P+1,): begin of each patch in
    tet (N,): tets of the patches; corner (N, 4): index of each corner among its patch's vertices; slot (N, 4): of each
    corner in its patch, -1 if the vertex belongs to another one.
    """
    n = len(order)
    for rounds in range(1, max(n // blocks, 1) + 1):
        tables = _divided(tets, order, np.linspace(0, n, blocks * rounds + 1).astype(np.int64))
        if tables is not None:
            return tables
    raise BadInput(f"a vertex has too many neighbours: more than {MAX_SLOTS} tetrahedra meet in it")


def _divided(tets, order, begin) -> dict[str, np.ndarray] | None:
    """The tables of `divide` for these ranges of `order`; None if a patch would be too large."""
    n = len(order)
    corner_place = np.argsort(order)[tets]  # (T, 4)
    ends = np.r_[0, np.cumsum(np.bincount(corner_place.ravel(), minlength=n))]
    if np.diff(ends[begin]).max(initial=0) > MAX_SLOTS:
        return None
    patch_of = np.repeat(np.arange(len(begin) - 1), np.diff(begin))
    patch = patch_of[corner_place]
    first = np.ones(patch.shape, bool)  # corners that are the first of their tet in their patch
    for c in range(1, 4):
        for d in range(c):
            first[:, c] &= patch[:, c] != patch[:, d]
    t, c = np.nonzero(first)
    by_patch = np.argsort(patch[t, c], kind="stable")
    t, owner = t[by_patch], patch[t, c][by_patch]
    tables = local_tables(order, begin, owner, corner_place[t], np.arange(n), MAX_LOCAL)
    if tables is None:
        return None
    slot_begin, slot_end = (np.zeros(len(tables["local"]), np.int64) for _ in range(2))
    start, mine = ends[begin[patch_of]], tables["mine"]
    slot_begin[mine], slot_end[mine] = ends[:-1] - start, ends[1:] - start
    rank = np.argsort(np.argsort(corner_place.ravel(), kind="stable"))  # of each corner, by the place of its vertex
    slot = np.where(patch[t] == owner[:, None], rank.reshape(-1, 4)[t] - ends[begin[owner]][:, None], -1)
    tet_begin = np.searchsorted(owner, np.arange(len(begin)))
    return {**tables, "slot_begin": slot_begin, "slot_end": slot_end, "tet_begin": tet_begin, "tet": t, "slot": slot}


def local_tables(order, begin, owner, corner_place, rank, most: int) -> dict[str, np.ndarray] | None:
    """Vertices of patches that own the ranges of `order` from begin (P+1,) on; None if one has more than `most`.

    owner (N,): patch of each element; corner_place (N, 4): of its corners in `order`; rank (V,): of each place, by
    which the vertices that others own are ordered.
    Returns local: vertices of the patches, own ones first; local_begin (P+1,), own_end (P,) in it; corner (N, 4): index
    of each corner among its patch's vertices; mine (V,): place in `local` of each own vertex; others, others_patch:
    places in `order` of the vertices that others own, and in whose patch.
    """
    n, patches = len(order), len(begin) - 1
    patch_of = np.repeat(np.arange(patches), np.diff(begin))
    own = patch_of[corner_place] == owner[:, None]
    outside, index = np.unique((owner[:, None] * n + rank[corner_place])[~own], return_inverse=True)
    others_patch, others = outside // n, np.argsort(rank)[outside % n]
    others_begin = np.searchsorted(others_patch, np.arange(patches + 1))
    sizes = np.diff(begin) + np.diff(others_begin)
    if sizes.max(initial=0) > most:
        return None
    local_begin = np.r_[0, np.cumsum(sizes)]
    own_end = local_begin[:-1] + np.diff(begin)
    mine = np.arange(n) - begin[patch_of] + local_begin[patch_of]
    theirs = np.arange(len(others)) - others_begin[others_patch] + own_end[others_patch]
    local = np.zeros(local_begin[-1], np.int64)
    local[mine], local[theirs] = order, order[others]
    corner = corner_place - begin[owner][:, None]
    corner[~own] = (theirs - local_begin[others_patch])[index]
    return {
        "local": local,
        "local_begin": local_begin,
        "own_end": own_end,
        "corner": corner,
        "mine": mine,
        "others": others,
        "others_patch": others_patch,
    }


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
class ColorPatches(RestShapes):
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

    def __init__(self, state: State, elasticity: Elasticity, blocks: int):
        self.state, self.elasticity, self.blocks, self._last = state, elasticity, blocks, TablesOf()
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
        patches = [self.local, self.slot_begin, self.local_begin, self.own_end, self.own_begin, self.others_begin]
        self._upload = Upload([*patches, self.count, *self.words, self.tet])
        self.colors = 0
        self._tables: dict | None = None  # those on the device

    def load(self, model: Model) -> None:
        """Take the rest shapes of these bodies."""
        orders = [s.root.once(compact_order) for s in model.shapes]
        order = stacked([o + b for o, b in zip(orders, model.vertex_begin, strict=False)])
        colors = body_colors(model)
        begin, sizes = model.vertex_begin, (self.blocks, self.max_count)
        t = self._last.get(orders + colors, lambda: divide_by_color(model.tets, order, stacked(colors), begin, *sizes))
        if t is not self._tables:
            c = t["corners"]
            words = c[:, 0] | c[:, 1] << INDEX_BITS | t["corner"] << (2 * INDEX_BITS), c[:, 2] | c[:, 3] << INDEX_BITS
            local = t["local"], t["slot_begin"], t["local_begin"], t["own_end"]
            colors_begin = t["own_begin"].ravel(), t["others_begin"].ravel()
            self._upload([*local, *colors_begin, [len(t["own_end"])], *words, t["tet"]])
            self.colors, self._tables = t["colors"], t
        self.take_rest_shapes()

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
        tables = None if begin is None else _divided_by_color(tets, order, color, begin)
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


def _divided_by_color(tets: np.ndarray, order: np.ndarray, color: np.ndarray, begin: np.ndarray) -> dict | None:
    """The tables of `divide_by_color` for patches from `begin` (P+1,) on; None if one has PLACES vertices or more."""
    n, blocks = len(order), len(begin) - 1
    patch_at = np.repeat(np.arange(blocks), np.diff(begin))
    order = order[np.lexsort((color[order], patch_at))]
    corner_place = np.argsort(order)[tets]
    by_vertex = np.argsort(corner_place.ravel(), kind="stable")  # slots: corners in the order of their vertices
    tet, corner = by_vertex // 4, by_vertex % 4
    ends = np.r_[0, np.cumsum(np.bincount(corner_place.ravel(), minlength=n))]
    owner = patch_at[corner_place[tet, corner]]
    by_color = np.argsort(np.argsort(color[order], kind="stable"))
    tables = local_tables(order, begin, owner, corner_place[tet], by_color, PLACES - 1)
    if tables is None:
        return None
    local_begin, own_end = tables["local_begin"], tables["own_end"]
    slot_begin = np.zeros(local_begin[-1] + 1, np.int64)
    slot_begin[tables["mine"]] = ends[:-1]
    slot_begin[own_end] = ends[begin[1:]]  # the place after a patch's last own vertex
    counts, others = (np.zeros((blocks, COLOR_PLACES), np.int64) for _ in range(2))  # of colour -1 first
    np.add.at(counts, (patch_at, color[order] + 1), 1)
    np.add.at(others, (tables["others_patch"], color[order][tables["others"]] + 1), 1)
    return {
        **tables,
        "colors": int(color.max(initial=-1)) + 1,
        "own_begin": np.cumsum(counts, axis=1),
        "others_begin": np.cumsum(others, axis=1) + (own_end - local_begin[:-1])[:, None],
        "slot_begin": slot_begin,
        "tet": tet,
        "corner": corner,
        "corners": tables["corner"],
    }
