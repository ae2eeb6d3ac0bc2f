"""Broad phase with rigid bodies: the shapes that each sample may touch until the next search, and groups of contacts.

Each sample keeps a few slots for the shapes that it is near; each slot is a contact constraint
(sim/contact/constraints.py), so that a contact keeps its impulse from search to search. Constraints between rigid
bodies alone form groups, one for each two bodies that touch; all static shapes count as one body.

Of contacts in a plane, those at the corners of their convex hull suffice: what they hold, they hold for all points
between them. Of these corners the farthest in each of a few directions are kept. The others are left out of a group
until the next search.
"""

import math

import taichi as ti
from taichi.math import vec3

from core.fields import FieldGroup
from core.lanes import dealt, lane_count, rank_lanes, sync_lanes
from sim.contact.broad_phase import outside_box
from sim.contact.narrow_phase import StaticContact
from sim.contact.response import CONTACT_SLOP
from sim.contact.static_shapes import MAX_SHAPES, UNKNOWN_DISTANCE, known, tangents
from sim.model import MAX_BODIES
from sim.rigid.rigid_bodies import FREE, SOFT, RigidShapes

SLOTS = 4  # shapes that one sample can touch at once: a floor, a wall and two neighbours
WORLD = MAX_BODIES  # the one body that all static shapes are
GROUPS = MAX_BODIES * (MAX_BODIES + 1)
STRAIGHT = 1e-3  # [rad] by which normals of one plane may differ
DIRECTIONS = 16  # in a plane, in each of which the farthest contact is kept: of a round foot 2% of the radius is lost
STEEPEST = 1e30  # inclination of a plane
# [m] by which others have to touch sooner than a contact that is left out: flat faces lean by rounding and by the slop.
# With half of this up to 14 contacts of two bricks carry a load, and a pass takes as long as its largest group.
HULL_TOLERANCE = 2.0 * CONTACT_SLOP


@ti.func
def bodies_of_group(g):
    """The two bodies of group g, the first of lower index; the second may be WORLD."""
    return g // (MAX_BODIES + 1), g % (MAX_BODIES + 1)


@ti.func
def below(ahead, beside, rise, least, most):
    """The part of least..most in which a plane of that inclination passes below a point.

    The point is so far ahead, to the left, and higher by `rise` [m]. Of two points as far ahead the one on the left
    counts as farther; a point that coincides with the plane's does not count.
    """
    low, high = least, most
    if ahead > CONTACT_SLOP:
        high = ti.min(high, rise / ahead)
    elif ahead < -CONTACT_SLOP:
        low = ti.max(low, rise / ahead)
    elif rise < 0.0 and beside > CONTACT_SLOP:
        high = 0.0
    elif rise < 0.0 and beside < -CONTACT_SLOP:
        low = ti.max(low, 0.5 * STEEPEST)
    return low, high


