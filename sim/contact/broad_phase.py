"""Broad phase: swept bounds of the bodies, which of them may touch themselves, and a hash of points."""

import numpy as np
import taichi as ti
from taichi.math import vec3

from core.fields import FieldGroup, Upload, round_up_capacity
from core.lanes import lane_count, max_by_key, max_lanes
from core.tetmesh import vertex_components
from sim.elastic.energy import energy_density
from sim.model import MAX_BODIES, BodyModel, Model, RestShape
from sim.state import State

# [m] added to the motion that is expected: what that estimate lacks, such as a push out of the floor or through several
# bodies. With half as much, a cube that is pushed out of the floor enters one that floats 1.5 mm above it by 3 mm in a
# frame. It also keeps the time until the next look finite: what rests without gravity is expected not to move at all.
CONTACT_MARGIN = 0.002
MIN_REST_DISTANCE = 5.0  # [max. displacement of a substep, half an edge]: points closer at rest do not collide
SHAPE_SUMS = 34  # m; m x, m X, m v; m X X^T, its upper half; m x X^T, m v X^T
FLOAT_MAX = 3.0e38  # larger than any coordinate, finite in float32
MAX_QUERY_CELLS = 24  # of the hash along each axis; a box that large has exploded, and would take hours


@ti.func
def outside_box(low, high, x):
    """Distance [m] of x outside of a box along the axis where that is most; negative inside."""
    return ti.max(low - x, x - high).max()


@ti.func
def gap_of_boxes(low, high, other_low, other_high):
    """Gap [m] between two boxes along the axis where it is largest; negative where they overlap."""
    return ti.max(low - other_high, other_low - high).max()


