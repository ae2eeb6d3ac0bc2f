"""Swept (speculative) bounds: the speed that each body may gain before the next search, by springs, hands and impacts.

Contacts are searched as far away as bodies can come, so a bound that is too low lets a thin plate tunnel. Of
body b, whose vertices move at speed_b, with t the time until the next search,

    gain_b = |g| t + sqrt(2 max Psi / rho) + max min(|target - x| / t, a t)

because energy Psi [J/m^3] that springs back moves matter at sqrt(2 Psi / rho), and a hand's spring is damped
critically: its vertices go to their target and not beyond, with the acceleration a at most. What a body c in its path
may hit moves on at 2 m_c / (m_b + m_c) times the speed of c, at most (elastic and head-on).
"""

from typing import TYPE_CHECKING

import taichi as ti

from core.fields import FieldGroup
from core.lanes import lane_count, max_by_key
from sim.contact.broad_phase import CONTACT_MARGIN, gap_of_boxes
from sim.elastic.energy import energy_density
from sim.model import MAX_BODIES

if TYPE_CHECKING:
    from sim.contact.broad_phase import BodyBounds
    from sim.state import State


@ti.data_oriented
class SweptBounds:
    """spring_speed, grasp_speed f32[B] [m/s]: the two maxima above;   impact_speed f32[B] [m/s]: which b brings."""

    def __init__(self, state: "State", grasps, bounds: "BodyBounds"):
        self.state, self.grasps, self.bounds = state, grasps, bounds
        group = self._group = FieldGroup()
        self.spring_speed, self.grasp_speed = group.scalar(MAX_BODIES), group.scalar(MAX_BODIES)
        self.impact_speed = group.scalar(MAX_BODIES)
        group.build()

    @ti.func
    def update(self):
        """Widen the bounds, which must be up to date, by the hands' poses of this frame too.

        Outermost level of a kernel.
        """
        s = self.state
        for b in range(MAX_BODIES):
            self.spring_speed[b] = 0.0
            self.grasp_speed[b] = 0.0
        lanes = ti.static(lane_count())
        for t in range(s.T):  # whole warps: T is a multiple of them
            b, speed = 0, 0.0
            if t < s.tet_count[None]:
                b, speed = s.body_of_tet[t], self._spring_speed(t)
            max_by_key(self.spring_speed, b, speed, t % lanes, lanes)
        if ti.static(self.grasps.count > 0):
            for i in range(s.V):
                if i < s.vertex_count[None] and self.grasps.held[i] != 0:
                    ti.atomic_max(self.grasp_speed[s.body_of_vertex[i]], self.grasps.max_speed_gain(i))
        for b in range(MAX_BODIES):
            if b < s.body_count[None]:
                t = s.detect_dt[None]
                gain = s.gravity[None].norm() * t + self.spring_speed[b] + self.grasp_speed[b]
                self.impact_speed[b] = self.bounds.speed[b] + gain
        for b in range(MAX_BODIES):
            if b < s.body_count[None]:
                self.bounds.widen(b, self._after_impact(b) - self.bounds.speed[b])

    @ti.func
    def _spring_speed(self, t):
        """sqrt(2 Psi / rho) of a tet [m/s]."""
        s = self.state
        a = s.tets[t]
        b = s.body_of_tet[t]
        x0, X0 = s.x[a[0]], s.rest[a[0]]
        e = ti.Matrix.cols([s.x[a[1]] - x0, s.x[a[2]] - x0, s.x[a[3]] - x0])
        E = ti.Matrix.cols([s.rest[a[1]] - X0, s.rest[a[2]] - X0, s.rest[a[3]] - X0])
        F = e @ E.inverse()
        psi = energy_density((F.transpose() @ F).trace(), F.determinant() - 1.0, s.mu[b], s.lam[b])
        return ti.sqrt(2.0 * ti.max(psi, 0.0) / s.density[b])

    @ti.func
    def _after_impact(self, b):
        """Speed [m/s] of body b, or that to which a faster body that may hit it brings it."""
        s = self.state
        t = s.detect_dt[None]
        box = self.bounds
        result = self.impact_speed[b]
        for c in range(s.body_count[None]):
            margin = (self.impact_speed[b] + self.impact_speed[c]) * t + CONTACT_MARGIN
            apart = gap_of_boxes(box.low[b], box.high[b], box.low[c], box.high[c])
            if c != b and apart < margin:
                transfer = 2.0 * s.body_mass[c] / (s.body_mass[b] + s.body_mass[c])
                result = ti.max(result, transfer * self.impact_speed[c])
        return result
