"""How fast each body may get before the next search, beyond its present speed: by what pulls, springs and hits it.

Contacts are looked for as far away as bodies can come, so a bound that is too low lets a thin plate slip through. Of
body b, whose vertices move at speed_b, with t the time until the next search,

    extra_b = |g| t + sqrt(2 max Psi / rho) + max min(|target - x| / t, a t)

because energy Psi [J/m^3] that springs back moves matter at sqrt(2 Psi / rho), and a hand's spring is damped
critically: its vertices go to their target and not beyond, with the acceleration a at most. What a body c on its way
may hit moves on at 2 m_c / (m_b + m_c) times the speed of c, at most (elastic and head-on); so may what that hits.
"""

import taichi as ti

from sim.contact.broad_phase import MARGIN, BodyBounds
from sim.elastic.energy import energy_density
from sim.hands.grasp import Grasps
from sim.model import MAX_BODIES
from sim.state import State

ROUNDS = 3  # of passing a push on before the next search: a, b, c, d in a row


@ti.data_oriented
class SweptBounds:
    """spring, haste f32[B] [m/s]: the two maxima above;   hit f32[2,B] [m/s]: speeds passed on."""

    def __init__(self, state: State, hands: Grasps, bounds: BodyBounds):
        self.state, self.hands, self.bounds = state, hands, bounds
        self.builder = ti.FieldsBuilder()
        self.spring, self.haste, self.hit = ti.field(ti.f32), ti.field(ti.f32), ti.field(ti.f32)
        self.builder.dense(ti.i, MAX_BODIES).place(self.spring, self.haste)
        self.builder.dense(ti.ij, (2, MAX_BODIES)).place(self.hit)
        self.tree = self.builder.finalize()

    @ti.kernel
    def update(self):
        """Widen the bounds, which must be up to date; the hands' poses are those of this frame."""
        s = self.state
        for b in range(MAX_BODIES):
            self.spring[b] = 0.0
            self.haste[b] = 0.0
        for t in range(s.T):
            if t < s.tet_count[None]:
                self._spring_back(t)
        if ti.static(self.hands.count > 0):
            for i in range(s.V):
                if i < s.vertex_count[None] and self.hands.held[i] != 0:
                    ti.atomic_max(self.haste[s.body_of_vertex[i]], self.hands.haste(i))
        for b in range(MAX_BODIES):
            if b < s.body_count[None]:
                t = s.detect_dt[None]
                extra = s.gravity[None].norm() * t + self.spring[b] + self.haste[b]
                self.hit[0, b] = self.bounds.speed[b] + extra
        for turn in ti.static(range(ROUNDS)):
            for b in range(MAX_BODIES):
                if b < s.body_count[None]:
                    self.hit[1 - turn % 2, b] = self._passed_on(b, turn % 2)
        for b in range(MAX_BODIES):
            if b < s.body_count[None]:
                self.bounds.widen(b, self.hit[ROUNDS % 2, b] - self.bounds.speed[b])

    @ti.func
    def _spring_back(self, t):
        """spring = max of sqrt(2 Psi / rho) over the tets of a body."""
        s = self.state
        a = s.tets[t]
        b = s.body_of_tet[t]
        x0, X0 = s.x[a[0]], s.rest[a[0]]
        e = ti.Matrix.cols([s.x[a[1]] - x0, s.x[a[2]] - x0, s.x[a[3]] - x0])
        E = ti.Matrix.cols([s.rest[a[1]] - X0, s.rest[a[2]] - X0, s.rest[a[3]] - X0])
        F = e @ E.inverse()
        psi = energy_density((F.transpose() @ F).trace(), F.determinant() - 1.0, s.mu[b], s.lam[b])
        speed = ti.sqrt(2.0 * ti.max(psi, 0.0) / s.density[b])
        if speed > self.spring[b]:
            ti.atomic_max(self.spring[b], speed)

    @ti.func
    def _passed_on(self, b, now):
        """The speed of body b, or of what hits it and is faster."""
        s = self.state
        t = s.detect_dt[None]
        box = self.bounds
        result = self.hit[now, b]
        for c in range(s.body_count[None]):
            way = (self.hit[now, b] + self.hit[now, c]) * t + MARGIN
            apart = ti.max(box.low[b] - box.high[c], box.low[c] - box.high[b]).max()
            if c != b and apart < way:
                share = 2.0 * s.body_mass[c] / (s.body_mass[b] + s.body_mass[c])
                result = ti.max(result, share * self.hit[now, c])
        return result

    def destroy(self) -> None:
        self.tree.destroy()
