"""Rigid bodies: pose and momentum of each, their motion in a substep (Mueller, Macklin et al. 2020), and their shapes.

As for vertices (sim/state.py), a substep works on increments, here of the centre of mass and of the attitude:

    predict      dx = dt (v + dt g) + x_lo,   rotation = dt omega,   omega = I^-1 L at half the rotation (midpoint rule)
    constraints  dx += sum w lambda,   rotation += sum I^-1 (r x lambda)           (lambda: impulses times dt [kg m])
    commit       v += dt g + (dx - predicted)/dt,   L += I (rotation - predicted)/dt,   q <- exp(rotation) q

The angular momentum L in the world is the state, not omega, so that a free body keeps it exactly, and the gyroscopic
term is that omega changes with the attitude. Kinematic bodies have w = 0 and follow their targets.
"""

import math

import numpy as np
import taichi as ti
from taichi.math import vec3

from core import quaternion
from core.errors import BadInput
from core.fields import FieldGroup, Upload, two_sum
from core.rotation import best_fit_rotation, matrices_from_quaternions, quaternions_from_matrices
from sim.bodies import RigidBody
from sim.contact.constraints import STEPS_PER_METER
from sim.contact.contact_samples import ContactSamples, points_of, root_spacing
from sim.contact.response import CONTACT_SLOP
from sim.contact.static_shapes import UNKNOWN_DISTANCE, DistanceGrids, box_distance
from sim.elastic.substep import Constraint
from sim.model import MAX_BODIES, BodyModel, Model, RestShape
from sim.state import State

SOFT, FREE, DRIVEN = range(3)  # kinds of bodies
MAX_ROTATION = 0.5  # [rad] a substep; beyond, the attitude's increments, of first order, mean nothing
SUBSTEP_PER_PASS = 1.6e-4  # [s] of a substep for each pass over the constraints; with 2e-4 a stack rebounds too low
MAX_RIGID_SUBSTEP = 5e-4  # [s] for each sweep, with rigid bodies: the contacts of a stack converge over sweeps


