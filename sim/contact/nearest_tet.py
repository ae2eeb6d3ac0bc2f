"""Which tet of another body holds each contact sample, or comes close enough to before the next search.

The points are the bodies' surface samples and, so that nothing thin slips between those, spots on the axes of static
capsules. Bodies and capsules are *groups*; a point looks for tets of other groups,
and of its own body where that may be folded on itself (sim/contact/self_collision.py).
"""

import numpy as np
import taichi as ti

from core.fields import Upload
from sim.contact.broad_phase import MARGIN, BodyBounds, PointHash
from sim.contact.capsule_samples import MAX_CAPSULES, CapsuleSamples
from sim.contact.contact_samples import ContactSamples
from sim.contact.device_grids import FAR, corner
from sim.contact.self_collision import SelfCollision
from sim.contact.tet_planes import beyond, neighbors_of, outward
from sim.model import MAX_BODIES, Model, stacked
from sim.state import State

GROUPS = MAX_BODIES + MAX_CAPSULES
NONE = 2**62  # a key above all others
SEEDS = 64  # tets of a body at which the search for what is far away begins


@ti.data_oriented
class NearestTets:
    """host i32[N]: the foreign tet that is nearest to a point; neighbor vec4i[T]: tets across each corner's face.

    Within a cell's size that is exact. For what may come from farther away until the next search, it begins at the
    nearest of a body's SEEDS tets, and goes from neighbor to neighbor while that is nearer: a fast body comes near all.

    overlap f32[B,G] [m]: how far body b and group g may approach until the next search, 0 if they cannot meet
    """

    def __init__(
        self,
        state: State,
        samples: ContactSamples,
        spots: CapsuleSamples,
        bounds: BodyBounds,
        folding: SelfCollision | None,
    ):
        self.folding, self.folds = folding, folding is not None
        self.state, self.samples, self.spots, self.bounds = state, samples, spots, bounds
        self.hash = PointHash(samples.capacity + spots.size)
        N = self.hash.points
        self.builder = ti.FieldsBuilder()
        self.key, self.host = ti.field(ti.i64), ti.field(ti.i32)
        self.builder.dense(ti.i, N).place(self.key)
        self.builder.dense(ti.i, N).place(self.host)
        self.overlap, self.wanted = ti.field(ti.f32), ti.field(ti.i32)
        self.builder.dense(ti.ij, (MAX_BODIES, GROUPS)).place(self.overlap)
        self.builder.dense(ti.i, GROUPS).place(self.wanted)
        self.neighbor = ti.Vector.field(4, ti.i32)
        self.builder.dense(ti.i, state.T).place(self.neighbor)
        self.busy = ti.field(ti.i32)
        self.builder.place(self.busy)
        self.tree = self.builder.finalize()
        self._upload = Upload([self.neighbor, self.hash.cell])

    def load(self, model: Model) -> None:
        """Take the tets of these bodies."""
        shapes, begin = model.shapes, model.tet_begin
        near = [s.root.once(neighbors_of) for s in shapes]
        near = stacked([np.where(n < 0, n, n + o) for n, o in zip(near, begin, strict=False)], 4)
        edge = float(np.median([s.edge for s in shapes])) if shapes else 0.0
        self._upload([near, max(edge, self.samples.spacing)])

    @ti.func
    def group(self, p):
        n = self.samples.count[None]
        return self.samples.body[p] if p < n else self.spots.group[p - n]

    @ti.func
    def place(self, p):
        """Where point p is [m]."""
        n = self.samples.count[None]
        x = ti.Vector([0.0, 0.0, 0.0])
        if p < n:
            x = self.samples.blend(p, self.state.x)
        else:
            x = self.spots.place[p - n]
        return x

    @ti.func
    def reach(self, p):
        """Distance [m] at which point p touches: a capsule's axis touches at its radius."""
        n = self.samples.count[None]
        return 0.0 if p < n else self.spots.radius[p - n]

    @ti.func
    def sweep(self, low, high, slow, fast, g):
        """How a box that moves with velocities slow..fast can meet group g until the next search.

        Returns the part of g's box in which they can meet, whether there is any, and how far [m] they may approach.
        """
        t = self.state.detect_dt[None]
        other_low, other_high = ti.Vector([0.0, 0.0, 0.0]), ti.Vector([0.0, 0.0, 0.0])
        other_slow, other_fast, margin = other_low, other_low, MARGIN
        if g < MAX_BODIES:
            other_low, other_high = self.bounds.low[g], self.bounds.high[g]
            other_slow, other_fast = self.bounds.slow[g], self.bounds.fast[g]
        else:
            other_low, other_high = self.spots.low[g - MAX_BODIES], self.spots.high[g - MAX_BODIES]
            margin += self.spots.thickness[g - MAX_BODIES]
        back, forth = ti.min((slow - other_fast) * t, 0.0), ti.max((fast - other_slow) * t, 0.0)
        a, b = ti.max(low + back - margin, other_low), ti.min(high + forth + margin, other_high)
        return a, b, (a - b).max() <= 0.0, margin + ti.max(-back, forth).norm()

    @ti.kernel
    def find(self, rows: ti.template(), begin: ti.i32):
        s = self.state
        h = self.hash
        groups = MAX_BODIES + self.spots.group_count[None]
        self.busy[None], h.total[None] = 0, 0
        for g in range(GROUPS):
            self.wanted[g] = 0
        for b, g in self.overlap:  # which bodies come near which groups
            n = s.body_count[None]
            meets, way = False, 0.0
            alone = True
            if ti.static(self.folds):
                alone = b == g and self.folding.folded[b] == 0
            else:
                alone = b == g
            if b < n and not alone and (g < n or MAX_BODIES <= g < groups):
                box = self.bounds
                _, _, meets, way = self.sweep(box.low[b], box.high[b], box.slow[b], box.fast[b], g)
            self.overlap[b, g] = way if meets else 0.0
            if meets:
                self.wanted[g] = 1
                self.busy[None] = 1
        for bucket in range(h.buckets):
            h.clear(bucket)
        for p in range(h.points):
            self.key[p] = ti.i64(NONE)
            if self._searches(p):
                h.count(p, self.place(p))
        for bucket in range(h.buckets):
            h.allot(bucket)
        for p in range(h.points):
            if self._searches(p):
                h.fill(p, self.place(p))
        for t in range(s.T):
            if self.busy[None] and t < s.tet_count[None]:
                self._visit(t)
        for p in range(h.points):
            host = -1
            if self.key[p] != ti.i64(NONE):
                host = ti.cast(self.key[p] & ti.i64(0x7FFFFFFF), ti.i32)
            elif self._searches(p):
                host = self._from_afar(p)
            if host >= 0:
                self.host[p] = host
                rows.wake[begin + p] = 0
                rows.enlist(begin + p)
            else:
                rows.forget(begin + p)

    @ti.func
    def _searches(self, p):
        """Whether some body comes near point p's group."""
        result = False
        if self.busy[None] and p < self.samples.count[None] + self.spots.count[None]:
            result = self.wanted[self.group(p)] != 0
        return result

    @ti.func
    def _visit(self, t):
        """Offer tet t to the points near it that it can meet until the next search; the lowest (distance, t) wins."""
        s = self.state
        h = self.hash
        body = s.body_of_tet[t]
        low, high, slow, fast = self._box(t)
        box_low, box_high, reach = corner(FAR), corner(-FAR), 0.0
        n = s.body_count[None]
        for k in range(n + self.spots.group_count[None]):
            g = k if k < n else MAX_BODIES + k - n
            if self.overlap[body, g] > 0.0:
                part_low, part_high, meets, way = self.sweep(low, high, slow, fast, g)
                near = self._near(g)
                part_low, part_high = ti.max(part_low, low - near), ti.min(part_high, high + near)
                way = ti.min(way, near)
                if ti.static(self.folds):
                    part_low, part_high, way = self._or_around(part_low, part_high, way, low, high, body, g)
                if meets:
                    box_low, box_high, reach = (
                        ti.min(box_low, part_low),
                        ti.max(box_high, part_high),
                        ti.max(reach, way),
                    )
        x0, e1, e2, e3 = self._edges(t)
        if reach > 0.0 and e1.dot(e2.cross(e3)) > 0.0:
            n0, n1, n2, n3 = outward(e1, e2, e3)
            first, last = h.range_of(box_low, box_high)
            for i in range(first[0], last[0]):
                for j in range(first[1], last[1]):
                    for k in range(first[2], last[2]):
                        bucket = h.bucket_of(ti.Vector([i, j, k]))
                        for e in range(h.begin[bucket], h.begin[bucket] + h.size[bucket]):
                            x = h.at[e]
                            if (box_low - x).max() <= 0.0 and (x - box_high).max() <= 0.0:
                                outside = beyond(x - x0, e1, n0, n1, n2, n3)
                                p = h.entry[e]
                                if outside < reach and self._strange(p, t, body):
                                    key = (ti.cast(outside * 1e7, ti.i64) << 32) | ti.cast(t, ti.i64)
                                    ti.atomic_min(self.key[p], key)

    @ti.func
    def _near(self, g):
        """How far from a point of group g all tets are searched [m]."""
        near = self.hash.cell[None]
        if g >= MAX_BODIES:
            near += self.spots.thickness[g - MAX_BODIES]
        return near

    @ti.func
    def _from_afar(self, p):
        """The tet that may come to point p, which has none near: a seed, and on to neighbors that are nearer; or -1."""
        s, x, g = self.state, self.place(p), self.group(p)
        box = self.bounds
        best, now = FAR, -1
        for b in range(s.body_count[None]):
            if b != g and self.overlap[b, g] > self._near(g):
                low, high, _, _ = self.sweep(box.low[b], box.high[b], box.slow[b], box.fast[b], g)
                if (low - x).max() <= 0.0 and (x - high).max() <= 0.0:
                    first, n = s.tet_begin[b], s.tet_begin[b + 1] - s.tet_begin[b]
                    count = ti.min(n, SEEDS)  # none of a rigid body
                    for k in range(count):
                        t = first + k * n // ti.max(count, 1)  # lest the division be hoisted out of a loop over none
                        d = (x - s.x[s.tets[t][0]]).norm_sqr()
                        if d < best:
                            best, now = d, t
        going = now >= 0
        if going:
            best = self._outside(now, x)
        while going:
            here = now
            for j in range(4):
                t = self.neighbor[here][j]
                if t >= 0:
                    d = self._outside(t, x)
                    if d < best:
                        best, now = d, t
            going = now != here
        if now >= 0:
            low, high, slow, fast = self._box(now)
            _, _, meets, way = self.sweep(low, high, slow, fast, g)
            if not meets or best >= way:
                now = -1
        return now

    @ti.func
    def _box(self, t):
        """Of tet t: the box of its positions, low and high, and of its velocities with what may come, slow and fast."""
        s, a = self.state, self.state.tets[t]
        x0, x1, x2, x3 = s.x[a[0]], s.x[a[1]], s.x[a[2]], s.x[a[3]]
        v0, v1, v2, v3 = s.v[a[0]], s.v[a[1]], s.v[a[2]], s.v[a[3]]
        extra = self.bounds.extra[s.body_of_tet[t]]
        slow, fast = ti.min(v0, v1, v2, v3) - extra, ti.max(v0, v1, v2, v3) + extra
        return ti.min(x0, x1, x2, x3), ti.max(x0, x1, x2, x3), slow, fast

    @ti.func
    def _edges(self, t):
        """Corner 0 of tet t, and the edges from it."""
        s, a = self.state, self.state.tets[t]
        x0 = s.x[a[0]]
        return x0, s.x[a[1]] - x0, s.x[a[2]] - x0, s.x[a[3]] - x0

    @ti.func
    def _outside(self, t, x):
        """How far x is beyond the worst face of tet t [m], 0 inside; FAR if the tet is inverted."""
        x0, e1, e2, e3 = self._edges(t)
        result = FAR
        if e1.dot(e2.cross(e3)) > 0.0:
            n0, n1, n2, n3 = outward(e1, e2, e3)
            result = beyond(x - x0, e1, n0, n1, n2, n3)
        return result

    @ti.func
    def _or_around(self, part_low, part_high, way, low, high, body, g):
        """If the group is the tet's own body: the part of its box that it can meet, and how far they may approach."""
        if g == body:
            way = self.folding.way[body]
            part_low, part_high = ti.max(low - way, self.bounds.low[body]), ti.min(high + way, self.bounds.high[body])
        return part_low, part_high, way

    @ti.func
    def _strange(self, p, t, body):
        """Whether tet t of a body may meet point p: of another body that comes near, or far away at rest."""
        result = self.overlap[body, self.group(p)] > 0.0
        if ti.static(self.folds):
            s = self.state
            a = s.tets[t]
            if self.group(p) == body:
                X = self.samples.blend(p, s.rest)
                away = 0.25 * (s.rest[a[0]] + s.rest[a[1]] + s.rest[a[2]] + s.rest[a[3]]) - X
                result = result and away.norm() > self.folding.apart(body)
                for k in ti.static(range(3)):
                    for j in ti.static(range(4)):
                        result = result and self.samples.ids[p][k] != a[j]
        return result

    def destroy(self) -> None:
        self.tree.destroy()
        self.hash.destroy()
