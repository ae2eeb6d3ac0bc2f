"""Soft bodies as wholes in VBD: what contact moves at once, and the momentum that it gives.

A few sweeps over vertices do not tell a stiff body of a push. So at the end of a substep, and between the sweeps while
bodies are near one another, each moves rigidly to where its momentum is what inertia, the impulses of other bodies and
the forces R_i of static shapes want:

    sum_i m_i (e_i - u_i') + dt^2 (R_i - K_i u_i) = 0, and the same of its moments,   e_i = target_i - dx_i

    u_i = shift + turn x r_i,   u_i' = (1 - H_i^-1 K_i) u_i,   dx_i += u_i',   R_i -= K_i u_i

with r_i from the centre of mass. K_i is the stiffness of the vertex's static contacts (sim/contact/narrow_phase.py),
which hold it: it follows its body by what H_i lets it. Elastic forces do not count in these sums, so however far the
sweeps have come, a body gets what those that it meets lose, and friction takes from it what its load allows.

Of an impulse of another body on vertex i the part phi_i = m_i tr(H_i^-1) / 3 dt^2 moves that vertex against its
neighbours, the rest the whole body: soft bodies yield locally, stiff ones answer a contact constraint like rigid ones
(`mobility`). Bodies with prescribed vertices only yield.
"""

import taichi as ti

from core.fields import FieldGroup
from core.lanes import from_lane, sum_lanes
from sim.model import MAX_BODIES
from sim.reductions import ReductionBlocks
from sim.state import State, inverse_mass_matrix

# p = m e + dt^2 R (3), r x p (3), m r (3), m r r^T (6), and the vertices on static shapes; r from the first vertex ...
FREE_SUMS = 16
SUMS = 52  # ... and of those Q, Q [r], [r] Q and [r] Q [r], Q = dt^2 K - m H^-1 K, [r] v = r x v
MIN_INERTIA = 1e-4  # of its trace: vertices in a line have none about that