@ti.data_oriented
class RigidBodies(Constraint):
    """All rigid bodies, indexed like all bodies; soft ones have kind SOFT and no pose here.

    kind i32[B];   center vec3 centre of mass in the body frame [m];   inv_mass f32 [1/kg];   restitution f32
    max_step f32 [m] in a substep;   inertia, inverse_inertia mat3 in the body frame [kg m^2]
    x, x_lo, v, v_lo vec3;   q, q_lo vec4;   angular_momentum vec3 [kg m^2/s]
    R mat3, inverse_inertia_world mat3 = R I^-1 R^T, angular_velocity vec3 [rad/s]: follow from these
    dx [m], rotation [rad], dx_predicted, rotation_predicted vec3: increments of the substep
    frame_x vec3, frame_q vec4, frame_displacement [m], frame_rotation [rad] vec3: where a driven body starts in this
    frame, how it moves and turns;   target vec8: 1 if it has one, at the end of the frame, and its position [m] and q
    split_count i32[B]: constraints, and groups of them, that share its mass;   corrections i64[B, 1+passes, 6]: of
    these, as in sim/contact/constraints.py
    sweep i32[B]: sweeps so far of substep sweep_substep i32[B]
    """

    has_pairs = True
    phase_sizes = (MAX_BODIES,)

    def __init__(self, state: State, grasp, *, passes: int):
        """Allocate for MAX_BODIES; grasp: the springs of the hands (RigidGrasp); passes: over the constraints."""
        self.state, self.grasp, self.passes = state, grasp, passes
        group, B = FieldGroup(), MAX_BODIES
        self.kind, self.split_count, self.sweep, self.sweep_substep = (group.scalar(B, dtype=ti.i32) for _ in range(4))
        self.inv_mass, self.restitution, self.max_step = (group.scalar(B) for _ in range(3))
        self.center, self.x, self.x_lo, self.v, self.v_lo = (group.vector(B) for _ in range(5))
        self.angular_momentum, self.angular_velocity = group.vector(B), group.vector(B)
        self.dx, self.dx_predicted, self.rotation, self.rotation_predicted = (group.vector(B) for _ in range(4))
        self.frame_x, self.frame_displacement, self.frame_rotation = (group.vector(B) for _ in range(3))
        self.q, self.q_lo, self.frame_q = (group.vector(B, n=4) for _ in range(3))
        self.target = group.vector(B, n=8)
        self.inertia, self.inverse_inertia, self.R, self.inverse_inertia_world = (group.matrix(B) for _ in range(4))
        self.corrections = group.scalar(B, 1 + passes, 6, dtype=ti.i64)
        self._group = group
        group.build()
        constants = [self.kind, self.center, self.inv_mass, self.restitution, self.max_step]
        self._constants = Upload([*constants, self.inertia, self.inverse_inertia])
        self._motion = Upload([self.x, self.x_lo, self.v, self.v_lo, self.q, self.q_lo, self.angular_momentum])
        self._write_targets = Upload([self.target])
        self.bodies: list[BodyModel] = []
        self.targets: dict[int, tuple[np.ndarray, np.ndarray]] = {}

    def load(self, model: Model) -> None:
        """Take the rigid ones of these bodies; `set_motion` gives their poses and momenta."""
        self.bodies, self.begin = model.bodies, model.vertex_begin
        B = len(self.bodies)
        kind, inv_mass, restitution, max_step = (np.zeros(B) for _ in range(4))
        center, inertia, inverse_inertia = np.zeros((B, 3)), np.zeros((B, 3, 3)), np.zeros((B, 3, 3))
        for b, body in self._rigid():
            m, center[b], inertia[b] = body.inertia
            kind[b], restitution[b] = DRIVEN if body.kinematic else FREE, body.restitution
            max_step[b] = 0.5 * np.ptp(np.asarray(body.vertices, np.float64), axis=0).min()
            if not body.kinematic:
                inv_mass[b], inverse_inertia[b] = 1 / m, np.linalg.inv(inertia[b])
        self._constants([kind, center, inv_mass, restitution, max_step, inertia, inverse_inertia])
        self.targets.clear()

    def _rigid(self) -> list[tuple[int, RigidBody]]:
        """Index and description of each rigid body."""
        return [(b, p.body) for b, p in enumerate(self.bodies) if p.body.rigid]

    def set_motion(self, x: np.ndarray, v: np.ndarray) -> None:
        """Set poses and momenta to those of the positions [m] and velocities [m/s] of all vertices, (V, 3)."""
        B = len(self.bodies)
        at, speed, momentum, q = np.zeros((B, 3)), np.zeros((B, 3)), np.zeros((B, 3)), np.zeros((B, 4))
        for b, body in self._rigid():
            mine, m = slice(self.begin[b], self.begin[b + 1]), self.bodies[b].mass[:, None]
            mass, center, inertia = body.inertia
            at[b], speed[b] = (m * x[mine]).sum(0) / mass, (m * v[mine]).sum(0) / mass
            r = x[mine] - at[b]
            R = best_fit_rotation((m * r).T @ (np.asarray(body.vertices, np.float64) - center))
            q[b] = quaternions_from_matrices(R)
            lumped = (m * (r**2)).sum() * np.eye(3) - (m * r).T @ r
            omega = np.linalg.lstsq(lumped, (m * np.cross(r, v[mine] - speed[b])).sum(0), rcond=1e-9)[0]
            momentum[b] = 0.0 if body.kinematic else R @ inertia @ R.T @ omega
        split = [(a.astype(np.float32), a - a.astype(np.float32)) for a in (at, speed, q)]
        self._motion([*(part for pair in split for part in pair), momentum])
        self.targets.clear()
        self.grasp.reset()
        self._clear()

    def drive(self, b: int, position, rotation) -> None:
        """Set the pose of kinematic body b at the end of the next frame: x = R(rotation) rest + position [m]."""
        name, body = self.bodies[b].body.name, self.bodies[b].body
        p, q = np.asarray(position, np.float64), np.asarray(rotation, np.float64)
        if not (body.rigid and body.kinematic):
            raise BadInput(f"{name}: only a kinematic rigid body can be driven")
        if p.shape != (3,) or q.shape != (4,) or not (np.isfinite(p).all() and np.linalg.norm(q) > 1e-6):
            raise BadInput(f"{name}: cannot be driven to position {position}, rotation {rotation}")
        q = q / np.linalg.norm(q)
        self.targets[b] = (p + matrices_from_quaternions(q) @ body.inertia[1], q)

    def begin_frame(self) -> None:
        """Start towards the targets of this frame; driven bodies without a target stand still."""
        driven = len(self.targets) > 0
        if driven:  # else without an array from the host, for which the device would be waited for
            table = np.zeros((MAX_BODIES, 8), np.float32)
            for b, (position, q) in self.targets.items():
                table[b] = (1.0, *position, *q)
            self._write_targets([table])
            self.targets.clear()
        self.grasp.update(self)
        self._begin(driven)

    def warm_up(self) -> None:
        """See Solver.warm_up."""
        self._write_targets([np.zeros((MAX_BODIES, 8))])
        self.grasp.warm_up(self)

    def reset(self) -> None:
        """Open all hands."""
        self.grasp.reset()

    @ti.kernel
    def _clear(self):
        for b in range(MAX_BODIES):
            self.split_count[b], self.sweep[b], self.sweep_substep[b] = 0, 0, -2
            for j, c in ti.ndrange(1 + self.passes, 6):
                self.corrections[b, j, c] = 0
            if self.kind[b] != SOFT:
                self.update_rotation(b)

    @ti.kernel
    def _begin(self, driven: ti.i32):
        s = self.state
        for b in range(MAX_BODIES):
            if self.kind[b] != SOFT:
                self.frame_x[b], self.frame_q[b] = self.x[b] + self.x_lo[b], self.q[b]
                self.frame_displacement[b], self.frame_rotation[b] = 0.0, 0.0
                if self.kind[b] == DRIVEN:
                    target = self.target[b]
                    if driven and target[0] != 0.0:
                        self.frame_displacement[b] = target[1:4] - self.frame_x[b]
                        self.frame_rotation[b] = quaternion.rotation_vector_between(target[4:8], self.q[b])
                    duration = s.dt[None] * ti.cast(s.substeps[None], ti.f32)
                    self.v[b] = self.frame_displacement[b] / duration
                    self.angular_velocity[b] = self.frame_rotation[b] / duration
                    self.v_lo[b], self.x_lo[b] = 0.0, 0.0
                self.predict_body(b)
                self.sweep_substep[b] = -2
        for i in range(s.V):
            if s.awake_vertex(i) and self.kind[s.body_of_vertex[i]] != SOFT:
                self.place_vertex(i)

    @ti.func
    def increments(self, b, passed):
        """Increments of centre [m] and attitude [rad] so far, with the corrections of the first `passed` passes."""
        d, rotation = self.dx[b] - self.x_lo[b], self.rotation[b]
        for j in range(passed):
            for c in ti.static(range(3)):
                d[c] += ti.cast(self.corrections[b, j, c], ti.f32) * (1.0 / STEPS_PER_METER)
                rotation[c] += ti.cast(self.corrections[b, j, 3 + c], ti.f32) * (1.0 / STEPS_PER_METER)
        return d, rotation

    @ti.func
    def add_impulse(self, b, impulse, angular, j):
        """Add an impulse [kg m] and its moment about the centre [kg m^2] to the corrections of pass j."""
        if self.kind[b] == FREE:
            d = self.inv_mass[b] * STEPS_PER_METER * impulse
            rotation = STEPS_PER_METER * (self.inverse_inertia_world[b] @ angular)
            for c in ti.static(range(3)):
                ti.atomic_add(self.corrections[b, j, c], ti.cast(d[c], ti.i64))
                ti.atomic_add(self.corrections[b, j, 3 + c], ti.cast(rotation[c], ti.i64))

    @ti.func
    def inverse_effective_mass(self, b, arm, n):
        """1/m + (r x n) I^-1 (r x n) [1/kg] along n at the lever arm r [m]."""
        a = arm.cross(n)
        return self.inv_mass[b] + a.dot(self.inverse_inertia_world[b] @ a)

    @ti.func
    def solve_phase(self, integrator: ti.template(), later: ti.template(), phase, b):
        """Add the corrections of all constraints; after the last sweep, move."""
        if self.kind[b] != SOFT and not self.state.asleep[b]:
            if self.sweep_substep[b] != self.state.substep_index[None]:
                self.sweep_substep[b], self.sweep[b] = self.state.substep_index[None], 0
            self.sweep[b] += 1
            d, rotation = self.increments(b, 1 + self.passes)
            d += self.x_lo[b]
            self.split_count[b] = 0
            for j in range(1 + self.passes):
                for c in ti.static(range(6)):
                    self.corrections[b, j, c] = 0
            if self.sweep[b] == integrator.iterations:  # until then, the next sweep applies all impulses again
                if self.kind[b] == FREE:
                    self.commit_body(b, d, rotation)
                else:
                    self.follow_target(b)
                self.predict_body(b)

    @ti.func
    def any_active(self):
        """Return True: there is always something to move."""
        return True

    @ti.func
    def phase_count(self, phase: ti.template()):
        return MAX_BODIES

    @ti.func
    def update_rotation(self, b):
        """Rotation matrix, world inertia and angular velocity, from attitude and angular momentum."""
        R = quaternion.to_matrix(self.q[b].normalized())
        self.R[b] = R
        self.inverse_inertia_world[b] = R @ self.inverse_inertia[b] @ R.transpose()
        if self.kind[b] == FREE:
            self.angular_velocity[b] = self.inverse_inertia_world[b] @ self.angular_momentum[b]

    @ti.func
    def predict_body(self, b):
        """Predict the increments of the next substep: free motion, and the springs of the hands."""
        s = self.state
        dt, n = s.dt[None], ti.cast(s.substeps[None], ti.f32)
        if self.kind[b] == FREE:
            d = dt * (self.v[b] + (self.v_lo[b] + dt * s.gravity[None])) + self.x_lo[b]
            half = quaternion.rotation_increment(0.5 * dt * self.angular_velocity[b], self.q[b])
            R = quaternion.to_matrix((self.q[b] + half).normalized())
            rotation = dt * (R @ (self.inverse_inertia[b] @ (R.transpose() @ self.angular_momentum[b])))
            self.dx_predicted[b], self.rotation_predicted[b] = d, rotation
            self.dx[b], self.rotation[b] = d, rotation
            self.grasp.apply_springs(self, b)
        else:
            self.dx[b], self.rotation[b] = self.frame_displacement[b] / n + self.x_lo[b], self.frame_rotation[b] / n

    @ti.func
    def place_vertex(self, i):
        """Put vertex i where the pose of its rigid body has it."""
        s = self.state
        b = s.body_of_vertex[i]
        r = self.R[b] @ (s.rest[i] - self.center[b])
        s.x[i], s.v[i] = self.x[b] + (r + self.x_lo[b]), self.v[b] + self.angular_velocity[b].cross(r)
        s.x_lo[i], s.v_lo[i], s.dx[i] = 0.0, 0.0, 0.0

    @ti.func
    def commit_body(self, b, d, rotation):
        """Commit the increments of centre d [m] and attitude [rad] of a free body."""
        s = self.state
        dt = s.dt[None]
        change = dt * s.gravity[None] + (d - self.dx_predicted[b]) / dt
        v, v_lo = two_sum(self.v[b], self.v_lo[b] + change)
        speed, limit = v.norm(), self.max_step[b] / dt
        if speed > limit:
            v, v_lo = v * (limit / speed), 0.0 * v
        self.v[b], self.v_lo[b] = v, v_lo
        self.x[b], self.x_lo[b] = two_sum(self.x[b], dt * (v + v_lo) + self.x_lo[b])
        R = self.R[b]
        gain = (rotation - self.rotation_predicted[b]) / dt
        self.angular_momentum[b] += R @ (self.inertia[b] @ (R.transpose() @ gain))
        q = ti.cast(self.q[b], ti.f64)
        excess = ti.cast(q.norm_sqr() - 1.0, ti.f32)
        change_q = quaternion.rotation_increment(rotation, self.q[b]) - 0.5 * excess * self.q[b]
        self.q[b], self.q_lo[b] = two_sum(self.q[b], change_q + self.q_lo[b])
        self.update_rotation(b)
        angle = self.angular_velocity[b].norm() * dt
        if angle > MAX_ROTATION:
            self.angular_momentum[b] *= MAX_ROTATION / angle
            self.angular_velocity[b] *= MAX_ROTATION / angle

    @ti.func
    def follow_target(self, b):
        """Put a driven body where it is at the end of this substep."""
        s = self.state
        f = ti.cast(s.substep_index[None] + 1, ti.f32) / ti.cast(s.substeps[None], ti.f32)
        self.x[b], self.x_lo[b] = two_sum(self.frame_x[b], f * self.frame_displacement[b])
        turn = quaternion.rotation_increment(f * self.frame_rotation[b], self.frame_q[b])
        self.q[b] = (self.frame_q[b] + turn).normalized()
        self.update_rotation(b)


