"""Modal correction by warps, inside a kernel that stays: the steps of sim/elastic/modal_correction.py.

A warp takes a run of at most 64 vertices of one body (ReductionBlocks), two vertices a lane. Between the steps all
threads meet.
"""

from typing import TYPE_CHECKING

import taichi as ti

from core.fields import FieldGroup
from core.quaternion import polar_quaternion, to_matrix
from sim.capacity import MAX_BODIES
from sim.elastic.modal_correction import MODES

if TYPE_CHECKING:
    from sim.elastic.modal_correction import ModalCorrection
    from sim.elastic.persistent_grid import PersistentGrid
    from sim.elastic.vbd import VertexDescent


@ti.data_oriented
class ModalWarps:
    """The steps; each is called by all threads."""

    def __init__(self, modal: "ModalCorrection", descent: "VertexDescent", grid: "PersistentGrid"):
        self.modal, self.descent, self.grid = modal, descent, grid
        self.state, self.blocks = modal.state, modal.blocks
        self.lanes, self.warps = grid.warp, grid.warps
        g = self._group = FieldGroup()
        # Point of each body about which moments are summed: of the last substep, because x is just being moved
        self.origin = g.vector(MAX_BODIES)
        g.build()

    @ti.func
    def begin(self, b):
        """Before the first turn, for each body."""
        if b < self.state.body_count[None]:
            self.origin[b] = self.state.x[self.state.vertex_begin[b]]

    @ti.func
    def _sum(self, value):
        """Sum of a float over the lanes of a warp, in its first one."""
        return self.grid.sum_lanes(value, self.lanes)

    @ti.func
    def _spans(self):
        """Number of runs in use."""
        return self.blocks.begin[self.state.body_count[None]]

    @ti.func
    def turn(self, thread, ends, begins):
        """End a substep, begin the next one: shorten the last step, commit, predict; and the moments for rotations."""
        s, m = self.state, self.modal
        j, lane = self.grid.warp_index(thread), thread % self.lanes
        while j < self._spans():
            span = self.blocks.span[j]
            if not self.state.asleep[span[2]]:
                a = 1.0
                if ends:
                    gain, curvature = self._body_sums(span[2], lane)
                    if curvature > gain:
                        a = ti.max(gain / curvature, 0.0)
                i = span[0] + lane
                while i < span[1]:
                    predicted = s.dx_predicted[i]
                    if ends:
                        predicted = self.descent.end(i, s.dx[i] + (a - 1.0) * m.step[i])
                    if begins:
                        self.descent.begin(i, predicted)
                    i += self.lanes
                if begins:
                    self._sum_moments(j, span, lane)
            j += self.warps

    @ti.func
    def _sum_moments(self, j, span, lane):
        s, m = self.state, self.modal
        total = ti.Matrix.zero(ti.f32, 3, 3)
        p, q = ti.Vector([0.0, 0.0, 0.0]), ti.Vector([0.0, 0.0, 0.0])
        first, origin = s.vertex_begin[span[2]], self.origin[span[2]]
        i = span[0] + lane
        while i < span[1]:
            mass, x, X = s.mass[i], s.x[i] - origin, s.rest[i] - s.rest[first]
            total += mass * x.outer_product(X)
            p += mass * x
            q += mass * X
            i += self.lanes
        for k in ti.static(range(3)):
            for l in ti.static(range(3)):
                total[k, l] = self._sum(total[k, l])
            p[k], q[k] = self._sum(p[k]), self._sum(q[k])
        if lane == 0:
            for k in ti.static(range(3)):
                for l in ti.static(range(3)):
                    m.moments[j, 3 * k + l] = total[k, l]
                m.moments[j, 9 + k], m.moments[j, 12 + k] = p[k], q[k]

    @ti.func
    def fit_rotations(self, thread):
        """R of each body."""
        s, m = self.state, self.modal
        b, lane = self.grid.warp_index(thread), thread % self.lanes
        while b < s.body_count[None]:
            self.origin[b] = s.x[s.vertex_begin[b]]  # all threads of the warp write the same
            total = ti.Matrix.zero(ti.f32, 3, 3)
            p, q = ti.Vector([0.0, 0.0, 0.0]), ti.Vector([0.0, 0.0, 0.0])
            j = self.blocks.begin[b] + lane
            while j < self.blocks.begin[b + 1]:
                for k in ti.static(range(3)):
                    for l in ti.static(range(3)):
                        total[k, l] += m.moments[j, 3 * k + l]
                    p[k] += m.moments[j, 9 + k]
                    q[k] += m.moments[j, 12 + k]
                j += self.lanes
            for k in ti.static(range(3)):
                for l in ti.static(range(3)):
                    total[k, l] = self._sum(total[k, l])
                p[k], q[k] = self._sum(p[k]), self._sum(q[k])
            if lane == 0:
                m.rotation[b] = to_matrix(polar_quaternion(total - p.outer_product(q) / s.body_mass[b]))
            b += self.warps

    @ti.func
    def set_residual(self, i, elastic, trial):
        """Residual force of vertex i, from its elastic part [N]; at the trial, its terms of the secant."""
        s, m, d = self.state, self.modal, self.descent
        b = s.body_of_vertex[i]
        f = ti.Vector([0.0, 0.0, 0.0])
        if s.inv_mass[i] > 0.0:
            f = elastic + d.reaction[i] + s.mass[i] / s.dt[None] ** 2 * (d.target[i] - s.dx[i])
        if trial == 0:
            m.force[i] = m.rotation[b].transpose() @ f
        else:
            step, gain = m.step[i], m.product[i, 0] * m.trial[b]
            m.product[i, 0] = gain
            m.product[i, 1] = gain + d.contact_stiffness[i] * step.norm_sqr() - step.dot(f)

    @ti.func
    def project(self, thread):
        """Sums of each run for the amplitudes."""
        s, m = self.state, self.modal
        j, lane = self.grid.warp_index(thread), thread % self.lanes
        while j < self._spans():
            span = self.blocks.span[j]
            if not self.state.asleep[span[2]]:
                total = ti.Vector([0.0] * MODES)
                i = span[0] + lane
                while i < span[1]:
                    f = m.force[i]
                    for k in ti.static(range(MODES)):
                        total[k] += m.mode[k * s.vertex_count[None] + i].dot(f)
                    i += self.lanes
                for k in ti.static(range(MODES)):
                    total[k] = self._sum(total[k])
                if lane == 0:
                    for k in ti.static(range(MODES)):
                        m.mode_sums[j, k] = total[k]
            j += self.warps

    @ti.func
    def find_amplitudes(self, thread):
        """q_k of each body."""
        s, m = self.state, self.modal
        bk, lane = self.grid.warp_index(thread), thread % self.lanes
        while bk < s.body_count[None] * MODES:
            b, k = bk // MODES, bk % MODES
            total, j = 0.0, self.blocks.begin[b] + lane
            while j < self.blocks.begin[b + 1]:
                total += m.mode_sums[j, k]
                j += self.lanes
            total = self._sum(total)
            if lane == 0:
                m.amplitude[bk] = total / (1.0 / s.dt[None] ** 2 + m.frequency_sqr[bk])
            bk += self.warps

    @ti.func
    def find_step(self, thread):
        """d of each vertex, and the sums of f . d and h."""
        s, m = self.state, self.modal
        j, lane = self.grid.warp_index(thread), thread % self.lanes
        while j < self._spans():
            span = self.blocks.span[j]
            if not self.state.asleep[span[2]]:
                gain, h = 0.0, 0.0
                i = span[0] + lane
                while i < span[1]:
                    d = ti.Vector([0.0, 0.0, 0.0])
                    for k in range(MODES):
                        d += m.amplitude[span[2] * MODES + k] * m.mode[k * s.vertex_count[None] + i]
                    product = d.dot(m.force[i])
                    gain += product
                    h += self.descent.contact_stiffness[i] * d.norm_sqr()
                    m.product[i, 0] = product
                    m.step[i] = m.rotation[span[2]] @ d
                    i += self.lanes
                self._write_sums(j, lane, gain, h)
            j += self.warps

    @ti.func
    def move(self, thread):
        """Move by b d."""
        s, m = self.state, self.modal
        j, lane = self.grid.warp_index(thread), thread % self.lanes
        while j < self._spans():
            span = self.blocks.span[j]
            if not self.state.asleep[span[2]]:
                gain, h = self._body_sums(span[2], lane)
                b = gain / ti.max(gain + h, 1e-30) if gain > 0.0 else 0.0
                if lane == 0 and j == self.blocks.begin[span[2]]:
                    m.trial[span[2]] = b
                i = span[0] + lane
                while i < span[1]:
                    d = b * m.step[i]
                    m.step[i] = d
                    s.dx[i] += d
                    i += self.lanes
            j += self.warps

    @ti.func
    def measure(self, thread):
        """Sums of the secant."""
        m = self.modal
        j, lane = self.grid.warp_index(thread), thread % self.lanes
        while j < self._spans():
            span = self.blocks.span[j]
            if not self.state.asleep[span[2]]:
                gain, curvature = 0.0, 0.0
                i = span[0] + lane
                while i < span[1]:
                    gain += m.product[i, 0]
                    curvature += m.product[i, 1]
                    i += self.lanes
                self._write_sums(j, lane, gain, curvature)
            j += self.warps

    @ti.func
    def _write_sums(self, j, lane, a, b):
        a_total, b_total = self._sum(a), self._sum(b)
        if lane == 0:
            self.modal.product_sums[j, 0], self.modal.product_sums[j, 1] = a_total, b_total

    @ti.func
    def _body_sums(self, b, lane):
        """Both sums over body b, in all lanes."""
        m = self.modal
        one, other, j = 0.0, 0.0, self.blocks.begin[b] + lane
        while j < self.blocks.begin[b + 1]:
            one += m.product_sums[j, 0]
            other += m.product_sums[j, 1]
            j += self.lanes
        return self.grid.broadcast(self._sum(one)), self.grid.broadcast(self._sum(other))

    def destroy(self) -> None:
        self._group.destroy()
