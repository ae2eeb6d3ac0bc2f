"""Contact constraints that share vertices or rigid bodies, solved together, one step a sweep.

A constraint acts on the motion y = sum_e c_e y_e of a few vertices with coefficients c_e (negative on the other body).
Its impulse lambda moves vertex e by w_e c_e lambda. All constraints step at once, from the impulses of the last
substep, so that what rests is solved exactly. In a step each may use the part |c_e| / B_e of the mass of vertex e,
where the split count B_e is the sum of all active constraints' |c| on that vertex (mass splitting, Tonge et al. 2012):

    lambda += (wanted change of y) / sum_e |c_e| w_e B_e

A constraint may also act on rigid bodies (sim/rigid/rigid_bodies.py): there y_e = dx + rotation x r at the lever arm r,
and w is the inverse effective mass. Constraints between rigid bodies alone are solved in groups
(sim/rigid/rigid_contact.py).

So impulses stay equal and opposite, constraints that agree are solved in one step, others never overshoot. The sums
over constraints are integers: their order, and the number of threads, do not matter.
"""

import numpy as np
import taichi as ti

from core.fields import FieldGroup
from sim.contact.response import (
    INSIDE,
    MAX_RECOVERY_SPEED,
    UNBOUNDED,
    fingertip_spring,
    gentle_normal_motion,
    holding_impulse,
    isotropic_contact_impulse,
    min_normal_motion,
)
from sim.model import MAX_BODIES
from sim.state import State

STEPS_PER_METER = 2.0**44  # of the integer sums: 6e-14 m, and 5e5 m before overflow
STEPS_PER_COEFFICIENT = 2.0**20  # of the integer sums of coefficients
MAX_VERTICES = 7  # of a constraint: a triangle's and a tet's
SETTLED = 1e-3  # relative change of an impulse in a pass, after which no further pass is needed
FORCE_STEP = 1e-6  # [N] of the integer sums of forces, which do not depend on the order of summation
NOT_CHECKED, NO_DISTANCE, VALID = range(3)  # `status` of a constraint
GENTLE = 2  # `active` of a row, or vertex on static shapes, that began inside; 1 more in each sweep until it is out


