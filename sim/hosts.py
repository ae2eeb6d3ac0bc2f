"""Which tet of another body holds each contact sample, or comes close enough to before the next search.

The points are the bodies' surface samples and, so that nothing thin slips between those, spots on the axes of static
capsules. Bodies and capsules are *groups*; a point looks for tets of other groups,
and of its own body where that may be folded on itself (sim/folding.py).
"""

import numpy as np
import taichi as ti

from scenes.scene import Capsule
from sim.assembly import MAX_BODIES, Assembly, stacked
from sim.broad import MARGIN, Bounds, PointHash
from sim.folding import Folding
from sim.grids import FAR, corner
from sim.parts import RestShape
from sim.samples import Samples
from sim.state import State, Upload, capacity

MAX_CAPSULES = 32
GROUPS = MAX_BODIES + MAX_CAPSULES
NONE = 2**62  # a key above all others


@ti.data_oriented
class Spots:
    """Points on the axes of thin static capsules: place vec3, radius f32 [m], friction f32, group i32.

    Per capsule: low, high vec3 the box of its axis, thickness f32 its radius [m].
    """

    def __init__(self, capsules: list[Capsule], spacing: float):
        thin = [c for c in capsules if c.radius < 2 * spacing][:MAX_CAPSULES]  # thicker ones cannot slip through
        rows, low, high = [], np.zeros((MAX_CAPSULES, 3)), np.zeros((MAX_CAPSULES, 3))
        for k, c in enumerate(thin):
            a, b = np.asarray(c.a, np.float64), np.asarray(c.b, np.float64)
            n = int(np.clip(np.ceil(np.linalg.norm(b - a) / (0.5 * spacing)), 1, 256))
            rows += [(*(a + (b - a) * i / n), c.radius, c.friction, MAX_BODIES + k) for i in range(n + 1)]
            low[k], high[k] = np.minimum(a, b), np.maximum(a, b)
        table = np.array(rows).reshape(-1, 6)
        self.size, self.groups = len(table), len(thin)
        n = capacity(max(self.size, 1))
        self.place, self.low, self.high = (ti.Vector.field(3, ti.f32) for _ in range(3))
        self.radius, self.friction, self.thickness = ti.field(ti.f32), ti.field(ti.f32), ti.field(ti.f32)
        self.group = ti.field(ti.i32)
        self.builder = ti.FieldsBuilder()
        self.builder.dense(ti.i, n).place(self.place, self.radius, self.friction, self.group)
        self.builder.dense(ti.i, MAX_CAPSULES).place(self.low, self.high, self.thickness)
        self.count, self.group_count = ti.field(ti.i32), ti.field(ti.i32)
        self.builder.place(self.count, self.group_count)
        self.tree = self.builder.finalize()
        columns = [(self.place, table[:, :3]), (self.radius, table[:, 3]), (self.friction, table[:, 4])]
        columns += [(self.group, table[:, 5]), (self.low, low), (self.high, high)]
        columns += [
            (self.thickness, [c.radius for c in thin]),
            (self.count, self.size),
            (self.group_count, self.groups),
        ]
        Upload([f for f, _ in columns])([v for _, v in columns])

    def destroy(self) -> None:
        self.tree.destroy()


