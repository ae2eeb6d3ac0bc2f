"""Soft bodies as wholes in VBD: what contact with other bodies moves at once, and the momentum that it gives.

A few sweeps over vertices do not tell a stiff body of a push. So after each of them, while bodies are near one another,
each moves rigidly to where its momentum is what inertia and the impulses want:

    shift = sum_i m_i e_i / M,   turn = I^-1 sum_i r_i x m_i e_i,   e_i = target_i - dx_i,   dx_i += shift + turn x r_i

with r_i from the centre of mass. Elastic forces do not count in these sums, so however far the sweeps have come, a body
gets what those that it meets lose. Of an impulse on vertex i the part phi_i = m_i tr(H_i^-1) / 3 dt^2 moves that vertex
against its neighbours, the rest the whole body: soft bodies yield locally, stiff ones answer a contact constraint like
rigid ones (`mobility`). Bodies with prescribed vertices only yield. Those on static shapes, which take up momentum, are
not moved either, but answer alike: an impulse for the local stiffness alone would throw a body that leaves its shape.
"""

import taichi as ti

from core.fields import FieldGroup
from core.lanes import sum_lanes
from sim.model import MAX_BODIES
from sim.reductions import ReductionBlocks
from sim.state import State, inverse_mass_matrix

SUMS = 16  # m e (3), r x m e (3), m r (3), m r r^T (6), and the vertices on static shapes, r from the first vertex
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
        self.sums, self.inv_mass, self.split_count = g.scalar(blocks.size, SUMS), g.scalar(B), g.scalar(B, dtype=ti.i32)
        self.center, self.shift, self.turn = (g.vector(B) for _ in range(3))
        self.inverse_inertia = g.matrix(B)
        g.build()
        self._group = g

    @ti.func
    def sum_block(self, j, lane):
        """Sums of block j."""
        s, d, span = self.state, self.descent, self.blocks.span[j]
        total, origin = ti.Vector([0.0] * SUMS), s.x[s.vertex_begin[span[2]]]
        i = span[0] + lane
        while i < span[1]:
            m, r = s.mass[i], s.x[i] - origin
            p = m * (d.target[i] - s.dx[i])
            moment = r.cross(p)
            for k in ti.static(range(3)):
                total[k] += p[k]
                total[3 + k] += moment[k]
                total[6 + k] += m * r[k]
                total[9 + k] += m * r[k] ** 2
                total[12 + k] += m * r[k] * r[(k + 1) % 3]
            total[15] += 1.0 if d.reaction[i].norm_sqr() > 0.0 else 0.0
            i += self.lanes
        for k in ti.static(range(SUMS)):
            value = sum_lanes(total[k], self.lanes)
            if lane == 0:
                self.sums[j, k] = value

    @ti.func
    def solve(self, b, lane):
        """Shift and turn of body b."""
        total = ti.Vector([0.0] * SUMS)
        for k in ti.static(range(SUMS)):
            total[k] = self.blocks.sum_by_lanes(self.sums, b, k, lane)
        if lane == 0:
            mass, inv_mass = self.state.body_mass[b], 0.0
            c, inverse = total[6:9] / mass, ti.Matrix.zero(ti.f32, 3, 3)
            if self.state.prescribed_mass[b] == 0.0:
                inv_mass = 1.0 / mass
                xx = total[9:12] - mass * c * c
                xy = total[12:15] - mass * ti.Vector([c[0] * c[1], c[1] * c[2], c[2] * c[0]])
                trace = (1.0 + MIN_INERTIA) * xx.sum()
                inverse = ti.Matrix(
                    [[trace - xx[0], -xy[0], -xy[2]], [-xy[0], trace - xx[1], -xy[1]], [-xy[2], -xy[1], trace - xx[2]]]
                )
                inverse = (inverse / trace).inverse() / trace
            self.split_count[b] = 0
            self.center[b], self.inv_mass[b], self.inverse_inertia[b] = c, inv_mass, inverse
            free = 1.0 if total[15] == 0.0 else 0.0
            self.shift[b] = free * inv_mass * total[0:3]
            self.turn[b] = free * (inverse @ (total[3:6] - c.cross(total[0:3])))

    @ti.func
    def move(self, i):
        """Move vertex i with its body."""
        s, b = self.state, self.state.body_of_vertex[i]
        if self.inv_mass[b] > 0.0:
            s.dx[i] += self.shift[b] + self.turn[b].cross(s.x[i] - s.x[s.vertex_begin[b]] - self.center[b])

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
