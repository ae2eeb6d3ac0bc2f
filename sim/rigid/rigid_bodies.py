"""Rigid bodies: pose and momentum of each, and how they move in a substep (Mueller, Macklin et al. 2020).

As for vertices (sim/state.py), a substep works on increments, here of the centre of mass and of the attitude:

    predict   dx = dt (v + dt g) + x_lo,   turn = dt omega,   omega = I^-1 L at half the turn (explicit midpoint)
    rows      dx += sum w lambda,   turn += sum I^-1 (r x lambda)              (lambda: impulses times dt [kg m])
    commit    v += dt g + (dx - predicted)/dt,   L += I (turn - predicted turn)/dt,   q <- exp(turn) q

The angular momentum L in the world is the state, not omega, so that a free body keeps it exactly, and the gyroscopic
term is that omega changes with the attitude. Kinematic bodies have w = 0 and follow their drive.
"""

import numpy as np
import taichi as ti

from core import quaternion
from core.errors import BadInput
from core.fields import Upload
from core.rotation import best_fit_rotation, matrices_from_quaternions, quaternions_from_matrices
from sim.body_model import BodyModel
from sim.constraint import Constraint
from sim.contact.constraints import LENGTH, SHARE
from sim.model import MAX_BODIES, Model
from sim.rigid.rigid_body import RigidBody
from sim.rigid.rigid_grasp import RigidGrasp
from sim.rigid.rigid_motion import DRIVEN, FREE, SOFT, follow, move, place, predict, refresh
from sim.state import State

PASS = 1.25e-4  # [s] of a substep for each pass over the rows
MOST_PASSES = 4
LONGEST_SUBSTEP = 5e-4  # [s] with rigid bodies: the rows of a stack converge over substeps
MOTION = ("x", "x_lo", "v", "v_lo", "q", "q_lo", "spin")


