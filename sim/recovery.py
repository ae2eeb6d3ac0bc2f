"""Bodies that were inverted are moved back to their rest shape, and non-finite ones restored.

Untangling is shape matching (Mueller et al. 2005). A body that is squeezed through itself can be left in a kink: all
tets upright again, but wound around one another, in a true minimum of the energy that no force leaves. So a body that
had inverted tets, is slow again and still has crushed tets is softened for DURATION, and its vertices are moved to its
rest shape where that fits best:

    v_i += k (v_cm + omega x r_i + (x_cm + R (X_i - X_cm) - x_i) / TIME_CONSTANT - v_i),
    R the rotation that maximises tr(R^T sum m x (X - X_cm)^T)

It does not collide with itself meanwhile, because contact would hold the vertices that have passed through the body
where they are. It stiffens again gradually while it is moved: a soft body sags under its weight, and full stiffness at
once would turn that into speed: 9 m/s from the 1.6 mm by which a body of 0.1 m and 1e8 Pa sags.
"""

import numpy as np
import taichi as ti

from core.fields import FieldGroup, Upload
from core.quaternion import polar_quaternion
from sim.elastic.damping import Damping
from sim.model import MAX_BODIES, Model
from sim.reductions import CENTER, SHAPE, VELOCITY, Reductions, finite
from sim.state import State
from sim.time_step import lame

MAX_GROWTH = 10.0  # times the distance at rest: positions farther apart are not worth going back to
RECOVERED = 2  # bit of state.inverted, beside the 1 of an inverted tet
OVERSTRETCHED, NON_FINITE = 1, 2  # conditions of a body


@ti.data_oriented
class NonFiniteRecovery:
    """Last line of defence: a body with non-finite state gets its last good positions back, at rest.

    No cause is known. If it happens nevertheless, the other bodies are not affected: at the end of the frame the body
    is restored, and is then untangled. Contacts are forgotten, because they hold its infinities. The solver's stats
    count such bodies as `recovered`.

    good vec3[V]: last good positions [m];   condition i32[B], 0 if good;   count: bodies restored so far
    """

    def __init__(self, state: State):
        self.state = state
        g = self._group = FieldGroup()
        self.good = g.vector(state.V)
        self.condition, self.count = g.scalar(MAX_BODIES, dtype=ti.i32), g.scalar(dtype=ti.i32)
        g.build()

    def begin(self) -> None:
        """Take all finite positions as good: after bodies were loaded or moved."""
        self._run(1)

    def recover(self) -> None:
        """Restore non-finite bodies, and keep the positions of good ones: after a frame."""
        self._run(0)

    @ti.kernel
    def _run(self, begin: ti.i32):
        s = self.state
        ti.loop_config(serialize=s.serial)
        for b in range(MAX_BODIES):
            self.condition[b] = 0
        ti.loop_config(serialize=s.serial)
        for i in range(s.V):
            if i < s.vertex_count[None]:
                b = s.body_of_vertex[i]
                j = s.vertex_begin[b]
                for k in ti.static(range(3)):
                    low = finite(s.x_lo[i][k]) and finite(s.v_lo[i][k])
                    if not (finite(s.x[i][k]) and finite(s.v[i][k]) and low):
                        ti.atomic_max(self.condition[b], NON_FINITE)
                far = MAX_GROWTH**2 * ((s.rest[i] - s.rest[j]).norm_sqr() + s.max_step[b] ** 2)
                if begin == 0 and (s.x[i] - s.x[j]).norm_sqr() > far:
                    ti.atomic_max(self.condition[b], OVERSTRETCHED)
        ti.loop_config(serialize=s.serial)
        for i in range(s.V):
            if i < s.vertex_count[None]:
                b, zero = s.body_of_vertex[i], ti.Vector([0.0, 0.0, 0.0])
                if self.condition[b] == NON_FINITE:
                    s.x[i], s.x_lo[i], s.v[i], s.v_lo[i] = self.good[i], zero, zero, zero
                    if i == s.vertex_begin[b]:
                        s.inverted[b] |= RECOVERED
                        ti.atomic_add(self.count[None], 1)
                elif self.condition[b] == 0:
                    self.good[i] = s.x[i]


