"""Nearest-tetrahedron query: the tet of another body that holds each contact sample or may come to it.

The points and their groups are the QueryPoints of sim/contact/contact_samples.py; a point looks for tets of other
groups, and of its own body where that may touch itself (SelfCollision in sim/contact/broad_phase.py). Of such a pair,
those close together at rest never meet: they are neighbours, and the narrow phase leaves them out too. Others stay
apart if an axis that separates them still does so when both have moved on at their velocities: rotation of both, and
motion past each other, hardly bring them closer along it.
"""

import numpy as np
import taichi as ti
from taichi.math import vec3

from core.fields import FieldGroup, Upload
from core.lanes import dealt, first_of, from_lane, int_from_lane, lane_count, max_lanes, vector_from_lane, vote
from core.morton import morton_order
from core.tetmesh import shared_face_pairs
from sim.contact.broad_phase import CONTACT_MARGIN, PointHash, SelfCollision, outside_box
from sim.contact.contact_samples import QueryPoints
from sim.contact.static_shapes import UNKNOWN_DISTANCE
from sim.model import MAX_BODIES, Model, RestShape, stacked

MIN_VOLUME_RATIO = 1e-3  # of the rest volume; of a tet crushed flatter, normals are rounding, and soon overflow
MIN_WEIGHT = -0.01  # barycentric; below it a point moves on to the neighbouring tet, but not to and fro on a face
NO_TET = 2**62  # a key above those of all tets
SEEDS = 64  # tets of a body at which the search from far away begins; from 8, descents into a ring end in dead ends
CELL_SIZE = 2.0  # [median edge] of the hash: few points in a cell, and few cells near a tet
VISITORS = 8  # threads that share the cells near a tet that may meet a point, on CUDA


@ti.func
def tet_edges(field: ti.template(), a):
    """Corner 0 of a tet with vertices a, in a field of positions, and the edges from it [m]."""
    x0 = field[a[0]]
    return x0, field[a[1]] - x0, field[a[2]] - x0, field[a[3]] - x0


@ti.func
def face_normals(e1, e2, e3):
    """Outward unit normals of a tet's faces, each opposite its corner; e1, e2, e3 are its edges from corner 0."""
    n1, n2, n3 = -e2.cross(e3).normalized(), -e3.cross(e1).normalized(), -e1.cross(e2).normalized()
    return (e2 - e1).cross(e3 - e1).normalized(), n1, n2, n3


@ti.func
def worst_face(r, e1, n0, n1, n2, n3):
    """The face plane beyond which r, relative to corner 0, is farthest, or least inside.

    Returns how far [m] beyond it, 0 inside (a lower bound of the distance from the tet), and its unit normal.
    """
    worst, normal = n0.dot(r - e1), n0
    for n in ti.static((n1, n2, n3)):
        if n.dot(r) > worst:
            worst, normal = n.dot(r), n
    return ti.max(worst, 0.0), normal


@ti.func
def tet_key(distance, t):
    """64-bit key that orders tets by distance [m], in steps of 1e-7 m, then by index: for an atomic minimum."""
    return (ti.cast(distance * 1e7, ti.i64) << 32) | ti.cast(t, ti.i64)


@ti.func
def tet_of_key(key):
    """Index of the tet of a key, -1 for NO_TET."""
    return -1 if key == ti.i64(NO_TET) else ti.cast(key & ti.i64(0x7FFFFFFF), ti.i32)


@ti.func
def rest_coordinates(s: ti.template(), t, x):
    """Barycentric and rest coordinates of the point x in tet t of the state s.

    Returns whether the tet has enough volume for them; the weights b (4,); the rest position X [m]; and as columns the
    gradients G of b_1..b_3 [1/m] and the rest edges E [m]: a gradient N at rest becomes F^-T N = G E^T N.
    """
    x0, e1, e2, e3 = tet_edges(s.x, s.tets[t])
    X0, E1, E2, E3 = tet_edges(s.rest, s.tets[t])
    det = e1.dot(e2.cross(e3))
    g1, g2, g3, X = E1, E2, E3, X0
    b = ti.Vector([1.0, 0.0, 0.0, 0.0])
    thick = det > MIN_VOLUME_RATIO * E1.dot(E2.cross(E3))
    if thick:
        g1, g2, g3 = e2.cross(e3) / det, e3.cross(e1) / det, e1.cross(e2) / det
        d = x - x0
        b1, b2, b3 = g1.dot(d), g2.dot(d), g3.dot(d)
        b = ti.Vector([1.0 - b1 - b2 - b3, b1, b2, b3])
        X = X0 + b1 * E1 + b2 * E2 + b3 * E3
    return thick, b, X, ti.Matrix.cols([g1, g2, g3]), ti.Matrix.cols([E1, E2, E3])


