"""Damping of vibrations: towards each body's rigid motion (Mueller et al. 2007, Sec. 3.5), and of its rocking.

    v_i += k (v_cm + omega x r_i - v_i),   k = 1 - exp(-c t),   omega = I^-1 L

Inner friction is the other part of a material's damping (sim/state.py).

The rigid motion is left alone, but the rotation of a body that stands on something is part of a vibration, too: the
body rocks on its feet, which are elastic. So its rotation about the centre of pressure p decays at the same rate c, by
a torque no larger than that of rolling resistance:

    v_i -= s k omega x (x_i - p),   |s k I_p omega| <= t ROLLING_RESISTANCE a F,   a^2 = sum_i f_i d_i^2 / F

where f_i are the forces of static shapes on the vertices, F is their sum, and d_i are their distances from the axis of
rotation through p. What rolls or tips over stands on a small spot or an edge: there a is small. What flies has no f_i.

In a body with prescribed vertices, v_cm and omega are those of these alone, and it does not rock. Applied once for
several substeps (t is their sum; c t << 1), because the sums over a body cost as much as a substep.
"""

import taichi as ti

from core.fields import FieldGroup, two_sum
from sim.model import MAX_BODIES
from sim.reductions import ReductionBlocks
from sim.state import State

# First index of the sums over one body: m r, m v, m r x v, m r_k^2, m r_k r_l (3 numbers each) ...
MASS_R, MOMENTUM, SPIN, SQUARES, PRODUCTS = 0, 3, 6, 9, 12
FORCE, FORCE_R, FORCE_SQUARES, FORCE_PRODUCTS = 15, 16, 19, 22  # ... f (1), f r, f r_k^2, f r_k r_l (3 each)
DAMPING_SUMS = 25
# Lever arm of rolling resistance, in units of a. A ball that loses the fraction alpha of the energy that its contact
# stores meets 3/16 alpha of the contact's radius (Greenwood, Minshall and Tabor 1961), 0.42 alpha a; rubbers have an
# alpha of 0.1 to 0.4. Rocking figures need less: their feet are far apart.
ROLLING_RESISTANCE = 0.1


@ti.func
def products(r):
    """r_y r_z, r_z r_x, r_x r_y."""
    return ti.Vector([r[1] * r[2], r[2] * r[0], r[0] * r[1]])


@ti.func
def moment_of_inertia(squares, mixed, center, M):
    """tr(S) 1 - S of S = sum m r r^T - M c c^T, from the sums of m r_k^2, of m r_k r_l, and the centre c of mass M."""
    q, n = squares - M * center * center, mixed - M * products(center)
    return ti.Matrix([[q[1] + q[2], -n[2], -n[1]], [-n[2], q[2] + q[0], -n[0]], [-n[1], -n[0], q[0] + q[1]]])


