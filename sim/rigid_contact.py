"""Contact of rigid bodies with static shapes and with one another, and of soft bodies with rigid ones.

Each sample keeps a few slots for the shapes that it is near; each slot is a row (sim/rows.py). Rows whose ends are all
rigid form groups, one for each two bodies that touch (all static shapes count as one body). Where rows share masses
(mass splitting, Tonge et al. 2012), a group counts as one, and is solved by Gauss-Seidel sweeps over its rows:
four corners on a floor take no longer to agree than one. Restitution is a speed that a row asks for after an impact.
"""

import taichi as ti

from sim.assembly import MAX_BODIES, Assembly
from sim.broad import Bounds
from sim.colliders import MAX_SHAPES, Colliders
from sim.grids import FAR, corner
from sim.response import grip, least
from sim.rigid import FREE, SOFT, Movers
from sim.rigid_shapes import RigidShapes
from sim.rows import Rows
from sim.samples import Samples
from sim.state import State

SLOTS = 4  # shapes that one sample can touch at once: a floor, a wall and two neighbours
WORLD = MAX_BODIES  # the one body that all static shapes are
GROUPS = MAX_BODIES * (MAX_BODIES + 1)
SWEEPS = 3  # over a group's rows in each pass
ALIKE = 3e-4  # [m]; samples between corners that are as near as they are would say nothing new
IMPACT = 4.0  # times the speed that a substep of gravity gives; slower contacts do not bounce
PATIENCE = 16  # substeps that an impact may take to reach its speed


