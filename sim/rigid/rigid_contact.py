"""Contact of rigid bodies with static shapes and with one another, and of soft bodies with rigid ones.

Where constraints share masses (mass splitting, Tonge et al. 2012), all between the same two rigid bodies count as one,
and are solved by Gauss-Seidel sweeps: four corners on a floor take no longer to agree than one. Restitution is a speed
that a constraint asks for after an impact.
"""

import taichi as ti
from taichi.math import vec3

from core.fields import FieldGroup
from core.lanes import from_lane, lane_count, max_lanes, rank_lanes, sync_lanes, vector_from_lane
from sim.contact.constraints import GENTLE, SETTLED
from sim.contact.response import GENTLE_SPEED, isotropic_contact_impulse, min_normal_motion
from sim.contact.static_shapes import MAX_SHAPES, known
from sim.rigid.rigid_bodies import SOFT
from sim.rigid.rigid_broad_phase import WORLD, RigidBroadPhase, bodies_of_group
from sim.state import inverse_mass_matrix

GROUP_SWEEPS = 3  # over a group's constraints in each pass; with one, corners that strike together do not all rebound
MIN_IMPACT = 4.0  # times the speed that a substep of gravity gives; slower contacts do not bounce, and so come to rest
IMPACT_SUBSTEPS = 8  # that an impact may take to reach its speed: what is wedged in cannot, and must not push on