@ti.data_oriented
class RigidBodies(Constraint):
    """All rigid bodies, indexed like all bodies; soft ones have kind SOFT and no place here.

    kind i32[B];   center vec3 centre of mass in the body frame;   w f32 = 1/m;   restitution, max_step f32 [m]
    inertia, inverse_inertia mat3 in the body frame;   x, x_lo, v, v_lo vec3;   q, q_lo vec4; spin vec3 = L
    R mat3, world mat3 = R I^-1 R^T, omega vec3: follow from these;   dx, predicted, turn, turned vec3: of the substep
    origin vec3, origin_q vec4, way vec3, swing vec3: where a driven body starts in this frame, how it moves and turns
    share i32[B] and sums i64[B, 1+passes, 6]: of the rows, as in sim/contact/constraints.py;   swept i32: sweeps of substep swept_at
    """

    has_pairs = True
    phase_sizes = (MAX_BODIES,)

    def __init__(self, state: State, *, hands: int, passes: int):
        self.state, self.passes = state, passes
        vec, mat = (lambda n=3: ti.Vector.field(n, ti.f32)), (lambda: ti.Matrix.field(3, 3, ti.f32))
        self.kind, self.share, self.swept, self.swept_at = (ti.field(ti.i32) for _ in range(4))
        self.w, self.restitution, self.max_step = (ti.field(ti.f32) for _ in range(3))
        self.center, self.x, self.x_lo, self.v, self.v_lo, self.spin, self.omega = (vec() for _ in range(7))
        self.dx, self.dx_predicted, self.turn, self.turned, self.origin, self.way, self.swing = (
            vec() for _ in range(7)
        )
        self.q, self.q_lo, self.origin_q = vec(4), vec(4), vec(4)
        self.inertia, self.inverse_inertia, self.R, self.world = (mat() for _ in range(4))
        self.sums = ti.field(ti.i64)
        self.builder = ti.FieldsBuilder()
        for f in vars(self).copy().values():
            if isinstance(f, ti.Field) and f is not self.sums:
                self.builder.dense(ti.i, MAX_BODIES).place(f)
        self.builder.dense(ti.ijk, (MAX_BODIES, 1 + passes, 6)).place(self.sums)
        self.tree = self.builder.finalize()
        self.grip = RigidGrasp(self, hands)
        self._constants = Upload(
            [self.kind, self.center, self.w, self.restitution, self.max_step, self.inertia, self.inverse_inertia]
        )
        self._motion = Upload([getattr(self, name) for name in MOTION])
        self.parts: list[BodyModel] = []
        self.targets: dict[int, tuple[np.ndarray, np.ndarray]] = {}

    def load(self, model: Model) -> None:
        """Take these bodies, of which those that are rigid move here; poses and momenta come by `fit`."""
        self.parts, self.begin = model.bodies, model.vertex_begin
        B = len(self.parts)
        kind, w, restitution, max_step = np.zeros(B), np.zeros(B), np.zeros(B), np.zeros(B)
        center, inertia, inverse = np.zeros((B, 3)), np.zeros((B, 3, 3)), np.zeros((B, 3, 3))
        for b, body in self.rigid():
            m, center[b], inertia[b] = body.inertia
            kind[b], restitution[b] = DRIVEN if body.kinematic else FREE, body.restitution
            max_step[b] = 0.5 * np.ptp(np.asarray(body.vertices, np.float64), axis=0).min()
            if not body.kinematic:
                w[b], inverse[b] = 1 / m, np.linalg.inv(inertia[b])
        self._constants([kind, center, w, restitution, max_step, inertia, inverse])
        self.targets.clear()

    def rigid(self) -> list[tuple[int, RigidBody]]:
        """Index and body of each rigid one."""
        return [(b, p.body) for b, p in enumerate(self.parts) if p.body.rigid]

    def fit(self, x: np.ndarray, v: np.ndarray) -> None:
        """Take the poses and momenta that the positions [m] and velocities [m/s] of all vertices, (V, 3), stand for."""
        values = [np.zeros((len(self.parts), 4 if name[0] == "q" else 3)) for name in MOTION]
        for b, body in self.rigid():
            mine, m = slice(self.begin[b], self.begin[b + 1]), self.parts[b].mass[:, None]
            mass, center, inertia = body.inertia
            at, speed = (m * x[mine]).sum(0) / mass, (m * v[mine]).sum(0) / mass
            r = x[mine] - at
            R = best_fit_rotation((m * r).T @ (np.asarray(body.vertices, np.float64) - center))
            lumped = (m * (r**2)).sum() * np.eye(3) - (m * r).T @ r
            omega = np.linalg.lstsq(lumped, (m * np.cross(r, v[mine] - speed)).sum(0), rcond=1e-9)[0]
            for value, precise in ((values[0], at), (values[2], speed), (values[4], quaternions_from_matrices(R))):
                value[b] = precise
            values[6][b] = 0.0 if body.kinematic else R @ inertia @ R.T @ omega
        for k in (0, 2, 4):
            high = values[k].astype(np.float32)
            values[k], values[k + 1] = high, values[k] - high
        self._motion(values)
        self.targets.clear()
        self.grip.reset()
        self._clear()

    def drive(self, b: int, position, rotation) -> None:
        """Where kinematic body b is at the end of the next frame: x = R(rotation) rest + position."""
        name, body = self.parts[b].body.name, self.parts[b].body
        p, q = np.asarray(position, np.float64), np.asarray(rotation, np.float64)
        if not (body.rigid and body.kinematic):
            raise BadInput(f"{name}: only a kinematic rigid body can be driven")
        if p.shape != (3,) or q.shape != (4,) or not (np.isfinite(p).all() and np.linalg.norm(q) > 1e-6):
            raise BadInput(f"{name}: cannot be driven to position {position}, rotation {rotation}")
        q = q / np.linalg.norm(q)
        self.targets[b] = (p + matrices_from_quaternions(q[None])[0] @ body.inertia[1], q)

    def begin_frame(self, hands: list, dt: float, substeps: int) -> None:
        """Start the drives of this frame; a body that is not driven (any more) stands still."""
        table = np.zeros((MAX_BODIES, 8), np.float32)
        for b, (position, q) in self.targets.items():
            table[b] = (1.0, *position, *q)
        self.targets.clear()
        if self.grip.hands is not None:
            self.grip.update()
        self._begin(table)

    def warm_up(self) -> None:
        self.grip.warm_up()

    def reset(self) -> None:
        """Let all go."""
        self.grip.reset()

    @ti.kernel
    def _clear(self):
        for b in range(MAX_BODIES):
            self.share[b], self.swept[b], self.swept_at[b] = 0, 0, -2
            for j, c in ti.ndrange(1 + self.passes, 6):
                self.sums[b, j, c] = 0
            if self.kind[b] != SOFT:
                refresh(self, b)

    @ti.kernel
    def _begin(self, table: ti.types.ndarray(ti.f32, 2)):
        s = self.state
        for b in range(MAX_BODIES):
            if self.kind[b] != SOFT:
                self.origin[b], self.origin_q[b] = self.x[b] + self.x_lo[b], self.q[b]
                self.way[b], self.swing[b] = 0.0, 0.0
                if self.kind[b] == DRIVEN:
                    if table[b, 0] != 0.0:
                        self.way[b] = ti.Vector([table[b, 1], table[b, 2], table[b, 3]]) - self.origin[b]
                        target = ti.Vector([table[b, 4], table[b, 5], table[b, 6], table[b, 7]])
                        self.swing[b] = quaternion.rotation_vector_between(target, self.q[b])
                    whole = s.dt[None] * ti.cast(s.substeps[None], ti.f32)
                    self.v[b], self.omega[b] = self.way[b] / whole, self.swing[b] / whole
                    self.v_lo[b], self.x_lo[b] = 0.0, 0.0
                predict(self, b)
                self.swept_at[b] = -2
        for i in range(s.V):
            if i < s.vertex_count[None] and self.kind[s.body_of_vertex[i]] != SOFT:
                place(self, i)

    @ti.func
    def moved(self, b, upto):
        """Increments of centre and attitude in this substep, with what the first `upto` passes of the rows pushed."""
        d, t = self.dx[b] - self.x_lo[b], self.turn[b]
        for j in range(upto):
            for c in ti.static(range(3)):
                d[c] += ti.cast(self.sums[b, j, c], ti.f32) * (1.0 / LENGTH)
                t[c] += ti.cast(self.sums[b, j, 3 + c], ti.f32) * (1.0 / LENGTH)
        return d, t

    @ti.func
    def push(self, b, impulse, angular, j):
        """Add an impulse [kg m] and its moment about the centre [kg m^2] to the sums of pass j."""
        if self.kind[b] == FREE:
            d, t = self.w[b] * LENGTH * impulse, LENGTH * (self.world[b] @ angular)
            for c in ti.static(range(3)):
                ti.atomic_add(self.sums[b, j, c], ti.cast(d[c], ti.i64))
                ti.atomic_add(self.sums[b, j, 3 + c], ti.cast(t[c], ti.i64))

    @ti.func
    def claim(self, b, amount):
        """Announce that a row (or a group of rows) uses a share of the body's mass."""
        ti.atomic_add(self.share[b], ti.cast(amount * SHARE, ti.i32))

    @ti.func
    def claims(self, b):
        """All shares of body b, the B of sim/contact/constraints.py."""
        return ti.cast(self.share[b], ti.f32) * (1.0 / SHARE)

    @ti.func
    def inverse(self, b, arm, n):
        """1/m + (r x n) I^-1 (r x n): what a push along n at r from the centre meets, inverse [1/kg]."""
        a = arm.cross(n)
        return self.w[b] + a.dot(self.world[b] @ a)

    @ti.func
    def solve_phase(self, integrator: ti.template(), phase: ti.template(), b, first: ti.template()):
        """Add what all rows pushed; after the last sweep, move."""
        if self.kind[b] != SOFT:
            if self.swept_at[b] != self.state.substep_index[None]:
                self.swept_at[b], self.swept[b] = self.state.substep_index[None], 0
            self.swept[b] += 1
            d, t = self.moved(b, 1 + self.passes)
            d += self.x_lo[b]
            self.share[b] = 0
            for j in range(1 + self.passes):
                for c in ti.static(range(6)):
                    self.sums[b, j, c] = 0
            if self.swept[b] < integrator.iterations:
                if ti.static(not integrator.warm_started):  # else the next sweep pushes all anew
                    self.dx[b], self.turn[b] = d, t
            else:
                if self.kind[b] == FREE:
                    move(self, b, d, t)
                else:
                    follow(self, b)
                predict(self, b)

    @ti.func
    def any_active(self):
        """Return True: there is always something to move."""
        return True

    @ti.func
    def phase_count(self, phase: ti.template()):
        return MAX_BODIES

    @ti.func
    def place_vertex(self, i):
        """Put vertex i of a rigid body where the committed pose has it."""
        place(self, i)

    def destroy(self) -> None:
        self.tree.destroy()
        self.grip.destroy()
