"""Broad phase with rigid bodies: the shapes that each sample may touch until the next search, and groups of contacts.

Each sample keeps a few slots for the shapes that it is near; each slot is a contact constraint
(sim/contact/constraints.py), so that a contact keeps its impulse from search to search. Constraints between rigid
bodies alone form groups, one for each two bodies that touch; all static shapes count as one body.
"""

from typing import TYPE_CHECKING

import taichi as ti

from core.fields import FieldGroup
from sim.capacity import MAX_BODIES
from sim.contact.broad_phase import outside_box
from sim.contact.response import CONTACT_SLOP
from sim.contact.signed_distance import UNKNOWN_DISTANCE, known
from sim.contact.static_shapes import MAX_SHAPES
from sim.rigid.rigid_motion import FREE, SOFT

if TYPE_CHECKING:
    from sim.contact.broad_phase import BodyBounds
    from sim.contact.constraints import ContactConstraints
    from sim.contact.contact_samples import ContactSamples
    from sim.contact.static_shapes import StaticShapes
    from sim.rigid.rigid_bodies import RigidBodies
    from sim.rigid.rigid_shapes import RigidShapes
    from sim.state import State

SLOTS = 4  # shapes that one sample can touch at once: a floor, a wall and two neighbours
WORLD = MAX_BODIES  # the one body that all static shapes are
GROUPS = MAX_BODIES * (MAX_BODIES + 1)


def slot_count(samples: "ContactSamples") -> int:
    """Number of slots, which is that of the constraints."""
    return SLOTS * samples.capacity


