"""Motion of a rigid body in a substep: the equations of sim/rigid/rigid_bodies.py, for body b of the RigidBodies m."""

import taichi as ti

from core import quaternion
from core.fields import two_sum

SOFT, FREE, DRIVEN = range(3)  # kinds of bodies
MAX_ROTATION = 0.5  # [rad] a substep; beyond, the attitude's increments, of first order, mean nothing


@ti.func
def update_rotation(m: ti.template(), b):
    """Rotation matrix, world inertia and angular velocity, from attitude and angular momentum."""
    R = quaternion.to_matrix(m.q[b].normalized())
    m.R[b] = R
    m.inverse_inertia_world[b] = R @ m.inverse_inertia[b] @ R.transpose()
    if m.kind[b] == FREE:
        m.angular_velocity[b] = m.inverse_inertia_world[b] @ m.angular_momentum[b]


@ti.func
def predict_body(m: ti.template(), b):
    """Increments of the next substep without contacts, and then what the hands add."""
    s = m.state
    dt, n = s.dt[None], ti.cast(s.substeps[None], ti.f32)
    if m.kind[b] == FREE:
        d = dt * (m.v[b] + (m.v_lo[b] + dt * s.gravity[None])) + m.x_lo[b]
        half = (m.q[b] + quaternion.rotation_increment(0.5 * dt * m.angular_velocity[b], m.q[b])).normalized()
        R = quaternion.to_matrix(half)
        rotation = dt * (R @ (m.inverse_inertia[b] @ (R.transpose() @ m.angular_momentum[b])))
        m.dx_predicted[b], m.rotation_predicted[b] = d, rotation
        m.dx[b], m.rotation[b] = d, rotation
        m.grasp.apply_springs(m, b)
    else:
        m.dx[b], m.rotation[b] = m.frame_displacement[b] / n + m.x_lo[b], m.frame_rotation[b] / n


@ti.func
def place_vertex(m: ti.template(), i):
    """Put vertex i of a rigid body where its body has it."""
    s = m.state
    b = s.body_of_vertex[i]
    r = m.R[b] @ (s.rest[i] - m.center[b])
    s.x[i], s.v[i] = m.x[b] + (r + m.x_lo[b]), m.v[b] + m.angular_velocity[b].cross(r)
    s.x_lo[i], s.v_lo[i], s.dx[i] = 0.0, 0.0, 0.0


@ti.func
def commit_body(m: ti.template(), b, d, rotation):
    """Commit the increments of centre d [m] and attitude [rad] of a free body."""
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
    gain = (rotation - m.rotation_predicted[b]) / dt
    m.angular_momentum[b] += R @ (m.inertia[b] @ (R.transpose() @ gain))
    q = ti.cast(m.q[b], ti.f64)
    excess = ti.cast(q.norm_sqr() - 1.0, ti.f32)
    change_q = quaternion.rotation_increment(rotation, m.q[b]) - 0.5 * excess * m.q[b]
    m.q[b], m.q_lo[b] = two_sum(m.q[b], change_q + m.q_lo[b])
    update_rotation(m, b)
    angle = m.angular_velocity[b].norm() * dt
    if angle > MAX_ROTATION:
        m.angular_momentum[b] *= MAX_ROTATION / angle
        m.angular_velocity[b] *= MAX_ROTATION / angle


@ti.func
def follow_target(m: ti.template(), b):
    """Put a driven body where it is at the end of this substep."""
    s = m.state
    f = ti.cast(s.substep_index[None] + 1, ti.f32) / ti.cast(s.substeps[None], ti.f32)
    m.x[b], m.x_lo[b] = two_sum(m.frame_x[b], f * m.frame_displacement[b])
    m.q[b] = (m.frame_q[b] + quaternion.rotation_increment(f * m.frame_rotation[b], m.frame_q[b])).normalized()
    update_rotation(m, b)
