"""Grasps of rigid bodies: a spring holds the whole body in the hand's frame, as sim/hands/grasp.py holds vertices.

    a = (kappa (p - x - dx) + gamma (step + x_lo - dx)) / (1 + kappa + gamma)
    kappa = (omega dt)^2 max(1, MIN_SPRING_MASS / M)

for the centre of mass, which the hand wants at p and to move by `step` in this substep, and alike for the attitude.
"""

from typing import TYPE_CHECKING

import numpy as np
import taichi as ti

from core import quaternion
from core.fields import FieldGroup
from sim.hands.grasp_state import MAX_HAND_FORCE, MIN_SPRING_MASS, SPRING_OMEGA

if TYPE_CHECKING:
    from sim.state import State

MAX_HAND_TORQUE = 0.1 * MAX_HAND_FORCE  # [N m] of one hand: its force at the width of a hand


@ti.data_oriented
class RigidGrasp:
    """The rigid body that each hand h holds: body i32[H] (-1 none), position vec3 [m] and attitude vec4 in its frame.

    force vec3[H] [N]: of the last substep, on the body.   grasps: the hands' poses and grasps, None without hands.
    """

    def __init__(self, state: "State", grasps):
        self.state, self.grasps = state, grasps
        self.count = 0 if grasps is None else grasps.count
        H, group = max(self.count, 1), FieldGroup()
        self.body, self.position, self.force = group.scalar(H, dtype=ti.i32), group.vector(H), group.vector(H)
        self.attitude = group.vector(H, n=4)
        self._group = group
        group.build()
        self.reset()

    def reset(self) -> None:
        """Open all hands."""
        self.held = [-1] * self.count
        self.body.fill(-1)
        self.force.fill(0.0)

    def update(self, rigid_bodies) -> None:
        """Update grasps and releases at the beginning of a frame."""
        grasped = self.grasps.grasped_bodies() if self.count else []
        for h, b in enumerate(grasped):
            b = b if b >= 0 and rigid_bodies.bodies[b].body.rigid else -1
            if b != self.held[h]:
                self.held[h] = b
                self._take(rigid_bodies, h, b)

    @ti.kernel
    def _take(self, m: ti.template(), h: ti.i32, b: ti.i32):
        """Hold body b where it is now in the frame that hand h has at the begin of the frame."""
        self.body[h], self.force[h] = b, 0.0
        if b >= 0:
            back = quaternion.conjugate(self.grasps.rotation[h, 0])
            self.position[h] = quaternion.to_matrix(back) @ (m.x[b] - self.grasps.position[h, 0])
            self.attitude[h] = quaternion.multiply(back, m.q[b])

    @ti.func
    def _target(self, h, f):
        """Position [m] and attitude that hand h wants of its body at a fraction of the frame."""
        a, b = self.grasps.rotation[h, 0], self.grasps.rotation[h, 1]
        q = ti.math.mix(a, b if a.dot(b) >= 0.0 else -b, f).normalized()
        p = ti.math.mix(self.grasps.position[h, 0], self.grasps.position[h, 1], f)
        return p + quaternion.to_matrix(q) @ self.position[h], quaternion.multiply(q, self.attitude[h])

    @ti.func
    def apply_springs(self, m: ti.template(), b):
        """Add the springs of all hands that hold free body b of the RigidBodies m to its increments."""
        if ti.static(self.count > 0):
            for h in range(self.count):
                if self.body[h] == b:
                    self._apply_spring(m, h, b)

    @ti.func
    def _apply_spring(self, m: ti.template(), h, b):
        s = self.state
        dt, n = s.dt[None], ti.cast(s.substeps[None], ti.f32)
        f = ti.cast(s.substep_index[None] + 2, ti.f32) / n  # the substep index is still that of the one before
        p, q = self._target(h, f)
        p_before, q_before = self._target(h, f - 1.0 / n)
        light = ti.max(1.0, MIN_SPRING_MASS * m.inv_mass[b])
        kappa = SPRING_OMEGA * SPRING_OMEGA * dt * dt * light
        gamma = 2.0 * SPRING_OMEGA * dt * ti.sqrt(light)
        implicit = 1.0 / (1.0 + kappa + gamma)
        d, rotation = m.dx[b], m.rotation[b]
        a = implicit * (kappa * (p - m.x[b] - d) + gamma * (p - p_before + m.x_lo[b] - d))
        a *= ti.min(1.0, MAX_HAND_FORCE * m.inv_mass[b] * dt * dt / ti.max(a.norm(), 1e-20))
        twist = quaternion.rotation_vector_between(q, m.q[b]) - rotation
        alpha = implicit * (kappa * twist + gamma * (quaternion.rotation_vector_between(q, q_before) - rotation))
        R = m.R[b]
        torque = R @ (m.inertia[b] @ (R.transpose() @ alpha)) / (dt * dt)
        alpha *= ti.min(1.0, MAX_HAND_TORQUE / ti.max(torque.norm(), 1e-20))
        m.dx[b] += a
        m.rotation[b] += alpha
        self.force[h] = a / (m.inv_mass[b] * dt * dt)

    def forces(self) -> list:
        """Force of each hand on the rigid body that it holds [N], (3,), in the last substep."""
        if self.held == [-1] * self.count:
            return [np.zeros(3)] * self.count
        return list(self.force.to_numpy()[: self.count])

    def warm_up(self, rigid_bodies) -> None:
        """See Solver.warm_up."""
        self.force.to_numpy()
        if -1 in self.held:
            self._take(rigid_bodies, self.held.index(-1), -1)
