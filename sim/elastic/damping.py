"""Damping towards each body's rigid motion, which it leaves alone (Mueller et al. 2007, Sec. 3.5).

    v_i += k (v_cm + omega x r_i - v_i),   k = 1 - exp(-c t),   omega = I^-1 L

In a body with prescribed vertices, v_cm and omega are those of these alone. Applied once for several
substeps (t is their sum; c t << 1), because the sums over a body cost as much as a substep.
"""

from itertools import pairwise

import numpy as np
import taichi as ti

from core.fields import Upload, round_up_capacity, two_sum
from sim.elastic.xpbd import predict
from sim.model import MAX_BODIES, Model
from sim.state import State

SUMS = 15  # of one body: m r (3), m v (3), m r x v (3), m r_k^2 (3), m r_k r_l (3)
CHUNK = 64  # vertices that one thread sums; chunks never straddle bodies, so sums have a fixed order


@ti.data_oriented
class ReductionBlocks:
    """The vertices of all bodies in runs of at most CHUNK: begin, end, body of each; run range of each body."""

    def __init__(self, state: State):
        self.size = round_up_capacity(state.V // CHUNK + MAX_BODIES)
        self.builder = ti.FieldsBuilder()
        self.span, self.of_body = ti.Vector.field(3, ti.i32), ti.field(ti.i32)  # unused rows are empty ranges
        self.builder.dense(ti.i, self.size).place(self.span)
        self.builder.dense(ti.i, MAX_BODIES + 1).place(self.of_body)
        self.tree = self.builder.finalize()
        self._upload = Upload([self.span, self.of_body])

    def load(self, assembly: Model) -> None:
        """Cut up the vertices of these bodies."""
        rows = [
            (begin, min(begin + CHUNK, last), b)
            for b, (first, last) in enumerate(pairwise(assembly.vertex_begin.tolist()))
            for begin in range(first, last, CHUNK)
        ]
        table = np.array(rows, np.int64).reshape(-1, 3)
        self._upload([table, np.searchsorted(table[:, 2], np.arange(MAX_BODIES + 1))])

    def destroy(self) -> None:
        self.tree.destroy()


@ti.data_oriented
class Damping:
    """`run(t)` damps the velocities by t [s] worth and predicts the increments of the next substep."""

    def __init__(self, state: State, chunks: ReductionBlocks):
        self.state, self.chunks = state, chunks
        self.builder = ti.FieldsBuilder()
        self.sums, self.total = ti.field(ti.f32), ti.field(ti.f32)
        self.builder.dense(ti.ij, (chunks.size, SUMS)).place(self.sums)
        self.builder.dense(ti.ij, (MAX_BODIES, SUMS)).place(self.total)
        self.center, self.velocity, self.omega = (ti.Vector.field(3, ti.f32) for _ in range(3))
        self.builder.dense(ti.i, MAX_BODIES).place(self.center, self.velocity, self.omega)
        self.tree = self.builder.finalize()

    @ti.kernel
    def run(self, t: ti.f32):
        s = self.state
        c = self.chunks
        ti.loop_config(serialize=s.serial)
        for j in range(c.size):
            span = c.span[j]
            about = s.x[s.vertex_begin[span[2]]]  # sums about a point of the body hardly cancel
            p, q, L = ti.Vector([0.0, 0.0, 0.0]), ti.Vector([0.0, 0.0, 0.0]), ti.Vector([0.0, 0.0, 0.0])
            square, mixed = ti.Vector([0.0, 0.0, 0.0]), ti.Vector([0.0, 0.0, 0.0])
            for i in range(span[0], span[1]):
                m, r, v = s.mass[i], s.x[i] - about, s.v[i]
                if s.w[i] > 0.0 and s.led[span[2]] > 0.0:
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
        for bk in range(MAX_BODIES * SUMS):
            b, k = bk // SUMS, bk % SUMS
            value = 0.0
            for j in range(c.of_body[b], c.of_body[b + 1]):
                value += self.sums[j, k]
            self.total[b, k] = value
        ti.loop_config(serialize=s.serial)
        for b in range(MAX_BODIES):
            if b < s.body_count[None]:
                total = ti.Vector([self.total[b, k] for k in range(SUMS)])
                M = s.led[b] if s.led[b] > 0.0 else s.body_mass[b]
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
            if i < s.vertex_count[None]:
                b = s.body_of_vertex[i]
                if s.damping[b] > 0.0 and s.w[i] > 0.0:
                    rigid = self.velocity[b] + self.omega[b].cross(s.x[i] - self.center[b])
                    k = 1.0 - ti.exp(-s.damping[b] * t)
                    s.v[i], s.v_carry[i] = two_sum(s.v[i], s.v_carry[i] + k * (rigid - s.v[i]))
                predict(s, i)

    def destroy(self) -> None:
        self.tree.destroy()