@ti.data_oriented
class RigidBroadPhase:
    """Slot q = slot P + p of sample p is constraint begin + q.

    shape i32[4P]: a static shape, or MAX_SHAPES + a body; -1 none;   distance f32[4P] [m], at the last search
    bounce_speed f32[4P] [m/s]: speed that an impact still asks for
    gap f32 [m], normal vec3 from the group's second body to its first, position vec3 [m] on its
    surface, all [4P]: at the last search
    size, group_begin i32[G]: constraints of a group, and where they begin in entry i32[4P], in the order of their slots
    group i32[G], group_count: the groups that have constraints
    listed, spare i32[4P]: the entries before they are sorted; whether an entry is left out
    active i32[G], loaded i32[4P]: how many of a group carry a load, and which; 1 before they are listed
    """

    def __init__(self, shapes: RigidShapes, static: StaticContact, begin: int):
        self.shapes, self.static_shapes, self.begin = shapes, static.shapes, begin
        self.state, self.rigid_bodies, self.samples = static.state, shapes.rigid_bodies, shapes.samples
        self.bounds, self.constraints = static.bounds, static.constraints
        self.lanes = lane_count()
        group, slots = FieldGroup(), SLOTS * self.samples.capacity
        with group.interleaved(slots):
            self.shape, self.entry = group.scalar(dtype=ti.i32), group.scalar(dtype=ti.i32)
            self.distance, self.bounce_speed = group.scalar(), group.scalar()
            self.listed, self.spare, self.loaded = (group.scalar(dtype=ti.i32) for _ in range(3))
        with group.interleaved(slots):
            self.gap, self.normal, self.position = group.scalar(), group.vector(), group.vector()
        with group.interleaved(GROUPS):
            self.size, self.group_begin, self.filled, self.active = (group.scalar(dtype=ti.i32) for _ in range(4))
            self.group = group.scalar(dtype=ti.i32)
        self.total, self.group_count = group.scalar(dtype=ti.i32), group.scalar(dtype=ti.i32)
        self._group = group
        group.build()

    def reset(self) -> None:
        """Forget all contacts."""
        self.shape.fill(-1)
        self.bounce_speed.fill(0.0)
        self.size.fill(0)
        self.group_count[None] = 0

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
        margin, x, d = self.bounds.max_speed[b] * s.detect_dt[None], self.samples.blend(p, s.x), UNKNOWN_DISTANCE
        if k < MAX_SHAPES:
            d = self.static_shapes.distance_within(k, x, margin)
        else:
            m = k - MAX_SHAPES
            margin += self.bounds.max_speed[m] * s.detect_dt[None]
            if outside_box(self.bounds.low[m], self.bounds.high[m], x) < margin:
                d, _ = self.shapes.distance(m, x, self.shapes.normal(p))
        return d if d < margin else UNKNOWN_DISTANCE

    @ti.func
    def surface_at(self, q, x):
        """Distance [m] of the sample of slot q, at x, from its shape, and the shape's normal there."""
        p, k = q % self.samples.capacity, self.shape[q]
        phi, n = UNKNOWN_DISTANCE, vec3(0.0)
        if k < MAX_SHAPES:
            phi, n = self.static_shapes.distance(k, x)
        else:
            phi, n = self.shapes.distance(k - MAX_SHAPES, x, self.shapes.normal(p))
        return phi, n

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
        """Keep or drop shape k if sample p has it in a slot, else give it a free slot, or that of a farther shape."""
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
        """Make candidates of what can touch before the next search, and group them; bounds must be up to date."""
        self.total[None], self.group_count[None] = 0, 0
        for g in range(GROUPS):
            self.size[g], self.filled[g], self.active[g] = 0, 0, 0
        for k in range(self.samples.capacity):
            p = dealt(k, self.samples.capacity)
            if p < self.samples.count[None]:
                n = self.static_shapes.count[None]
                for j in range(n + self.state.body_count[None]):
                    self._offer(p, j if j < n else MAX_SHAPES + j - n)
        self._count_groups()
        self._fill_groups()
        # Of a group only the corners of its lower hull, and what bounces, are left
        for step in range(self.total[None] * DIRECTIONS):
            k = dealt(step, self.total[None] * DIRECTIONS)
            e = k // DIRECTIONS
            if self.spare[e] and self._is_corner(e, k % DIRECTIONS):
                self.spare[e] = 0
        for k in range(GROUPS * self.lanes):
            self._thin_out(k // self.lanes, k % self.lanes)

    @ti.func
    def _count_groups(self):
        """Make contacts of soft bodies candidates; locate and count those of groups. Outermost level of a kernel."""
        P = self.samples.capacity
        for q in range(SLOTS * P):
            if self._in_use(q):
                g = self.group_of(q)
                if g < 0:
                    r = self.begin + q
                    self.samples.set_vertices(q % P, r, self.constraints)
                    self.constraints.set_vertex_count(r, 3)
                    self.constraints.body_count[r] = 1
                    self.constraints.add_candidate(r)
                else:
                    p = q % P
                    x, skin = self.samples.blend(p, self.state.x), self.samples.skin[p]
                    phi, n = self.surface_at(q, x)
                    self.gap[q], self.position[q], self.normal[q] = phi + skin, x + skin * n, self._side(q, g) * n
                    ti.atomic_add(self.size[g], 1)

    @ti.func
    def _fill_groups(self):
        """List the groups, and the slots of each in their order. Outermost level of a kernel."""
        for g in range(GROUPS):
            if self.size[g] > 0:
                self.group_begin[g] = ti.atomic_add(self.total[None], self.size[g])
                self.group[ti.atomic_add(self.group_count[None], 1)] = g
        for q in range(SLOTS * self.samples.capacity):
            if self._in_use(q):
                g = self.group_of(q)
                if g >= 0:  # in any order, which is put right below
                    self.listed[self.group_begin[g] + ti.atomic_add(self.filled[g], 1)] = q
        for e in range(SLOTS * self.samples.capacity):
            if e < self.total[None]:
                self._sort(self.listed[e])

    @ti.func
    def _in_use(self, q):
        return q % self.samples.capacity < self.samples.count[None] and self.shape[q] >= 0

    @ti.func
    def _side(self, q, g):
        """1 if slot q is a sample of the first body of group g, -1 if of the second."""
        return 1.0 if self.samples.body[q % self.samples.capacity] == bodies_of_group(g)[0] else -1.0

    @ti.func
    def _sort(self, q):
        """Put slot q into its place in its group; unless it bounces, it is spare until it proves to be a corner."""
        g, rank = self.group_of(q), 0
        for e in range(self.group_begin[g], self.group_begin[g] + self.size[g]):
            rank += ti.cast(self.listed[e] < q, ti.i32)
        e = self.group_begin[g] + rank
        self.entry[e], self.spare[e] = q, ti.cast(self.bounce_speed[q] == 0.0, ti.i32)

    @ti.func
    def _is_corner(self, e, k):
        """Test if entry e can touch sooner than all others over the same plane when the body tilts in direction k.

        It can if a plane through it, inclined in that direction, lies below all others. An entry that can in none of
        DIRECTIONS is no corner of their lower hull: what all others hold, it would hold as well.
        """
        q = self.entry[e]
        g = self.group_of(q)
        n = self._side(q, g) * self.normal[q]  # along which its own gap widens
        s, t = tangents(n)
        angle = (k + 0.5) * (2.0 * math.pi / DIRECTIONS)
        uphill = ti.cos(angle) * s + ti.sin(angle) * t
        left, least, most = n.cross(uphill), 0.0, STEEPEST  # inclinations that are left
        f, end = self.group_begin[g], self.group_begin[g] + self.size[g]
        while f < end and least < most:
            other = self.entry[f]
            v, rise = self.position[other] - self.position[q], self.gap[other] - self.gap[q]
            if (
                abs(rise - n.dot(v)) < CONTACT_SLOP
                and n.cross(self.normal[other]).norm() < STRAIGHT
                and (bodies_of_group(g)[1] != WORLD or self.shape[other] == self.shape[q])
            ):
                least, most = below(v.dot(uphill), v.dot(left), rise - HULL_TOLERANCE, least, most)
            f += 1
        return least < most

    @ti.func
    def _thin_out(self, g, lane):
        """Keep the entries of group g that are not spare, in their order, and make them candidates."""
        count, first, begin, size = 0, 0, self.group_begin[g], self.size[g]
        while first < size:
            e, q, kept = begin + first + lane, 0, 0
            if first + lane < size:
                q = self.entry[e]
                r = self.begin + q
                if self.spare[e]:
                    self.constraints.clear_impulse(r)
                    self.bounce_speed[q] = 0.0
                else:
                    kept = 1
                    self.constraints.set_vertex_count(r, 0)
                    self.constraints.body_count[r] = 1 if self.shape[q] < MAX_SHAPES else 2
                    self.constraints.add_candidate(r)
            before, total = rank_lanes(kept, lane, ti.static(self.lanes))
            if kept:
                self.entry[begin + count + before] = q
            count += total
            first += ti.static(self.lanes)
        sync_lanes(ti.static(self.lanes))
        if lane == 0:
            self.size[g] = count