@ti.func
def bounding_sphere(field: ti.template(), a):
    """Centre and radius of a sphere around the values of a vec3 field at four vertices a."""
    center, radius = vec3(0.0), 0.0
    for j in ti.static(range(4)):
        center += 0.25 * field[a[j]]
    for j in ti.static(range(4)):
        radius = ti.max(radius, (field[a[j]] - center).norm())
    return center, radius


@ti.func
def neighborhood(s: ti.template(), t, distance):
    """Centre and radius [m] of a sphere around tet t at rest: of its body, points within never meet the tet.

    Its radius is `distance`, or what the narrow phase takes for a neighbour: half of that beyond the tet.
    """
    center, radius = bounding_sphere(s.rest, s.tets[t])
    return center, ti.max(distance, radius + 0.5 * distance)


@ti.func
def outside_sphere(p, center, radius):
    """Distance of p outside of a sphere; negative inside."""
    return (p - center).norm() - radius


@ti.func
def stay_apart(s: ti.template(), x, v, t, axis):
    """True if a unit axis goes on separating tet t of the state s and a point of its body at x [m], at v [m/s]."""
    a, gap, closing = s.tets[t], UNKNOWN_DISTANCE, 0.0
    for j in ti.static(range(4)):
        gap = ti.min(gap, axis.dot(x - s.x[a[j]]))
        closing = ti.max(closing, axis.dot(s.v[a[j]] - v))
    return gap >= CONTACT_MARGIN + closing * s.detect_dt[None]


@ti.dataclass
class TetOutline:
    """Quick bounds of where a tet can meet points until the next search."""

    body: ti.i32
    low: vec3  # box in which it can meet points [m]
    high: vec3
    max_distance: ti.f32  # from which it may come to a point [m], 0: from nowhere
    rest: vec3  # sphere within which points of its own body, at rest, never meet it [m]
    rest_radius: ti.f32
    center: vec3  # sphere around it [m]
    radius: ti.f32
    velocity: vec3  # sphere around the velocities of its corners [m/s]
    speed_radius: ti.f32


