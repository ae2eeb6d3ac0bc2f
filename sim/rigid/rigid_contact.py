"""Contact of rigid bodies with static shapes and with one another, and of soft bodies with rigid ones.

Where rows share masses (mass splitting, Tonge et al. 2012), all rows between the same two rigid bodies count as one,
and are solved by Gauss-Seidel sweeps: four corners on a floor take no longer to agree than one. Restitution is a speed
that a row asks for after an impact.
"""

import taichi as ti

from sim.contact.device_grids import FAR, corner
from sim.contact.response import grip, least
from sim.contact.static_shapes import MAX_SHAPES
from sim.model import MAX_BODIES
from sim.rigid.rigid_bodies import SOFT
from sim.rigid.rigid_broad_phase import WORLD, RigidSearch

SWEEPS = 3  # over a group's rows in each pass
IMPACT = 4.0  # times the speed that a substep of gravity gives; slower contacts do not bounce
PATIENCE = 16  # substeps that an impact may take to reach its speed


@ti.data_oriented
class RigidContacts(RigidSearch):
    """The rows that the search lists, from substep to substep.

    bounce f32[4P] [m/s]: speed that an impact still asks for, patience i32[4P]: for how long
    """

    @ti.func
    def meet(self, r):
        """Take row r's distance, normal and ends anew; whether the shape says anything there."""
        s = self.state
        rows = self.rows
        q = r - self.begin
        p, k = q % self.samples.capacity, self.shape[q]
        b = self.samples.body[p]
        x = self.samples.blend(p, s.x)
        phi, n, friction, pace = FAR, corner(0.0), s.frictions(b), self.bounds.pace[b]
        rigid = self.movers.kind[b] != SOFT
        if rigid:
            rows.set_end(r, 0, b, x, 1.0)
        if k < MAX_SHAPES:
            phi, n = self.colliders.distance(k, x)
            friction *= self.colliders.friction[k]
        else:
            m = k - MAX_SHAPES
            phi, n = self.shapes.distance(m, x, self.shapes.facing(p))
            friction *= s.frictions(m)
            pace += self.bounds.pace[m]
            rows.set_end(r, 1 if rigid else 0, m, x, -1.0)
        usable = phi < 0.5 * FAR
        if usable:
            phi += self.samples.skin[p] + n.dot(self.samples.blend(p, s.x_lo))
            rows.set(r, phi, n, ti.sqrt(friction), pace)
        return usable

    @ti.func
    def claim(self, r, usable, first: ti.template(), integrator: ti.template()):
        """As Rows.claim, for a row of a group, of which the first one that carries a load claims for all."""
        rows = self.rows
        q = r - self.begin
        g = self._group(q % self.samples.capacity, self.shape[q])
        dt = self.state.dt[None]
        rows.claimed[r] = 0
        loaded, fall = False, self.state.gravity[None].norm() * dt * dt
        if usable:
            way = rows.normal[r].dot(rows.motion(r, 0, integrator))
            loaded = rows.impulse[r].norm_sqr() > 0.0
            if self.bounce[q] > 0.0:
                self.patience[q] -= 1
                rows.forget(r)  # what stopped a body is not what must be borne from now on
                if way >= 0.999 * self.bounce[q] * dt - 1.01 * fall or self.patience[q] < 0:
                    self.bounce[q] = 0.0
                loaded = self.bounce[q] > 0.0
            elif not loaded and way < least(rows.phi[r], dt):
                loaded = True
                if way < -IMPACT * fall:
                    self.bounce[q] = -way / dt * self._restitution(g)
                    self.patience[q] = PATIENCE
        if loaded:
            rows.claimed[r] = 1
            a, b = g // (MAX_BODIES + 1), g % (MAX_BODIES + 1)
            if ti.atomic_max(self.active[g], 1) == 0:
                self.movers.claim(a, 1.0)
                if b != WORLD:
                    self.movers.claim(b, 1.0)
            if ti.static(first):
                rows.push(r, rows.impulse[r], 0)
        else:
            rows.forget(r)
            if usable:
                rows.rest(r, rows.phi[r], rows.pace[r])

    @ti.func
    def _least(self, r, q, e):
        """The least normal motion [m] of row r in this substep, with restitution e.

        An impact asks for `bounce`; in its first substep for as much less as the body first has to go to get there.
        """
        dt = self.state.dt[None]
        way = least(self.rows.phi[r], dt)
        if self.bounce[q] > 0.0:
            way = self.bounce[q] * dt
            if self.patience[q] == PATIENCE:
                way -= (1.0 + e) * ti.max(self.rows.phi[r], 0.0)
        return way

    @ti.func
    def _restitution(self, g):
        """Of the livelier one of a group's two bodies."""
        a, b = g // (MAX_BODIES + 1), g % (MAX_BODIES + 1)
        e = self.movers.restitution[a]
        if b != WORLD:
            e = ti.max(e, self.movers.restitution[b])
        return e

    @ti.func
    def solve(self, g, j: ti.template()):
        """Pass j over group g: sweeps over its rows, on copies of its bodies with their shares of mass."""
        m = self.movers
        rows = self.rows
        if self.size[g] > 0 and self.active[g] != 0:
            a, b = g // (MAX_BODIES + 1), g % (MAX_BODIES + 1)
            dt = self.state.dt[None]
            claims = m.claims(a)
            d_a, t_a = m.moved(a, j)
            w_a, I_a = claims * m.w[a], claims * m.world[a]
            d_b, t_b, w_b, I_b = corner(0.0), corner(0.0), 0.0, ti.Matrix.zero(ti.f32, 3, 3)
            if b != WORLD:
                claims = m.claims(b)
                d_b, t_b = m.moved(b, j)
                w_b, I_b = claims * m.w[b], claims * m.world[b]
            restitution = self._restitution(g)
            push, moment_a, moment_b = corner(0.0), corner(0.0), corner(0.0)
            for _ in range(SWEEPS):
                for e in range(self.begin_of[g], self.begin_of[g] + self.size[g]):
                    q = self.entry[e]
                    r = self.begin + q
                    if rows.claimed[r]:
                        flip = 1.0 if rows.end[r, 0] == a else -1.0
                        r_a, r_b = rows.arm[r, 0], corner(0.0)
                        if b != WORLD:
                            r_b = rows.arm[r, 1]
                            if flip < 0.0:
                                r_a, r_b = r_b, r_a
                        y = flip * (d_a + t_a.cross(r_a) - d_b - t_b.cross(r_b))
                        n, old = rows.normal[r], rows.impulse[r]
                        y_n, old_n = n.dot(y), n.dot(old)
                        y_t = y - y_n * n
                        u = y_t / ti.max(y_t.norm(), 1e-20)
                        A, B, C, D = r_a.cross(n), r_b.cross(n), r_a.cross(u), r_b.cross(u)
                        mass = w_a + w_b + A.dot(I_a @ A) + B.dot(I_b @ B)
                        mass_t = w_a + w_b + C.dot(I_a @ C) + D.dot(I_b @ D)
                        new_n = ti.max(old_n + (self._least(r, q, restitution) - y_n) / mass, 0.0)
                        new_t = (old - old_n * n) - y_t / mass_t
                        new = new_n * n + new_t * grip(new_t.norm(), new_n, rows.friction[r], mass_t, dt)
                        rows.impulse[r] = new
                        c = flip * (new - old)
                        d_a += w_a * c
                        d_b -= w_b * c
                        t_a += I_a @ r_a.cross(c)
                        t_b -= I_b @ r_b.cross(c)
                        push += c
                        moment_a += r_a.cross(c)
                        moment_b += r_b.cross(c)
            m.push(a, push, moment_a, j)
            if b != WORLD:
                m.push(b, -push, -moment_b, j)
            if ti.static(j == self.movers.passes):
                self.active[g] = 0
