"""Hands on rigid bodies: a spring holds the whole body in the hand's frame, as sim/hands/grasp.py holds vertices.

    a = (kappa (p - x - dx) + gamma (step + x_lo - dx)) / (1 + kappa + gamma),  kappa = (omega dt)^2 max(1, LIGHTEST/M)

for the centre of mass, which the hand wants at p and to move by `step` in this substep, and alike for the attitude.
"""

import numpy as np
import taichi as ti

from core import quaternion
from sim.hands.grasp import FORCE, LIGHTEST, OMEGA, Grasps

TORQUE = 0.1 * FORCE  # [N m] of one hand at most: its force at the width of a hand


@ti.data_oriented
class RigidGrasp:
    """What each hand h holds: body i32[H] (-1 none), place vec3 [m] and attitude vec4 in the hand's frame.

    force vec3[H] [N]: of the last substep, on the body
    """

    def __init__(self, movers, hands: int):
        self.movers, self.count = movers, hands
        self.holds, self.hands = False, None
        H = max(hands, 1)
        self.builder = ti.FieldsBuilder()
        self.body, self.place, self.force = ti.field(ti.i32), ti.Vector.field(3, ti.f32), ti.Vector.field(3, ti.f32)
        self.attitude = ti.Vector.field(4, ti.f32)
        self.builder.dense(ti.i, H).place(self.body, self.place, self.force, self.attitude)
        self.tree = self.builder.finalize()
        self.reset()

    def follow(self, hands: Grasps) -> None:
        """Take the hands' poses and grips from here; before any kernel is compiled, if ever."""
        self.hands, self.holds = hands, self.count > 0

    def reset(self) -> None:
        """Open all hands."""
        self.held = [-1] * self.count
        self.body.fill(-1)
        self.force.fill(0.0)

    def update(self) -> None:
        """Host, at the begin of a frame: follow what the hands grip and let go."""
        gripped = self.hands.gripped()
        for h in range(self.count):
            b = gripped[h]
            b = b if b >= 0 and self.movers.parts[b].body.rigid else -1
            if b != self.held[h]:
                self.held[h] = b
                self._take(h, b)

    @ti.kernel
    def _take(self, h: ti.i32, b: ti.i32):
        """Hold body b where it is now in the frame that hand h has at the begin of the frame."""
        m = self.movers
        self.body[h], self.force[h] = b, 0.0
        if b >= 0:
            back = quaternion.conjugate(self.hands.rotation[h, 0])
            self.place[h] = quaternion.to_matrix(back) @ (m.x[b] - self.hands.position[h, 0])
            self.attitude[h] = quaternion.multiply(back, m.q[b])

    @ti.func
    def _goal(self, h, f):
        """Place and attitude that hand h wants of its body at a fraction of the frame."""
        a, b = self.hands.rotation[h, 0], self.hands.rotation[h, 1]
        q = ti.math.mix(a, b if a.dot(b) >= 0.0 else -b, f).normalized()
        p = ti.math.mix(self.hands.position[h, 0], self.hands.position[h, 1], f)
        return p + quaternion.to_matrix(q) @ self.place[h], quaternion.multiply(q, self.attitude[h])

    @ti.func
    def pull(self, b):
        """Add the springs of all hands that hold free body b to its increments of the next substep."""
        if ti.static(self.holds):
            for h in range(self.count):
                if self.body[h] == b:
                    self._spring(h, b)

    @ti.func
    def _spring(self, h, b):
        s = self.movers.state
        m = self.movers
        dt, n = s.dt[None], ti.cast(s.substeps[None], ti.f32)
        f = ti.cast(s.substep_index[None] + 2, ti.f32) / n  # the tick is still that of the substep before
        p, q = self._goal(h, f)
        p_before, q_before = self._goal(h, f - 1.0 / n)
        more = ti.max(1.0, LIGHTEST * m.w[b])
        kappa = OMEGA * OMEGA * dt * dt * more
        gamma = 2.0 * OMEGA * dt * ti.sqrt(more)
        soft = 1.0 / (1.0 + kappa + gamma)
        d, t = m.dx[b], m.turn[b]
        a = soft * (kappa * (p - m.x[b] - d) + gamma * (p - p_before + m.x_lo[b] - d))
        a *= ti.min(1.0, FORCE * m.w[b] * dt * dt / ti.max(a.norm(), 1e-20))
        twist = quaternion.rotation_vector_between(q, m.q[b]) - t
        alpha = soft * (kappa * twist + gamma * (quaternion.rotation_vector_between(q, q_before) - t))
        R = m.R[b]
        torque = R @ (m.inertia[b] @ (R.transpose() @ alpha)) / (dt * dt)
        alpha *= ti.min(1.0, TORQUE / ti.max(torque.norm(), 1e-20))
        m.dx[b] += a
        m.turn[b] += alpha
        self.force[h] = a / (m.w[b] * dt * dt)

    def forces(self) -> list:
        """Force of each hand on the rigid body that it holds [N], (3,), in the last substep."""
        if self.held == [-1] * self.count:
            return [np.zeros(3)] * self.count
        return list(self.force.to_numpy()[: self.count])

    def warm_up(self) -> None:
        """See Solver.warm_up."""
        self.force.to_numpy()
        if -1 in self.held:
            self._take(self.held.index(-1), -1)

    def destroy(self) -> None:
        self.tree.destroy()
