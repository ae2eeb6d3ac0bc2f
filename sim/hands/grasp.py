"""Grasps: what each hand holds, the springs that hold it, and throws.

A held vertex i is tied to its position p in the hand's frame by a critically damped spring. The springs of one hand
together carry the whole body, of mass M, at omega = SPRING_OMEGA (or faster, a body lighter than MIN_SPRING_MASS):

    kappa = omega^2 max(M, MIN_SPRING_MASS) / m_held,   gamma = 2 sqrt(kappa M / m_held)
    |force_i| <= MAX_HAND_FORCE m_i / m_held

per mass of vertex, and are integrated implicitly in each substep, with the hand's pose interpolated to the substep:

    dx' = dx + dt^2 (kappa (p - x - dx') + gamma (p_dot - x_dot')),   x_dot' = (dx' - x_lo) / dt

A rigid body hangs on one spring for its centre of mass and one for its attitude. A body that a hand lets go of is
thrown: fingers slow down as they open, and a soft body swings on its springs, so neither the hand's last velocity nor
the body's is what the user means. The rigid part of its motion becomes the straight line through the hand's last poses.
"""

import math
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import taichi as ti
from scipy.spatial.transform import Rotation

from core import quaternion
from core.fields import Download, FieldGroup
from core.rotation import matrices_from_quaternions
from core.vocabulary import Hand
from sim.model import Model, stacked
from sim.state import State

SPRING_OMEGA = 2.0 * math.pi * 20.0  # [rad/s] of the whole body on its springs: stiffer than an arm, softer than a pin
MIN_SPRING_MASS = 0.2  # [kg]; lighter bodies are held as firmly, with 3 N/mm, so that they too can be squeezed
MAX_HAND_FORCE = 80.0  # [N] of one hand: a firm pull
MIN_GRASP_VERTICES = 4  # one more than fix a body's attitude
MAX_WIDENING = 1.5  # times the reach, where a coarse cage has fewer vertices within reach
MAX_HAND_TORQUE = 0.1 * MAX_HAND_FORCE  # [N m] of one hand: its force at the width of a hand
THROW_WINDOW = 0.08  # [s] before the release that decide: longer than fingers take to open


@dataclass(frozen=True, eq=False)
class Grasp:
    """One hand's grasp: some vertices (n,) of a body, and their positions in the hand's frame [m], (n, 3)."""

    body: int
    vertices: np.ndarray
    positions: np.ndarray


Indices, Vectors = ti.types.ndarray(ti.i32, 1), ti.types.ndarray(ti.f32, 2)  # arguments of kernels
PoseHistory = tuple[tuple[float, tuple[float, ...]], ...]  # ages [s] and poses (position, quaternion), oldest first


@dataclass(frozen=True)
class GraspState:
    """State of all hands: grasps (None for nothing), last inputs, and pose histories."""

    grasps: tuple[Grasp | None, ...]
    last: tuple[Hand | None, ...]
    histories: tuple[PoseHistory, ...]

    def renumbered(self, index: list[int | None]) -> "GraspState":
        """The same after bodies were renumbered: index[old] is the new number, None of a removed body and its grasp."""
        kept = [None if g is None or index[g.body] is None else replace(g, body=index[g.body]) for g in self.grasps]
        return replace(self, grasps=tuple(kept))

    def shifted(self, body: int, shift: np.ndarray) -> "GraspState":
        """The same after the vertices of a body were moved by (V, 3) [m], so that the hands do not pull them back."""
        grasps = list(self.grasps)
        for h, grasp in enumerate(grasps):
            if grasp is not None and grasp.body == body:
                world_from_hand = matrices_from_quaternions(self.last[h].rotation)
                grasps[h] = replace(grasp, positions=grasp.positions + shift[grasp.vertices] @ world_from_hand)
        return replace(self, grasps=tuple(grasps))


def pose(hand: Hand) -> np.ndarray:
    """Position and unit quaternion of a hand, (7,)."""
    q = np.asarray(hand.rotation, np.float64)
    return np.concatenate([np.asarray(hand.position, np.float64), q / np.linalg.norm(q)])


def has_pose(hand: Hand) -> bool:
    """True if a hand has a finite pose."""
    values = np.array([*hand.position, *hand.rotation], np.float64)
    return bool(np.isfinite(values).all() and np.linalg.norm(values[3:]) > 1e-6)


def extended(history: PoseHistory, dt: float, hand: Hand) -> PoseHistory:
    """The history after dt [s]: with the hand's present pose, without poses older than THROW_WINDOW."""
    aged = [(age + dt, at) for age, at in history if age + dt <= THROW_WINDOW + 1e-6]
    return (*aged, (0.0, tuple(pose(hand).tolist())))