@ti.data_oriented
class NearestTets:
    """The host of each point: the tet of another group that is nearest to it.

    Within a cell's size that is exact. For what may come from farther away until the next search, the search begins at
    the nearest of a body's SEEDS tets, and goes from neighbor to neighbor while that is nearer: a fast body comes near
    all.

    host i32[N]: the tet;   neighbor vec4i[T]: tet across each corner's face;   rest vec3[N] [m]: samples at rest
    entry_group i32[N], and of bodies' samples entry_rest [m] and entry_velocity [m/s] vec3[N]: of the hash's entries
    order i32[ordered_count]: the tets, those of a warp close to one another, and -1 in places that are left
    max_approach f32[B,G] [m]: how far body b and group g may approach until the next search, 0 if they cannot meet
    """

    def __init__(self, points: QueryPoints, self_collision: SelfCollision | None):
        self.self_collision, self.self_collides = self_collision, self_collision is not None
        self.points, self.state, self.samples, self.bounds = points, points.state, points.samples, points.bounds
        self.fingers, self.has_fingers = points.fingers, points.has_fingers
        state = self.state
        self.lanes = lane_count()
        self.visitors = VISITORS if self.lanes > 1 else 1
        self.hash = PointHash(self.points.size)
        group, N, G = FieldGroup(), self.hash.points, self.points.groups
        self.key, self.host = group.scalar(N, dtype=ti.i64), group.scalar(N, dtype=ti.i32)
        self.max_approach, self.wanted = group.scalar(MAX_BODIES, G), group.scalar(G, dtype=ti.i32)
        self.neighbor = group.vector(state.T, n=4, dtype=ti.i32)
        self.rest = group.vector(N)
        with group.interleaved(N):
            self.entry_group, self.entry_rest = group.scalar(dtype=ti.i32), group.vector()
            self.entry_velocity = group.vector()
        self.any_near, self.nearby_count = group.scalar(dtype=ti.i32), group.scalar(dtype=ti.i32)
        self.nearby = group.scalar(state.T, dtype=ti.i32)  # tets that may meet a point, in any order
        self.order = group.scalar(state.T + self.lanes * MAX_BODIES, dtype=ti.i32)
        self.ordered_count = group.scalar(dtype=ti.i32)
        self._group = group
        group.build()
        self._upload = Upload([self.neighbor, self.rest, self.hash.cell, self.order, self.ordered_count])

    def load(self, model: Model) -> None:
        """Take the tets of these bodies."""
        shapes, begin = model.shapes, model.tet_begin
        near = [s.root.once(tet_neighbors) for s in shapes]
        near = stacked([np.where(n < 0, n, n + o) for n, o in zip(near, begin, strict=False)], 4)
        edges = [s.edge for s in shapes if len(s.tets)]  # a rigid body's would make cells that hold all points
        edge = float(np.median(edges)) if edges else 0.0
        ids, weights = self.samples.host_ids, self.samples.host_weights
        rest = (stacked([s.vertices for s in shapes], 3)[ids] * weights[..., None]).sum(1)
        runs = [s.root.once(compact_runs, self.lanes) for s in shapes]
        order = stacked([np.where(r < 0, r, r + o) for r, o in zip(runs, begin, strict=False)])
        self._upload([near, rest, CELL_SIZE * edge or self.samples.spacing, order, len(order)])

    @ti.func
    def next_host(self, t, b):
        """Return the tet to look in next for a point of weights b in tet t: across the face it is farthest beyond."""
        result, worst = t, MIN_WEIGHT
        for j in ti.static(range(4)):
            if b[j] < worst and self.neighbor[t][j] >= 0:
                result, worst = self.neighbor[t][j], b[j]
        return result

    @ti.func
    def sweep(self, low, high, v_min, v_max, g):
        """Swept overlap of group g and a box that moves with velocities v_min..v_max, until the next search.

        Returns the part of g's box in which they can meet, whether there is any, and how far [m] they may approach.
        """
        t, margin = self.state.detect_dt[None], CONTACT_MARGIN + self.points.reach(g)
        other_low, other_high, other_min, other_max = self.points.box(g)
        back, forth = ti.min((v_min - other_max) * t, 0.0), ti.max((v_max - other_min) * t, 0.0)
        a, b = ti.max(low + back - margin, other_low), ti.min(high + forth + margin, other_high)
        return a, b, (a - b).max() <= 0.0, margin + ti.max(-back, forth).norm()

    @ti.kernel
    def find(self, constraints: ti.template(), begin: ti.i32):
        """Find the host of each point; that of point p makes constraint begin + p a candidate."""
        self.any_near[None], self.hash.total[None], self.nearby_count[None] = 0, 0, 0
        self._find_meetings()
        self._hash_points()
        # Few tets meet anything: the others are sorted out first, in a loop of its own that needs few registers
        for k in range(self.ordered_count[None]):
            if self.any_near[None]:
                self._list_if_nearby(self.order[dealt(k, self.ordered_count[None])], k % self.lanes)
        for k in range(self.nearby_count[None] * self.visitors):
            self._visit(self.nearby[k // self.visitors], k % self.visitors)
        self._set_hosts(constraints, begin)

    @ti.func
    def _find_meetings(self):
        """Find which bodies come near which groups until the next search. Outermost level of a kernel."""
        s, box = self.state, self.bounds
        for g in self.wanted:
            self.wanted[g] = 0
        for b, g in self.max_approach:
            n = s.body_count[None]
            meets, approach = False, 0.0
            alone = b == g
            if ti.static(self.self_collides):
                alone = b == g and self.self_collision.self_colliding[b] == 0
            if b < n and not alone and self.points.is_group(g):
                _low, _high, meets, approach = self.sweep(box.low[b], box.high[b], box.v_min[b], box.v_max[b], g)
            self.max_approach[b, g] = approach if meets else 0.0
            if meets:
                self.wanted[g] = 1
                self.any_near[None] = 1

    @ti.func
    def _hash_points(self):
        """Put the points of the groups that bodies come near into the hash. Outermost level of a kernel."""
        s, h = self.state, self.hash
        for bucket in range(h.buckets):
            h.size[bucket] = 0
        for p in range(h.points):
            self.key[p] = ti.i64(NO_TET)
            if self._searches(p):
                h.count(p, self.points.position(p, True))
        for bucket in range(h.buckets):
            h.allocate(bucket)
        for p in range(h.points):
            if self._searches(p):
                e = h.insert(p, self.points.position(p, True))
                self.entry_group[e] = self.points.group(p)
                if p < self.samples.count[None]:
                    self.entry_rest[e], self.entry_velocity[e] = self.rest[p], self.samples.blend(p, s.v)

    @ti.func
    def _set_hosts(self, constraints: ti.template(), begin):
        """Make the constraint of each point that has a host a candidate. Outermost level of a kernel."""
        s = self.state
        for p in range(self.hash.points):
            host = tet_of_key(self.key[p])
            if host < 0 and self._searches(p):
                host = self._approaching(p)
            if host < 0 or s.body_of_tet[host] != s.body_of_tet[self.host[p]]:
                constraints.clear_impulse(begin + p)  # it was of a contact with another body
            if host >= 0:
                self.host[p] = host
                constraints.add_candidate(begin + p)

    @ti.func
    def _searches(self, p):
        """True if some body comes near point p's group."""
        result = False
        if self.points.exists(p) and self.any_near[None]:
            result = self.wanted[self.points.group(p)] != 0
        return result

    @ti.func
    def _reach(self, t):
        """Box in which tet t can meet points until the next search, and the largest distance [m] it may come from."""
        s = self.state
        body = s.body_of_tet[t]
        low, high, v_min, v_max = self._box(t)
        box_low, box_high, max_distance = vec3(UNKNOWN_DISTANCE), vec3(-UNKNOWN_DISTANCE), 0.0
        for k in range(self.points.group_count()):
            g = self.points.group_at(k)
            if self.max_approach[body, g] > 0.0:
                part_low, part_high, meets, approach = self.sweep(low, high, v_min, v_max, g)
                near = self._near(g)
                part_low, part_high = ti.max(part_low, low - near), ti.min(part_high, high + near)
                approach = ti.min(approach, near)
                if ti.static(self.self_collides):  # noqa: SIM102
                    if g == body:  # the part of its own box that the tet can meet
                        approach = self.self_collision.reach(t)
                        part_low = ti.max(low - approach, self.bounds.low[body])
                        part_high = ti.min(high + approach, self.bounds.high[body])
                if meets:
                    box_low, box_high = ti.min(box_low, part_low), ti.max(box_high, part_high)
                    max_distance = ti.max(max_distance, approach)
        return box_low, box_high, max_distance

    @ti.func
    def _list_if_nearby(self, t, lane):
        """Add tet t to `nearby` if a point may meet it, by what is quickly known of both; -1: no tet.

        The lanes of a warp, which have tets close to one another, look at each point near any of these together: cell
        by cell of the box around all of their boxes, until each lane has found a point or all points have been seen.
        """
        s, h = self.state, self.hash
        lanes = ti.static(self.lanes)
        tet = TetOutline(body=-1, low=vec3(UNKNOWN_DISTANCE), high=vec3(-UNKNOWN_DISTANCE), max_distance=0.0)
        if t >= 0:
            tet.body = s.body_of_tet[t]
            tet.low, tet.high, tet.max_distance = self._reach(t)
        low, high = tet.low, tet.high
        for axis in ti.static(range(3)):
            low[axis] = from_lane(-max_lanes(-tet.low[axis], lanes), 0, lanes)
            high[axis] = from_lane(max_lanes(tet.high[axis], lanes), 0, lanes)
        searches, found = tet.max_distance > 0.0, False
        searching = vote(searches, lanes)
        if searching != 0:
            if ti.static(self.self_collides):  # noqa: SIM102
                if searches:
                    distance = self.self_collision.min_rest_distance(tet.body)
                    tet.rest, tet.rest_radius = neighborhood(s, t, distance)
                    tet.center, tet.radius = bounding_sphere(s.x, s.tets[t])
                    tet.velocity, tet.speed_radius = bounding_sphere(s.v, s.tets[t])
            first, last = h.cell_range(low, high)
            cells, cell = last - first, 0
            count = cells.x * cells.y * cells.z
            while cell < count and searching != 0:
                begin, size = 0, 0  # entries in the bucket of a lane's cell
                if cell + lane < count:
                    bucket = self._bucket(first, cells, cell + lane)
                    begin, size = h.begin[bucket], h.size[bucket]
                filled = vote(size > 0, lanes)
                while filled != 0 and searching != 0:  # the lanes' buckets, one after the other
                    of = first_of(filled)
                    e, end = int_from_lane(begin, of, lanes), int_from_lane(size, of, lanes)
                    end += e
                    while e < end:
                        found = self._look_at(e + lane, end, tet, low, high, searches, found)
                        e += lanes
                    searching = vote(searches and not found, lanes)
                    filled &= filled - ti.u32(1)
                cell += lanes
        if found:
            self.nearby[ti.atomic_add(self.nearby_count[None], 1)] = t

    @ti.func
    def _look_at(self, e, end, tet, low, high, searches, found):
        """Test the entries that the lanes hold, e < end, against the tet of each lane.

        low, high: the box around all lanes' boxes. Returns whether this lane has found a point, now or before.
        """
        h = self.hash
        lanes = ti.static(self.lanes)
        x, x_rest, x_v, g, near = vec3(0.0), vec3(0.0), vec3(0.0), 0, False
        if e < end:
            x, g = h.position[e], self.entry_group[e]
            x_rest, x_v = self.entry_rest[e], self.entry_velocity[e]
            near = outside_box(low, high, x) <= 0.0
        result, those = found, vote(near, lanes)
        while those != 0:
            k = first_of(those)
            y, y_rest = vector_from_lane(x, k, lanes), vector_from_lane(x_rest, k, lanes)
            y_v = vector_from_lane(x_v, k, lanes)
            group = int_from_lane(g, k, lanes)
            if searches and not result and outside_box(tet.low, tet.high, y) <= 0.0:
                result = self.max_approach[tet.body, group] > 0.0
                if ti.static(self.self_collides):  # noqa: SIM102
                    if group == tet.body:
                        speed = (y_v - tet.velocity).norm() + tet.speed_radius
                        closing = CONTACT_MARGIN + speed * self.state.detect_dt[None]
                        result = result and outside_sphere(y, tet.center, tet.radius) < closing
                        result = result and outside_sphere(y_rest, tet.rest, tet.rest_radius) > 0.0
            those &= those - ti.u32(1)
        return result

    @ti.func
    def _bucket(self, first, cells, k):
        """Bucket of the k-th cell of a box of cells."""
        h = self.hash
        return h.bucket_of(first + ti.Vector([k // (cells.y * cells.z), k // cells.z % cells.y, k % cells.z]))

    @ti.func
    def _visit(self, t, visitor):
        """Offer tet t to what it can meet in a visitor's share of the cells; the lowest (distance, t) wins."""
        s, h = self.state, self.hash
        body = s.body_of_tet[t]
        box_low, box_high, max_distance = self._reach(t)
        x0, e1, e2, e3 = tet_edges(s.x, s.tets[t])
        if max_distance > 0.0 and e1.dot(e2.cross(e3)) > 0.0:
            n0, n1, n2, n3 = face_normals(e1, e2, e3)
            first, last = h.cell_range(box_low, box_high)
            cells, cell = last - first, visitor
            while cell < cells.x * cells.y * cells.z:
                bucket = self._bucket(first, cells, cell)
                for e in range(h.begin[bucket], h.begin[bucket] + h.size[bucket]):
                    x = h.position[e]
                    if outside_box(box_low, box_high, x) <= 0.0:
                        outside, face = worst_face(x - x0, e1, n0, n1, n2, n3)
                        if outside < max_distance:  # noqa: SIM102
                            if self._may_meet(e, t, body, outside, face):
                                ti.atomic_min(self.key[h.entry[e]], tet_key(outside, t))
                cell += self.visitors

    @ti.func
    def _near(self, g):
        """Distance [m] from a point of group g within which all tets are searched."""
        return self.hash.cell[None] + self.points.reach(g)

    @ti.func
    def _approaching(self, p):
        """Tet that may come to point p from far away, by descent from a seed to ever nearer neighbors; -1 if none."""
        s, x, g = self.state, self.points.position(p, True), self.points.group(p)
        box = self.bounds
        best, now = UNKNOWN_DISTANCE, -1
        for b in range(s.body_count[None]):
            if b != g and not self.points.spares(p, b) and self.max_approach[b, g] > self._near(g):
                low, high, _meets, _approach = self.sweep(box.low[b], box.high[b], box.v_min[b], box.v_max[b], g)
                if outside_box(low, high, x) <= 0.0:
                    first, n = s.tet_begin[b], s.tet_begin[b + 1] - s.tet_begin[b]
                    count = ti.min(n, SEEDS)  # none of a rigid body
                    for k in range(count):
                        t = first + k * n // ti.max(count, 1)  # the division may be hoisted out of an empty loop
                        d = (x - s.x[s.tets[t][0]]).norm_sqr()
                        if d < best:
                            best, now = d, t
        descending = now >= 0
        if descending:
            best = self._outside(now, x)
        while descending:
            here = now
            for j in range(4):
                t = self.neighbor[here][j]
                if t >= 0:
                    d = self._outside(t, x)
                    if d < best:
                        best, now = d, t
            descending = now != here
        if now >= 0:
            low, high, v_min, v_max = self._box(now)
            _low, _high, meets, approach = self.sweep(low, high, v_min, v_max, g)
            if not meets or best >= approach:
                now = -1
        return now

    @ti.func
    def _box(self, t):
        """Box of the positions of tet t, low and high, and of its velocities with their gain, v_min and v_max."""
        s, a = self.state, self.state.tets[t]
        x0, x1, x2, x3 = s.x[a[0]], s.x[a[1]], s.x[a[2]], s.x[a[3]]
        v0, v1, v2, v3 = s.v[a[0]], s.v[a[1]], s.v[a[2]], s.v[a[3]]
        gain = self.bounds.speed_gain[s.body_of_tet[t]]
        v_min, v_max = ti.min(v0, v1, v2, v3) - gain, ti.max(v0, v1, v2, v3) + gain
        return ti.min(x0, x1, x2, x3), ti.max(x0, x1, x2, x3), v_min, v_max

    @ti.func
    def _outside(self, t, x):
        """Distance [m] of x beyond the worst face of tet t, 0 inside; UNKNOWN_DISTANCE if the tet is inverted."""
        x0, e1, e2, e3 = tet_edges(self.state.x, self.state.tets[t])
        result = UNKNOWN_DISTANCE
        if e1.dot(e2.cross(e3)) > 0.0:
            n0, n1, n2, n3 = face_normals(e1, e2, e3)
            result, _face = worst_face(x - x0, e1, n0, n1, n2, n3)
        return result

    @ti.func
    def _may_meet(self, e, t, body, outside, face):
        """True if tet t may meet the point of entry e, `outside` [m] beyond its face of this normal, before long."""
        p, x = self.hash.entry[e], self.hash.position[e]
        result = self.max_approach[body, self.entry_group[e]] > 0.0
        if ti.static(self.has_fingers):  # noqa: SIM102
            if self.points.spares(p, body):
                result = False
                self.fingers.note_overlap(p - self.points.first_finger, outside)
        if ti.static(self.self_collides):  # noqa: SIM102
            if self.entry_group[e] == body:
                s = self.state
                a = s.tets[t]
                rest, rest_radius = neighborhood(s, t, self.self_collision.min_rest_distance(body))
                result = result and outside_sphere(self.entry_rest[e], rest, rest_radius) > 0.0
                part = self.self_collision.part[a[0]]
                result = result and (part < 0 or part != self.self_collision.part[self.samples.ids[p][0]])
                for k in ti.static(range(3)):
                    for j in ti.static(range(4)):
                        result = result and self.samples.ids[p][k] != a[j]
                away = x - 0.25 * (s.x[a[0]] + s.x[a[1]] + s.x[a[2]] + s.x[a[3]])
                for axis in ti.static((away / ti.max(away.norm(), 1e-12), face)):
                    result = result and not stay_apart(s, x, self.entry_velocity[e], t, axis)
        return result


def compact_runs(shape: RestShape, length: int) -> np.ndarray:
    """The tets of a rest shape in runs of this length, each of nearby tets; the last run is filled up with -1."""
    order = morton_order(shape.vertices[shape.tets].mean(axis=1))
    return np.concatenate([order, np.full(-len(order) % length, -1)])


def tet_neighbors(shape: RestShape) -> np.ndarray:
    """Tet across the face opposite each corner of a rest shape's tets, -1 at the surface, (T, 4) int32."""
    result = np.full(4 * len(shape.tets), -1, np.int32)
    a, b = shared_face_pairs(shape.tets).T
    result[a], result[b] = b // 4, a // 4
    return result.reshape(-1, 4)