@ti.data_oriented
class WholeBodies:
    """The rigid motions of the soft bodies: their steps, each by `lanes` threads for a block of vertices or a body.

    center vec3[B] [m] from the first vertex;   inv_mass f32[B] [1/kg], inverse_inertia[B]: 0 with prescribed vertices
    shift, turn vec3[B];   split_count i32[B]: active contact constraints that share the body's mass
    """

    def __init__(self, state: State, blocks: ReductionBlocks, descent, lanes: int = 1):
        self.state, self.blocks, self.descent, self.lanes = state, blocks, descent, lanes
        g, B = FieldGroup(), MAX_BODIES
        self.sums, self.totals = g.scalar(blocks.size, SUMS), g.scalar(B, SUMS)
        self.inv_mass, self.split_count = g.scalar(B), g.scalar(B, dtype=ti.i32)
        self.center, self.shift, self.turn = (g.vector(B) for _ in range(3))
        self.inverse_inertia = g.matrix(B)
        g.build()
        self._group = g

    @ti.func
    def sum_block(self, j, lane):
        """Sums of block j."""
        s, d, span = self.state, self.descent, self.blocks.span[j]
        total, origin = ti.Vector([0.0] * FREE_SUMS), s.x[s.vertex_begin[span[2]]]
        i = span[0] + lane
        while i < span[1]:
            m, r = s.mass[i], s.x[i] - origin
            p = m * (d.target[i] - s.dx[i]) + s.dt[None] ** 2 * d.reaction[i]
            moment = r.cross(p)
            for k in ti.static(range(3)):
                total[k] += p[k]
                total[3 + k] += moment[k]
                total[6 + k] += m * r[k]
                total[9 + k] += m * r[k] ** 2
                total[12 + k] += m * r[k] * r[(k + 1) % 3]
            total[15] += 1.0 if self._is_held(i) else 0.0
            i += self.lanes
        for k in ti.static(range(FREE_SUMS)):
            total[k] = sum_lanes(total[k], self.lanes)
            if lane == 0:
                self.sums[j, k] = total[k]
        if from_lane(total[15], 0, self.lanes) > 0.0:
            self._sum_held(j, origin, lane)
        elif lane == 0:
            for k in range(FREE_SUMS, SUMS):
                self.sums[j, k] = 0.0

    @ti.func
    def _is_held(self, i):
        """True if a static shape presses against vertex i."""
        return self.descent.reaction[i].norm_sqr() > 0.0

    @ti.func
    def _sum_held(self, j, origin, lane):
        """Sums of the vertices of block j on static shapes."""
        s, d, span = self.state, self.descent, self.blocks.span[j]
        total = [ti.Matrix.zero(ti.f32, 3, 3) for _ in range(4)]
        i = span[0] + lane
        while i < span[1]:
            if self._is_held(i):
                Q, R = s.dt[None] ** 2 * d.contact_matrix[i] - s.mass[i] * d.held[i], cross_matrix(s.x[i] - origin)
                QR = Q @ R
                total[0] += Q
                total[1] += QR
                total[2] += R @ Q
                total[3] += R @ QR
            i += self.lanes
        for n in ti.static(range(4)):
            for k, l in ti.static(ti.ndrange(3, 3)):
                value = sum_lanes(total[n][k, l], self.lanes)
                if lane == 0:
                    self.sums[j, FREE_SUMS + 9 * n + 3 * k + l] = value

    @ti.func
    def solve(self, b, lane):
        """Shift and turn of body b."""
        held = False
        for k in range(SUMS):  # as a loop: unrolled it takes seconds to compile
            if k < FREE_SUMS or held:
                value = self.blocks.sum_by_lanes(self.sums, b, k, lane, self.lanes)
                if lane == 0:
                    self.totals[b, k] = value
                if k == FREE_SUMS - 1:
                    held = from_lane(value, 0, self.lanes) > 0.0
        if lane == 0:
            mass, total = self.state.body_mass[b], ti.Vector([self.totals[b, k] for k in range(FREE_SUMS)])
            c, shift, turn = total[6:9] / mass, ti.Vector([0.0, 0.0, 0.0]), ti.Vector([0.0, 0.0, 0.0])
            inv_mass, inverse = 0.0, ti.Matrix.zero(ti.f32, 3, 3)
            if self.state.prescribed_mass[b] == 0.0:
                inv_mass = 1.0 / mass
                xx = total[9:12] - mass * c * c
                xy = total[12:15] - mass * ti.Vector([c[0] * c[1], c[1] * c[2], c[2] * c[0]])
                trace = (1.0 + MIN_INERTIA) * xx.sum()
                inertia = ti.Matrix(
                    [[trace - xx[0], -xy[0], -xy[2]], [-xy[0], trace - xx[1], -xy[1]], [-xy[2], -xy[1], trace - xx[2]]]
                )
                inverse = (inertia / trace).inverse() / trace
                p, moment = total[0:3], total[3:6] - c.cross(total[0:3])
                shift, turn = inv_mass * p, inverse @ moment
                if held:
                    shift, turn = self._held_motion(b, p, moment, mass, inertia, c)
            self.split_count[b] = 0
            self.center[b], self.inv_mass[b], self.inverse_inertia[b] = c, inv_mass, inverse
            self.shift[b], self.turn[b] = shift, turn

    @ti.func
    def _held_motion(self, b, p, moment, mass, inertia, c):
        """Shift and turn of body b, which static shapes hold, from the sums about a point from which c is the centre.

        (mass + Q) shift - Q[r] turn = p,   [r]Q shift + (inertia - [r]Q[r]) turn = moment,   sums about c.
        """
        C, Q = cross_matrix(c), self._held_sum(b, 0)
        Q_r, r_Q = self._held_sum(b, 1), self._held_sum(b, 2) - C @ Q
        r_Q_r = self._held_sum(b, 3) - C @ Q_r - r_Q @ C
        Q_r -= Q @ C
        D = (mass * ti.Matrix.identity(ti.f32, 3) + Q).inverse()
        turn = (inertia - r_Q_r + r_Q @ D @ Q_r).inverse() @ (moment - r_Q @ (D @ p))
        return D @ (p + Q_r @ turn), turn

    @ti.func
    def _held_sum(self, b, n: ti.template()):
        """Total of the n-th matrix of body b."""
        first = ti.static(FREE_SUMS + 9 * n)
        return ti.Matrix([[self.totals[b, first + 3 * k + l] for l in range(3)] for k in range(3)])

    @ti.func
    def move(self, i):
        """Move vertex i with its body."""
        s, d, b = self.state, self.descent, self.state.body_of_vertex[i]
        if self.inv_mass[b] > 0.0:
            u = self.shift[b] + self.turn[b].cross(s.x[i] - s.x[s.vertex_begin[b]] - self.center[b])
            if self._is_held(i):
                d.reaction[i] -= d.contact_matrix[i] @ u
                u -= d.held[i] @ u
            s.dx[i] += u

    @ti.func
    def mobility(self, b, total, moment):
        """Motion for a unit impulse [1/kg] of a constraint on body b with this sum of coefficients, and c_e r_e [m]."""
        arm = moment - total * self.center[b]
        return inverse_mass_matrix(arm, total * total * self.inv_mass[b], self.inverse_inertia[b])

    @ti.func
    def share(self, i):
        """Part of an impulse on vertex i that moves the body as a whole."""
        return 1.0 - ti.min(self.descent.effective_inv_mass[i] * self.state.mass[i], 1.0)

    def kernel(self):
        """Kernel of all steps with a single lane."""
        s, blocks = self.state, self.blocks

        @ti.kernel
        def balance():
            ti.loop_config(serialize=s.serial)
            for j in range(blocks.size):
                span = blocks.span[j]
                if span[0] < span[1] and not s.asleep[span[2]]:
                    self.sum_block(j, 0)
            ti.loop_config(serialize=s.serial)
            for b in range(MAX_BODIES):
                if s.awake_body(b):
                    self.solve(b, 0)
            s.each_vertex(self.move)

        return balance

    def destroy(self) -> None:
        self._group.destroy()


@ti.func
def cross_matrix(r):
    """The matrix [r] of [r] v = r x v."""
    return ti.Matrix([[0.0, -r.z, r.y], [r.z, 0.0, -r.x], [-r.y, r.x, 0.0]])
