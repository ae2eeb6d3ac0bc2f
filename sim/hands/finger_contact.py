"""What the spots of sim/hands/fingers.py touch: the search, and each row's distance and normal anew in each substep."""

import taichi as ti

from sim.contact.deformable_contact import FLAT, OUTSIDE
from sim.contact.device_grids import FAR, corner
from sim.contact.nearest_tet import NONE
from sim.contact.tet_planes import beyond, outward
from sim.rigid.rigid_motion import FREE

CAPSULES = 20  # of a hand: its 19 bones, and one to spare
SPOTS = 8  # of a capsule
EACH = CAPSULES * SPOTS  # spots of a hand
SKIN = 1.0  # coefficient of friction of skin; with a body, as ever, the geometric mean
STRONGEST = 10.0  # [N] of one spot: 30 to 40 of a fingertip
# A soft body yields to less: E r^2 presses a ball of radius r about half of r deep (Hertz); more would crush its cells.
YOUNG = 2.6  # E = 2 (1 + nu) mu


@ti.data_oriented
class FingerContact:
    """Part of Fingers."""

    @ti.func
    def _now(self):
        """The part of the frame that has passed when the next substep begins."""
        s = self.state
        return ti.cast(s.substep_index[None] + 1, ti.f32) / ti.cast(s.substeps[None], ti.f32)

    @ti.func
    def _meets(self, c, low, high):
        """Whether capsule c may come into a box until the next search."""
        return (self.low[c] - high).max() <= 0.0 and (low - self.high[c]).max() <= 0.0

    @ti.kernel
    def find(self, rows: ti.template()):
        """List the rows of spots that may touch something before the next search; after `widen`."""
        s = self.state
        for h in range(self.hands):
            self.pressed[h] = 0
        for q in range(self.size):
            strength = self._force(q, rows).norm()
            if strength > 0.0:
                ti.atomic_add(self.pressed[q % self.count // EACH], ti.cast(strength * 1e6, ti.i64))
        for h in range(self.hands):
            self._limit(h)
            self.overlaps[h] = 0
            if self.held[h] >= 0:
                self.spared[h] = self.held[h]
        for p in range(self.count):
            self.key[p] = ti.i64(NONE)
        for t in range(s.T):
            if t < s.tet_count[None]:
                self._visit(t)
        for p in range(self.count):
            host, now = -1, self.tet[p]
            if self.key[p] != ti.i64(NONE):
                host = ti.cast(self.key[p] & ti.i64(0x7FFFFFFF), ti.i32)
            self.tet[p] = host
            alike = host >= 0 and now >= 0
            if alike:
                alike = s.body_of_tet[host] == s.body_of_tet[now]
            if not alike:
                rows.forget(self.begin + p)
            if host >= 0:
                rows.wake[self.begin + p] = 0
                rows.enlist(self.begin + p)
        for p in range(self.count if ti.static(self.coupled) else 0):
            if ti.static(self.coupled):
                self._find_mover(p, rows)
        for h in range(self.hands):
            if self.held[h] < 0 and self.overlaps[h] == 0:
                self.spared[h] = -1

    @ti.func
    def _visit(self, t):
        """Offer tet t to the spots that it may meet until the next search; the lowest (distance, t) wins."""
        s = self.state
        a, b = s.tets[t], s.body_of_tet[t]
        x0, x1, x2, x3 = s.x[a[0]], s.x[a[1]], s.x[a[2]], s.x[a[3]]
        way = self.bounds.pace[b] * s.detect_dt[None]
        low, high = ti.min(x0, x1, x2, x3) - way, ti.max(x0, x1, x2, x3) + way
        e1, e2, e3 = x1 - x0, x2 - x0, x3 - x0
        if e1.dot(e2.cross(e3)) > 0.0:
            n0, n1, n2, n3 = outward(e1, e2, e3)
            for c in range(self.hands * CAPSULES):
                if self._meets(c, low, high):
                    for p in range(c * SPOTS, (c + 1) * SPOTS):
                        r = self.radius[p]
                        if r > 0.0:
                            outside = beyond(self._place(p) - x0, e1, n0, n1, n2, n3)
                            if b == self.spared[p // EACH]:
                                if outside < r:
                                    self.overlaps[p // EACH] = 1
                            elif outside < r + way + self.way[p].norm():
                                key = (ti.cast(outside * 1e7, ti.i64) << 32) | ti.cast(t, ti.i64)
                                ti.atomic_min(self.key[p], key)

    @ti.func
    def _place(self, p):
        """Where spot p is at a search [m]: when the next substep begins."""
        return self.origin[p] + self._now() * self.way[p]

    @ti.func
    def _begin(self, p):
        """Where spot p is when the substep in progress begins [m]."""
        s = self.state
        return self.origin[p] + ti.cast(s.substep_index[None], ti.f32) / ti.cast(s.substeps[None], ti.f32) * self.way[p]

    @ti.func
    def _find_mover(self, p, rows: ti.template()):
        """List spot p's second row if a free rigid body is near: the nearest."""
        s = self.state
        r, body, least = self.begin + self.count + p, -1, FAR
        if self.radius[p] > 0.0:
            x, h = self._place(p), p // EACH
            for b in range(s.body_count[None]):
                reach = self.radius[p] + self.bounds.pace[b] * s.detect_dt[None] + self.way[p].norm()
                outside = ti.max(self.bounds.low[b] - x, x - self.bounds.high[b]).max()
                if self.movers.kind[b] == FREE and outside < reach:
                    phi, _ = self.shapes.distance(b, x, corner(0.0))
                    if phi >= 0.5 * FAR:
                        phi = outside
                    if b == self.spared[h]:
                        if phi < self.radius[p]:
                            self.overlaps[h] = 1
                    elif phi < ti.min(reach, least):
                        body, least = b, phi
        if body != self.mover[p]:
            rows.forget(r)
        self.mover[p] = body
        if body >= 0:
            rows.wake[r] = 0
            rows.enlist(r)

    @ti.func
    def meet(self, r, rows: ti.template()):
        """Take row r's distance, normal and vertices anew; whether the body's shape says anything there."""
        q = r - self.begin
        usable = False
        if q < self.count:
            usable = self._meet_tet(q, r, rows)
        else:
            if ti.static(self.coupled):
                usable = self._meet_mover(q - self.count, r, rows)
        return usable

    @ti.func
    def _meet_tet(self, p, r, rows: ti.template()):
        """See sim/contact/deformable_contact.py for the equations; beyond its grid, a body's distance goes on."""
        s = self.state
        t = self.tet[p]
        a = s.tets[t]
        x0, X0 = s.x[a[0]], s.rest[a[0]]
        e1, e2, e3 = s.x[a[1]] - x0, s.x[a[2]] - x0, s.x[a[3]] - x0
        E1, E2, E3 = s.rest[a[1]] - X0, s.rest[a[2]] - X0, s.rest[a[3]] - X0
        det = e1.dot(e2.cross(e3))
        usable = rows.claimed[r] != 0  # a tet crushed flat has no normal: its contact stays as it was
        if det > FLAT * E1.dot(E2.cross(E3)):
            g1, g2, g3 = e2.cross(e3) / det, e3.cross(e1) / det, e1.cross(e2) / det
            d = self._begin(p) - x0
            b1, b2, b3 = g1.dot(d), g2.dot(d), g3.dot(d)
            b = ti.Vector([1.0 - b1 - b2 - b3, b1, b2, b3])
            body = s.body_of_tet[t]
            phi, N = self._distance(body, X0 + b1 * E1 + b2 * E2 + b3 * E3)
            normal = g1 * E1.dot(N) + g2 * E2.dot(N) + g3 * E3.dot(N)
            length, slope = normal.norm(), N.norm()
            usable = phi < 0.5 * FAR and slope > 0.1 and length > 1e-3 * slope
            self._walk(p, t, b)
            if usable:
                normal /= length
                phi = phi * slope / length - self.radius[p]
                b = ti.max(b, 0.0)
                b /= b.sum()
                for j in ti.static(range(4)):
                    phi -= b[j] * normal.dot(s.x_lo[a[j]])
                    rows.set_vertex(r, j, a[j], -b[j])
                rows.set_size(r, 4)
                if ti.static(rows.coupled):
                    rows.ends[r] = 0
                firm = ti.min(STRONGEST, YOUNG * s.mu[body] * self.radius[p] ** 2)
                self._fill(p, r, body, phi, normal, firm, rows)
        return usable

    @ti.func
    def _meet_mover(self, p, r, rows: ti.template()):
        b, x = self.mover[p], self._begin(p)
        phi, n = self.shapes.distance(b, x, corner(0.0))
        usable = phi < 0.5 * FAR
        if usable:
            rows.set_size(r, 0)
            rows.ends[r] = 1
            rows.set_end(r, 0, b, x - phi * n, -1.0)
            self._fill(p, r, b, phi - self.radius[p], n, STRONGEST, rows)
        return usable

    @ti.func
    def _fill(self, p, r, body, phi, normal, firm, rows: ti.template()):
        k, h, n = r - self.begin, p // EACH, ti.cast(self.state.substeps[None], ti.f32)
        rows.drive[k], rows.most[k] = self.way[p] / n, firm * self.share[h]
        friction = ti.sqrt(self.state.frictions(body) * SKIN)
        rows.set(r, phi, normal, friction, self.bounds.pace[body] + self.swift[h])

    @ti.func
    def _distance(self, k, X):
        """Distance [m] and its gradient at X in the frame of grid k; outside the grid by way of its nearest point."""
        g = self.grids
        low = g.origin[k]
        high = low + g.spacing[k] * ti.cast(g.dims[k] - 1, ti.f32)
        inset = corner(1e-3 * g.spacing[k])  # lest rounding put it outside again
        edge = ti.min(ti.max(X, low + inset), high - inset)
        phi, N = g.sample(k, edge)
        beyond_it = X - edge
        if phi < 0.5 * FAR and beyond_it.norm_sqr() > 0.0:
            whole = beyond_it + ti.max(phi, 0.0) * N / ti.max(N.norm(), 1e-9)
            phi = whole.norm()
            N = whole / ti.max(phi, 1e-9)
        return phi, N

    @ti.func
    def _walk(self, p, t, b):
        """From the next substep on, spot p belongs to the tet across the worst face that has one behind it."""
        worst = OUTSIDE
        for j in ti.static(range(4)):
            if b[j] < worst and self.hosts.neighbor[t][j] >= 0:
                worst = b[j]
                self.tet[p] = self.hosts.neighbor[t][j]

    @ti.func
    def _force(self, q, rows: ti.template()):
        """What row q pushes the finger back with in the last substep [N]."""
        dt = ti.max(self.state.dt[None], 1e-9)
        return rows.impulse[self.begin + q] / (dt * dt)
