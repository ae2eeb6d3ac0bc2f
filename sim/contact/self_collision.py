"""Self-collision candidates: bodies bent so far that they may touch themselves; the others are not searched.

With the best affine map A of the rest shape onto a body, and r the largest distance of a vertex from where A has it,
two points that are d apart at rest are at least sigma_min(A) d - 2 r from each other. Velocities are fitted likewise,
by G and r_v; rotation does not bring points together, so that in the time t they approach by at most 2 r_v t, and by
the fraction |sym(G A^-1)| t of their distance. While something is left beyond the margin in which contacts are looked
for, nothing of the body can meet itself. With X, x, v relative to the means,

    A = (sum m x X^T) S^-1,   G = (sum m v X^T) S^-1,   S = sum m X X^T

and sigma_min from |A^T A - I|, or from |A^-1| where the body is squeezed as a whole.
"""

from typing import TYPE_CHECKING

import numpy as np
import taichi as ti

from core.fields import FieldGroup, Upload
from core.lanes import max_by_key
from core.tetmesh import vertex_components
from sim.contact.broad_phase import CONTACT_MARGIN
from sim.model import MAX_BODIES

if TYPE_CHECKING:
    from sim.contact.broad_phase import BodyBounds
    from sim.model import BodyModel, Model, RestShape
    from sim.state import State

MIN_REST_DISTANCE = 5.0  # [max. displacement of a substep, half an edge]: points closer at rest do not collide
SHAPE_SUMS = 34  # m; m x, m X, m v; m X X^T, its upper half; m x X^T, m v X^T


@ti.data_oriented
class SelfCollision:
    """Per body: self_colliding i32[B], whether it may touch itself; disabled i32[B], whether it passes through itself.

    part i32[V]: number of a vertex's part where only the parts of its body meet each other, else -1
    search_distance f32[B] [m]: how far two points may approach, apart from the affine motion
    sums f32[blocks,34], total f32[B,34];   fit, gradient mat3[B] = A, G
    center, rest_center, velocity vec3[B]: the means
    residual, speed_residual f32[B]: the largest distances r [m] and r_v [m/s] from the fits
    """

    def __init__(self, state: "State", blocks, bounds: "BodyBounds"):
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

    def load(self, model: "Model") -> None:
        """Take which of these bodies pass through themselves."""
        parts = [part_of_vertices(p) for p in model.bodies]
        alone = [not part.any() for part in parts]  # of one part
        passes = [not (p.body.rigid or p.body.self_contact) for p in model.bodies]
        self._upload([np.logical_or(passes, alone), np.concatenate([np.zeros(0, np.int32), *parts])])

    @ti.func
    def min_rest_distance(self, b):
        """Least distance at rest [m] of two points of body b that may collide."""
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
            total = c.sum_by_lanes(self.sums, b, k, lane)
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


def part_of_vertices(p: "BodyModel") -> np.ndarray:
    """Number of the connected part of each vertex (V,); all -1 unless the body's parts alone meet each other."""
    count = len(p.shape.vertices)
    if p.body.rigid or p.body.self_contact != "parts":
        return np.full(count, -1, np.int32)
    part = np.empty(count, np.int32)
    part[p.shape.tets] = vertex_components(p.shape.tets)[:, None]
    return part


def can_fold(shape: "RestShape") -> bool:
    """True if a body has two ends, each as long as the distance at rest below which points do not collide."""
    return float(np.ptp(shape.vertices, axis=0).max()) > 2 * MIN_REST_DISTANCE * 0.5 * shape.edge