@ti.data_oriented
class BodyBounds:
    """Swept (speculative) bounds of the bodies: positions, velocities, and the speed gained until the next search.

    Contacts are searched for as far away as bodies can come; a bound that is too low lets a thin plate tunnel. Of
    body b, whose vertices move at speed_b, with t the time until the next search,

        gain_b = |g| t + sqrt(2 max Psi / rho) + max min(|target - x| / t, a t)

    because energy Psi [J/m^3] that springs back moves matter at sqrt(2 Psi / rho), and a hand's spring is critically
    damped: its vertices go to their target and not beyond, with the acceleration a at most. What a body c in its path
    may hit moves on at 2 m_c / (m_b + m_c) times the speed of c, at most (elastic and head-on).

    low, high vec3[B] [m]: box of positions;   v_min, v_max vec3[B] [m/s]: of velocities, with the gain
    speed f32[B] [m/s]: upper bound of the speed of its vertices;   speed_gain f32[B] [m/s]: what may come on top
    max_speed f32[B] [m/s]: the speed that no vertex is expected to exceed, on average, until the next search
    spring_speed, grasp_speed f32[B] [m/s]: the two maxima above;   impact_speed f32[B] [m/s]: that b brings
    """

    def __init__(self, state: State, blocks, grasps):
        self.state, self.blocks, self.grasps = state, blocks, grasps
        group = self._group = FieldGroup()
        self.partial = group.vector(blocks.size, 4)
        with group.interleaved(MAX_BODIES):
            self.low, self.high, self.v_min, self.v_max = (group.vector() for _ in range(4))
        self.max_speed, self.speed, self.speed_gain = (group.scalar(MAX_BODIES) for _ in range(3))
        self.spring_speed, self.grasp_speed, self.impact_speed = (group.scalar(MAX_BODIES) for _ in range(3))
        group.build()

    @ti.func
    def update(self):
        """Compute the bounds, for the hands' poses of this frame too. Outermost level of a kernel."""
        self._find_boxes()
        self._add_gains()

    @ti.func
    def _find_boxes(self):
        """Boxes without gains. Outermost level of a kernel."""
        s = self.state
        c = self.blocks
        for w in range(c.size * c.lanes):
            j, lane = w // c.lanes, w % c.lanes
            span = c.span[j]
            low, high = vec3(FLOAT_MAX), vec3(-FLOAT_MAX)
            v_min, v_max = low, high
            i = span[0] + lane
            while i < span[1]:
                low, high = ti.min(low, s.x[i]), ti.max(high, s.x[i])
                v_min, v_max = ti.min(v_min, s.v[i]), ti.max(v_max, s.v[i])
                i += c.lanes
            low, high, v_min, v_max = self._combined(low, high, v_min, v_max)
            if lane == 0:
                self.partial[j, 0], self.partial[j, 1], self.partial[j, 2], self.partial[j, 3] = low, high, v_min, v_max
        for w in range(MAX_BODIES * c.lanes):
            b, lane = w // c.lanes, w % c.lanes
            if b < s.body_count[None]:
                low, high = vec3(FLOAT_MAX), vec3(-FLOAT_MAX)
                v_min, v_max = low, high
                j = c.begin[b] + lane
                while j < c.begin[b + 1]:
                    low, high = ti.min(low, self.partial[j, 0]), ti.max(high, self.partial[j, 1])
                    v_min, v_max = ti.min(v_min, self.partial[j, 2]), ti.max(v_max, self.partial[j, 3])
                    j += c.lanes
                low, high, v_min, v_max = self._combined(low, high, v_min, v_max)
                if lane == 0:
                    self.low[b], self.high[b], self.v_min[b], self.v_max[b] = low, high, v_min, v_max
                    self.speed[b] = ti.max(abs(v_min), abs(v_max)).norm()

    @ti.func
    def _combined(self, low, high, v_min, v_max):
        """The bounds of all lanes together, in the first of them."""
        lanes = ti.static(self.blocks.lanes)
        for k in ti.static(range(3)):
            low[k], high[k] = -max_lanes(-low[k], lanes), max_lanes(high[k], lanes)
            v_min[k], v_max[k] = -max_lanes(-v_min[k], lanes), max_lanes(v_max[k], lanes)
        return low, high, v_min, v_max

    @ti.func
    def _add_gains(self):
        """Add the speeds that bodies may gain. Outermost level of a kernel."""
        s = self.state
        for b in range(MAX_BODIES):
            self.spring_speed[b] = 0.0
            self.grasp_speed[b] = 0.0
        lanes = ti.static(lane_count())
        for t in range(s.T):  # whole warps: T is a multiple of them
            b, speed = 0, 0.0
            if t < s.tet_count[None]:
                b, speed = s.body_of_tet[t], self._spring_speed(t)
            max_by_key(self.spring_speed, b, speed, t % lanes, lanes)
        if ti.static(self.grasps.count > 0):
            for i in range(s.V):
                if i < s.vertex_count[None] and self.grasps.held[i] != 0:
                    ti.atomic_max(self.grasp_speed[s.body_of_vertex[i]], self.grasps.max_speed_gain(i))
        for b in range(MAX_BODIES):
            if b < s.body_count[None]:
                t = s.detect_dt[None]
                gain = s.gravity[None].norm() * t + self.spring_speed[b] + self.grasp_speed[b]
                self.impact_speed[b] = self.speed[b] + gain
        for b in range(MAX_BODIES):
            if b < s.body_count[None]:
                gain = self._after_impact(b) - self.speed[b]
                self.v_min[b] -= gain
                self.v_max[b] += gain
                self.speed_gain[b] = gain
                self.max_speed[b] = self.speed[b] + gain + CONTACT_MARGIN / s.detect_dt[None]

    @ti.func
    def _spring_speed(self, t):
        """sqrt(2 Psi / rho) of a tet [m/s]."""
        s = self.state
        a = s.tets[t]
        b = s.body_of_tet[t]
        x0, X0 = s.x[a[0]], s.rest[a[0]]
        e = ti.Matrix.cols([s.x[a[1]] - x0, s.x[a[2]] - x0, s.x[a[3]] - x0])
        E = ti.Matrix.cols([s.rest[a[1]] - X0, s.rest[a[2]] - X0, s.rest[a[3]] - X0])
        F = e @ E.inverse()
        psi = energy_density((F.transpose() @ F).trace(), F.determinant() - 1.0, s.mu[b], s.lam[b])
        return ti.sqrt(2.0 * ti.max(psi, 0.0) / s.density[b])

    @ti.func
    def _after_impact(self, b):
        """Speed [m/s] of body b, or the one it has after a faster body has hit it, if one may."""
        s = self.state
        t = s.detect_dt[None]
        result = self.impact_speed[b]
        for c in range(s.body_count[None]):
            margin = (self.impact_speed[b] + self.impact_speed[c]) * t + CONTACT_MARGIN
            apart = gap_of_boxes(self.low[b], self.high[b], self.low[c], self.high[c])
            if c != b and apart < margin:
                transfer = 2.0 * s.body_mass[c] / (s.body_mass[b] + s.body_mass[c])
                result = ti.max(result, transfer * self.impact_speed[c])
        return result


