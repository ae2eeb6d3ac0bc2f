"""Grasps: what each hand holds, and the springs that hold it.

A held vertex i is tied to its position p in the hand's frame by a critically damped spring. The springs of one hand
together carry the whole body, of mass M, at omega = SPRING_OMEGA (or faster, a body lighter than MIN_SPRING_MASS):

    kappa = omega^2 max(M, MIN_SPRING_MASS) / m_held,   gamma = 2 sqrt(kappa M / m_held)
    |force_i| <= MAX_HAND_FORCE m_i / m_held

per mass of vertex, and are integrated implicitly in each substep, with the hand's pose interpolated to the substep:

    dx' = dx + dt^2 (kappa (p - x - dx') + gamma (p_dot - x_dot')),   x_dot' = (dx' - x_lo) / dt
"""

import math
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import taichi as ti

from core.fields import Download, FieldGroup
from core.vocabulary import Hand
from sim.hands.grasp_state import (
    MAX_HAND_FORCE,
    MIN_SPRING_MASS,
    SPRING_OMEGA,
    GraspState,
    extended,
    find_grasp,
    has_pose,
    pose,
)
from sim.hands.throw import THROW_WINDOW, throw_velocities
from sim.model import stacked

if TYPE_CHECKING:
    from sim.hands.grasp_state import Grasp, PoseHistory
    from sim.model import Model
    from sim.state import State

MAX_HAND_JUMP = 1.0  # [m] in a frame; faster than any arm, so the tracking was lost
TRACKING_TIMEOUT = 0.25  # [s] that a hand is held where it was lost


