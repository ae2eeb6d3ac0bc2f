"""Damping towards each body's rigid motion, which it leaves alone (Mueller et al. 2007, Sec. 3.5).

    v_i += k (v_cm + omega x r_i - v_i),   k = 1 - exp(-c t),   omega = I^-1 L

Inner friction is the other part of a material's damping (sim/state.py).

In a body with prescribed vertices, v_cm and omega are those of these alone. Applied once for several
substeps (t is their sum; c t << 1), because the sums over a body cost as much as a substep.
"""

import taichi as ti

from core.fields import FieldGroup, two_sum
from sim.capacity import MAX_BODIES
from sim.reductions import ReductionBlocks
from sim.state import State

DAMPING_SUMS = 15  # of one body: m r (3), m v (3), m r x v (3), m r_k^2 (3), m r_k r_l (3)


@ti.data_oriented
class Damping:
    """`run(t)` damps the velocities for t [s] and predicts the increments of the next substep."""

    def __init__(self, state: State, blocks: ReductionBlocks):
        self.state, self.blocks = state, blocks
        g = self._group = FieldGroup()
        self.sums, self.total = g.scalar(blocks.size, DAMPING_SUMS), g.scalar(MAX_BODIES, DAMPING_SUMS)
        self.center = g.vector(MAX_BODIES)  # of mass [m]
        self.velocity = g.vector(MAX_BODIES)  # m/s
        self.omega = g.vector(MAX_BODIES)  # rad/s
        g.build()

    @ti.kernel
    def run(self, t: ti.f32):
        s = self.state
        c = self.blocks
        ti.loop_config(serialize=s.serial)
        for j in range(c.size):
            span = c.span[j]
            about = s.x[s.vertex_begin[span[2]]]  # sums about a point of the body hardly cancel
            p, q, L = ti.Vector([0.0, 0.0, 0.0]), ti.Vector([0.0, 0.0, 0.0]), ti.Vector([0.0, 0.0, 0.0])
            square, mixed = ti.Vector([0.0, 0.0, 0.0]), ti.Vector([0.0, 0.0, 0.0])
            for i in range(span[0], span[0] if s.asleep[span[2]] else span[1]):
                m, r, v = s.mass[i], s.x[i] - about, s.v[i]
                if s.inv_mass[i] > 0.0 and s.prescribed_mass[span[2]] > 0.0:
                    m = 0.0
                p += m * r
                q += m * v
                L += m * r.cross(v)
                square += m * r * r
                mixed += m * ti.Vector([r[1] * r[2], r[2] * r[0], r[0] * r[1]])
            for k in ti.static(range(3)):
                self.sums[j, k] = p[k]
                self.sums[j, 3 + k] = q[k]
                self.sums[j, 6 + k] = L[k]
                self.sums[j, 9 + k] = square[k]
                self.sums[j, 12 + k] = mixed[k]
        ti.loop_config(serialize=s.serial)
        for bk in range(MAX_BODIES * DAMPING_SUMS):
            b, k = bk // DAMPING_SUMS, bk % DAMPING_SUMS
            self.total[b, k] = c.sum(self.sums, b, k)
        ti.loop_config(serialize=s.serial)
        for b in range(MAX_BODIES):
            if b < s.body_count[None]:
                total = ti.Vector([self.total[b, k] for k in range(DAMPING_SUMS)])
                M = s.prescribed_mass[b] if s.prescribed_mass[b] > 0.0 else s.body_mass[b]
                d = total[0:3] / M
                v = total[3:6] / M
                L = total[6:9] - M * d.cross(v)
                xx, yy, zz = total[9] - M * d[0] ** 2, total[10] - M * d[1] ** 2, total[11] - M * d[2] ** 2
                yz, zx, xy = total[12] - M * d[1] * d[2], total[13] - M * d[2] * d[0], total[14] - M * d[0] * d[1]
                tiny = 1e-6 * (xx + yy + zz) + 1e-9 * M  # a body flattened to a line has no inertia about it
                inertia = ti.Matrix(
                    [[yy + zz + tiny, -xy, -zx], [-xy, zz + xx + tiny, -yz], [-zx, -yz, xx + yy + tiny]]
                )
                self.center[b] = s.x[s.vertex_begin[b]] + d
                self.velocity[b] = v
                self.omega[b] = (inertia / M).inverse() @ (L / M)
        ti.loop_config(serialize=s.serial)
        for i in range(s.V):
            if s.awake_vertex(i):
                b = s.body_of_vertex[i]
                if s.damping[b] > 0.0 and s.inv_mass[i] > 0.0:
                    rigid = self.velocity[b] + self.omega[b].cross(s.x[i] - self.center[b])
                    k = 1.0 - ti.exp(-s.damping[b] * t)
                    s.v[i], s.v_lo[i] = two_sum(s.v[i], s.v_lo[i] + k * (rigid - s.v[i]))
                s.predict(i)

    def destroy(self) -> None:
        self._group.destroy()
