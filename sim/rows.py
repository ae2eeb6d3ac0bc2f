"""Contacts that share vertices, as rows of a system that takes one step a sweep.

A row constrains the motion y = sum_e c_e y_e of a few vertices with coefficients c_e (negative on the other body).
Its impulse lambda moves vertex e by w_e c_e lambda. All rows step at once, from the impulses of the last substep,
so that what rests is solved exactly. In a step each row may use the share |c_e| / B_e of the mass of vertex e, where
B_e is the sum of all active rows' |c| on that vertex (mass splitting, Tonge et al. 2012):

    lambda += (wanted change of y) / sum_e |c_e| w_e B_e

So impulses stay equal and opposite, rows that agree are solved in one step, others never overshoot. The sums over rows
are integers: their order, and the number of threads, do not matter.
"""

import taichi as ti

from sim.response import grip, least
from sim.state import State

LENGTH = 2.0**44  # steps of the integer sums in a metre: 6e-14 m, and 5e5 m before overflow
SHARE = 2.0**20  # steps of the integer sums of coefficients
MOST = 7  # vertices of a row: a triangle's and a tet's


@ti.data_oriented
class Rows:
    """The table of rows, and the sums that they make.

    normal vec3[R], phi f32[R] [m], friction vec2[R] = (mu_s, mu_k), pace f32[R] [m/s]
    impulse vec3[R] [kg m] of the last sweep
    wake i32[R]: the substep until which a row is too far from contact to be looked at
    seen i32[R]: in this substep, 0: not looked at, 1: has no distance, 2: has one
    size i32[R], vertex i32[R,7], coefficient f32[R,7]: the vertices of a row;   claimed i32[R]: active in this sweep
    listed i32[R], listed_count: the rows in use
    share i32[V] = B, in 1/SHARE;   start, change i64[V,3], in 1/LENGTH m: what the impulses of the last substep, and
    their changes, move a vertex;   last vec3[V] [m]: both, in the last sweep
    """

    def __init__(self, state: State, capacity: int):
        self.state, self.capacity = state, capacity
        # side by side, the vertices' loads wait for memory once instead of one after the other; a CPU gains nothing
        self.unrolled = ti.cfg.arch == ti.cuda
        self.builder = ti.FieldsBuilder()
        self.normal, self.impulse, self.last = (ti.Vector.field(3, ti.f32) for _ in range(3))
        self.phi, self.pace, self.coefficient = (ti.field(ti.f32) for _ in range(3))
        self.friction = ti.Vector.field(2, ti.f32)
        self.size, self.wake, self.vertex, self.claimed, self.listed, self.share, self.seen, self.listed_count = (
            ti.field(ti.i32) for _ in range(8)
        )
        self.start, self.change = ti.Vector.field(3, ti.i64), ti.Vector.field(3, ti.i64)
        self.builder.dense(ti.i, capacity).place(self.normal, self.phi, self.friction, self.pace, self.size)
        self.builder.dense(ti.i, capacity).place(self.wake, self.claimed, self.seen)
        self.builder.dense(ti.i, capacity).place(self.impulse)
        self.builder.dense(ti.i, capacity).place(self.listed)
        self.builder.dense(ti.i, capacity).dense(ti.j, MOST).place(self.vertex, self.coefficient)
        self.builder.dense(ti.i, state.V).place(self.share)
        self.builder.dense(ti.i, state.V).place(self.last)
        self.builder.dense(ti.i, state.V).place(self.start, self.change)
        self.builder.place(self.listed_count)
        self.tree = self.builder.finalize()

    @ti.func
    def enlist(self, r):
        """Put row r on the list until the next search."""
        self.listed[ti.atomic_add(self.listed_count[None], 1)] = r

    @ti.func
    def forget(self, r):
        self.impulse[r] = ti.Vector([0.0, 0.0, 0.0])

    @ti.func
    def set(self, r, phi, normal, friction, pace):
        """What row r is like now; at `pace` [m/s] its distance phi may shrink."""
        self.phi[r], self.normal[r], self.friction[r], self.pace[r] = phi, normal, friction, pace

    @ti.func
    def rest(self, r, phi, pace):
        """Look at row r again when its distance phi [m] may be used up."""
        s = self.state
        self.wake[r] = s.tick[None] + 1 + ti.cast(ti.max(phi, 0.0) / (pace * s.dt[None]), ti.i32)

    @ti.func
    def set_vertex(self, r, e, i, c):
        self.vertex[r, e], self.coefficient[r, e] = i, c

    @ti.func
    def set_size(self, r, size):
        """Row r has the vertices set so far. The places after them are filled with nothing, harmlessly."""
        self.size[r] = size
        if ti.static(self.unrolled):
            for e in ti.static(range(MOST)):
                if e >= size:
                    self.vertex[r, e], self.coefficient[r, e] = self.vertex[r, 0], 0.0

    @ti.func
    def claim(self, r, usable, first: ti.template()):
        """First pass: if the row carries a load or is about to, claim masses and push as in the last substep."""
        self.claimed[r] = 0
        if usable and (
            self.impulse[r].norm_sqr() > 0.0
            or self.normal[r].dot(self._motion(r, False)) < least(self.phi[r], self.state.dt[None])
        ):
            self.claimed[r] = 1
            if ti.static(self.unrolled):
                for e in ti.static(range(MOST)):
                    self._claim(r, e)
            else:
                for e in range(self.size[r]):
                    self._claim(r, e)
            if ti.static(first):
                self._push(r, self.impulse[r], self.start)
        else:
            self.forget(r)
            if usable:
                self.rest(r, self.phi[r], self.pace[r])

    @ti.func
    def step(self, r):
        """Second pass: change the impulse so that lambda_n >= 0 and |lambda_t| <= mu lambda_n (see `grip`)."""
        if self.claimed[r]:
            mass = 0.0  # inverse
            if ti.static(self.unrolled):
                for e in ti.static(range(MOST)):
                    mass += self._split(r, e)
            else:
                for e in range(self.size[r]):
                    mass += self._split(r, e)
            if mass > 0.0:
                n, old, y = self.normal[r], self.impulse[r], self._motion(r, True)
                old_n, y_n = n.dot(old), n.dot(y)
                new_n = ti.max(old_n + (least(self.phi[r], self.state.dt[None]) - y_n) / mass, 0.0)
                new_t = (old - old_n * n) - (y - y_n * n) / mass
                new = new_n * n + new_t * grip(new_t.norm(), new_n, self.friction[r], mass, self.state.dt[None])
                self.impulse[r] = new
                self._push(r, new - old, self.change)

    @ti.func
    def settle(self, i):
        """All pushes [m] on vertex i, whose sums are thereby cleared."""
        d = ti.Vector([0.0, 0.0, 0.0])
        if self.share[i] != 0:
            d = ti.cast(self.start[i] + self.change[i], ti.f32) * (1.0 / LENGTH)
            self.start[i] = ti.Vector([0, 0, 0], ti.i64)
            self.change[i] = ti.Vector([0, 0, 0], ti.i64)
            self.share[i] = 0
        self.last[i] = d
        return d

    @ti.func
    def _motion(self, r, started: ti.template()):
        """y [m] in this substep so far; in the second pass (`started`) with what the first one pushed."""
        y = ti.Vector([0.0, 0.0, 0.0])
        if ti.static(self.unrolled):
            for e in ti.static(range(MOST)):
                y += self._moved(r, e, started)
        else:
            for e in range(self.size[r]):
                y += self._moved(r, e, started)
        return y

    @ti.func
    def _moved(self, r, e, started: ti.template()):
        """The share of vertex e in y [m]."""
        i = self.vertex[r, e]
        y = self.state.dx[i] - self.state.carry[i]
        if ti.static(started and not self.state.answers):  # else dx has answered already
            y += ti.cast(self.start[i], ti.f32) * (1.0 / LENGTH)
        return self.coefficient[r, e] * y

    @ti.func
    def _push(self, r, impulse, sums: ti.template()):
        if ti.static(self.unrolled):
            for e in ti.static(range(MOST)):
                self._push_one(r, e, impulse, sums)
        else:
            for e in range(self.size[r]):
                self._push_one(r, e, impulse, sums)

    @ti.func
    def _push_one(self, r, e, impulse, sums: ti.template()):
        i = self.vertex[r, e]
        push = self.state.w[i] * self.coefficient[r, e] * LENGTH * impulse
        if push.norm_sqr() > 0.0:
            for axis in ti.static(range(3)):
                ti.atomic_add(sums[i][axis], ti.cast(push[axis], ti.i64))

    @ti.func
    def _claim(self, r, e):
        i, c = self.vertex[r, e], self.coefficient[r, e]
        if c != 0.0 and self.state.w[i] > 0.0:
            ti.atomic_add(self.share[i], ti.cast(ti.abs(c) * SHARE, ti.i32))

    @ti.func
    def _split(self, r, e):
        """Inverse of the mass [1/kg] that row r may use of its vertex e."""
        i = self.vertex[r, e]
        return ti.abs(self.coefficient[r, e]) * self.state.mobility[i] * ti.cast(self.share[i], ti.f32) / SHARE

    @ti.kernel
    def clear(self):
        """Forget all contacts."""
        self.listed_count[None] = 0
        for r in self.size:
            self.forget(r)
        for i in self.share:
            self.share[i] = 0
            self.last[i] = ti.Vector([0.0, 0.0, 0.0])
            self.start[i] = ti.Vector([0, 0, 0], ti.i64)
            self.change[i] = ti.Vector([0, 0, 0], ti.i64)

    def destroy(self) -> None:
        self.tree.destroy()