@ti.data_oriented
class Grasps:
    """Grasps of up to `count` hands.

    held i32[V]: bit h = hand h holds the vertex;   target vec3[H,V]: its position in the hand's frame [m]
    position vec3[H,2], rotation vec4[H,2]: poses at the start and at the end of the frame
    kappa [1/s^2], gamma [1/s], mass f32[H] = m_held [kg];   correction vec3[H,V]: last correction of a vertex [m]
    total i64[H,3]: force sums [1e-6 N]
    """

    def __init__(self, state: "State", count: int):
        self.state, self.count = state, count
        H, V, group = max(count, 1), state.V, FieldGroup()
        self.held, self.target, self.correction = group.scalar(V, dtype=ti.i32), group.vector(H, V), group.vector(H, V)
        self.position, self.rotation = group.vector(H, 2), group.vector(H, 2, n=4)
        self.kappa, self.gamma, self.mass = (group.scalar(H) for _ in range(3))
        self.total = group.scalar(H, 3, dtype=ti.i64)
        self._group = group
        group.build()
        self._motion = Download([state.x, state.v])

    def load(self, model: "Model", ids: np.ndarray, weights: np.ndarray) -> None:
        """Take other bodies, with the vertices (P, 3) and weights (P, 3) of their surface samples."""
        self.model, self.offsets, self.samples = model, model.vertex_begin, (ids, weights)
        self.masses = stacked([p.mass for p in model.bodies])
        self.reset()

    def reset(self) -> None:
        """Open all hands and forget where they were."""
        self.set_state(GraspState.none(self.count))

    def grasped_bodies(self) -> list[int]:
        """The body that each hand holds, -1 for none."""
        return [-1 if grasp is None else grasp.body for grasp in self.grasps]

    def get_state(self) -> GraspState:
        """The grasps, as a value."""
        return GraspState(tuple(self.grasps), tuple(self.last), tuple(self.histories), tuple(self.lost))

    def set_state(self, state: GraspState) -> None:
        """Replace all grasps by those of the state."""
        self.grasps, self.last = list(state.grasps), list(state.last)
        self.histories, self.lost = list(state.histories), list(state.lost)
        self.held.fill(0)
        for h, grasp in enumerate(self.grasps):
            if grasp is not None:
                self._hold(h, grasp)

    def begin_frame(self, hands: list[Hand | None], dt: float, moving: bool) -> None:
        """Take the hands' poses after dt [s]; grasp and release.

        A hand that opens throws a body that no other hand holds, if bodies are `moving` (sim/hands/throw.py). A
        missing hand opens and throws nothing. One that is None, or has no finite pose, holds still; so does one that
        holds something and is suddenly MAX_HAND_JUMP away, until it is back or, after TRACKING_TIMEOUT, opens.
        """
        poses = np.zeros((max(self.count, 1), 2, 7), np.float32)
        for h in range(self.count):
            before = self.last[h]
            now = self._tracked(h, hands[h], dt) if h < len(hands) else None
            if self.grasps[h] is not None and (now is None or not now.grip):
                body, history = self.grasps[h].body, self.histories[h]
                self._hold(h, None)
                if now is not None and moving and len(history) > 1 and body not in self.grasped_bodies():
                    self._throw(body, history)
            elif now is not None and now.grip and not (before is not None and before.grip):
                x = self._motion(int(self.offsets[-1]))[0].astype(np.float64)
                self._hold(h, find_grasp(now, x, self.offsets, *self.samples))
                before = None  # targets are measured at the present pose, so that nothing jumps
            if now is not None:
                poses[h, 0], poses[h, 1] = pose(now if before is None else before), pose(now)
            self.last[h] = None if now is None else replace(now)
            self.histories[h] = () if self.grasps[h] is None else extended(self.histories[h], dt, now, THROW_WINDOW)
        if any(grasp is not None for grasp in self.grasps):
            self._set_poses(poses)

    def _tracked(self, h: int, given: Hand | None, dt: float) -> Hand | None:
        """Hand h with the pose that it counts as having, if the tracking gives `given`."""
        last = self.last[h]
        if given is None or not has_pose(given):
            return last
        far = last is not None and math.dist(given.position, last.position) > MAX_HAND_JUMP
        if not far or self.grasps[h] is None:
            self.lost[h] = 0.0
            return given
        self.lost[h] += dt
        if self.lost[h] > TRACKING_TIMEOUT:  # it drops the body without a throw
            self._hold(h, None)
            return given
        return replace(last, grip=given.grip)

    def _throw(self, body: int, history: "PoseHistory") -> None:
        """Let a body move on as the hand did that has held it."""
        part = self.model.bodies[body]
        first, last = (int(o) for o in self.offsets[body : body + 2])
        if (part.inv_mass > 0.0).all():
            x, v = self._motion(last)[:, first:].astype(np.float64)
            change = throw_velocities(history, x, v, part.mass, MAX_HAND_FORCE * THROW_WINDOW)
            self._add(first, last - first, change.astype(np.float32))

    @ti.kernel
    def _add(self, first: ti.i32, n: ti.i32, dv: ti.types.ndarray(ti.f32, 2)):
        for i in range(n):
            self.state.v[first + i] += ti.Vector([dv[i, c] for c in range(3)])

    def _hold(self, h: int, grasp: "Grasp | None") -> None:
        """Let hand h hold exactly this."""
        self.grasps[h] = grasp
        count = 1 if grasp is None else len(grasp.vertices)  # Taichi takes no empty arrays
        vertices, positions = np.zeros(count, np.int32), np.zeros((count, 3), np.float32)
        strength = ti.Vector([0.0, 0.0, 0.0])
        if grasp is not None:
            first, last = self.offsets[grasp.body : grasp.body + 2]
            vertices[:], positions[:] = grasp.vertices + first, grasp.positions
            held, whole = float(self.masses[vertices].sum()), float(self.masses[first:last].sum())
            kappa = SPRING_OMEGA**2 * max(whole, MIN_SPRING_MASS) / held
            strength = ti.Vector([held, kappa, 2 * math.sqrt(kappa * whole / held)])
        self._set_held(h, 0 if grasp is None else count, vertices, positions, strength)

    @ti.kernel
    def _set_held(
        self,
        h: ti.i32,
        count: ti.i32,
        taken: ti.types.ndarray(ti.i32, 1),
        positions: ti.types.ndarray(ti.f32, 2),
        strength: ti.types.vector(3, ti.f32),
    ):
        for i in self.held:
            self.held[i] &= ~(1 << h)
        self.mass[h], self.kappa[h], self.gamma[h] = strength[0], strength[1], strength[2]
        for k in range(count):
            self.held[taken[k]] |= 1 << h
            self.correction[h, taken[k]] = ti.Vector([0.0, 0.0, 0.0])
            self.target[h, taken[k]] = ti.Vector([positions[k, 0], positions[k, 1], positions[k, 2]])

    @ti.kernel
    def _set_poses(self, poses: ti.types.ndarray(ti.f32, 3)):
        for h, k in ti.ndrange(poses.shape[0], 2):
            self.position[h, k] = ti.Vector([poses[h, k, c] for c in range(3)])
            self.rotation[h, k] = ti.Vector([poses[h, k, c] for c in range(3, 7)])

    @ti.func
    def _target(self, h, i, fraction):
        """Target [m] of vertex i in hand h at a fraction of the frame; rotations blend along the shorter arc."""
        a, b = self.rotation[h, 0], self.rotation[h, 1]
        q = ti.math.mix(a, b if a.dot(b) >= 0.0 else -b, fraction).normalized()
        r, u = self.target[h, i], ti.Vector([q[1], q[2], q[3]])
        t = 2.0 * u.cross(r)
        return ti.math.mix(self.position[h, 0], self.position[h, 1], fraction) + r + q[0] * t + u.cross(t)

    @ti.func
    def _spring(self, h, i, d):
        """Correction [m] of vertex i's increment d by the spring of hand h."""
        s = self.state
        dt, tick, n = s.dt[None], s.substep_index[None], ti.cast(s.substeps[None], ti.f32)
        p = self._target(h, i, (tick + 1) / n)
        step = p - self._target(h, i, tick / n)
        kappa, gamma = self.kappa[h] * dt * dt, self.gamma[h] * dt
        a = (kappa * (p - s.x[i] - d) + gamma * (step + s.x_lo[i] - d)) / (1.0 + kappa + gamma)
        most = MAX_HAND_FORCE / self.mass[h] * dt * dt
        return a * ti.min(1.0, most / ti.max(a.norm(), 1e-20))

    @ti.func
    def apply_springs(self, i, d):
        """The increment d [m] of vertex i with the springs of all hands that hold it."""
        pulled = d
        if ti.static(self.count > 0):
            held = self.held[i]
            if held != 0:
                for h in range(self.count):
                    if (held >> h) & 1:
                        a = self._spring(h, i, pulled)  # after the last hand's, so that two do not overshoot
                        self.correction[h, i] = a
                        pulled += a
        return pulled

    @ti.func
    def max_speed_gain(self, i):
        """Speed [m/s] that hands may add to vertex i until the next search.

        That which takes it to its target of the end of the frame, or which the greatest force gives it.
        """
        t, most = self.state.detect_dt[None], 0.0
        for h in range(self.count):
            if (self.held[i] >> h) & 1:
                distance = (self._target(h, i, 1.0) - self.state.x[i]).norm()
                most = ti.max(most, ti.min(distance / t, MAX_HAND_FORCE / self.mass[h] * t))
        return most

    def forces(self) -> list[np.ndarray]:
        """Force of each hand on the body it holds in the last substep [N], (3,) each; zero for an open hand."""
        if self.grasps == [None] * self.count:
            return [np.zeros(3)] * self.count
        return self._forces()

    def _forces(self) -> list[np.ndarray]:
        self._sum()
        return list(self.total.to_numpy()[: self.count] * 1e-6)

    @ti.kernel
    def _sum(self):
        s = self.state
        for h, c in self.total:
            self.total[h, c] = 0
        for i in self.held:
            for h in range(self.count):
                if (self.held[i] >> h) & 1 and s.dt[None] > 0.0:
                    force = s.mass[i] / s.dt[None] ** 2 * self.correction[h, i]
                    for c in ti.static(range(3)):
                        ti.atomic_add(self.total[h, c], ti.cast(force[c] * 1e6, ti.i64))

    def warm_up(self) -> None:
        """See Solver.warm_up."""
        self._motion(0)
        self._forces()
        if self.count:
            self._hold(0, self.grasps[0])
            self._set_poses(np.zeros((self.count, 2, 7), np.float32))  # each frame that needs them sets them
            self._add(0, 0, np.zeros((1, 3), np.float32))