@ti.data_oriented
class RigidContacts:
    """Row begin + slot P + p is slot `slot` of sample p.

    shape i32[4P]: a static shape, or MAX_SHAPES + a body; -1 none;   distance f32[4P] [m], at the last search
    bounce f32[4P] [m/s]: speed that an impact still asks for, patience i32[4P]: for how long
    size, begin_of, active i32[G]: rows of a group, where they begin in entry i32[4P], whether any carries a load
    """

    def __init__(
        self,
        state: State,
        movers: Movers,
        samples: Samples,
        colliders: Colliders,
        shapes: RigidShapes,
        bounds: Bounds,
        begin: int,
    ):
        self.state, self.movers, self.samples, self.bounds = state, movers, samples, bounds
        self.colliders, self.shapes = colliders, shapes
        self.rows: Rows | None = None  # comes before any kernel is compiled
        self.begin = begin
        self.size_of_rows = SLOTS * samples.capacity
        self.shape, self.patience, self.entry = (ti.field(ti.i32) for _ in range(3))
        self.distance, self.bounce = ti.field(ti.f32), ti.field(ti.f32)
        self.size, self.begin_of, self.filled, self.active = (ti.field(ti.i32) for _ in range(4))
        self.total = ti.field(ti.i32)
        self.builder = ti.FieldsBuilder()
        fields = (self.shape, self.patience, self.entry, self.distance, self.bounce)
        self.builder.dense(ti.i, self.size_of_rows).place(*fields)
        self.builder.dense(ti.i, GROUPS).place(self.size, self.begin_of, self.filled, self.active)
        self.builder.place(self.total)
        self.tree = self.builder.finalize()

    def load(self, assembly: Assembly) -> None:
        self.shapes.load(assembly)

    def reset(self) -> None:
        """Forget all contacts."""
        self.shape.fill(-1)
        self.bounce.fill(0.0)
        self.size.fill(0)

    def detect(self) -> None:
        """List the rows of samples that can touch something before the next search; needs up-to-date Bounds."""
        self._find()

    @ti.func
    def _near(self, p, k):
        """Distance [m] of sample p from shape k, FAR if they cannot meet until the next search."""
        s = self.state
        b = self.samples.body[p]
        facing = self.shapes.facing(p)
        margin = self.bounds.pace[b] * s.detect_dt[None]
        if k >= MAX_SHAPES:
            margin += self.bounds.pace[k - MAX_SHAPES] * s.detect_dt[None]
        d, points = FAR, 1
        if self.movers.kind[b] != SOFT and not self.samples.single[p]:
            points = 4  # first the sample, then the corners of its triangle
        alike = points > 1
        for c in range(points):
            if c == 0 or (alike and self.samples.weight[p][c - 1] > 0.0):
                x = self.samples.blend(p, s.x)
                if c > 0:
                    x = s.x[self.samples.ids[p][c - 1]]
                away = self._distance_to(k, x, facing, margin)
                if c == 0:
                    d = away
                    alike = alike and d < 0.5 * FAR
                elif away > d + ALIKE:
                    alike = False
        return FAR if alike else d

    @ti.func
    def _distance_to(self, k, x, facing, margin):
        """Distance [m] of x from shape k, FAR if it is more than margin."""
        d = FAR
        if k < MAX_SHAPES:
            if (self.colliders.low[k] - x).max() < margin and (x - self.colliders.high[k]).max() < margin:
                d = self.colliders.gap(k, x)
        else:
            m = k - MAX_SHAPES
            if (self.bounds.low[m] - x).max() < margin and (x - self.bounds.high[m]).max() < margin:
                d, _ = self.shapes.distance(m, x, facing)
        return d if d < margin else FAR

    @ti.func
    def _may_touch(self, p, k):
        """Whether shape k is another body, and one of both moves freely."""
        b = self.samples.body[p]
        result = self.movers.kind[b] == FREE
        if k >= MAX_SHAPES:
            kind = self.movers.kind[k - MAX_SHAPES]
            result = kind != SOFT and k - MAX_SHAPES != b
            result = result and (self.movers.kind[b] == SOFT or self.movers.kind[b] == FREE or kind == FREE)
        return result

    @ti.func
    def _offer(self, p, k):
        """Keep or drop shape k if sample p has it in a slot, else give it the farthest slot if it is near."""
        P = self.samples.capacity
        mine, farthest, most = -1, 0, -FAR
        for slot in range(SLOTS):
            q = slot * P + p
            away = self.distance[q] if self.shape[q] >= 0 else 2.0 * FAR
            if self.shape[q] == k:
                mine = q
            if away > most:
                farthest, most = q, away
        d = FAR
        if self._may_touch(p, k):
            d = self._near(p, k)
        if mine >= 0:
            if d < 0.5 * FAR:
                self.distance[mine] = d
            else:
                self._assign(mine, -1, FAR)
        elif d < ti.min(most, 0.5 * FAR):
            self._assign(farthest, k, d)

    @ti.func
    def _assign(self, q, k, d):
        self.shape[q], self.distance[q], self.bounce[q] = k, d, 0.0
        self.rows.forget(self.begin + q)

    @ti.func
    def _group(self, p, k):
        """The group of sample p's body and shape k, or -1 if a soft body is among them."""
        b, other = self.samples.body[p], WORLD
        if k >= MAX_SHAPES:
            other = k - MAX_SHAPES
        g = ti.min(b, other) * (MAX_BODIES + 1) + ti.max(b, other)
        return g if self.movers.kind[b] != SOFT else -1

    @ti.kernel
    def _find(self):
        P = self.samples.capacity
        self.total[None] = 0
        for g in range(GROUPS):
            self.size[g], self.filled[g], self.active[g] = 0, 0, 0
        for p in range(P):
            if p < self.samples.count[None]:
                n = self.colliders.count[None]
                for k in range(n + self.state.body_count[None]):
                    self._offer(p, k if k < n else MAX_SHAPES + k - n)
        for q in range(SLOTS * P):
            p = q % P
            if p < self.samples.count[None] and self.shape[q] >= 0:
                r = self.begin + q
                self.rows.wake[r] = 0
                self.rows.enlist(r)
                g = self._group(p, self.shape[q])
                self.rows.set_size(r, 0)
                self.rows.ends[r] = 1
                if g < 0:
                    self.samples.put(p, r, self.rows)
                    self.rows.set_size(r, 3)
                else:
                    self.rows.ends[r] = 1 if self.shape[q] < MAX_SHAPES else 2
                    ti.atomic_add(self.size[g], 1)
        for g in range(GROUPS):
            if self.size[g] > 0:
                self.begin_of[g] = ti.atomic_add(self.total[None], self.size[g])
        for q in range(SLOTS * P):
            p = q % P
            if p < self.samples.count[None] and self.shape[q] >= 0:
                g = self._group(p, self.shape[q])
                if g >= 0:
                    self.entry[self.begin_of[g] + ti.atomic_add(self.filled[g], 1)] = q
        for g in range(GROUPS):  # in a fixed order, whoever came first
            for e in range(self.begin_of[g] + 1, self.begin_of[g] + self.size[g]):
                q, at = self.entry[e], e
                while at > self.begin_of[g] and self.entry[at - 1] > q:
                    self.entry[at] = self.entry[at - 1]
                    at -= 1
                self.entry[at] = q

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
            phi += self.samples.skin[p] + n.dot(self.samples.blend(p, s.carry))
            rows.set(r, phi, n, ti.sqrt(friction), pace)
        return usable

    @ti.func
    def claim(self, r, usable, first: ti.template()):
        """As Rows.claim, for a row of a group, of which the first one that carries a load claims for all."""
        rows = self.rows
        q = r - self.begin
        g = self._group(q % self.samples.capacity, self.shape[q])
        dt = self.state.dt[None]
        rows.claimed[r] = 0
        loaded, fall = False, self.state.gravity[None].norm() * dt * dt
        if usable:
            way = rows.normal[r].dot(rows.motion(r, 0))
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

    def destroy(self) -> None:
        self.tree.destroy()
        self.shapes.destroy()