@ti.data_oriented
class RigidContacts:
    """Narrow phase and solution of the constraints that a RigidBroadPhase lists, from substep to substep.

    impact_left i32[4P]: substeps for which an impact still asks for its speed
    """

    def __init__(self, search: RigidBroadPhase):
        self.search, self.state, self.rigid_bodies = search, search.state, search.rigid_bodies
        self.constraints, self.samples, self.begin = search.constraints, search.samples, search.begin
        self.lanes = lane_count()
        self._group = FieldGroup()
        self.impact_left = self._group.scalar(search.shape.shape[0], dtype=ti.i32)
        self._group.build()

    @ti.func
    def evaluate(self, r):
        """Update constraint r's distance, normal and bodies; returns whether the shape has a distance there."""
        s = self.state
        table = self.constraints
        f = self.search
        q = r - self.begin
        p, k = q % self.samples.capacity, f.shape[q]
        b = self.samples.body[p]
        x = self.samples.blend(p, s.x)
        friction, closing_speed = s.frictions(b), f.bounds.max_speed[b]
        rigid = self.rigid_bodies.kind[b] != SOFT
        if rigid:
            table.set_body(r, 0, b, x, 1.0)
        phi, n = f.surface_at(q, x)
        if k < MAX_SHAPES:
            friction *= f.static_shapes.friction[k]
        else:
            m = k - MAX_SHAPES
            friction *= s.frictions(m)
            closing_speed += f.bounds.max_speed[m]
            table.set_body(r, 1 if rigid else 0, m, x, -1.0)
        usable = known(phi)
        if usable:
            phi += self.samples.skin[p] + n.dot(self.samples.blend(p, s.x_lo))
            table.set_contact(r, phi, n, ti.sqrt(friction), closing_speed)
        return usable

    @ti.func
    def activate(self, r, usable, integrator: ti.template()):
        """Activate a constraint of a group as ContactConstraints does; the first that carries a load counts for all."""
        g, loaded, gentle = self.search.group_of(r - self.begin), False, False
        if usable:
            table = self.constraints
            gentle = table.is_gentle(r, table.phi[r], table.impulse[r].norm_sqr() > 0.0)
            loaded = self._carries_load(r, g, self.constraints.relative_motion(r, 0, integrator))
        if loaded:
            a, b = bodies_of_group(g)
            if ti.atomic_max(self.search.active[g], 1) == 0:
                ti.atomic_add(self.rigid_bodies.split_count[a], 1)
                if b != WORLD:
                    ti.atomic_add(self.rigid_bodies.split_count[b], 1)
        self.constraints.set_active(r, usable, loaded, gentle and loaded)

    @ti.func
    def _carries_load(self, r, g, y):
        """True if constraint r of group g pushed in the last substep, or has to now, after the motion y [m].

        For an impact it stores the speed of the rebound, until that is reached or IMPACT_SUBSTEPS are over.
        """
        table, f, q = self.constraints, self.search, r - self.begin
        dt = self.state.dt[None]
        fall = self.state.gravity[None].norm() * dt * dt  # [m] in a substep from rest
        y_n = table.normal[r].dot(y)
        loaded = table.impulse[r].norm_sqr() > 0.0
        if f.bounce_speed[q] > 0.0:
            self.impact_left[q] -= 1
            table.clear_impulse(r)  # the impulse that stopped a body is not the load that follows
            if y_n >= 0.999 * f.bounce_speed[q] * dt - 1.01 * fall or self.impact_left[q] < 0:
                f.bounce_speed[q] = 0.0
            loaded = f.bounce_speed[q] > 0.0
        elif not loaded and y_n < min_normal_motion(table.phi[r], dt):
            loaded = True
            if y_n < -MIN_IMPACT * fall:
                f.bounce_speed[q] = -y_n / dt * self._restitution(g)
                self.impact_left[q] = IMPACT_SUBSTEPS
        return loaded

    @ti.func
    def _min_normal_motion(self, r, q, restitution):
        """Least normal motion [m] of constraint r in this substep.

        An impact asks for its bounce speed, in its first substep less what the body has to go until it touches.
        """
        dt = self.state.dt[None]
        y_n = min_normal_motion(self.constraints.phi[r], dt)
        if self.constraints.active[r] >= GENTLE:
            y_n = ti.min(y_n, GENTLE_SPEED * dt)
        if self.search.bounce_speed[q] > 0.0:
            y_n = self.search.bounce_speed[q] * dt
            if self.impact_left[q] == IMPACT_SUBSTEPS:
                y_n -= (1.0 + restitution) * ti.max(self.constraints.phi[r], 0.0)
        return y_n

    @ti.func
    def _restitution(self, g):
        """Larger restitution of a group's two bodies."""
        a, b = bodies_of_group(g)
        e = self.rigid_bodies.restitution[a]
        if b != WORLD:
            e = ti.max(e, self.rigid_bodies.restitution[b])
        return e

    @ti.func
    def solve(self, g, j, lane):
        """Pass j over group g: sweeps over it until it has settled, on copies of its bodies with their parts of mass.

        For a constraint at lever arms r_a, r_b from the centres of bodies a and b, moved by d and turned by t so far,

            y = d_a + t_a x r_a - d_b - t_b x r_b,   lambda changes by c (`_impulse`),
            d_a += w_a c,   t_a += I_a^-1 (r_a x c),   d_b -= w_b c,   t_b -= I_b^-1 (r_b x c)

        The lanes of a warp hold a constraint each; one after the other takes a step, which all learn of.
        """
        m, table, f = self.rigid_bodies, self.constraints, self.search
        lanes = ti.static(self.lanes)
        if f.active[g] != 0 and table.continues(j):
            a, b = bodies_of_group(g)
            d_a, t_a, w_a, I_a = self._copy_of(a, j)
            d_b, t_b, w_b, I_b = vec3(0.0), vec3(0.0), 0.0, ti.Matrix.zero(ti.f32, 3, 3)
            if b != WORLD:
                d_b, t_b, w_b, I_b = self._copy_of(b, j)
            dt, restitution, begin, size = self.state.dt[None], self._restitution(g), f.group_begin[g], f.active[g]
            if j == 1:
                size = self._list_loaded(g, lane)
            # of all steps together, on the first body, and their moments about the centres of both
            impulse, moment_a, moment_b = vec3(0.0), vec3(0.0), vec3(0.0)
            # of this lane's constraint
            r, sign, n, old, r_a, r_b = -1, 1.0, vec3(0.0), vec3(0.0), vec3(0.0), vec3(0.0)
            friction, least = ti.Vector([0.0, 0.0]), 0.0
            A, w_n, mass = ti.Matrix.zero(ti.f32, 3, 3), 0.0, 0.0
            sweep, settled = 0, 0.0
            while sweep < GROUP_SWEEPS and settled == 0.0:
                first, change, load = 0, 0.0, 0.0
                while first < size:
                    if sweep == 0 or size > lanes:  # else each lane still has its constraint
                        r = -1
                        if first + lane < size:
                            q = f.loaded[begin + first + lane]
                            r = self.begin + q
                            sign = 1.0 if table.body[r, 0] == a else -1.0
                            r_a = table.lever_arm[r, 0]
                            if b != WORLD:
                                r_b = table.lever_arm[r, 1]
                                if sign < 0.0:
                                    r_a, r_b = r_b, r_a
                            n, old, friction = table.normal[r], table.impulse[r], table.friction[r]
                            least = self._min_normal_motion(r, q, restitution)
                            A = inverse_mass_matrix(r_a, w_a, I_a) + inverse_mass_matrix(r_b, w_b, I_b)
                            w_n = n.dot(A @ n)
                            mass = 1.0 / ti.max(w_n, 1e-20)
                    for k in range(ti.min(lanes, size - first)):
                        c, moment, counter = vec3(0.0), vec3(0.0), vec3(0.0)
                        if lane == k:
                            y = sign * (d_a + t_a.cross(r_a) - d_b - t_b.cross(r_b))
                            new = self._impulse(old, n, y, least, A, w_n, mass, friction, dt)
                            c = sign * (new - old)
                            change, load = ti.max(change, c.norm_sqr()), ti.max(load, new.norm_sqr())
                            moment, counter, old = r_a.cross(c), r_b.cross(c), new
                        c = vector_from_lane(c, k, lanes)
                        moment, counter = vector_from_lane(moment, k, lanes), vector_from_lane(counter, k, lanes)
                        d_a += w_a * c
                        d_b -= w_b * c
                        t_a += I_a @ moment
                        t_b -= I_b @ counter
                        impulse += c
                        moment_a += moment
                        moment_b += counter
                    if r >= 0:
                        table.impulse[r] = old
                    first += lanes
                settled = 1.0 if max_lanes(change, lanes) <= SETTLED**2 * max_lanes(load, lanes) else 0.0
                settled = from_lane(settled, 0, lanes)
                if sweep == 0 and settled == 0.0:
                    table.changed[j] = 1  # all writers write the same
                sweep += 1
            if lane == 0:
                m.add_impulse(a, impulse, moment_a, j)
                if b != WORLD:
                    m.add_impulse(b, -impulse, -moment_b, j)
                f.active[g] = size

    @ti.func
    def _copy_of(self, b, j):
        """Increments of body b before pass j, and the inverse of the mass and inertia that a group may use."""
        m = self.rigid_bodies
        splits = ti.cast(m.split_count[b], ti.f32)
        d, t = m.increments(b, j)
        return d, t, splits * m.inv_mass[b], splits * m.inverse_inertia_world[b]

    @ti.func
    def _impulse(self, old, n, y, least, A, w_n, mass, friction, dt):
        """Impulse [kg m] after `old` of a contact of inverse mass A, w_n = n . A n = 1 / mass, that moved by y [m].

            lambda = old + (least - n . y) / w_n n - |y_t|^2 / (y_t . A y_t) y_t,   y_t = y - (n . y) n,

        brought into the cone of friction (sim/contact/response.py).
        """
        y_n = n.dot(y)
        y_t = y - y_n * n
        held, w_t, slip_sqr = old + mass * (least - y_n) * n, w_n, y_t.norm_sqr()
        if slip_sqr > 1e-30:
            A_t = y_t.dot(A @ y_t)
            w_t = A_t / slip_sqr
            held -= slip_sqr / ti.max(A_t, 1e-20 * slip_sqr) * y_t  # two divisions side by side
        return isotropic_contact_impulse(held, n, w_t, friction, dt)

    @ti.func
    def _list_loaded(self, g, lane):
        """List the constraints of group g that carry a load, in their order; returns their number."""
        f, count, first = self.search, 0, 0
        while first < f.size[g]:
            q, loaded = -1, 0
            if first + lane < f.size[g]:
                q = f.entry[f.group_begin[g] + first + lane]
                loaded = ti.cast(self.constraints.active[self.begin + q] != 0, ti.i32)
            before, total = rank_lanes(loaded, lane, ti.static(self.lanes))
            if loaded:
                f.loaded[f.group_begin[g] + count + before] = q
            count += total
            first += ti.static(self.lanes)
        sync_lanes(ti.static(self.lanes))
        return count