@ti.data_oriented
class ContactConstraints:
    """The table of contact constraints, one row each, and the sums of what they do.

    normal vec3[R], phi f32[R] [m] signed distance, friction vec2[R] = (mu_s, mu_k)
    closing_speed f32[R] [m/s] at which phi may shrink;   impulse vec3[R] [kg m] of the last sweep
    next_check i32[R]: the substep until which a constraint is too far from contact to be evaluated
    status i32[R]: of this substep, see above;   active i32[R]: 1 if it takes part in this sweep, or see GENTLE
    vertex_count i32[R], vertex i32[R,7], coefficient f32[R,7]: the vertices of a constraint
    candidate i32[R], candidate_count: the rows in use until the next search;   listed_count: with those that sleep
    split_count i32[V] = B, in steps;   last_correction vec3[V] [m]: of the last sweep
    changed i32[1+passes]: 1 if a pass of this sweep changed an impulse by more than SETTLED
    corrections i64[V,1+passes,3], in steps: what the impulses of the last substep move a vertex by, and their changes
    in each pass over the constraints, of which there is one without rigid bodies
    body_count i32[R], body i32[R,2], lever_arm vec3[R,2] [m], sign f32[R,2]: its rigid bodies and their coefficients
    Of the rows of fingers, from `first_finger` on, which push softly (sim/hands/finger_contact.py): finger_motion vec3
    [m] of this substep; max_force f32 [N].
    """

    def __init__(self, state: State, capacity: int, rigid_bodies=None, first_finger: int | None = None):
        self.state, self.capacity = state, capacity
        self.rigid_bodies, self.coupled = rigid_bodies, rigid_bodies is not None
        self.fingers, self.first_finger = first_finger is not None, first_finger
        self.passes = rigid_bodies.passes if self.coupled else 1
        # unrolled, the loads of all vertices overlap; a CPU gains nothing
        self.unrolled = ti.cfg.arch == ti.cuda
        group = self._group = FieldGroup()
        with group.interleaved(capacity):
            self.normal, self.phi, self.friction = group.vector(), group.scalar(), group.vector(n=2)
            self.closing_speed, self.vertex_count = group.scalar(), group.scalar(dtype=ti.i32)
        with group.interleaved(capacity):
            self.next_check, self.active, self.status = (group.scalar(dtype=ti.i32) for _ in range(3))
        self.impulse, self.candidate = group.vector(capacity), group.scalar(capacity, dtype=ti.i32)
        with group.interleaved(capacity, MAX_VERTICES):
            self.vertex, self.coefficient = group.scalar(dtype=ti.i32), group.scalar()
        self.split_count, self.last_correction = group.scalar(state.V, dtype=ti.i32), group.vector(state.V)
        self.corrections = group.vector(state.V, 1 + self.passes, dtype=ti.i64)
        self.changed = group.scalar(1 + self.passes, dtype=ti.i32)
        if self.coupled:
            self.body_count = group.scalar(capacity, dtype=ti.i32)
            with group.interleaved(capacity, 2):
                self.body, self.sign, self.lever_arm = group.scalar(dtype=ti.i32), group.scalar(), group.vector()
        if self.fingers:
            with group.interleaved(capacity - first_finger):
                self.finger_motion, self.max_force = group.vector(), group.scalar()
        self.candidate_count, self.listed_count = group.scalar(dtype=ti.i32), group.scalar(dtype=ti.i32)
        group.build()

    @ti.func
    def add_candidate(self, r):
        """Keep row r in use until the next search, and evaluate it in the next substep."""
        self.next_check[r] = 0
        self.candidate[ti.atomic_add(self.candidate_count[None], 1)] = r

    @ti.func
    def clear_impulse(self, r):
        self.impulse[r] = ti.Vector([0.0, 0.0, 0.0])

    @ti.func
    def set_contact(self, r, phi, normal, friction, closing_speed):
        """The contact of row r as it is now; its distance phi [m] may shrink at closing_speed [m/s]."""
        self.phi[r], self.normal[r], self.friction[r] = phi, normal, friction
        self.closing_speed[r] = closing_speed

    @ti.func
    def postpone(self, r, phi, closing_speed):
        """Do not evaluate row r before its distance phi [m] can be used up."""
        s = self.state
        substeps = ti.cast(ti.max(phi, 0.0) / (closing_speed * s.dt[None]), ti.i32)
        self.next_check[r] = s.substep_index[None] + 1 + substeps

    @ti.func
    def set_vertex_count(self, r, count):
        """Give row r the vertices set so far; unused places get a coefficient of 0."""
        self.vertex_count[r] = count
        if ti.static(self.unrolled):
            for e in ti.static(range(MAX_VERTICES)):
                if e >= count:
                    self.vertex[r, e], self.coefficient[r, e] = self.vertex[r, 0], 0.0

    @ti.func
    def set_body(self, r, e, b, x, sign):
        """Make rigid body b, touched at x, body e of row r, with coefficient `sign`."""
        self.body[r, e], self.sign[r, e], self.lever_arm[r, e] = b, sign, x - self.rigid_bodies.x[b]

    @ti.func
    def activate(self, r, usable, alone, integrator: ti.template()):
        """First pass: warm-start row r, and count it for mass splitting, if it carries a load or is about to.

        A contact of a body with itself, a thin capsule or a finger (`alone`) is none that began inside: what is thin
        would let the body through meanwhile.
        """
        pushed = self.impulse[r].norm_sqr() > 0.0
        gentle = usable and not alone and self.is_gentle(r, self.phi[r], pushed)
        loaded = usable and pushed
        if usable and not loaded:
            y_n = self.normal[r].dot(self.relative_motion(r, 0, integrator))
            loaded = y_n < min_normal_motion(self.phi[r], self.state.dt[None])
            if self.active[r] < GENTLE:  # a fast one was outside before
                gentle = gentle and y_n > -MAX_RECOVERY_SPEED * self.state.dt[None]
            loaded = loaded or gentle
        if loaded:
            if ti.static(self.unrolled):
                for e in ti.static(range(MAX_VERTICES)):
                    self._count_split(r, e)
            else:
                for e in range(self.vertex_count[r]):
                    self._count_split(r, e)
            if ti.static(self.coupled):
                for e in range(self.body_count[r]):
                    ti.atomic_add(self.rigid_bodies.split_count[self.body[r, e]], 1)
            if ti.static(integrator.warm_started):
                a, b = self._soft_bodies(r)
                if a >= 0:
                    ti.atomic_add(integrator.whole.split_count[a], 1)
                if b != a:
                    ti.atomic_add(integrator.whole.split_count[b], 1)
        self.set_active(r, usable, loaded, gentle)

    @ti.func
    def is_gentle(self, r, phi, pushed):
        """Return whether row r, at distance phi [m], began INSIDE, where it had not `pushed` before, and still is."""
        return phi < -INSIDE and (not pushed or self.active[r] >= GENTLE)

    @ti.func
    def mark(self, r, loaded, gentle):
        """Set `active` of row r."""
        self.active[r] = ti.max(self.active[r], 1) + 1 if gentle else ti.cast(loaded, ti.i32)

    @ti.func
    def set_active(self, r, usable, loaded, gentle):
        """Activate row r in this sweep if it is loaded, beginning with its impulse of the last substep.

        Otherwise clear that impulse and, if the row has a distance (`usable`), skip it until that may be used up.
        """
        self.mark(r, loaded, gentle)
        if loaded:
            self.add_impulse(r, self.impulse[r], 0)
        else:
            self.clear_impulse(r)
            if usable:
                self.postpone(r, self.phi[r], self.closing_speed[r])

    @ti.func
    def continues(self, j):
        """Return whether pass j is needed: it is the first, or the one before it has changed something."""
        return j == 1 or self.changed[j - 1] != 0

    @ti.func
    def solve(self, r, j, integrator: ti.template()):
        """Pass j: one step of the impulse lambda of row r, within lambda_n >= 0, |lambda_t| <= mu lambda_n.

            lambda_n += (least - n . y) / w_n,   lambda_t -= y_t / w_t,   w = sum_e |c_e| w_e B_e along n and along y_t,

        where fingers are soft (`holding_impulse` and the cone: sim/contact/response.py).
        """
        if self.active[r]:
            inv_mass = self._vertices_inv_mass(r, integrator)
            n, old, y, dt = self.normal[r], self.impulse[r], self.relative_motion(r, j, integrator), self.state.dt[None]
            inv_mass_t = inv_mass  # of vertices it is the same in all directions; of whole bodies it is not
            y_t = y - n.dot(y) * n
            along = y_t / ti.max(y_t.norm(), 1e-20)
            if ti.static(integrator.warm_started):
                W = self._mobility_of_wholes(r, integrator)
                inv_mass += n.dot(W @ n)
                inv_mass_t += along.dot(W @ along)
            if ti.static(self.coupled):
                for e in range(self.body_count[r]):
                    b, arm = self.body[r, e], self.lever_arm[r, e]
                    count = ti.cast(self.rigid_bodies.split_count[b], ti.f32)
                    inv_mass += count * self.rigid_bodies.inverse_effective_mass(b, arm, n)
                    inv_mass_t += count * self.rigid_bodies.inverse_effective_mass(b, arm, along)
            if inv_mass > 0.0:
                least, compliance, damping, most = min_normal_motion(self.phi[r], dt), 0.0, 1.0, UNBOUNDED
                friction = self.friction[r]
                if self.active[r] >= GENTLE:
                    time = dt * (self.active[r] - 1) / integrator.iterations
                    least = gentle_normal_motion(self.phi[r], n.dot(y) - inv_mass * n.dot(old), time, dt)
                    friction *= 0.0  # of what squeezes it, which would hold it inside
                if ti.static(self.fingers):  # noqa: SIM102
                    if r >= self.first_finger:
                        least, compliance, damping = fingertip_spring(self.phi[r], dt)
                        most = self.max_force[r - self.first_finger] * dt * dt
                held = holding_impulse(old, n, y, least, inv_mass, inv_mass_t, compliance, damping, most)
                new = isotropic_contact_impulse(held, n, inv_mass_t, friction, dt)
                self.impulse[r] = new
                self.add_impulse(r, new - old, j)
                if ti.static(self.coupled):  # noqa: SIM102
                    if self.body_count[r] > 0 and (new - old).norm_sqr() > SETTLED**2 * new.norm_sqr():
                        self.changed[j] = 1  # soft bodies do not ask for a pass; all writers write the same

    @ti.func
    def _vertices_inv_mass(self, r, integrator: ti.template()):
        """sum_e |c_e| w_e B_e [1/kg] over the vertices of row r."""
        inv_mass = 0.0
        if ti.static(self.unrolled):
            for e in ti.static(range(MAX_VERTICES)):
                inv_mass += self._vertex_inv_mass(r, e, integrator)
        else:
            for e in range(self.vertex_count[r]):
                inv_mass += self._vertex_inv_mass(r, e, integrator)
        return inv_mass

    @ti.func
    def _soft_bodies(self, r):
        """The soft bodies of row r, twice the same if there is one, -1 if none: vertices of the second come last."""
        a, b = -1, -1
        if self.vertex_count[r] > 0:
            a = self.state.body_of_vertex[self.vertex[r, 0]]
            b = self.state.body_of_vertex[self.vertex[r, self.vertex_count[r] - 1]]
        return a, b

    @ti.func
    def _mobility_of_wholes(self, r, integrator: ti.template()):
        """Inverse of the mass [1/kg] that row r may use of its soft bodies as wholes, (3, 3)."""
        s, whole = self.state, integrator.whole
        W = ti.Matrix.zero(ti.f32, 3, 3)
        a, b = self._soft_bodies(r)
        for side in range(0 if a < 0 else (1 if a == b else 2)):
            body = a if side == 0 else b
            total, moment, origin = 0.0, ti.Vector([0.0, 0.0, 0.0]), s.x[s.vertex_begin[body]]
            for e in range(self.vertex_count[r]):
                i = self.vertex[r, e]
                if s.body_of_vertex[i] == body:
                    c = self.coefficient[r, e] * ti.sqrt(whole.share(i))
                    total += c
                    moment += c * (s.x[i] - origin)
            W += ti.cast(whole.split_count[body], ti.f32) * whole.mobility(body, total, moment)
        return W

    @ti.func
    def apply(self, i):
        """Return the sum of all corrections [m] of vertex i, and clear it."""
        d = ti.Vector([0.0, 0.0, 0.0])
        if self.split_count[i] != 0:
            total = ti.Vector([0, 0, 0], ti.i64)
            for j in ti.static(range(1 + self.passes)):
                total += self.corrections[i, j]
                self.corrections[i, j] = ti.Vector([0, 0, 0], ti.i64)
            d = ti.cast(total, ti.f32) * (1.0 / STEPS_PER_METER)
            self.split_count[i] = 0
        self.last_correction[i] = d
        return d

    @ti.func
    def relative_motion(self, r, passed, integrator: ti.template()):
        """Relative motion y [m] in this substep so far, with the corrections of the first `passed` passes."""
        y = ti.Vector([0.0, 0.0, 0.0])
        if ti.static(self.unrolled):
            for e in ti.static(range(MAX_VERTICES)):
                y += self._vertex_motion(r, e, passed, integrator)
        else:
            for e in range(self.vertex_count[r]):
                y += self._vertex_motion(r, e, passed, integrator)
        if ti.static(self.coupled):
            for e in range(self.body_count[r]):
                d, rotation = self.rigid_bodies.increments(self.body[r, e], passed)
                y += self.sign[r, e] * (d + rotation.cross(self.lever_arm[r, e]))
        if ti.static(self.fingers):  # noqa: SIM102
            if r >= self.first_finger:
                y += self.finger_motion[r - self.first_finger]
        return y

    @ti.func
    def _vertex_motion(self, r, e, passed, integrator: ti.template()):
        """The part of vertex e in y [m]."""
        i = self.vertex[r, e]
        y = self.state.dx[i] - self.state.x_lo[i]
        for j in ti.static(range(1 if integrator.warm_started else 0, self.passes)):  # dx has the first sums already
            if j < passed:
                moved = ti.cast(self.corrections[i, j], ti.f32) * (1.0 / STEPS_PER_METER)
                if ti.static(integrator.warm_started):
                    moved *= integrator.effective_inv_mass[i] / ti.max(self.state.inv_mass[i], 1e-20)
                y += moved
        return self.coefficient[r, e] * y

    @ti.func
    def add_impulse(self, r, impulse, j):
        """Add the displacements that an impulse [kg m] of row r causes to the corrections of pass j."""
        if ti.static(self.unrolled):
            for e in ti.static(range(MAX_VERTICES)):
                self._correct_vertex(r, e, impulse, j)
        else:
            for e in range(self.vertex_count[r]):
                self._correct_vertex(r, e, impulse, j)
        if ti.static(self.coupled):
            for e in range(self.body_count[r]):
                p = self.sign[r, e] * impulse
                self.rigid_bodies.add_impulse(self.body[r, e], p, self.lever_arm[r, e].cross(p), j)

    @ti.func
    def _correct_vertex(self, r, e, impulse, j):
        i = self.vertex[r, e]
        correction = self.state.inv_mass[i] * self.coefficient[r, e] * STEPS_PER_METER * impulse
        if correction.norm_sqr() > 0.0:
            for axis in ti.static(range(3)):
                ti.atomic_add(self.corrections[i, j][axis], ti.cast(correction[axis], ti.i64))

    @ti.func
    def _count_split(self, r, e):
        i, c = self.vertex[r, e], self.coefficient[r, e]
        if c != 0.0 and self.state.inv_mass[i] > 0.0:
            ti.atomic_add(self.split_count[i], ti.cast(ti.abs(c) * STEPS_PER_COEFFICIENT, ti.i32))

    @ti.func
    def _vertex_inv_mass(self, r, e, integrator: ti.template()):
        """Inverse of the mass [1/kg] that row r may use of its vertex e."""
        i = self.vertex[r, e]
        count = ti.cast(self.split_count[i], ti.f32)
        return ti.abs(self.coefficient[r, e]) * integrator.effective_inv_mass[i] * count / STEPS_PER_COEFFICIENT

    @ti.kernel
    def clear(self):
        """Forget all contacts."""
        self.candidate_count[None], self.listed_count[None] = 0, 0
        for r in self.impulse:
            self.clear_impulse(r)
            self.active[r] = 0
        for i in self.split_count:
            self.split_count[i] = 0
            self.last_correction[i] = ti.Vector([0.0, 0.0, 0.0])
            for j in range(1 + self.passes):
                self.corrections[i, j] = ti.Vector([0, 0, 0], ti.i64)
        if ti.static(self.coupled):
            for r in self.body_count:
                self.body_count[r] = 0