def passes_for(substep: float) -> int:
    """Passes over the constraints that a substep [s] needs."""
    return math.ceil(substep / SUBSTEP_PER_PASS - 1e-6)


@ti.data_oriented
class RigidShapes:
    """Collision shapes of rigid bodies: exact boxes, or distance grids, in the body's frame.

    boxed i32[B], half vec3[B] [m];   outward vec3[P]: surface normal of a rigid body at a sample, in its frame; on a
    corner or an edge the mean of the faces that meet there; 0 for samples of soft bodies
    """

    def __init__(self, rigid_bodies: RigidBodies, samples: ContactSamples, grids: DistanceGrids):
        self.rigid_bodies, self.samples, self.grids = rigid_bodies, samples, grids
        group = self._group = FieldGroup()
        self.boxed, self.half = group.scalar(MAX_BODIES, dtype=ti.i32), group.vector(MAX_BODIES)
        self.outward = group.vector(samples.capacity)
        group.build()
        self._upload = Upload([self.boxed, self.half, self.outward])

    def load(self, model: Model) -> None:
        """Take the shapes of these bodies."""
        shapes = model.shapes
        half = [s.vertices.max(0) if s.boxed else np.zeros(3) for s in shapes]
        outward = [s.root.once(outward_of, root_spacing(s, self.samples.spacing)) for s in shapes]
        self._upload([[s.boxed for s in shapes], half, np.concatenate([np.zeros((0, 3)), *outward])])

    @ti.func
    def normal(self, p):
        """Surface normal at sample p in the world; 0 on soft bodies."""
        n = vec3(0.0)
        b = self.samples.body[p]
        if self.rigid_bodies.kind[b] != 0:
            n = self.rigid_bodies.R[b] @ self.outward[p]
        return n

    @ti.func
    def distance(self, b, x, facing):
        """Signed distance [m] from x to body b and outward unit normal; UNKNOWN_DISTANCE, 0 where a grid has none."""
        m = self.rigid_bodies
        R = m.R[b]
        q = R.transpose() @ ((x - m.x[b]) - m.x_lo[b]) + m.center[b]
        phi, normal = UNKNOWN_DISTANCE, vec3(0.0)
        if self.boxed[b]:
            phi, normal = bearing_distance(q, self.half[b], R.transpose() @ facing)
        else:
            value, gradient = self.grids.sample(b, q)
            length = gradient.norm()
            if length > 0.0:
                phi, normal = value, gradient / length
        return phi, R @ normal


