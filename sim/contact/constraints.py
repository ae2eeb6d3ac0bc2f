"""Contacts that share vertices, as rows of a system that takes one step a sweep.

A row constrains the motion y = sum_e c_e y_e of a few vertices with coefficients c_e (negative on the other body).
Its impulse lambda moves vertex e by w_e c_e lambda. All rows step at once, from the impulses of the last substep,
so that what rests is solved exactly. In a step each row may use the share |c_e| / B_e of the mass of vertex e, where
B_e is the sum of all active rows' |c| on that vertex (mass splitting, Tonge et al. 2012):

    lambda += (wanted change of y) / sum_e |c_e| w_e B_e

A row may also end on rigid bodies (sim/rigid/rigid_bodies.py): there y_e = dx + turn x r at the arm r, and w is the inverse of what
a push meets there. Rows between rigid bodies alone are solved in groups (sim/rigid/rigid_contact.py).

So impulses stay equal and opposite, rows that agree are solved in one step, others never overshoot. The sums over rows
are integers: their order, and the number of threads, do not matter.
"""

import taichi as ti

from sim.contact.response import grip, least, press
from sim.state import State

LENGTH = 2.0**44  # steps of the integer sums in a metre: 6e-14 m, and 5e5 m before overflow
SHARE = 2.0**20  # steps of the integer sums of coefficients
MOST = 7  # vertices of a row: a triangle's and a tet's


