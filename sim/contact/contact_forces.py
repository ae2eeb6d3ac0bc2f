"""Contact forces on the bodies, summed on demand: for haptics, and to see what carries a weight."""

import numpy as np
import taichi as ti

from sim.contact.constraints import ContactConstraints
from sim.model import MAX_BODIES
from sim.state import State

UNIT = 1e-6  # [N] of the integer sums, which do not depend on the order of summation


@ti.data_oriented
class ContactForces:
    """push vec3[V] [m]: what static shapes did to each vertex in the last substep;   total i64[B,3] [UNIT]."""

    def __init__(self, state: State):
        self.state = state
        self.builder = ti.FieldsBuilder()
        self.push, self.total = ti.Vector.field(3, ti.f32), ti.field(ti.i64)
        self.builder.dense(ti.i, state.V).place(self.push)
        self.builder.dense(ti.ij, (MAX_BODIES, 3)).place(self.total)
        self.tree = self.builder.finalize()

    @ti.func
    def note(self, i, correction, first: ti.template()):
        """Static shapes moved vertex i by this in the sweep; `first` starts the substep."""
        if ti.static(first):
            self.push[i] = correction
        else:
            self.push[i] += correction

    @ti.func
    def forget(self, i):
        self.push[i] = ti.Vector([0.0, 0.0, 0.0])

    def per_body(self, rows: ContactConstraints) -> np.ndarray:
        """Force of all contacts on each body in the last substep [N], (B, 3) float64."""
        self._sum(rows)
        return self.total.to_numpy()[: self.state.body_count[None]] * UNIT

    @ti.kernel
    def _sum(self, rows: ti.template()):
        """f = sum m_i d_i / dt^2 over vertices + sum c_e lambda / dt^2 over the rows' vertices."""
        s = self.state
        for b, axis in self.total:
            self.total[b, axis] = 0
        for i in range(s.V):
            if i < s.vertex_count[None] and s.dt[None] > 0.0:
                self._add(s.body_of_vertex[i], s.mass[i] * self.push[i])
        for k in range(rows.capacity):
            if k < rows.listed_count[None] and s.dt[None] > 0.0:
                r = rows.listed[k]
                for e in range(rows.size[r]):
                    self._add(s.body_of_vertex[rows.vertex[r, e]], rows.coefficient[r, e] * rows.impulse[r])
                if ti.static(rows.coupled):
                    for e in range(rows.ends[r]):
                        self._add(rows.end[r, e], rows.side[r, e] * rows.impulse[r])

    @ti.func
    def _add(self, b, impulse):
        if impulse.norm_sqr() > 0.0:
            dt = ti.cast(self.state.dt[None], ti.f64)
            for axis in ti.static(range(3)):
                ti.atomic_add(self.total[b, axis], ti.cast(ti.cast(impulse[axis], ti.f64) / (dt * dt * UNIT), ti.i64))

    def destroy(self) -> None:
        self.tree.destroy()
