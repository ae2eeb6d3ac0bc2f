"""How a rigid body moves in a substep: the equations of sim/rigid/rigid_bodies.py, for body b of its Movers m."""

import taichi as ti

from core import quaternion
from core.fields import two_sum

SOFT, FREE, DRIVEN = range(3)
FASTEST = 0.5  # [rad] a substep; beyond, the attitude's increments mean nothing


@ti.func
def refresh(m: ti.template(), b):
    """What follows from attitude and momentum."""
    R = quaternion.to_matrix(m.q[b].normalized())
    m.R[b] = R
    m.world[b] = R @ m.inverse_inertia[b] @ R.transpose()
    if m.kind[b] == FREE:
        m.omega[b] = m.world[b] @ m.spin[b]


@ti.func
def predict(m: ti.template(), b):
    """The increments of the next substep without contacts, and then what the hands add."""
    s = m.state
    dt, n = s.dt[None], ti.cast(s.substeps[None], ti.f32)
    if m.kind[b] == FREE:
        d = dt * (m.v[b] + (m.v_lo[b] + dt * s.gravity[None])) + m.x_lo[b]
        half = (m.q[b] + quaternion.rotation_increment(0.5 * dt * m.omega[b], m.q[b])).normalized()
        R = quaternion.to_matrix(half)
        turn = dt * (R @ (m.inverse_inertia[b] @ (R.transpose() @ m.spin[b])))
        m.dx_predicted[b], m.turned[b] = d, turn
        m.dx[b], m.turn[b] = d, turn
        m.grip.pull(b)
    else:
        m.dx[b], m.turn[b] = m.way[b] / n + m.x_lo[b], m.swing[b] / n


@ti.func
def place(m: ti.template(), i):
    """Put vertex i of a rigid body where its body has it."""
    s = m.state
    b = s.body_of_vertex[i]
    r = m.R[b] @ (s.rest[i] - m.center[b])
    s.x[i], s.v[i] = m.x[b] + (r + m.x_lo[b]), m.v[b] + m.omega[b].cross(r)
    s.x_lo[i], s.v_lo[i], s.dx[i] = 0.0, 0.0, 0.0


@ti.func
def move(m: ti.template(), b, d, t):
    """Commit the increments d and t of a free body."""
    s = m.state
    dt = s.dt[None]
    change = dt * s.gravity[None] + (d - m.dx_predicted[b]) / dt
    v, v_lo = two_sum(m.v[b], m.v_lo[b] + change)
    speed, limit = v.norm(), m.max_step[b] / dt
    if speed > limit:
        v, v_lo = v * (limit / speed), 0.0 * v
    m.v[b], m.v_lo[b] = v, v_lo
    m.x[b], m.x_lo[b] = two_sum(m.x[b], dt * (v + v_lo) + m.x_lo[b])
    R = m.R[b]
    m.spin[b] += R @ (m.inertia[b] @ (R.transpose() @ ((t - m.turned[b]) / dt)))
    q = ti.cast(m.q[b], ti.f64)
    stretch = ti.cast(q.norm_sqr() - 1.0, ti.f32)
    turned = quaternion.rotation_increment(t, m.q[b]) - 0.5 * stretch * m.q[b]
    m.q[b], m.q_lo[b] = two_sum(m.q[b], turned + m.q_lo[b])
    refresh(m, b)
    spinning = m.omega[b].norm() * dt
    if spinning > FASTEST:
        m.spin[b] *= FASTEST / spinning
        m.omega[b] *= FASTEST / spinning


@ti.func
def follow(m: ti.template(), b):
    """Put a driven body where it is at the end of this substep."""
    s = m.state
    f = ti.cast(s.substep_index[None] + 1, ti.f32) / ti.cast(s.substeps[None], ti.f32)
    m.x[b], m.x_lo[b] = two_sum(m.origin[b], f * m.way[b])
    m.q[b] = (m.origin_q[b] + quaternion.rotation_increment(f * m.swing[b], m.origin_q[b])).normalized()
    refresh(m, b)