@ti.data_oriented
class PointHash:
    """Spatial hash of points (Teschner et al. 2003): empty buckets, `count`, `allocate`, `insert`, and query.

    cell f32 is a cell's size [m]; entry i32[N] the points and position vec3[N] where they are, cell after cell; begin,
    size i32[] the range of each bucket.

    An atomic counter decides where a cell's points lie: it differs from run to run, but what a query finds does not.
    """

    def __init__(self, points: int):
        self.points, self.buckets = round_up_capacity(points), 1 << max(8, int(np.ceil(np.log2(2 * points + 1))))
        group = self._group = FieldGroup()
        with group.interleaved(self.points):
            self.bucket, self.rank = group.scalar(dtype=ti.i32), group.scalar(dtype=ti.i32)
        with group.interleaved(self.points):
            self.entry, self.position = group.scalar(dtype=ti.i32), group.vector()
        with group.interleaved(self.buckets):
            self.size, self.begin = group.scalar(dtype=ti.i32), group.scalar(dtype=ti.i32)
        self.total, self.cell = group.scalar(dtype=ti.i32), group.scalar()
        group.build()

    @ti.func
    def cell_of(self, p):
        return ti.floor(p / self.cell[None], ti.i32)

    @ti.func
    def bucket_of(self, c):
        return (c[0] * 73856093 ^ c[1] * 19349663 ^ c[2] * 83492791) & (self.buckets - 1)

    @ti.func
    def count(self, k, p):
        """Count point k at p in its bucket."""
        bucket = self.bucket_of(self.cell_of(p))
        self.bucket[k] = bucket
        self.rank[k] = ti.atomic_add(self.size[bucket], 1)

    @ti.func
    def allocate(self, bucket):
        """Give a bucket its range of entries; `total` must be 0 before the first."""
        if self.size[bucket] > 0:
            self.begin[bucket] = ti.atomic_add(self.total[None], self.size[bucket])

    @ti.func
    def insert(self, k, p):
        """Put point k at p into its bucket's range; returns its entry."""
        e = self.begin[self.bucket[k]] + self.rank[k]
        self.entry[e], self.position[e] = k, p
        return e

    @ti.func
    def cell_range(self, low, high):
        """First cell of a box and one past its last, at most MAX_QUERY_CELLS along each axis."""
        first = self.cell_of(low)
        return first, ti.min(self.cell_of(high) + 1, first + MAX_QUERY_CELLS)


