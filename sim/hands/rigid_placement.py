"""Rigid placement of bodies relative to their positions at grasp time, so that repeated edits accumulate no error."""

import numpy as np
import taichi as ti

from sim.state import State


@ti.data_oriented
class RigidPlacement:
    """start vec3[V] [m]: positions of the vertices of a body when it was kept."""

    def __init__(self, state: State):
        self.state = state
        self.builder = ti.FieldsBuilder()
        self.start = ti.Vector.field(3, ti.f32)
        self.builder.dense(ti.i, state.V).place(self.start)
        self.tree = self.builder.finalize()

    @ti.kernel
    def keep(self, body: ti.i32):
        """Measure later placements of the body from its present positions."""
        s = self.state
        for i in range(s.V):
            if i < s.vertex_count[None] and s.body_of_vertex[i] == body:
                self.start[i] = s.x[i]

    def to(self, body: int, A, t) -> None:
        """Place the body at A start + t, A (3, 3), t (3,) [m], at rest."""
        self._to(body, ti.Matrix(A.tolist()), ti.Vector(t.tolist()))

    @ti.kernel
    def _to(self, body: ti.i32, A: ti.types.matrix(3, 3, ti.f32), t: ti.types.vector(3, ti.f32)):
        s = self.state
        for i in range(s.V):
            if i < s.vertex_count[None] and s.body_of_vertex[i] == body:
                s.x[i] = A @ self.start[i] + t
                s.x_lo[i].fill(0.0)
                s.v[i].fill(0.0)
                s.v_lo[i].fill(0.0)

    def warm_up(self) -> None:
        """See Solver.warm_up."""
        self.keep(-1)
        self.to(-1, np.eye(3), np.zeros(3))

    def destroy(self) -> None:
        self.tree.destroy()
