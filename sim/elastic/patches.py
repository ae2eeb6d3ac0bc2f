"""Patches: the vertices divided into compact groups, one for each block of threads, with all tets that touch a group.

A block copies the vertices of its patch, and those just outside that its tets need, to shared memory, and sums the
corrections of its own vertices there: random reads of global memory cost more than the arithmetic. A tet at a border
belongs to several patches and is projected by each of them, from the same numbers in the same order, so that the
corrections of its corners cancel to the bit: otherwise rounding would push the whole body.
"""

from collections.abc import Callable

import numpy as np
import taichi as ti

from core.errors import BadInput
from core.fields import FieldGroup, Upload
from sim.body_model import RestShape
from sim.capacity import MAX_BODIES, stacked
from sim.elastic.energy import CRUSHED_DJ, STRETCHED_I1, row, shortened_step, stress
from sim.model import Model
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
class Patches:
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

    def __init__(self, state: State, blocks: int):
        """For this many blocks that run at once."""
        self.state, self.blocks, self._last = state, blocks, TablesOf()
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
        self.kappa = g.scalar(state.T)  # 1/s^2
        self.published = g.vector(2, V, 3, n=4)
        g.build()
        self._upload = Upload(
            [
                *(self.local, self.slot_begin, self.slot_end, self.local_begin, self.own_end, self.tet_begin),
                *(self.count, *self.corners, *self.slots, *self.gradient, self.tet, self.kappa),
            ]
        )

    def load(self, model: Model) -> None:
        """Take the rest shapes of these bodies."""
        orders = [s.root.once(compact_order) for s in model.shapes]
        order = stacked([o + b for o, b in zip(orders, model.vertex_begin, strict=False)])
        t = self._last.get(orders, lambda: divide(model.tets, order, self.blocks))
        tets, corner = t["tet"], t["corner"]
        gradients = stacked([s.inverse.reshape(-1, 9) for s in model.shapes], 9)[tets]
        body = np.repeat(np.arange(len(model.shapes)), np.diff(model.tet_begin))[tets]
        slot = np.where(t["slot"] < 0, NO_SLOT, t["slot"])
        corners = corner[:, 0] | corner[:, 1] << 16, corner[:, 2] | corner[:, 3] << 16
        slots = slot[:, 0] | slot[:, 1] << SLOT_BITS | body << (2 * SLOT_BITS), slot[:, 2] | slot[:, 3] << SLOT_BITS
        kappa = stacked([p.kappa for p in model.bodies])
        words = (w.astype(np.uint32).view(np.int32) for w in (*corners, *slots))
        local = t["local"], t["slot_begin"], t["slot_end"], t["local_begin"], t["own_end"], t["tet_begin"]
        self._upload([*local, [len(t["own_end"])], *words, *gradients.T, tets, kappa])

    @ti.func
    def publish(self, i, x, v, dx, parity):
        """Show the neighbours of vertex i its position, velocity and increment, in substeps of this parity."""
        d = dx - self.state.stress_lag[self.state.body_of_vertex[i]] * v
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

        The step is that of Elasticity.project_tet for a single sweep.
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
            step = shortened_step(F, g, w, W, motion, V, I1, dJ, self.kappa[t], mu, lam, dt2)
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

    def destroy(self) -> None:
        self._group.destroy()


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
    n, patches = len(order), len(begin) - 1
    place = np.empty(n, np.int64)
    place[order] = np.arange(n)
    corner_place = place[tets]  # (T, 4)
    ends = np.r_[0, np.cumsum(np.bincount(corner_place.ravel(), minlength=n))]
    if np.diff(ends[begin]).max(initial=0) > MAX_SLOTS:
        return None
    patch_of = np.repeat(np.arange(patches), np.diff(begin))
    patch = patch_of[corner_place]
    first = np.ones(patch.shape, bool)  # corners that are the first of their tet in their patch
    for c in range(1, 4):
        for d in range(c):
            first[:, c] &= patch[:, c] != patch[:, d]
    t, c = np.nonzero(first)
    by_patch = np.argsort(patch[t, c], kind="stable")
    t, owner = t[by_patch], patch[t, c][by_patch]
    own = patch[t] == owner[:, None]
    outside, index = np.unique((owner[:, None] * n + corner_place[t])[~own], return_inverse=True)
    outside_begin = np.searchsorted(outside, np.arange(patches + 1) * n)
    sizes = np.diff(begin) + np.diff(outside_begin)
    if sizes.max(initial=0) > MAX_LOCAL:
        return None
    local_begin = np.r_[0, np.cumsum(sizes)]
    own_end = local_begin[:-1] + np.diff(begin)
    local, slot_begin, slot_end = (np.zeros(local_begin[-1], np.int64) for _ in range(3))
    mine = np.arange(n) - begin[patch_of] + local_begin[patch_of]  # place in `local` of each own vertex
    local[mine] = order
    start = ends[begin[patch_of]]
    slot_begin[mine], slot_end[mine] = ends[:-1] - start, ends[1:] - start
    of = outside // n
    theirs = np.arange(len(outside)) - outside_begin[of] + own_end[of]
    local[theirs] = order[outside % n]
    corner = corner_place[t] - begin[owner][:, None]
    corner[~own] = (theirs - local_begin[of])[index]
    rank = np.empty(tets.size, np.int64)  # of each corner among those of all vertices in order
    rank[np.argsort(corner_place.ravel(), kind="stable")] = np.arange(tets.size)
    slot = np.where(own, rank.reshape(-1, 4)[t] - ends[begin[owner]][:, None], -1)
    return {
        "local": local,
        "local_begin": local_begin,
        "own_end": own_end,
        "slot_begin": slot_begin,
        "slot_end": slot_end,
        "tet_begin": np.searchsorted(owner, np.arange(patches + 1)),
        "tet": t,
        "corner": corner,
        "slot": slot,
    }