@ti.data_oriented
class SelfCollision:
    """Self-collision candidates: the bodies bent so far that they may touch themselves; the others are not searched.

    With the best affine map A of the rest shape onto a body, and r the largest distance of a vertex from where A has
    it, two points that are d apart at rest are at least sigma_min(A) d - 2 r apart. Velocities are fitted likewise, by
    G and r_v; rotation does not bring points together, so that in the time t they approach by at most 2 r_v t, and by
    the fraction |sym(G A^-1)| t of their distance. While something is left beyond CONTACT_MARGIN, nothing of the body
    can meet itself. With X, x, v relative to the means,

        A = (sum m x X^T) S^-1,   G = (sum m v X^T) S^-1,   S = sum m X X^T

    and sigma_min from |A^T A - I|, or from |A^-1| where the body is squeezed as a whole.

    self_colliding i32[B]: whether a body may touch itself;   disabled i32[B]: whether it passes through itself
    part i32[V]: number of a vertex's part where only the parts of its body meet each other, else -1
    search_distance f32[B] [m]: how far two points may approach, apart from the affine motion
    sums f32[blocks,34], total f32[B,34];   fit, gradient mat3[B] = A, G
    center, rest_center, velocity vec3[B]: the means
    residual, speed_residual f32[B]: the largest distances r [m] and r_v [m/s] from the fits
    """

    def __init__(self, state: State, blocks, bounds: BodyBounds):
        self.state, self.blocks, self.bounds = state, blocks, bounds
        group, B = FieldGroup(), MAX_BODIES
        self.sums, self.total = group.scalar(blocks.size, SHAPE_SUMS), group.scalar(B, SHAPE_SUMS)
        self.part = group.scalar(state.V, dtype=ti.i32)
        self.self_colliding, self.disabled = group.scalar(B, dtype=ti.i32), group.scalar(B, dtype=ti.i32)
        self.search_distance, self.residual, self.speed_residual = (group.scalar(B) for _ in range(3))
        self.fit, self.gradient = group.matrix(B), group.matrix(B)
        self.center, self.rest_center, self.velocity = (group.vector(B) for _ in range(3))
        self._group = group
        group.build()
        self._upload = Upload([self.disabled, self.part])

    def load(self, model: Model) -> None:
        """Take these bodies; some pass through themselves."""
        parts = [part_of_vertices(p) for p in model.bodies]
        alone = [not part.any() for part in parts]  # of one part
        passes = [not (p.body.rigid or p.body.self_contact) for p in model.bodies]
        self._upload([np.logical_or(passes, alone), np.concatenate([np.zeros(0, np.int32), *parts])])

    @ti.func
    def min_rest_distance(self, b):
        """Least distance at rest [m] between two points of body b that may collide."""
        return MIN_REST_DISTANCE * self.state.max_step[b]

    @ti.func
    def closing_speed(self, b):
        """Speed [m/s] at which points of body b may come towards each other."""
        return 2.0 * self.speed_residual[b] + self.bounds.speed_gain[b] + CONTACT_MARGIN / self.state.detect_dt[None]

    @ti.func
    def reach(self, t):
        """Distance [m] by which tet t and another point of its body may approach, apart from the affine motion."""
        s = self.state
        b, speed = s.body_of_tet[t], 0.0
        for j in ti.static(range(4)):
            speed = ti.max(speed, self._residual_velocity(s.tets[t][j], b).norm())
        distance = (speed + self.speed_residual[b]) * s.detect_dt[None] + CONTACT_MARGIN
        return ti.min(distance, self.search_distance[b])

    @ti.func
    def _residual_velocity(self, i, b):
        """Velocity [m/s] of vertex i of body b apart from the affine motion."""
        s = self.state
        return s.v[i] - self.velocity[b] - self.gradient[b] @ (s.rest[i] - self.rest_center[b])

    @ti.func
    def update(self):
        """Find the bodies that may touch themselves; the bounds must be up to date. Outermost level of a kernel."""
        s = self.state
        c = self.blocks
        for w in range(c.size * c.lanes):
            j = w // c.lanes
            span = c.span[j]
            if span[1] > span[0]:
                self._sum(j, span, w % c.lanes)
        for w in range(MAX_BODIES * SHAPE_SUMS * c.lanes):
            bk, lane = w // c.lanes, w % c.lanes
            b, k = bk // SHAPE_SUMS, bk % SHAPE_SUMS
            total = c.sum_by_lanes(self.sums, b, k, lane, c.lanes)
            if lane == 0:
                self.total[b, k] = total
        for b in range(MAX_BODIES):
            if b < s.body_count[None]:
                self._fit(b)
        for i in range(s.V):  # whole warps: V is a multiple of them
            b, r, r_v = 0, 0.0, 0.0
            if i < s.vertex_count[None]:
                b = s.body_of_vertex[i]
                X = s.rest[i] - self.rest_center[b]
                r = (s.x[i] - self.center[b] - self.fit[b] @ X).norm()
                r_v = self._residual_velocity(i, b).norm()
            max_by_key(self.residual, b, r, i % c.lanes, c.lanes)
            max_by_key(self.speed_residual, b, r_v, i % c.lanes, c.lanes)
        for b in range(MAX_BODIES):
            self.self_colliding[b] = 0
            if b < s.body_count[None]:
                A = self.fit[b]
                t, stretch = s.detect_dt[None], A.transpose() @ A - ti.Matrix.identity(ti.f32, 3)
                sigma = ti.sqrt(ti.max(1.0 - stretch.norm(), 0.0))
                if ti.abs(A.determinant()) > 1e-6:
                    inverse = A.inverse()
                    L = self.gradient[b] @ inverse
                    sigma = ti.max(sigma, 1.0 / inverse.norm()) * (1.0 - 0.5 * t * (L + L.transpose()).norm())
                distance = 2.0 * self.speed_residual[b] * t + CONTACT_MARGIN
                passes = self.disabled[b] != 0 or self.state.untangling[b] != 0
                apart = passes or sigma * self.min_rest_distance(b) >= 2.0 * self.residual[b] + distance
                self.self_colliding[b] = 0 if apart else 1
                # a larger search would cost too much; faster points are met inside, where a body is thick enough
                self.search_distance[b] = ti.min(distance, self.min_rest_distance(b))

    @ti.func
    def _sum(self, j, span, lane):
        """Sums of one block, about the body's first vertex, by all lanes together."""
        s, c = self.state, self.blocks
        first = s.vertex_begin[span[2]]
        M, p, P, q = 0.0, ti.Vector([0.0, 0.0, 0.0]), ti.Vector([0.0, 0.0, 0.0]), ti.Vector([0.0, 0.0, 0.0])
        S = ti.Matrix.zero(ti.f32, 3, 3)
        C, H = S, S
        i = span[0] + lane
        while i < span[1]:
            m, x, X, v = s.mass[i], s.x[i] - s.x[first], s.rest[i] - s.rest[first], s.v[i]
            M += m
            p += m * x
            P += m * X
            q += m * v
            S += m * X.outer_product(X)
            C += m * x.outer_product(X)
            H += m * v.outer_product(X)
            i += c.lanes
        c.write_sum(self.sums, j, 0, M, lane)
        for k in ti.static(range(3)):
            c.write_sum(self.sums, j, 1 + k, p[k], lane)
            c.write_sum(self.sums, j, 4 + k, P[k], lane)
            c.write_sum(self.sums, j, 7 + k, q[k], lane)
            c.write_sum(self.sums, j, 10 + k, S[k, k], lane)
            c.write_sum(self.sums, j, 13 + k, S[k, (k + 1) % 3], lane)
            for axis in ti.static(range(3)):
                c.write_sum(self.sums, j, 16 + 3 * k + axis, C[k, axis], lane)
                c.write_sum(self.sums, j, 25 + 3 * k + axis, H[k, axis], lane)

    @ti.func
    def _fit(self, b):
        """Affine maps of body b from the sums of its blocks."""
        s = self.state
        total = ti.Vector([self.total[b, k] for k in range(SHAPE_SUMS)])
        M, first = total[0], s.vertex_begin[b]
        p, P, q = total[1:4] / M, total[4:7] / M, total[7:10] / M
        xx, yy, zz = total[10] - M * P[0] * P[0], total[11] - M * P[1] * P[1], total[12] - M * P[2] * P[2]
        xy, yz, zx = total[13] - M * P[0] * P[1], total[14] - M * P[1] * P[2], total[15] - M * P[2] * P[0]
        inverse = ti.Matrix([[xx, xy, zx], [xy, yy, yz], [zx, yz, zz]]).inverse()
        C = ti.Matrix([[total[16 + 3 * k + axis] - M * p[k] * P[axis] for axis in range(3)] for k in range(3)])
        H = ti.Matrix([[total[25 + 3 * k + axis] - M * q[k] * P[axis] for axis in range(3)] for k in range(3)])
        self.fit[b], self.gradient[b] = C @ inverse, H @ inverse
        self.center[b], self.rest_center[b], self.velocity[b] = s.x[first] + p, s.rest[first] + P, q
        self.residual[b], self.speed_residual[b] = 0.0, 0.0


def part_of_vertices(p: BodyModel) -> np.ndarray:
    """Number of each vertex's connected part (V,); all -1 unless only the parts of the body may collide."""
    count = len(p.shape.vertices)
    if p.body.rigid or p.body.self_contact != "parts":
        return np.full(count, -1, np.int32)
    part = np.empty(count, np.int32)
    part[p.shape.tets] = vertex_components(p.shape.tets)[:, None]
    return part


def can_fold(shape: RestShape) -> bool:
    """True if a body is long enough for two of its points to collide: see MIN_REST_DISTANCE."""
    return float(np.ptp(shape.vertices, axis=0).max()) > 2 * MIN_REST_DISTANCE * 0.5 * shape.edge
