"""The coarse step of the descent path: each body as a whole moves along its softest modes (sim/elastic/modes.py).

With the residual force f_i of every vertex (elastic, inertial, and of its contacts as they are), the body's rotation R
and modes U_k of squared frequency w_k, all at the substep's dt,

    q_k = sum_i U_ki . R^T f_i / (1/dt^2 + w_k),   d_i = R sum_k q_k U_ki,   dx_i += a d_i,

    b = f . d / (f . d + h),   a = b f . d / (f . d - f(dx + b d) . d + b h)  in [0, b],   h = sum_i hold_i |d_i|^2:

the secant step to the least energy along d, so the energy does not rise however far the body is from its rest shape.
hold_i is the stiffness of vertex i where it touches something: the step may not outrun a contact. With b it would be
the least energy if the body were linear, as it is for small steps; the secant is taken there and not at d itself, for
what pushes one vertex of a light stiff body hard enough asks for turns by many radians, and the energy out there says
nothing of the energy here: the step would become nothing, and what the push left in the body would stay and grow.
"""

import taichi as ti

from core.fields import Upload
from sim.capacity import MAX_BODIES, stacked
from sim.elastic.best_fit_rotation import BestFitRotation
from sim.elastic.energy import Elasticity, fine_stress
from sim.elastic.modes import MODES, modes_of
from sim.model import Model
from sim.reductions import ReductionBlocks
from sim.state import State