def find_grasp(hand: Hand, x: np.ndarray, offsets: np.ndarray, ids: np.ndarray, weights: np.ndarray) -> Grasp | None:
    """Grasp of a closing hand: vertices of the nearest body, if any is within reach.

    x (V, 3) are all vertices [m], of body b those from offsets[b] to offsets[b+1]; ids, weights (P, 3) the samples of
    the surfaces. A coarse mesh may have few vertices within reach, or none of the triangle that is touched.
    """
    position, reach = np.asarray(hand.position, np.float64), hand.reach
    grasp, least = None, np.inf
    for body, (first, last) in enumerate(pairwise(offsets)):
        mine = x[first:last]
        if first == last or (position < mine.min(0) - reach).any() or (position > mine.max(0) + reach).any():
            continue
        distance = np.linalg.norm(mine - position, axis=1)
        of_body = (ids[:, 0] >= first) & (ids[:, 0] < last)
        own = ids[of_body] - first
        surface = np.linalg.norm(np.einsum("pk,pkc->pc", weights[of_body], mine[own]) - position, axis=1)
        nearest = min(distance.min(), surface.min(initial=np.inf))
        if not (nearest <= reach and nearest < least):  # too far, or not finite
            continue
        taken = np.flatnonzero(distance <= reach)
        if len(taken) < MIN_GRASP_VERTICES:
            taken = np.argsort(distance, kind="stable")[:MIN_GRASP_VERTICES]
            taken = taken[distance[taken] <= MAX_WIDENING * reach]
        if len(taken) == 0:
            taken = np.unique(own[np.argmin(surface)])
        positions = (mine[taken] - position) @ matrices_from_quaternions(hand.rotation)
        grasp, least = Grasp(body, taken, positions), nearest
    return grasp