@ti.data_oriented
class Hosts:
    """host i32[N]: the foreign tet that is nearest to a point; neighbor vec4i[T]: tets across each corner's face."""

    def __init__(self, state: State, samples: Samples, spots: Spots, bounds: Bounds, folding: Folding | None):
        self.folding, self.folds = folding, folding is not None
        self.state, self.samples, self.spots, self.bounds = state, samples, spots, bounds
        self.hash = PointHash(samples.capacity + spots.size)
        N = self.hash.points
        self.builder = ti.FieldsBuilder()
        self.key, self.host = ti.field(ti.i64), ti.field(ti.i32)
        self.builder.dense(ti.i, N).place(self.key)
        self.builder.dense(ti.i, N).place(self.host)
        self.overlap, self.wanted = ti.field(ti.i32), ti.field(ti.i32)
        self.builder.dense(ti.ij, (MAX_BODIES, GROUPS)).place(self.overlap)
        self.builder.dense(ti.i, GROUPS).place(self.wanted)
        self.neighbor = ti.Vector.field(4, ti.i32)
        self.builder.dense(ti.i, state.T).place(self.neighbor)
        self.busy = ti.field(ti.i32)
        self.builder.place(self.busy)
        self.tree = self.builder.finalize()
        self._upload = Upload([self.neighbor, self.hash.cell])

    def load(self, assembly: Assembly) -> None:
        """Take the tets of these bodies."""
        shapes, begin = assembly.shapes, assembly.tet_begin
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
            meets = False
            alone = True
            if ti.static(self.folds):
                alone = b == g and self.folding.folded[b] == 0
            else:
                alone = b == g
            if b < n and not alone and (g < n or MAX_BODIES <= g < groups):
                box = self.bounds
                _, _, meets, _ = self.sweep(box.low[b], box.high[b], box.slow[b], box.fast[b], g)
            self.overlap[b, g] = meets
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
            if self.key[p] != ti.i64(NONE):
                self.host[p] = ti.cast(self.key[p] & ti.i64(0x7FFFFFFF), ti.i32)
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
        """Offer tet t to the points that it can meet until the next search; the lowest (distance, t) wins a point."""
        s = self.state
        h = self.hash
        body = s.body_of_tet[t]
        a = s.tets[t]
        x0, x1, x2, x3 = s.x[a[0]], s.x[a[1]], s.x[a[2]], s.x[a[3]]
        v0, v1, v2, v3 = s.v[a[0]], s.v[a[1]], s.v[a[2]], s.v[a[3]]
        slow, fast = ti.min(v0, v1, v2, v3) - self.bounds.extra[body], ti.max(v0, v1, v2, v3) + self.bounds.extra[body]
        low, high = ti.min(x0, x1, x2, x3), ti.max(x0, x1, x2, x3)
        box_low, box_high, reach = corner(FAR), corner(-FAR), 0.0
        n = s.body_count[None]
        for k in range(n + self.spots.group_count[None]):
            g = k if k < n else MAX_BODIES + k - n
            if self.overlap[body, g]:
                part_low, part_high, meets, way = self.sweep(low, high, slow, fast, g)
                if ti.static(self.folds):
                    part_low, part_high, way = self._or_around(part_low, part_high, way, low, high, body, g)
                if meets:
                    box_low, box_high, reach = (
                        ti.min(box_low, part_low),
                        ti.max(box_high, part_high),
                        ti.max(reach, way),
                    )
        e1, e2, e3 = x1 - x0, x2 - x0, x3 - x0
        if reach > 0.0 and e1.dot(e2.cross(e3)) > 0.0:
            # the faces' planes: outward unit normals; all but the first pass through x0
            n1, n2, n3 = -e2.cross(e3).normalized(), -e3.cross(e1).normalized(), -e1.cross(e2).normalized()
            n0 = (e2 - e1).cross(e3 - e1).normalized()
            first, last = h.range_of(box_low, box_high)
            for i in range(first[0], last[0]):
                for j in range(first[1], last[1]):
                    for k in range(first[2], last[2]):
                        bucket = h.bucket_of(ti.Vector([i, j, k]))
                        for e in range(h.begin[bucket], h.begin[bucket] + h.size[bucket]):
                            x = h.at[e]
                            if (box_low - x).max() <= 0.0 and (x - box_high).max() <= 0.0:
                                # beyond the worst face: 0 inside, at most the distance outside
                                r = x - x0
                                outside = ti.max(n0.dot(r - e1), n1.dot(r), n2.dot(r), n3.dot(r), 0.0)
                                p = h.entry[e]
                                if outside < reach and self.overlap[body, self.group(p)] and self._strange(p, t, body):
                                    key = (ti.cast(outside * 1e7, ti.i64) << 32) | ti.cast(t, ti.i64)
                                    ti.atomic_min(self.key[p], key)

    @ti.func
    def _or_around(self, part_low, part_high, way, low, high, body, g):
        """If the group is the tet's own body: the part of its box that it can meet, and how far they may approach."""
        if g == body:
            way = self.folding.way[body]
            part_low, part_high = ti.max(low - way, self.bounds.low[body]), ti.min(high + way, self.bounds.high[body])
        return part_low, part_high, way

    @ti.func
    def _strange(self, p, t, body):
        """Whether tet t of a body is foreign to point p: of another, or far away at rest."""
        result = True
        if ti.static(self.folds):
            s = self.state
            a = s.tets[t]
            if self.group(p) == body:
                X = self.samples.blend(p, s.rest)
                away = 0.25 * (s.rest[a[0]] + s.rest[a[1]] + s.rest[a[2]] + s.rest[a[3]]) - X
                result = away.norm() > self.folding.apart(body)
                for k in ti.static(range(3)):
                    for j in ti.static(range(4)):
                        result = result and self.samples.ids[p][k] != a[j]
        return result

    def destroy(self) -> None:
        self.tree.destroy()
        self.hash.destroy()


def neighbors_of(shape: RestShape) -> np.ndarray:
    return neighbors(shape.tets)


def neighbors(tets: np.ndarray) -> np.ndarray:
    """Tet across the face opposite each corner, -1 at the surface, (T, 4) int32."""
    faces = np.sort(tets[:, [[1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 1, 2]]].reshape(-1, 3), axis=1)
    order = np.lexsort(faces.T)
    same = (faces[order[1:]] == faces[order[:-1]]).all(1)
    result = np.full(4 * len(tets), -1, np.int32)
    a, b = order[:-1][same], order[1:][same]
    result[a], result[b] = b // 4, a // 4
    return result.reshape(-1, 4)