@ti.data_oriented
class Damping:
    """`run(t)` damps the velocities for t [s] and predicts the increments of the next substep."""

    def __init__(self, state: State, blocks: ReductionBlocks, forces=None):
        """Forces: of static shapes on the vertices (ContactForces), None without contacts."""
        self.state, self.blocks, self.forces, self.touches = state, blocks, forces, forces is not None
        g = self._group = FieldGroup()
        self.sums, self.total = g.scalar(blocks.size, DAMPING_SUMS), g.scalar(MAX_BODIES, DAMPING_SUMS)
        self.center = g.vector(MAX_BODIES)  # of mass [m]
        self.velocity = g.vector(MAX_BODIES)  # m/s
        self.omega = g.vector(MAX_BODIES)  # rad/s
        self.pressure_center = g.vector(MAX_BODIES)  # m
        self.rocking_change = g.vector(MAX_BODIES)  # of the rotation about it [rad/s]
        g.build()

    @ti.kernel
    def run(self, t: ti.f32):
        self._sum_blocks()
        self._sum_bodies()
        self._find_rigid_motion(t)
        self._damp(t)

    @ti.func
    def _sum_blocks(self):
        """Fill `sums`, about the first vertex of each body: sums about a point of the body hardly cancel."""
        s = self.state
        c = self.blocks
        ti.loop_config(serialize=s.serial)
        for w in range(c.size * c.lanes):
            j, lane = w // c.lanes, w % c.lanes
            span = c.span[j]
            about = s.x[s.vertex_begin[span[2]]]
            p, q, L = ti.Vector([0.0, 0.0, 0.0]), ti.Vector([0.0, 0.0, 0.0]), ti.Vector([0.0, 0.0, 0.0])
            square, mixed = ti.Vector([0.0, 0.0, 0.0]), ti.Vector([0.0, 0.0, 0.0])
            force, force_r = 0.0, ti.Vector([0.0, 0.0, 0.0])
            force_square, force_mixed = ti.Vector([0.0, 0.0, 0.0]), ti.Vector([0.0, 0.0, 0.0])
            i = span[1] if s.asleep[span[2]] else span[0] + lane
            while i < span[1]:
                m, r, v = s.mass[i], s.x[i] - about, s.v[i]
                if ti.static(self.touches):
                    f = m * self.forces.correction[i].norm() / s.dt[None] ** 2
                    force += f
                    force_r += f * r
                    force_square += f * r * r
                    force_mixed += f * products(r)
                if s.inv_mass[i] > 0.0 and s.prescribed_mass[span[2]] > 0.0:
                    m = 0.0
                p += m * r
                q += m * v
                L += m * r.cross(v)
                square += m * r * r
                mixed += m * products(r)
                i += c.lanes
            c.write_sum(self.sums, j, FORCE, force, lane)
            for k in ti.static(range(3)):
                c.write_sum(self.sums, j, MASS_R + k, p[k], lane)
                c.write_sum(self.sums, j, MOMENTUM + k, q[k], lane)
                c.write_sum(self.sums, j, SPIN + k, L[k], lane)
                c.write_sum(self.sums, j, SQUARES + k, square[k], lane)
                c.write_sum(self.sums, j, PRODUCTS + k, mixed[k], lane)
                c.write_sum(self.sums, j, FORCE_R + k, force_r[k], lane)
                c.write_sum(self.sums, j, FORCE_SQUARES + k, force_square[k], lane)
                c.write_sum(self.sums, j, FORCE_PRODUCTS + k, force_mixed[k], lane)

    @ti.func
    def _sum_bodies(self):
        """Fill `total`."""
        c = self.blocks
        ti.loop_config(serialize=self.state.serial)
        for w in range(MAX_BODIES * DAMPING_SUMS * c.lanes):
            bk, lane = w // c.lanes, w % c.lanes
            b, k = bk // DAMPING_SUMS, bk % DAMPING_SUMS
            total = c.sum_by_lanes(self.sums, b, k, lane, c.lanes)
            if lane == 0:
                self.total[b, k] = total

    @ti.func
    def _find_rigid_motion(self, t):
        """Rigid motion of each body, and what its rolling resistance takes from its rotation."""
        s = self.state
        ti.loop_config(serialize=s.serial)
        for b in range(MAX_BODIES):
            if b < s.body_count[None]:
                total = ti.Vector([self.total[b, k] for k in range(DAMPING_SUMS)])
                M = s.prescribed_mass[b] if s.prescribed_mass[b] > 0.0 else s.body_mass[b]
                d = total[MASS_R:MOMENTUM] / M
                v = total[MOMENTUM:SPIN] / M
                L = total[SPIN:SQUARES] - M * d.cross(v)
                inertia = moment_of_inertia(total[SQUARES:PRODUCTS], total[PRODUCTS:FORCE], d, M)
                tiny = 0.5e-6 * inertia.trace() + 1e-9 * M  # a body flattened to a line has no inertia about it
                inertia += tiny * ti.Matrix.identity(ti.f32, 3)
                omega = (inertia / M).inverse() @ (L / M)
                self.center[b] = s.x[s.vertex_begin[b]] + d
                self.velocity[b] = v
                self.omega[b] = omega
                self.rocking_change[b], self.pressure_center[b] = ti.Vector([0.0, 0.0, 0.0]), self.center[b]
                if ti.static(self.touches):
                    force = total[FORCE]
                    if force > 0.0 and s.prescribed_mass[b] == 0.0:
                        p = total[FORCE_R:FORCE_SQUARES] / force
                        arm, k = d - p, 1.0 - ti.exp(-s.damping[b] * t)
                        wanted = k * (inertia @ omega + M * arm.cross(omega.cross(arm)))  # s = 1: k I_p omega
                        axis = wanted / ti.max(wanted.norm(), 1e-20)
                        spread = moment_of_inertia(
                            total[FORCE_SQUARES:FORCE_PRODUCTS], total[FORCE_PRODUCTS:DAMPING_SUMS], p, force
                        )
                        square = axis.dot(spread @ axis) / force  # a^2
                        most = ROLLING_RESISTANCE * force * t * ti.sqrt(ti.max(square, 0.0))
                        self.pressure_center[b] = s.x[s.vertex_begin[b]] + p
                        self.rocking_change[b] = -k * ti.min(most / ti.max(wanted.norm(), 1e-20), 1.0) * omega

    @ti.func
    def _damp(self, t):
        """Change the velocities of the vertices, and predict their increments."""
        s = self.state
        ti.loop_config(serialize=s.serial)
        for i in range(s.V):
            if s.awake_vertex(i):
                b = s.body_of_vertex[i]
                if s.damping[b] > 0.0 and s.inv_mass[i] > 0.0:
                    rigid = self.velocity[b] + self.omega[b].cross(s.x[i] - self.center[b])
                    k = 1.0 - ti.exp(-s.damping[b] * t)
                    change = k * (rigid - s.v[i])
                    if ti.static(self.touches):
                        change += self.rocking_change[b].cross(s.x[i] - self.pressure_center[b])
                    s.v[i], s.v_lo[i] = two_sum(s.v[i], s.v_lo[i] + change)
                s.predict(i)