@ti.func
def bearing_distance(p, half, facing):
    """Distance and normal of the box |p| <= half for a point of a surface that faces `facing` (0: unknown).

    Inside the box, and up to CONTACT_SLOP beside it, the nearest of those faces counts that the surface can rest on.
    Without this, the corners of a box that stands on an equal one would be pushed off sideways.
    """
    phi, normal = box_distance(p, half)
    q = abs(p) - half
    if q.max() < CONTACT_SLOP:
        best = -UNKNOWN_DISTANCE
        for k in ti.static(range(3)):
            side = 1.0 if p[k] >= 0.0 else -1.0
            if side * facing[k] < 0.0 and q[k] > best:
                best = q[k]
                normal = vec3(0.0)
                normal[k] = side
        phi = best if best > -UNKNOWN_DISTANCE else phi
    return phi, normal


def outward_of(shape: RestShape, spacing: float) -> np.ndarray:
    """Normalised sum of the distinct face normals that meet at each sample of a rigid shape, (P, 3)."""
    points = shape.once(points_of, spacing)
    result = np.zeros((len(points.ids), 3))
    if not shape.rigid:
        return result
    x, surface = shape.vertices, shape.surface
    normals = np.cross(x[surface[:, 1]] - x[surface[:, 0]], x[surface[:, 2]] - x[surface[:, 0]])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    around: dict[int, set[int]] = {}
    for t, triangle in enumerate(surface.tolist()):
        for i in triangle:
            around.setdefault(i, set()).add(t)
    for p, (ids, weights) in enumerate(zip(points.ids.tolist(), points.weights, strict=True)):
        meeting = sorted(set.intersection(*(around[i] for i, w in zip(ids, weights, strict=True) if w > 0)))
        different = np.unique(np.round(normals[meeting], 6), axis=0)
        total = different.sum(0)
        result[p] = total / max(np.linalg.norm(total), 1e-9)
    return result
