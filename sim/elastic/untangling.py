"""Bodies that were turned inside out get their shape back.

Without contact with itself, a body that is squeezed through itself can be left in a kink: all tets upright again, but
wound around one another, in a true minimum of the energy from where no force leads home. So when a hand lets go of a
body of which it had inverted some tets, or tets stay inverted by themselves, then for DURATION the body is limp, and
its vertices are led to its rest shape, where the rest shape fits best (Mueller et al. 2005):

    v_i += k (v_cm + omega x r_i + (x_cm + R (X_i - X_cm) - x_i) / TIME - v_i),
    R the rotation that maximises tr(R^T sum m x (X - X_cm)^T)

It stiffens again by and by, and is led meanwhile: a limp body sags a little under its weight, and were it itself again
at once, the 1.6 mm by which one of 0.1 m and 1e8 Pa does so would throw it at 9 m/s.
"""

import numpy as np
import taichi as ti

from core.fields import Upload
from core.quaternion import polar_quaternion
from sim.elastic.damping import Damping
from sim.elastic.time_step import lame
from sim.model import MAX_BODIES, Model
from sim.recovery import LOST
from sim.reductions import Reductions
from sim.state import State

DURATION = 0.6  # [s] from the last inverted tet on
STIFFENING = 0.2  # [s] of them, at the end: each frame of 60 Hz three times as stiff, for 1e8 Pa
TIME = 0.04  # [s] in which what is left to go shrinks to a third
FASTEST = 2.0  # [m/s] at which it does: a hand may drop a body that it drew out by metres. With 0.4, kinks hold out
PATIENCE = 0.02  # [s] that tets may be inverted: more than a frame of 60 Hz
LIMP = 200.0  # [Pa] Young's modulus of a limp body: g and kinks must not hold out against 1/TIME^2


@ti.data_oriented
class Untangling:
    """`begin_frame` learns what is tangled, `run` leads it. Both do nothing, and cost nothing, where nothing is."""

    def __init__(self, state: State, summary: Reductions, damping: Damping):
        self.state, self.summary, self.damping = state, summary, damping
        self.limp = ti.field(ti.i32)
        self.quaternion = ti.Vector.field(4, ti.f32)
        self.longest = ti.field(ti.f32)  # way [m] of a vertex to the rest shape
        self.builder = ti.FieldsBuilder()
        self.builder.dense(ti.i, MAX_BODIES).place(self.limp, self.quaternion, self.longest)
        self.tree = self.builder.finalize()
        self._set = Upload([self.limp, state.inverted, state.mu, state.lam])
        self.seen: np.ndarray | None = None  # `inverted` after the last frame, if the host knows it already
        self.parts = []
        self.status = np.zeros((3, 0))  # seconds left; seconds with inverted tets; whether it is tangled and held

    def load(self, assembly: Model) -> None:
        """Other bodies from now on; those that stay go on mending."""
        known = dict(zip(map(id, self.parts), self.kept().T, strict=True))
        self.parts = assembly.parts
        self.hold(np.array([known.get(id(p), np.zeros(4)) for p in self.parts]).reshape(-1, 4).T)

    def reset(self) -> None:
        """All bodies are sound."""
        self.hold(np.zeros((4, len(self.parts))))

    def kept(self) -> np.ndarray:
        """What `hold` needs to go on from here, (4, B)."""
        return np.vstack([self.status, self._inverted()])

    def hold(self, kept: np.ndarray) -> None:
        """Go on from what was `kept` of these bodies."""
        self.status = np.array(kept[:3])
        self.damping.omega.fill(0.0)  # of a time that is over; bodies may be others now
        self._soften(kept[3])

    def _inverted(self) -> np.ndarray:
        return self.state.inverted.to_numpy()[: len(self.parts)]

    def begin_frame(self, held: set[int], driven: set[int], dt: float) -> bool:
        """Before a frame of dt [s]: which bodies had inverted tets in the last one, and which does a hand hold?

        Those whose vertices are driven have no other shape to go to than where these lead them.
        Whether any was lost (sim/recovery.py).
        """
        marks, self.seen = self._inverted() if self.seen is None else self.seen, None
        if not marks.any() and not self.status.any():
            return False
        lost = marks & LOST != 0
        inverted = (marks & ~LOST != 0) & ~np.isin(np.arange(len(self.parts)), list(driven))
        held_now = np.isin(np.arange(len(self.parts)), list(held))
        left, since, tangled = self.status
        since = np.where(inverted, since + dt, 0.0)
        tangled = (tangled > 0) | (inverted & held_now) | (since > PATIENCE) | lost
        left = np.where(tangled & ~held_now, DURATION, np.where(held_now, 0.0, np.maximum(left - dt, 0.0)))
        self.status = np.stack([left, since, tangled & held_now])
        self._soften(np.zeros(len(self.parts)))
        return bool(lost.any())

    def _soften(self, inverted: np.ndarray) -> None:
        limp = self.status[0] > 0.0
        materials = [p.material for p in self.parts]
        softest = np.array([min(1.0, LIMP / m.young) for m in materials])
        scale = np.where(limp, softest ** np.clip(self.status[0] / STIFFENING, 0.0, 1.0), 1.0)
        self.seen = None
        constants = np.array([lame(m) for m in materials]).reshape(-1, 2) * scale[:, None]
        self._set([limp, inverted, constants[:, 0], constants[:, 1]])

    def run(self, t: float) -> None:
        """Lead the limp bodies for t [s], before the damping."""
        if self.status[0].any():
            self.summary.sum_up()
            self.damping.run(0.0)  # omega of now: the last one would spin a body that has grown since
            self._lead(t)

    def warm_up(self) -> None:
        """See Solver.warm_up."""
        self._lead(0.0)

    @ti.kernel
    def _lead(self, t: ti.f32):
        s = self.state
        total = ti.static(self.summary.total)
        for b in range(MAX_BODIES):
            if b < s.body_count[None] and self.limp[b]:
                A = ti.Matrix([[total[b, 6 + 3 * k + l] for l in range(3)] for k in range(3)])
                self.quaternion[b] = polar_quaternion(A)
                self.longest[b] = 0.0
        for i in range(s.V):
            if i < s.vertex_count[None]:
                b = s.body_of_vertex[i]
                if self.limp[b] and s.inv_mass[i] > 0.0:
                    ti.atomic_max(self.longest[b], self._way(i, b).norm())
        for i in range(s.V):
            if i < s.vertex_count[None]:
                b = s.body_of_vertex[i]
                if self.limp[b] and s.inv_mass[i] > 0.0:
                    center = ti.Vector([total[b, k] for k in range(3)])
                    goal = ti.Vector([total[b, 3 + k] for k in range(3)])
                    goal += self.damping.omega[b].cross(s.x[i] - center)
                    # one time for the whole body: ways that were cut one by one would push it to a side
                    goal += self._way(i, b) / ti.max(TIME, self.longest[b] / FASTEST)
                    s.v[i] += (1.0 - ti.exp(-t / (0.1 * TIME))) * (goal - s.v[i])

    @ti.func
    def _way(self, i: ti.i32, b: ti.i32):
        """From vertex i to where it is in the rest shape of body b, laid over the body."""
        s, q = self.state, self.quaternion[b]
        u, r = ti.Vector([q[1], q[2], q[3]]), s.rest[i] - self.summary.rest_center[b]
        center = ti.Vector([ti.static(self.summary.total)[b, k] for k in range(3)])
        return center + r + 2.0 * (q[0] * u.cross(r) + u.cross(u.cross(r))) - s.x[i]

    def destroy(self) -> None:
        self.tree.destroy()