DURATION = 0.6  # [s] from the last inverted tet on
STIFFENING = 0.2  # [s] of them, at the end: each frame of 60 Hz three times as stiff, for 1e8 Pa
TIME_CONSTANT = 0.04  # [s] in which the remaining distance shrinks to a third
MAX_SPEED = 2.0  # [m/s] towards the rest shape: a hand may drop a body that it drew out by metres. 0.4 leaves kinks
# [Pa] meanwhile: gravity and kinks must not hold out against 1/TIME_CONSTANT^2. A body so soft cannot resist its own
# momentum, so it must be slow, rho v^2 / 2 at most as large: a ring made soft while it hit a peg let the peg through.
SOFT_YOUNG = 200.0
KINKED_VOLUME = 0.9  # of a tet, to its rest volume: of random starts that end in kinks, the least has 0.5 to 0.81


@ti.data_oriented
class Untangling:
    """`begin_frame` finds the tangled bodies, `run` moves them; both cost nothing where there is none.

    quaternion vec4[B]: R;   farthest f32[B]: distance to the rest shape [m]
    slow i32[B]: slow enough to be made soft;   kinked i32[B]: a tet is crushed or inverted
    """

    def __init__(self, state: State, reductions: Reductions, damping: Damping):
        self.state, self.reductions, self.damping = state, reductions, damping
        g = self._group = FieldGroup()
        self.quaternion = g.vector(MAX_BODIES, n=4)
        self.farthest = g.scalar(MAX_BODIES)
        self.slow = g.scalar(MAX_BODIES, dtype=ti.i32)
        self.kinked = g.scalar(MAX_BODIES, dtype=ti.i32)
        g.build()
        self._upload = Upload([state.untangling, state.inverted, state.mu, state.lam])
        self.bodies = ()
        self._status = np.zeros((2, 0))  # seconds left; whether tets were inverted since it was last seen slow

    @property
    def active(self) -> np.ndarray:
        """Bodies that are being untangled, (B,) bool."""
        return self._status[0] > 0.0

    @property
    def occupied(self) -> set[int]:
        """Bodies that are being untangled, or may have to be."""
        return set(np.flatnonzero(self._status.any(axis=0) | (self._inverted() != 0)).tolist())

    def load(self, model: Model) -> None:
        """Take other bodies; the untangling of those that stay continues."""
        known = dict(zip(map(id, self.bodies), self.snapshot().T, strict=True))
        self.bodies = model.bodies
        self.restore(np.array([known.get(id(p), np.zeros(3)) for p in self.bodies]).reshape(-1, 3).T)

    def snapshot(self) -> np.ndarray:
        """Return what `restore` needs to go on from here, (3, B)."""
        return np.vstack([self._status, self._inverted()])

    def restore(self, snapshot: np.ndarray | None) -> None:
        """Go on from a snapshot of these bodies; None: no body is tangled."""
        values = np.zeros((3, len(self.bodies))) if snapshot is None else np.array(snapshot)
        self._status = values[:2]
        self.damping.omega.fill(0.0)  # of another time; bodies may be others now
        self._set_stiffness(values[2])

    def begin_frame(self, held: set[int], driven: set[int], dt: float) -> bool:
        """Find the tangled bodies, before a frame of dt [s]; return whether any was recovered.

        `held` by hands, `driven` by prescribed vertices: such a body can only go where these hold it.
        """
        flags = self._inverted()
        if not flags.any() and not self._status.any():
            return False
        index = np.arange(len(self.bodies))
        recovered = flags & RECOVERED != 0
        inverted = (flags & ~RECOVERED != 0) & ~np.isin(index, list(driven))
        held_now = np.isin(index, list(held))
        left, suspect = self._status
        suspect = (suspect > 0) | inverted
        slow, kinked = self._examine() if (suspect & ~held_now).any() else np.zeros((2, len(index)), bool)
        begin = recovered | (suspect & slow & kinked)
        left = np.where(held_now, 0.0, np.where(begin, DURATION, np.maximum(left - dt, 0.0)))
        self._status = np.stack([left, suspect & (held_now | ~slow)])
        self._set_stiffness(np.zeros(len(self.bodies)))
        return bool(recovered.any())

    def run(self, t: float) -> None:
        """Move the bodies for t [s], before the damping."""
        if self.active.any():
            self.reductions.sum_up()
            self.damping.run(0.0)  # omega of now: the last one would spin a body that has grown since
            self._move(t)

    def warm_up(self) -> None:
        """Compile, see Solver.warm_up."""
        self._move(0.0)
        self._examine()

    def _examine(self) -> np.ndarray:
        """The bodies that are slow now, and those that have a kinked tet, (2, B) bool."""
        self._find_slow_and_kinked()
        return np.array([f.to_numpy()[: len(self.bodies)] != 0 for f in (self.slow, self.kinked)])

    @ti.kernel
    def _find_slow_and_kinked(self):
        s = self.state
        for b in range(MAX_BODIES):
            self.slow[b], self.kinked[b] = 1, 0
        for i in range(s.V):
            if i < s.vertex_count[None]:
                b = s.body_of_vertex[i]
                if 0.5 * s.density[b] * s.v[i].norm_sqr() > SOFT_YOUNG:
                    self.slow[b] = 0
        for t in range(s.T):
            if t < s.tet_count[None]:
                a = s.tets[t]
                x, X = s.x[a[0]], s.rest[a[0]]
                volume = (s.x[a[1]] - x).dot((s.x[a[2]] - x).cross(s.x[a[3]] - x))
                rest = (s.rest[a[1]] - X).dot((s.rest[a[2]] - X).cross(s.rest[a[3]] - X))
                if volume < KINKED_VOLUME * rest:
                    self.kinked[s.body_of_tet[t]] = 1

    def _inverted(self) -> np.ndarray:
        """State.inverted after the last frame, (B,)."""
        return self.reductions.flags()[0, : len(self.bodies)].astype(np.int32)

    def _set_stiffness(self, inverted: np.ndarray) -> None:
        """Set state.untangling, state.inverted and the Lame constants of the bodies as they are now."""
        materials = [p.material for p in self.bodies]
        softest = np.array([min(1.0, SOFT_YOUNG / m.young) for m in materials])
        scale = np.where(self.active, softest ** np.clip(self._status[0] / STIFFENING, 0.0, 1.0), 1.0)
        self.reductions.forget()
        constants = np.array([lame(m) for m in materials]).reshape(-1, 2) * scale[:, None]
        self._upload([self.active, inverted, constants[:, 0], constants[:, 1]])

    @ti.kernel
    def _move(self, t: ti.f32):
        s = self.state
        total = ti.static(self.reductions.total)
        for b in range(MAX_BODIES):
            if b < s.body_count[None] and s.untangling[b]:
                A = ti.Matrix([[total[b, SHAPE + 3 * k + l] for l in range(3)] for k in range(3)])
                self.quaternion[b] = polar_quaternion(A)
                self.farthest[b] = 0.0
        for i in range(s.V):
            if i < s.vertex_count[None]:
                b = s.body_of_vertex[i]
                if s.untangling[b] and s.inv_mass[i] > 0.0:
                    ti.atomic_max(self.farthest[b], self._to_rest_shape(i, b).norm())
        for i in range(s.V):
            if i < s.vertex_count[None]:
                b = s.body_of_vertex[i]
                if s.untangling[b] and s.inv_mass[i] > 0.0:
                    center = ti.Vector([total[b, CENTER + k] for k in range(3)])
                    goal = ti.Vector([total[b, VELOCITY + k] for k in range(3)])
                    goal += self.damping.omega[b].cross(s.x[i] - center)
                    # one time for the whole body: displacements that were cut one by one would push it aside
                    goal += self._to_rest_shape(i, b) / ti.max(TIME_CONSTANT, self.farthest[b] / MAX_SPEED)
                    s.v[i] += (1.0 - ti.exp(-t / (0.1 * TIME_CONSTANT))) * (goal - s.v[i])

    @ti.func
    def _to_rest_shape(self, i: ti.i32, b: ti.i32):
        """Displacement [m] of vertex i to its place in the rest shape of body b, fitted to the body."""
        s, q = self.state, self.quaternion[b]
        u, r = ti.Vector([q[1], q[2], q[3]]), s.rest[i] - self.reductions.rest_center[b]
        center = ti.Vector([ti.static(self.reductions.total)[b, CENTER + k] for k in range(3)])
        return center + r + 2.0 * (q[0] * u.cross(r) + u.cross(u.cross(r))) - s.x[i]