@ti.data_oriented
class RigidBroadPhase:
    """Slot q = slot P + p of sample p is constraint begin + q.

    shape i32[4P]: a static shape, or MAX_SHAPES + a body; -1 none;   distance f32[4P] [m], at the last search
    bounce_speed f32[4P] [m/s]: speed that an impact still asks for
    size, group_begin i32[G]: constraints of a group, and where they begin in entry i32[4P]
    active i32[G]: whether any of a group carries a load
    """

    def __init__(
        self,
        state: "State",
        rigid_bodies: "RigidBodies",
        samples: "ContactSamples",
        static_shapes: "StaticShapes",
        shapes: "RigidShapes",
        bounds: "BodyBounds",
        constraints: "ContactConstraints",
        begin: int,
    ):
        self.state, self.rigid_bodies, self.samples, self.bounds = state, rigid_bodies, samples, bounds
        self.static_shapes, self.shapes, self.constraints, self.begin = static_shapes, shapes, constraints, begin
        group, slots = FieldGroup(), slot_count(samples)
        with group.interleaved(slots):
            self.shape, self.entry = group.scalar(dtype=ti.i32), group.scalar(dtype=ti.i32)
            self.distance, self.bounce_speed = group.scalar(), group.scalar()
        with group.interleaved(GROUPS):
            self.size, self.group_begin, self.filled, self.active = (group.scalar(dtype=ti.i32) for _ in range(4))
        self.total = group.scalar(dtype=ti.i32)
        self._group = group
        group.build()

    def reset(self) -> None:
        """Forget all contacts."""
        self.shape.fill(-1)
        self.bounce_speed.fill(0.0)
        self.size.fill(0)

    @ti.func
    def group_of(self, q):
        """Group of slot q, by the body of its sample and its shape; -1 if a soft body is among them."""
        b, other = self.samples.body[q % self.samples.capacity], WORLD
        if self.shape[q] >= MAX_SHAPES:
            other = self.shape[q] - MAX_SHAPES
        g = ti.min(b, other) * (MAX_BODIES + 1) + ti.max(b, other)
        return g if self.rigid_bodies.kind[b] != SOFT else -1

    @ti.func
    def _sample_distance(self, p, k):
        """Distance [m] of sample p from shape k, unknown if they cannot meet until the next search."""
        s = self.state
        b = self.samples.body[p]
        facing = self.shapes.normal(p)
        margin = self.bounds.max_speed[b] * s.detect_dt[None]
        if k >= MAX_SHAPES:
            margin += self.bounds.max_speed[k - MAX_SHAPES] * s.detect_dt[None]
        d, points = UNKNOWN_DISTANCE, 1
        if self.rigid_bodies.kind[b] != SOFT and not self.samples.on_vertex[p]:
            points = 4  # first the sample, then the corners of its triangle
        redundant = points > 1
        for c in range(points):
            if c == 0 or (redundant and self.samples.weight[p][c - 1] > 0.0):
                x = self.samples.blend(p, s.x)
                if c > 0:
                    x = s.x[self.samples.ids[p][c - 1]]
                distance = self._distance_to(k, x, facing, margin)
                if c == 0:
                    d = distance
                    redundant = redundant and known(d)
                elif distance > d + CONTACT_SLOP:
                    redundant = False
        return UNKNOWN_DISTANCE if redundant else d

    @ti.func
    def _distance_to(self, k, x, facing, margin):
        """Distance [m] of x from shape k, unknown if it is more than margin [m]."""
        d = UNKNOWN_DISTANCE
        if k < MAX_SHAPES:
            d = self.static_shapes.distance_within(k, x, margin)
        else:
            m = k - MAX_SHAPES
            if outside_box(self.bounds.low[m], self.bounds.high[m], x) < margin:
                d, _ = self.shapes.distance(m, x, facing)
        return d if d < margin else UNKNOWN_DISTANCE

    @ti.func
    def _may_touch(self, p, k):
        """True if shape k is another body and at least one of the two moves freely."""
        b = self.samples.body[p]
        result = self.rigid_bodies.kind[b] == FREE
        if k >= MAX_SHAPES:
            kind = self.rigid_bodies.kind[k - MAX_SHAPES]
            result = kind != SOFT and k - MAX_SHAPES != b
            result = result and (self.rigid_bodies.kind[b] == SOFT or self.rigid_bodies.kind[b] == FREE or kind == FREE)
        return result

    @ti.func
    def _offer(self, p, k):
        """Keep or drop shape k if sample p has it in a slot, else give it the slot of the farthest if it is near."""
        P = self.samples.capacity
        mine, farthest, most = -1, 0, -UNKNOWN_DISTANCE
        for slot in range(SLOTS):
            q = slot * P + p
            distance = self.distance[q] if self.shape[q] >= 0 else 2.0 * UNKNOWN_DISTANCE
            if self.shape[q] == k:
                mine = q
            if distance > most:
                farthest, most = q, distance
        d = UNKNOWN_DISTANCE
        if self._may_touch(p, k):
            d = self._sample_distance(p, k)
        if mine >= 0:
            if known(d):
                self.distance[mine] = d
            else:
                self._assign(mine, -1, UNKNOWN_DISTANCE)
        elif known(d) and d < most:
            self._assign(farthest, k, d)

    @ti.func
    def _assign(self, q, k, d):
        self.shape[q], self.distance[q], self.bounce_speed[q] = k, d, 0.0
        self.constraints.clear_impulse(self.begin + q)

    @ti.kernel
    def find(self):
        """Make the constraints of samples that can touch something before the next search candidates, and group them.

        The bounds must be up to date.
        """
        P = self.samples.capacity
        self.total[None] = 0
        for g in range(GROUPS):
            self.size[g], self.filled[g], self.active[g] = 0, 0, 0
        for p in range(P):
            if p < self.samples.count[None]:
                n = self.static_shapes.count[None]
                for k in range(n + self.state.body_count[None]):
                    self._offer(p, k if k < n else MAX_SHAPES + k - n)
        for q in range(SLOTS * P):
            p = q % P
            if p < self.samples.count[None] and self.shape[q] >= 0:
                r = self.begin + q
                self.constraints.add_candidate(r)
                g = self.group_of(q)
                self.constraints.set_vertex_count(r, 0)
                self.constraints.body_count[r] = 1
                if g < 0:
                    self.samples.set_vertices(p, r, self.constraints)
                    self.constraints.set_vertex_count(r, 3)
                else:
                    self.constraints.body_count[r] = 1 if self.shape[q] < MAX_SHAPES else 2
                    ti.atomic_add(self.size[g], 1)
        for g in range(GROUPS):
            if self.size[g] > 0:
                self.group_begin[g] = ti.atomic_add(self.total[None], self.size[g])
        for q in range(SLOTS * P):
            p = q % P
            if p < self.samples.count[None] and self.shape[q] >= 0:
                g = self.group_of(q)
                if g >= 0:
                    self.entry[self.group_begin[g] + ti.atomic_add(self.filled[g], 1)] = q
        for g in range(GROUPS):  # in a fixed order, whichever came first
            for e in range(self.group_begin[g] + 1, self.group_begin[g] + self.size[g]):
                q, at = self.entry[e], e
                while at > self.group_begin[g] and self.entry[at - 1] > q:
                    self.entry[at] = self.entry[at - 1]
                    at -= 1
                self.entry[at] = q