@ti.data_oriented
class ContactForces:
    """Contact forces on the bodies, summed on demand: for haptics, and to see what carries a weight.

    correction vec3[V] [m]: by static shapes, of each vertex in the last substep;   total i64[B,3] in FORCE_STEP.
    """

    def __init__(self, state: State, constraints: ContactConstraints):
        self.state, self.constraints, self._group = state, constraints, FieldGroup()
        self.correction = self._group.vector(state.V)
        self.total = self._group.scalar(MAX_BODIES, 3, dtype=ti.i64)
        self._group.build()

    @ti.func
    def clear(self, i):
        self.correction[i] = ti.Vector([0.0, 0.0, 0.0])

    def per_body(self) -> np.ndarray:
        """Force of all contacts on each body in the last substep [N], (B, 3) float64."""
        self._sum()
        return self.total.to_numpy()[: self.state.body_count[None]] * FORCE_STEP

    @ti.kernel
    def _sum(self):
        """f = sum m_i d_i / dt^2 over vertices + sum c_e lambda / dt^2 over the constraints' vertices and bodies."""
        s = self.state
        table = self.constraints
        for b, axis in self.total:
            self.total[b, axis] = 0
        for i in range(s.V):
            if i < s.vertex_count[None] and s.dt[None] > 0.0:
                self._add(s.body_of_vertex[i], s.mass[i] * self.correction[i])
        for k in range(table.capacity):
            if k < ti.max(table.candidate_count[None], table.listed_count[None]) and s.dt[None] > 0.0:
                r = table.candidate[k]
                for e in range(table.vertex_count[r]):
                    self._add(s.body_of_vertex[table.vertex[r, e]], table.coefficient[r, e] * table.impulse[r])
                if ti.static(table.coupled):
                    for e in range(table.body_count[r]):
                        self._add(table.body[r, e], table.sign[r, e] * table.impulse[r])

    @ti.func
    def _add(self, b, impulse):
        if impulse.norm_sqr() > 0.0:
            dt = ti.cast(self.state.dt[None], ti.f64)
            for axis in ti.static(range(3)):
                force = ti.cast(impulse[axis], ti.f64) / (dt * dt * FORCE_STEP)
                ti.atomic_add(self.total[b, axis], ti.cast(force, ti.i64))