def hand_motion(history: PoseHistory) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Last position [m] of a hand, and its velocity [m/s] and angular velocity [rad/s] by least squares."""
    t = -np.array([age for age, _ in history])
    poses = np.array([pose for _, pose in history], np.float64)
    attitudes = Rotation.from_quat(poses[:, 3:], scalar_first=True)
    rotations = (attitudes * attitudes[-1].inv()).as_rotvec()
    t = t - t.mean()
    slopes = t @ np.hstack([poses[:, :3], rotations]) / (t @ t)
    return poses[-1, :3], slopes[:3], slopes[3:]


def throw_velocities(history: PoseHistory, x: np.ndarray, v: np.ndarray, mass: np.ndarray) -> np.ndarray:
    """Change of the velocities v of a body's vertices at x, (V, 3), by which it moves on with the hand [m/s], (V, 3).

    Its root mean square is at most what MAX_HAND_FORCE gives the body in THROW_WINDOW.
    """
    M = mass.sum()
    c, v_c = mass @ x / M, mass @ v / M
    r = x - c
    square = (r**2).sum(1)[:, None, None] * np.eye(3) - r[:, :, None] * r[:, None, :]
    inertia = np.einsum("i,ijk->jk", mass, square)
    inertia += (1e-6 * np.trace(inertia) + 1e-12) * np.eye(3)
    omega_body = np.linalg.solve(inertia, mass @ np.cross(r, v))
    position, velocity, omega = hand_motion(history)
    change = velocity + np.cross(omega, c - position) - v_c + np.cross(omega - omega_body, r)
    size = np.sqrt(mass @ (change**2).sum(1) / M)
    return change * min(1.0, MAX_HAND_FORCE * THROW_WINDOW / M / max(size, 1e-12))


@ti.data_oriented
class Grasps:
    """Grasps of up to `count` hands.

    held i32[V]: bit h = hand h holds the vertex;   target vec3[H,V]: its position in the hand's frame [m]
    position vec3[H,2], rotation vec4[H,2]: poses at the start and at the end of the frame
    kappa [1/s^2], gamma [1/s], mass f32[H] = m_held [kg];   correction vec3[H,V]: last correction of a vertex [m]
    total i64[H,3]: force sums [1e-6 N]
    """

    def __init__(self, state: State, count: int):
        self.state, self.count = state, count
        H, V, group = max(count, 1), state.V, FieldGroup()
        self.held, self.target, self.correction = group.scalar(V, dtype=ti.i32), group.vector(H, V), group.vector(H, V)
        self.position, self.rotation = group.vector(H, 2), group.vector(H, 2, n=4)
        self.kappa, self.gamma, self.mass = (group.scalar(H) for _ in range(3))
        self.total = group.scalar(H, 3, dtype=ti.i64)
        self._group = group
        group.build()
        self._motion = Download([state.x, state.v])

    def load(self, model: Model, ids: np.ndarray, weights: np.ndarray) -> None:
        """Take other bodies, with the vertices (P, 3) and weights (P, 3) of their surface samples."""
        self.model, self.offsets, self.samples = model, model.vertex_begin, (ids, weights)
        self.masses = stacked([p.mass for p in model.bodies])
        self.reset()

    def reset(self) -> None:
        """Open all hands and forget where they were."""
        n = self.count
        self.set_state(GraspState((None,) * n, (None,) * n, ((),) * n))

    def grasped_bodies(self) -> list[int]:
        """The body that each hand holds, -1 for none."""
        return [-1 if grasp is None else grasp.body for grasp in self.grasps]

    def get_state(self) -> GraspState:
        """The grasps as a value that can be restored."""
        return GraspState(tuple(self.grasps), tuple(self.last), tuple(self.histories))

    def set_state(self, state: GraspState) -> None:
        """Replace all grasps by those of the state."""
        self.grasps, self.last, self.histories = list(state.grasps), list(state.last), list(state.histories)
        self.held.fill(0)
        for h, grasp in enumerate(self.grasps):
            if grasp is not None:
                self._hold(h, grasp)

    def begin_frame(self, hands: list[Hand | None], dt: float, moving: bool) -> None:
        """Take the hands' poses after dt [s]; grasp and release.

        A hand that opens throws a body that no other hand holds, if bodies are `moving`. A missing hand opens and
        throws nothing. One that is None, or has no finite pose, holds still.
        """
        poses = np.zeros((max(self.count, 1), 2, 7), np.float32)
        for h in range(self.count):
            before = self.last[h]
            now = hands[h] if h < len(hands) else None
            if h < len(hands) and (now is None or not has_pose(now)):
                now = before
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
            self.histories[h] = () if self.grasps[h] is None else extended(self.histories[h], dt, now)
        if any(grasp is not None for grasp in self.grasps):
            self._set_poses(poses)

    def _throw(self, body: int, history: PoseHistory) -> None:
        """Give a released body the motion of the hand that held it."""
        part = self.model.bodies[body]
        first, last = (int(o) for o in self.offsets[body : body + 2])
        if (part.inv_mass > 0.0).all():
            x, v = self._motion(last)[:, first:].astype(np.float64)
            change = throw_velocities(history, x, v, part.mass)
            self._add(first, last - first, change.astype(np.float32))

    @ti.kernel
    def _add(self, first: ti.i32, n: ti.i32, dv: Vectors):
        for i in range(n):
            self.state.v[first + i] += ti.Vector([dv[i, c] for c in range(3)])

    def _hold(self, h: int, grasp: Grasp | None) -> None:
        """Make hand h hold this, or nothing, in place of what it held."""
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
    def _set_held(self, h: ti.i32, count: ti.i32, taken: Indices, positions: Vectors, strength: ti.math.vec3):
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
    def pose_at(self, h, fraction):
        """Position [m] and rotation of hand h at a fraction of the frame; rotations blend along the shorter arc."""
        a, b = self.rotation[h, 0], self.rotation[h, 1]
        q = ti.math.mix(a, b if a.dot(b) >= 0.0 else -b, fraction).normalized()
        return ti.math.mix(self.position[h, 0], self.position[h, 1], fraction), q

    @ti.func
    def _target(self, h, i, fraction):
        """Target [m] of vertex i in hand h at a fraction of the frame."""
        p, q = self.pose_at(h, fraction)
        r, u = self.target[h, i], ti.Vector([q[1], q[2], q[3]])
        t = 2.0 * u.cross(r)
        return p + r + q[0] * t + u.cross(t)

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
        """Return the increment d [m] of vertex i after the springs of all hands that hold it."""
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
        """Speed [m/s] that hands may add to vertex i until the next search: to its target, with the greatest force."""
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
        self._sum()
        self.total.to_numpy()
        if self.count:
            self._hold(0, self.grasps[0])
            self._set_poses(np.zeros((self.count, 2, 7), np.float32))  # each frame that needs them sets them
            self._add(0, 0, np.zeros((1, 3), np.float32))


@ti.data_oriented
class RigidGrasp:
    """Grasps of rigid bodies: a spring holds the whole body in the hand's frame.

        a = (kappa (p - x - dx) + gamma (step + x_lo - dx)) / (1 + kappa + gamma)
        kappa = (omega dt)^2 max(1, MIN_SPRING_MASS / M)

    for the centre of mass, which the hand wants at p and to move by `step` in this substep, and alike for the attitude.

    body i32[H]: the rigid body that each hand holds, -1 none;   position vec3 [m] and attitude vec4 in its frame
    force vec3[H] [N]: of the last substep, on the body;   grasps: None without hands
    """

    def __init__(self, state: State, grasps: Grasps | None):
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
        """Let hand h hold body b, at its present pose in the hand's frame at the start of the frame."""
        self.body[h], self.force[h] = b, 0.0
        if b >= 0:
            back = quaternion.conjugate(self.grasps.rotation[h, 0])
            self.position[h] = quaternion.to_matrix(back) @ (m.x[b] - self.grasps.position[h, 0])
            self.attitude[h] = quaternion.multiply(back, m.q[b])

    @ti.func
    def _target(self, h, f):
        """Position [m] and attitude that hand h wants of its body at a fraction of the frame."""
        p, q = self.grasps.pose_at(h, f)
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
