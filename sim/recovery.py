"""Last line of defence: a body with non-finite state is restored to its last good positions, at rest.

No cause is known. If a body becomes non-finite nevertheless, the others are not affected: at the end of the frame it
gets its last good positions back and no velocity, and is then moved to its rest shape (sim/elastic/untangling.py).
Contacts are forgotten, because they hold its infinities. The solver's stats count such bodies as `recovered`.
"""

import taichi as ti

from core.fields import FieldGroup
from sim.capacity import MAX_BODIES
from sim.reductions import finite
from sim.state import State

MAX_GROWTH = 10.0  # times the distance at rest: positions farther apart are not worth going back to
RECOVERED = 2  # bit of state.inverted, beside the 1 of an inverted tet
OVERSTRETCHED, NON_FINITE = 1, 2  # conditions of a body


@ti.data_oriented
class NonFiniteRecovery:
    """good vec3[V]: last good positions [m];   condition i32[B], 0 if good;   count: bodies restored so far."""

    def __init__(self, state: State):
        self.state = state
        g = self._group = FieldGroup()
        self.good = g.vector(state.V)
        self.condition, self.count = g.scalar(MAX_BODIES, dtype=ti.i32), g.scalar(dtype=ti.i32)
        g.build()

    def begin(self) -> None:
        """Take all finite positions as good: after bodies were loaded or moved."""
        self._run(1)

    def recover(self) -> None:
        """Restore non-finite bodies, and keep the positions of good ones: after a frame."""
        self._run(0)

    @ti.kernel
    def _run(self, begin: ti.i32):
        s = self.state
        ti.loop_config(serialize=s.serial)
        for b in range(MAX_BODIES):
            self.condition[b] = 0
        ti.loop_config(serialize=s.serial)
        for i in range(s.V):
            if i < s.vertex_count[None]:
                b = s.body_of_vertex[i]
                j = s.vertex_begin[b]
                for k in ti.static(range(3)):
                    low = finite(s.x_lo[i][k]) and finite(s.v_lo[i][k])
                    if not (finite(s.x[i][k]) and finite(s.v[i][k]) and low):
                        ti.atomic_max(self.condition[b], NON_FINITE)
                far = MAX_GROWTH**2 * ((s.rest[i] - s.rest[j]).norm_sqr() + s.max_step[b] ** 2)
                if begin == 0 and (s.x[i] - s.x[j]).norm_sqr() > far:
                    ti.atomic_max(self.condition[b], OVERSTRETCHED)
        ti.loop_config(serialize=s.serial)
        for i in range(s.V):
            if i < s.vertex_count[None]:
                b, zero = s.body_of_vertex[i], ti.Vector([0.0, 0.0, 0.0])
                if self.condition[b] == NON_FINITE:
                    s.x[i], s.x_lo[i], s.v[i], s.v_lo[i] = self.good[i], zero, zero, zero
                    if i == s.vertex_begin[b]:
                        s.inverted[b] |= RECOVERED
                        ti.atomic_add(self.count[None], 1)
                elif self.condition[b] == 0:
                    self.good[i] = s.x[i]

    def destroy(self) -> None:
        self._group.destroy()
