"""The last line of defence: a body that is no longer finite is put back where it was, at rest.

Nothing is known by which a body comes to this. Should one all the same, the fault stays with it: at the end of the
frame it gets the positions back that it last had and that make a shape, and no velocity, and it is then led to its rest
shape (sim/elastic/untangling.py). Contacts are forgotten, for they know its infinities. How often this was is in the solver's
stats as `rescued`.
"""

import taichi as ti

from sim.model import MAX_BODIES
from sim.reductions import finite
from sim.state import State

SANE = 10.0  # times as far from one another as at rest: what is farther apart is not worth going back to
LOST = 2  # in state.inverted, beside the 1 of a tet that is inside out
STRANGE, BROKEN = 1, 2  # states of a body


@ti.data_oriented
class NonFiniteRecovery:
    """good vec3[V] [m]: where the vertices last were in good order;   mark i32[B] of each body;   count i32[]"""

    def __init__(self, state: State):
        self.state = state
        self.good = ti.Vector.field(3, ti.f32)
        self.mark, self.count = ti.field(ti.i32), ti.field(ti.i32)
        self.builder = ti.FieldsBuilder()
        self.builder.dense(ti.i, state.V).place(self.good)
        self.builder.dense(ti.i, MAX_BODIES).place(self.mark)
        self.builder.place(self.count)
        self.tree = self.builder.finalize()

    @ti.kernel
    def run(self, begin: ti.i32):
        """Put back what is not finite, and learn where the rest is; at the `begin`, where everything is."""
        s = self.state
        ti.loop_config(serialize=s.serial)
        for b in range(MAX_BODIES):
            self.mark[b] = 0
        ti.loop_config(serialize=s.serial)
        for i in range(s.V):
            if i < s.vertex_count[None]:
                b = s.body_of_vertex[i]
                j = s.vertex_begin[b]
                for k in ti.static(range(3)):
                    low = finite(s.x_lo[i][k]) and finite(s.v_lo[i][k])
                    if not (finite(s.x[i][k]) and finite(s.v[i][k]) and low):
                        ti.atomic_max(self.mark[b], BROKEN)
                far = SANE**2 * ((s.rest[i] - s.rest[j]).norm_sqr() + s.max_step[b] ** 2)
                if begin == 0 and (s.x[i] - s.x[j]).norm_sqr() > far:
                    ti.atomic_max(self.mark[b], STRANGE)
        ti.loop_config(serialize=s.serial)
        for i in range(s.V):
            if i < s.vertex_count[None]:
                b, none = s.body_of_vertex[i], ti.Vector([0.0, 0.0, 0.0])
                if self.mark[b] == BROKEN:
                    s.x[i], s.x_lo[i], s.v[i], s.v_lo[i] = self.good[i], none, none, none
                    if i == s.vertex_begin[b]:
                        s.inverted[b] |= LOST
                        ti.atomic_add(self.count[None], 1)
                elif self.mark[b] == 0:
                    self.good[i] = s.x[i]

    def destroy(self) -> None:
        self.tree.destroy()