@ti.data_oriented
class ModalCorrection:
    """The coarse step as `kernels()`, to be launched in their order.

    shape vec3[V*MODES], square f32[B*MODES]: U_k and w_k;   turn mat3[B] = R
    target vec3[V] where inertia and impulses want dx; reaction vec3[V] [N] of static shapes, hold f32[V] [N/m]
    force vec3[V] the residual in the body's frame, step vec3[V] = d, part f32[V], amplitude f32[B*MODES] = q
    """

    def __init__(self, state: State, elastic: Elasticity, blocks: ReductionBlocks, target, reaction, hold):
        self.state, self.elastic, self.blocks = state, elastic, blocks
        self.target, self.reaction, self.hold = target, reaction, hold
        V, C = state.V, blocks.size
        self.builder = ti.FieldsBuilder()
        self.shape, self.force, self.step = (ti.Vector.field(3, ti.f32) for _ in range(3))
        self.square, self.part, self.partial, self.amplitude, self.slope, self.share, self.trial = (
            ti.field(ti.f32) for _ in range(7)
        )
        self.builder.dense(ti.i, V * MODES).place(self.shape)
        self.builder.dense(ti.i, V).place(self.force, self.step)
        self.builder.dense(ti.ij, (V, 2)).place(self.part)
        self.builder.dense(ti.i, MAX_BODIES * MODES).place(self.square, self.amplitude)
        self.builder.dense(ti.i, MAX_BODIES).place(self.share, self.trial)
        self.builder.dense(ti.ij, (C, MODES)).place(self.partial)
        self.builder.dense(ti.ij, (C, 2)).place(self.slope)
        self.tree = self.builder.finalize()
        self.turning = BestFitRotation(state, blocks)
        self.turn = self.turning.turn
        self._upload = Upload([self.shape, self.square])

    def load(self, model: Model) -> None:
        """Take the modes of these bodies."""
        modes = [p.shape.once(modes_of, tuple((p.inv_mass == 0.0).tolist()), p.material) for p in model.bodies]
        self._upload([stacked([U.reshape(-1, 3) for U, _ in modes], 3), stacked([squares for _, squares in modes])])

    def kernels(self) -> list:
        return [self.turning.rotations(), self.residual(), self.project(), self.move(), self.measure(), self.shorten()]

    @ti.func
    def _residual(self, t):
        """Elastic forces of tet t, written to its corners' slots: f_k = -V P B^T e_k."""
        s = self.state
        e = self.elastic
        B = e.rest_inverse[t]
        F, P = fine_stress(s, t, B)
        if F.determinant() < 0.0:
            s.inverted[s.body_of_tet[t]] = 1
        H = -e.volume[t] * (P @ B.transpose())
        h1 = ti.Vector([H[0, 0], H[1, 0], H[2, 0]])
        h2 = ti.Vector([H[0, 1], H[1, 1], H[2, 1]])
        h3 = ti.Vector([H[0, 2], H[1, 2], H[2, 2]])
        k = e.slot[t]
        e.correction[k[0]] = -(h1 + h2 + h3)
        e.correction[k[1]] = h1
        e.correction[k[2]] = h2
        e.correction[k[3]] = h3

    @ti.func
    def _total(self, i):
        """Residual force of vertex i [N]."""
        s = self.state
        e = self.elastic
        f = self.reaction[i] + s.mass[i] / s.dt[None] ** 2 * (self.target[i] - s.dx[i])
        for k in range(e.slot_begin[i], e.slot_begin[i + 1]):
            f += e.correction[k]
        return f

    def residual(self):
        s = self.state

        @ti.kernel
        def residual():
            ti.loop_config(serialize=s.serial)
            for t in range(s.T):
                if t < s.tet_count[None]:
                    self._residual(t)
            ti.loop_config(serialize=s.serial)
            for i in range(s.V):
                if i < s.vertex_count[None]:
                    f = ti.Vector([0.0, 0.0, 0.0])
                    if s.inv_mass[i] > 0.0:
                        f = self.turn[s.body_of_vertex[i]].transpose() @ self._total(i)
                    self.force[i] = f

        return residual

    def project(self):
        s, c = self.state, self.blocks

        @ti.kernel
        def project():
            ti.loop_config(serialize=s.serial)
            for jk in range(c.size * MODES):
                j, k = jk // MODES, jk % MODES
                span, total = c.span[j], 0.0
                for i in range(span[0], span[1]):
                    total += self.shape[i * MODES + k].dot(self.force[i])
                self.partial[j, k] = total
            ti.loop_config(serialize=s.serial)
            for bk in range(MAX_BODIES * MODES):
                b, k = bk // MODES, bk % MODES
                if b < s.body_count[None]:
                    total = 0.0
                    for j in range(c.begin[b], c.begin[b + 1]):
                        total += self.partial[j, k]
                    self.amplitude[bk] = total / (1.0 / s.dt[None] ** 2 + self.square[bk])

        return project

    @ti.func
    def _sum_parts(self, j, k):
        """Sum column k of `part` over run j."""
        span, total = self.blocks.span[j], 0.0
        for i in range(span[0], span[1]):
            total += self.part[i, k]
        self.slope[j, k] = total

    @ti.func
    def _slope(self, b, k):
        """Sum column k of `part` over body b."""
        total = 0.0
        for j in range(self.blocks.begin[b], self.blocks.begin[b + 1]):
            total += self.slope[j, k]
        return total

    def move(self):
        s, c = self.state, self.blocks

        @ti.kernel
        def move():
            ti.loop_config(serialize=s.serial)
            for i in range(s.V):
                if i < s.vertex_count[None]:
                    b, d = s.body_of_vertex[i], ti.Vector([0.0, 0.0, 0.0])
                    for k in range(MODES):
                        d += self.amplitude[b * MODES + k] * self.shape[i * MODES + k]
                    self.part[i, 0] = d.dot(self.force[i])
                    self.part[i, 1] = self.hold[i] * d.norm_sqr()
                    self.step[i] = self.turn[b] @ d
            ti.loop_config(serialize=s.serial)
            for jk in range(2 * c.size):
                self._sum_parts(jk // 2, jk % 2)
            ti.loop_config(serialize=s.serial)
            for b in range(MAX_BODIES):
                if b < s.body_count[None]:
                    gain = self._slope(b, 0)
                    self.trial[b] = gain / ti.max(gain + self._slope(b, 1), 1e-30) if gain > 0.0 else 0.0
            ti.loop_config(serialize=s.serial)
            for i in range(s.V):
                if i < s.vertex_count[None]:
                    d = self.trial[s.body_of_vertex[i]] * self.step[i]
                    self.step[i] = d
                    s.dx[i] += d

        return move

    def measure(self):
        s, c = self.state, self.blocks

        @ti.kernel
        def measure():
            ti.loop_config(serialize=s.serial)
            for t in range(s.T):
                if t < s.tet_count[None]:
                    self._residual(t)
            ti.loop_config(serialize=s.serial)
            for i in range(s.V):
                if i < s.vertex_count[None]:
                    d, b = self.step[i], self.trial[s.body_of_vertex[i]]
                    self.part[i, 0] *= b
                    self.part[i, 1] = self.part[i, 0] + self.hold[i] * d.norm_sqr() - d.dot(self._total(i))
            ti.loop_config(serialize=s.serial)
            for jk in range(2 * c.size):
                self._sum_parts(jk // 2, jk % 2)

        return measure

    def shorten(self):
        s = self.state

        @ti.kernel
        def shorten():
            ti.loop_config(serialize=s.serial)
            for b in range(MAX_BODIES):
                if b < s.body_count[None]:
                    gain, curvature, a = self._slope(b, 0), self._slope(b, 1), 1.0
                    if curvature > gain:
                        a = ti.max(gain / curvature, 0.0)
                    self.share[b] = a
            ti.loop_config(serialize=s.serial)
            for i in range(s.V):
                if i < s.vertex_count[None]:
                    s.dx[i] += (self.share[s.body_of_vertex[i]] - 1.0) * self.step[i]

        return shorten

    def destroy(self) -> None:
        self.turning.destroy()
        self.tree.destroy()
