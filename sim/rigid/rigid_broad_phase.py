"""Which samples come near which shapes, where rigid bodies are among them, until the next search.

Each sample keeps a few slots for the shapes that it is near; each slot is a row (sim/contact/constraints.py), so that a contact keeps
its impulse from search to search. Rows whose ends are all rigid form groups, one for each two bodies that touch; all
static shapes count as one body.
"""

import taichi as ti

from sim.contact.broad_phase import BodyBounds
from sim.contact.constraints import ContactConstraints
from sim.contact.contact_samples import ContactSamples
from sim.contact.device_grids import FAR
from sim.contact.static_shapes import MAX_SHAPES, StaticShapes
from sim.model import MAX_BODIES, Model
from sim.rigid.rigid_bodies import FREE, SOFT, RigidBodies
from sim.rigid.rigid_shapes import RigidShapes
from sim.state import State

SLOTS = 4  # shapes that one sample can touch at once: a floor, a wall and two neighbours
WORLD = MAX_BODIES  # the one body that all static shapes are
GROUPS = MAX_BODIES * (MAX_BODIES + 1)
ALIKE = 3e-4  # [m]; samples between corners that are as near as they are would say nothing new


@ti.data_oriented
class RigidSearch:
    """Row begin + slot P + p is slot `slot` of sample p.

    shape i32[4P]: a static shape, or MAX_SHAPES + a body; -1 none;   distance f32[4P] [m], at the last search
    size, begin_of, active i32[G]: rows of a group, where they begin in entry i32[4P], whether any carries a load
    """

    def __init__(
        self,
        state: State,
        movers: RigidBodies,
        samples: ContactSamples,
        colliders: StaticShapes,
        shapes: RigidShapes,
        bounds: BodyBounds,
        begin: int,
    ):
        self.state, self.movers, self.samples, self.bounds = state, movers, samples, bounds
        self.colliders, self.shapes, self.begin = colliders, shapes, begin
        self.rows: ContactConstraints | None = None  # comes before any kernel is compiled
        self.size_of_rows = SLOTS * samples.capacity
        self.shape, self.patience, self.entry = (ti.field(ti.i32) for _ in range(3))
        self.distance, self.bounce = ti.field(ti.f32), ti.field(ti.f32)
        self.size, self.begin_of, self.filled, self.active = (ti.field(ti.i32) for _ in range(4))
        self.total = ti.field(ti.i32)
        self.builder = ti.FieldsBuilder()
        fields = (self.shape, self.patience, self.entry, self.distance, self.bounce)
        self.builder.dense(ti.i, self.size_of_rows).place(*fields)
        self.builder.dense(ti.i, GROUPS).place(self.size, self.begin_of, self.filled, self.active)
        self.builder.place(self.total)
        self.tree = self.builder.finalize()

    def load(self, model: Model) -> None:
        self.shapes.load(model)

    def reset(self) -> None:
        """Forget all contacts."""
        self.shape.fill(-1)
        self.bounce.fill(0.0)
        self.size.fill(0)

    def detect(self) -> None:
        """List the rows of samples that can touch something before the next search; needs up-to-date Bounds."""
        self._find()

    @ti.func
    def _near(self, p, k):
        """Distance [m] of sample p from shape k, FAR if they cannot meet until the next search."""
        s = self.state
        b = self.samples.body[p]
        facing = self.shapes.facing(p)
        margin = self.bounds.pace[b] * s.detect_dt[None]
        if k >= MAX_SHAPES:
            margin += self.bounds.pace[k - MAX_SHAPES] * s.detect_dt[None]
        d, points = FAR, 1
        if self.movers.kind[b] != SOFT and not self.samples.single[p]:
            points = 4  # first the sample, then the corners of its triangle
        alike = points > 1
        for c in range(points):
            if c == 0 or (alike and self.samples.weight[p][c - 1] > 0.0):
                x = self.samples.blend(p, s.x)
                if c > 0:
                    x = s.x[self.samples.ids[p][c - 1]]
                away = self._distance_to(k, x, facing, margin)
                if c == 0:
                    d = away
                    alike = alike and d < 0.5 * FAR
                elif away > d + ALIKE:
                    alike = False
        return FAR if alike else d

    @ti.func
    def _distance_to(self, k, x, facing, margin):
        """Distance [m] of x from shape k, FAR if it is more than margin."""
        d = FAR
        if k < MAX_SHAPES:
            if (self.colliders.low[k] - x).max() < margin and (x - self.colliders.high[k]).max() < margin:
                d = self.colliders.gap(k, x)
        else:
            m = k - MAX_SHAPES
            if (self.bounds.low[m] - x).max() < margin and (x - self.bounds.high[m]).max() < margin:
                d, _ = self.shapes.distance(m, x, facing)
        return d if d < margin else FAR

    @ti.func
    def _may_touch(self, p, k):
        """Whether shape k is another body, and one of both moves freely."""
        b = self.samples.body[p]
        result = self.movers.kind[b] == FREE
        if k >= MAX_SHAPES:
            kind = self.movers.kind[k - MAX_SHAPES]
            result = kind != SOFT and k - MAX_SHAPES != b
            result = result and (self.movers.kind[b] == SOFT or self.movers.kind[b] == FREE or kind == FREE)
        return result

    @ti.func
    def _offer(self, p, k):
        """Keep or drop shape k if sample p has it in a slot, else give it the farthest slot if it is near."""
        P = self.samples.capacity
        mine, farthest, most = -1, 0, -FAR
        for slot in range(SLOTS):
            q = slot * P + p
            away = self.distance[q] if self.shape[q] >= 0 else 2.0 * FAR
            if self.shape[q] == k:
                mine = q
            if away > most:
                farthest, most = q, away
        d = FAR
        if self._may_touch(p, k):
            d = self._near(p, k)
        if mine >= 0:
            if d < 0.5 * FAR:
                self.distance[mine] = d
            else:
                self._assign(mine, -1, FAR)
        elif d < ti.min(most, 0.5 * FAR):
            self._assign(farthest, k, d)

    @ti.func
    def _assign(self, q, k, d):
        self.shape[q], self.distance[q], self.bounce[q] = k, d, 0.0
        self.rows.forget(self.begin + q)

    @ti.func
    def _group(self, p, k):
        """The group of sample p's body and shape k, or -1 if a soft body is among them."""
        b, other = self.samples.body[p], WORLD
        if k >= MAX_SHAPES:
            other = k - MAX_SHAPES
        g = ti.min(b, other) * (MAX_BODIES + 1) + ti.max(b, other)
        return g if self.movers.kind[b] != SOFT else -1

    @ti.kernel
    def _find(self):
        P = self.samples.capacity
        self.total[None] = 0
        for g in range(GROUPS):
            self.size[g], self.filled[g], self.active[g] = 0, 0, 0
        for p in range(P):
            if p < self.samples.count[None]:
                n = self.colliders.count[None]
                for k in range(n + self.state.body_count[None]):
                    self._offer(p, k if k < n else MAX_SHAPES + k - n)
        for q in range(SLOTS * P):
            p = q % P
            if p < self.samples.count[None] and self.shape[q] >= 0:
                r = self.begin + q
                self.rows.wake[r] = 0
                self.rows.enlist(r)
                g = self._group(p, self.shape[q])
                self.rows.set_size(r, 0)
                self.rows.ends[r] = 1
                if g < 0:
                    self.samples.put(p, r, self.rows)
                    self.rows.set_size(r, 3)
                else:
                    self.rows.ends[r] = 1 if self.shape[q] < MAX_SHAPES else 2
                    ti.atomic_add(self.size[g], 1)
        for g in range(GROUPS):
            if self.size[g] > 0:
                self.begin_of[g] = ti.atomic_add(self.total[None], self.size[g])
        for q in range(SLOTS * P):
            p = q % P
            if p < self.samples.count[None] and self.shape[q] >= 0:
                g = self._group(p, self.shape[q])
                if g >= 0:
                    self.entry[self.begin_of[g] + ti.atomic_add(self.filled[g], 1)] = q
        for g in range(GROUPS):  # in a fixed order, whoever came first
            for e in range(self.begin_of[g] + 1, self.begin_of[g] + self.size[g]):
                q, at = self.entry[e], e
                while at > self.begin_of[g] and self.entry[at - 1] > q:
                    self.entry[at] = self.entry[at - 1]
                    at -= 1
                self.entry[at] = q

    def destroy(self) -> None:
        self.tree.destroy()
        self.shapes.destroy()