@ti.data_oriented
class ContactConstraints:
    """The table of rows, and the sums that they make.

    normal vec3[R], phi f32[R] [m], friction vec2[R] = (mu_s, mu_k), pace f32[R] [m/s]
    impulse vec3[R] [kg m] of the last sweep
    wake i32[R]: the substep until which a row is too far from contact to be looked at
    seen i32[R]: in this substep, 0: not looked at, 1: has no distance, 2: has one
    size i32[R], vertex i32[R,7], coefficient f32[R,7]: the vertices of a row;   claimed i32[R]: active in this sweep
    listed i32[R], listed_count: the rows in use
    share i32[V] = B, in 1/SHARE;   last vec3[V] [m]: what the rows moved a vertex by, in the last sweep
    sums i64[V,1+passes,3], in 1/LENGTH m: what the impulses of the last substep move it by, and their changes in each
    pass over the rows, of which there is one without rigid bodies
    ends i32[R], end i32[R,2], arm vec3[R,2] [m], side f32[R,2]: rigid bodies of a row, and +1 or -1 for its coefficient
    Of the last `fingers` rows, whose pushes are soft and bounded (sim/hands/fingers.py): drive vec3 [m], how the finger moves
    in this substep; most f32 [N], its greatest force.
    """

    def __init__(self, state: State, capacity: int, movers=None, fingers: int = 0):
        self.state, self.capacity, self.movers, self.coupled = state, capacity, movers, movers is not None
        self.fingers, self.first_finger = fingers > 0, capacity - fingers
        self.passes = movers.passes if self.coupled else 1
        # side by side, the vertices' loads wait for memory once instead of one after the other; a CPU gains nothing
        self.unrolled = ti.cfg.arch == ti.cuda
        self.builder = ti.FieldsBuilder()
        self.normal, self.impulse, self.last = (ti.Vector.field(3, ti.f32) for _ in range(3))
        self.phi, self.pace, self.coefficient = (ti.field(ti.f32) for _ in range(3))
        self.friction = ti.Vector.field(2, ti.f32)
        self.size, self.wake, self.vertex, self.claimed, self.listed, self.share, self.seen, self.listed_count = (
            ti.field(ti.i32) for _ in range(8)
        )
        self.sums = ti.Vector.field(3, ti.i64)
        self.builder.dense(ti.i, capacity).place(self.normal, self.phi, self.friction, self.pace, self.size)
        self.builder.dense(ti.i, capacity).place(self.wake, self.claimed, self.seen)
        self.builder.dense(ti.i, capacity).place(self.impulse)
        self.builder.dense(ti.i, capacity).place(self.listed)
        self.builder.dense(ti.i, capacity).dense(ti.j, MOST).place(self.vertex, self.coefficient)
        self.builder.dense(ti.i, state.V).place(self.share)
        self.builder.dense(ti.i, state.V).place(self.last)
        self.builder.dense(ti.ij, (state.V, 1 + self.passes)).place(self.sums)
        if self.coupled:
            self.ends, self.end = ti.field(ti.i32), ti.field(ti.i32)
            self.side, self.arm = ti.field(ti.f32), ti.Vector.field(3, ti.f32)
            self.builder.dense(ti.i, capacity).place(self.ends)
            self.builder.dense(ti.i, capacity).dense(ti.j, 2).place(self.end, self.side, self.arm)
        if self.fingers:
            self.drive, self.most = ti.Vector.field(3, ti.f32), ti.field(ti.f32)
            self.builder.dense(ti.i, fingers).place(self.drive, self.most)
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
        self.wake[r] = s.substep_index[None] + 1 + ti.cast(ti.max(phi, 0.0) / (pace * s.dt[None]), ti.i32)

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
    def set_end(self, r, e, b, x, side):
        """Make rigid body b, touched at x, end e of row r, with coefficient `side`."""
        self.end[r, e], self.side[r, e], self.arm[r, e] = b, side, x - self.movers.x[b]

    @ti.func
    def claim(self, r, usable, first: ti.template(), integrator: ti.template()):
        """First pass: if the row carries a load or is about to, claim masses and push as in the last substep."""
        self.claimed[r] = 0
        if usable and (
            self.impulse[r].norm_sqr() > 0.0
            or self.normal[r].dot(self.motion(r, 0, integrator)) < least(self.phi[r], self.state.dt[None])
        ):
            self.claimed[r] = 1
            if ti.static(self.unrolled):
                for e in ti.static(range(MOST)):
                    self._claim(r, e)
            else:
                for e in range(self.size[r]):
                    self._claim(r, e)
            if ti.static(self.coupled):
                for e in range(self.ends[r]):
                    self.movers.claim(self.end[r, e], 1.0)
            if ti.static(first):
                self.push(r, self.impulse[r], 0)
        else:
            self.forget(r)
            if usable:
                self.rest(r, self.phi[r], self.pace[r])

    @ti.func
    def step(self, r, j: ti.template(), integrator: ti.template()):
        """Pass j: change the impulse so that lambda_n >= 0 and |lambda_t| <= mu lambda_n (see `grip`)."""
        if self.claimed[r]:
            mass = 0.0  # inverse
            if ti.static(self.unrolled):
                for e in ti.static(range(MOST)):
                    mass += self._split(r, e, integrator)
            else:
                for e in range(self.size[r]):
                    mass += self._split(r, e, integrator)
            n, old, y = self.normal[r], self.impulse[r], self.motion(r, j, integrator)
            old_n, y_n = n.dot(old), n.dot(y)
            y_t, mass_t = y - y_n * n, mass
            if ti.static(self.coupled):
                along = y_t / ti.max(y_t.norm(), 1e-20)
                for e in range(self.ends[r]):
                    b, arm = self.end[r, e], self.arm[r, e]
                    mass += self.movers.claims(b) * self.movers.inverse(b, arm, n)
                    mass_t += self.movers.claims(b) * self.movers.inverse(b, arm, along)
            if mass > 0.0:
                new_n = ti.max(old_n + (least(self.phi[r], self.state.dt[None]) - y_n) / mass, 0.0)
                if ti.static(self.fingers):
                    new_n = self._pressed(r, old_n, y_n, mass, new_n)
                new_t = (old - old_n * n) - y_t / ti.max(mass_t, 1e-20)
                new = new_n * n + new_t * grip(new_t.norm(), new_n, self.friction[r], mass_t, self.state.dt[None])
                self.impulse[r] = new
                self.push(r, new - old, j)

    @ti.func
    def settle(self, i):
        """All pushes [m] on vertex i, whose sums are thereby cleared."""
        d = ti.Vector([0.0, 0.0, 0.0])
        if self.share[i] != 0:
            total = ti.Vector([0, 0, 0], ti.i64)
            for j in ti.static(range(1 + self.passes)):
                total += self.sums[i, j]
                self.sums[i, j] = ti.Vector([0, 0, 0], ti.i64)
            d = ti.cast(total, ti.f32) * (1.0 / LENGTH)
            self.share[i] = 0
        self.last[i] = d
        return d

    @ti.func
    def motion(self, r, passed: ti.template(), integrator: ti.template()):
        """y [m] in this substep so far, with what the first `passed` passes pushed."""
        y = ti.Vector([0.0, 0.0, 0.0])
        if ti.static(self.unrolled):
            for e in ti.static(range(MOST)):
                y += self._moved(r, e, passed, integrator)
        else:
            for e in range(self.size[r]):
                y += self._moved(r, e, passed, integrator)
        if ti.static(self.coupled):
            for e in range(self.ends[r]):
                d, t = self.movers.moved(self.end[r, e], passed)
                y += self.side[r, e] * (d + t.cross(self.arm[r, e]))
        if ti.static(self.fingers):
            y += self._driven(r)
        return y

    @ti.func
    def _driven(self, r):
        """How row r's finger moves in this substep [m]; 0 of other rows."""
        way = ti.Vector([0.0, 0.0, 0.0])
        if r >= self.first_finger:
            way = self.drive[r - self.first_finger]
        return way

    @ti.func
    def _pressed(self, r, old, y, mass, hard):
        """Row r's new normal impulse: `hard`, or what a finger yields."""
        new = hard
        if r >= self.first_finger:
            dt = self.state.dt[None]
            new = press(old, self.phi[r], y, mass, dt, self.most[r - self.first_finger] * dt * dt)
        return new

    @ti.func
    def _moved(self, r, e, passed: ti.template(), integrator: ti.template()):
        """The share of vertex e in y [m]."""
        i = self.vertex[r, e]
        y = self.state.dx[i] - self.state.x_lo[i]
        # warm-started: dx contains the first sums already
        for j in ti.static(range(1 if integrator.warm_started else 0, passed)):
            moved = ti.cast(self.sums[i, j], ti.f32) * (1.0 / LENGTH)
            if ti.static(integrator.warm_started):
                moved *= integrator.effective_inv_mass[i] / ti.max(self.state.inv_mass[i], 1e-20)
            y += moved
        return self.coefficient[r, e] * y

    @ti.func
    def push(self, r, impulse, j: ti.template()):
        """Let row r act with an impulse [kg m], in the sums of pass j."""
        if ti.static(self.unrolled):
            for e in ti.static(range(MOST)):
                self._push_one(r, e, impulse, j)
        else:
            for e in range(self.size[r]):
                self._push_one(r, e, impulse, j)
        if ti.static(self.coupled):
            for e in range(self.ends[r]):
                p = self.side[r, e] * impulse
                self.movers.push(self.end[r, e], p, self.arm[r, e].cross(p), j)

    @ti.func
    def _push_one(self, r, e, impulse, j: ti.template()):
        i = self.vertex[r, e]
        push = self.state.inv_mass[i] * self.coefficient[r, e] * LENGTH * impulse
        if push.norm_sqr() > 0.0:
            for axis in ti.static(range(3)):
                ti.atomic_add(self.sums[i, j][axis], ti.cast(push[axis], ti.i64))

    @ti.func
    def _claim(self, r, e):
        i, c = self.vertex[r, e], self.coefficient[r, e]
        if c != 0.0 and self.state.inv_mass[i] > 0.0:
            ti.atomic_add(self.share[i], ti.cast(ti.abs(c) * SHARE, ti.i32))

    @ti.func
    def _split(self, r, e, integrator: ti.template()):
        """Inverse of the mass [1/kg] that row r may use of its vertex e."""
        i = self.vertex[r, e]
        return (
            ti.abs(self.coefficient[r, e]) * integrator.effective_inv_mass[i] * ti.cast(self.share[i], ti.f32) / SHARE
        )

    @ti.kernel
    def clear(self):
        """Forget all contacts."""
        self.listed_count[None] = 0
        for r in self.size:
            self.forget(r)
        for i in self.share:
            self.share[i] = 0
            self.last[i] = ti.Vector([0.0, 0.0, 0.0])
            for j in range(1 + self.passes):
                self.sums[i, j] = ti.Vector([0, 0, 0], ti.i64)
        if ti.static(self.coupled):
            for r in self.size:
                self.ends[r] = 0

    def destroy(self) -> None:
        self.tree.destroy()
