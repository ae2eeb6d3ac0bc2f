"""Substeps for stiff bodies: vertex block descent (Chen et al. 2024), for any stiffness at any substep.

A substep minimises sum_i m_i/(2 dt^2) |dx_i - target_i|^2 + sum_t V Psi(F), Psi of MATH 7. J = det F is affine in one
vertex, so for that vertex alone the energy is a quadratic, and its minimum is met exactly:

    f = m/dt^2 (target - dx) - sum_t V P b,    H = m/dt^2 I + sum_t V (mu |b|^2 I + lam c c^T),    dx += H^-1 f

with b the gradient of the vertex's shape function at rest and c = cof(F) b. H is positive definite whatever F is, so
every update lowers the energy. Vertices of one colour (sim/elastic/coloring.py) share no tet and are moved at the same time.
After the sweeps of a substep each body moves along its softest modes (sim/elastic/modal_correction.py): few sweeps bring a push only a
few rings of tets far. The modes come last because they include the rigid ones, so that momentum is kept.

    begin     dx = dt v + dt^2 a + x_lo, a = the part of the last acceleration along gravity, in [0, |g|] (Sec. 3.6):
              what rests starts at rest, so that few sweeps do not let it sag;   target = prediction + pushes
    sweep     colour by colour; after each vertex its static contacts, in the metric of H (sim/contact/response.py)
    pairs     rows push the target; their push moves dx itself by effective_inv_mass/w of that, effective_inv_mass = tr(H^-1)/(3 dt^2)
    coarse    the step along the modes
    close     commit, as in sim/elastic/xpbd.py
"""

import numpy as np
import taichi as ti

from core.errors import BadInput
from core.fields import Upload, round_up_capacity
from sim.capacity import stacked
from sim.constraint import Constraint
from sim.elastic.coloring import color_ranges, colors_of
from sim.elastic.energy import Elasticity, corners_of, fine_stress
from sim.elastic.modal_correction import ModalCorrection
from sim.elastic.substep import block_size, commit, phase_kernels
from sim.model import Model
from sim.reductions import ReductionBlocks
from sim.state import State

MOST_COLORS = 64
NEARLY_CRUSHED = 1.5  # tr F^T F; below 1 the energy has a further term, mu/2 (1 - I1)^2 ...
CRUSHED = 5.0  # ... whose second derivative along b is at most 4 mu |b|^2, which H takes instead: still no overshoot


@ti.data_oriented
class VBDSubsteps:
    """Substeps of `iterations` sweeps each; `run(substeps)` replays several with one call from Python.

    order i32[V], color_begin i32[C+1]: vertices by colour;   corner i32[4T]: 4 t + k of each slot (sim/elastic/energy.py)
    target vec3[V] [m];   external vec3[V] [m] what the rows' impulses add to it;   fall f32[V] = |a| / |g|
    reaction vec3[V] [N] of static shapes;   hold f32[V] [N/m] local stiffness where something touches, else 0
    effective_inv_mass f32[V] [1/kg]: how a vertex answers to an impulse within the substep
    """

    max_substeps = 16  # behind one call
    warm_started = True

    def __init__(
        self,
        state: State,
        elastic: Elasticity,
        constraints: list[Constraint],
        rigid,
        blocks: ReductionBlocks,
        *,
        iterations: int,
    ):
        self.state, self.elastic, self.rigid, self.iterations = state, elastic, rigid, iterations
        self.has_rigid = rigid is not None
        self.on_vertex = [c for c in constraints if c.has_vertex]
        self.in_pairs = [c for c in constraints if c.has_pairs]
        self.builder = ti.FieldsBuilder()
        self.order, self.corner, self.color_begin = (ti.field(ti.i32) for _ in range(3))
        self.target, self.external, self.reaction = (ti.Vector.field(3, ti.f32) for _ in range(3))
        self.fall, self.hold, self.effective_inv_mass = (ti.field(ti.f32) for _ in range(3))
        self.builder.dense(ti.i, state.V).place(self.order)
        self.builder.dense(ti.i, 4 * state.T).place(self.corner)
        self.builder.dense(ti.i, MOST_COLORS + 1).place(self.color_begin)
        for f in (self.target, self.external, self.reaction, self.fall, self.hold, self.effective_inv_mass):
            self.builder.dense(ti.i, state.V).place(f)
        self.tree = self.builder.finalize()
        self.coarse = ModalCorrection(state, elastic, blocks, self.target, self.reaction, self.hold)
        self._upload = Upload([self.order, self.corner, self.color_begin])
        self._memory = Upload([self.fall, self.reaction, self.hold, self.external, self.effective_inv_mass])
        self.colors = 0
        self.kernels: tuple | None = None
        self.graphs: dict[int, ti.graph.Graph] = {}

    def load(self, model: Model) -> None:
        """Take the colours and modes of these bodies."""
        parts = model.bodies
        colors = [p.shape.root.once(colors_of, tuple((p.inv_mass == 0.0).tolist())) for p in parts]
        order, begin = color_ranges(stacked(colors))
        if len(begin) > MOST_COLORS + 1:
            raise BadInput(f"a vertex has too many neighbours: {len(begin) - 1} colours, the limit is {MOST_COLORS}")
        slots = [p.shape.root.once(corners_of) for p in parts]
        corners = stacked([c + o for c, o in zip(slots, 4 * model.tet_begin, strict=False)])
        self._upload([order, corners, np.r_[begin, np.full(MOST_COLORS + 1 - len(begin), begin[-1])]])
        self.coarse.load(model)
        if self.colors != len(begin) - 1:
            self.colors = len(begin) - 1
            self.graphs.clear()

    def run(self, substeps: int) -> None:
        """Take so many substeps; each number has a graph of its own, of the same kernels."""
        if substeps not in self.graphs:
            self.graphs[substeps] = self._record(substeps)
        self.graphs[substeps].run({f"color{k}": k for k in range(self.colors)})

    def _record(self, substeps: int):
        if self.kernels is None:
            pairs = [self.pairs()] if self.in_pairs else []
            if self.has_rigid:  # several kernels, as in sim/elastic/xpbd.py
                pairs[:0] = [
                    k for c in self.in_pairs for k in phase_kernels(self.state, self, c, first=True, evaluate=False)
                ]
            self.kernels = self.begin(), self.sweep(), pairs, self.coarse.kernels(), self.close()
        begin, sweep, pairs, coarse, close = self.kernels
        colors = [ti.graph.Arg(ti.graph.ArgKind.SCALAR, f"color{k}", ti.i32) for k in range(self.colors)]
        graph = ti.graph.GraphBuilder()
        for _ in range(substeps):
            graph.dispatch(begin)
            for k in range(self.iterations):
                for color in colors if k % 2 == 0 else reversed(colors):  # there and back: no direction is favoured
                    graph.dispatch(sweep, color)
                for kernel in pairs:
                    graph.dispatch(kernel)
            for kernel in (*coarse, close):
                graph.dispatch(kernel)
        return graph.compile()

    def reset(self) -> None:
        """Forget the last substep: its accelerations and contacts."""
        self._memory([np.zeros(0)] * 5)

    @ti.func
    def local(self, i):
        """Force f [N] on vertex i at the increments as they are, and H [N/m]."""
        s = self.state
        e = self.elastic
        b = s.body_of_vertex[i]
        mu, lam, stiff = s.mu[b], s.lam[b], s.mass[i] / s.dt[None] ** 2
        f = stiff * (self.target[i] - s.dx[i])
        H = ti.Matrix.identity(ti.f32, 3) * stiff
        for slot in range(e.slot_begin[i], e.slot_begin[i + 1]):
            t, k = self.corner[slot] // 4, self.corner[slot] % 4
            B, V = e.rest_inverse[t], e.volume[t]
            g = -ti.Vector([B[0, 0] + B[1, 0] + B[2, 0], B[0, 1] + B[1, 1] + B[2, 1], B[0, 2] + B[1, 2] + B[2, 2]])
            if k > 0:
                g = ti.Vector([B[k - 1, 0], B[k - 1, 1], B[k - 1, 2]])
            F, P = fine_stress(s, t, B)
            f1 = ti.Vector([F[0, 0], F[1, 0], F[2, 0]])
            f2 = ti.Vector([F[0, 1], F[1, 1], F[2, 1]])
            f3 = ti.Vector([F[0, 2], F[1, 2], F[2, 2]])
            c = f2.cross(f3) * g[0] + f3.cross(f1) * g[1] + f1.cross(f2) * g[2]
            f -= V * (P @ g)
            mu_t = mu * (CRUSHED if F.norm_sqr() < NEARLY_CRUSHED else 1.0)
            H += V * (mu_t * g.norm_sqr() * ti.Matrix.identity(ti.f32, 3) + lam * c.outer_product(c))
        return f, H

    @ti.func
    def descend(self, i):
        """Move vertex i to the least energy, its static contacts respected."""
        s = self.state
        f, H = self.local(i)
        A = inverse(H)
        d, reaction, hold = s.dx[i] + A @ f, ti.Vector([0.0, 0.0, 0.0]), 0.0
        for c in ti.static(self.on_vertex):
            d, p, h = c.project_vertex_implicit(i, d, H, A, self.reaction[i])
            reaction += p
            hold = ti.max(hold, h)
        s.dx[i] = d
        self.reaction[i] = reaction
        self.hold[i] = hold
        self.effective_inv_mass[i] = A.trace() / (3.0 * s.dt[None] ** 2)

    def begin(self):
        s, on_vertex, in_pairs = self.state, self.on_vertex, self.in_pairs

        @ti.kernel
        def begin():
            ti.loop_config(serialize=s.serial)
            for i in range(s.V):
                if i == 0:
                    s.substep_index[None] += 1
                if i < s.vertex_count[None]:
                    target = s.dx_predicted[i]
                    if s.inv_mass[i] > 0.0:
                        d = target - (1.0 - self.fall[i]) * s.dt[None] ** 2 * s.gravity[None]
                        for c in ti.static(on_vertex):
                            target += c.external_displacement(i, d)
                        s.dx[i] = d
                    self.target[i] = target + self.external[i]
            for c in ti.static(in_pairs):
                block = ti.static(block_size(s, c.phase_sizes[0]))
                ti.loop_config(serialize=s.serial, block_dim=block)
                for k in range(c.phase_sizes[0]):
                    c.evaluate(k)

        return begin

    def sweep(self):
        s = self.state
        width = round_up_capacity(s.V // 6)  # about what one colour has; longer ones take another turn
        block = block_size(s, width)

        @ti.kernel
        def sweep(color: ti.i32):
            ti.loop_config(serialize=s.serial, block_dim=block)
            for k in range(width):
                j = self.color_begin[color] + k
                while j < self.color_begin[color + 1]:
                    self.descend(self.order[j])
                    j += width

        return sweep

    def pairs(self):
        s, in_pairs = self.state, self.in_pairs

        @ti.kernel
        def pairs():
            for c in ti.static([] if self.has_rigid else in_pairs):
                for phase in ti.static(range(len(c.phase_sizes))):
                    block = ti.static(block_size(s, c.phase_sizes[phase]))
                    ti.loop_config(serialize=s.serial, block_dim=block)
                    for k in range(c.phase_sizes[phase]):
                        c.solve_phase(self, phase, k, True)
            ti.loop_config(serialize=s.serial)
            for i in range(s.V):
                if i < s.vertex_count[None] and s.inv_mass[i] > 0.0:
                    push = ti.Vector([0.0, 0.0, 0.0])
                    for c in ti.static(in_pairs):
                        push = c.apply_impulses(i, push)
                    change = push - self.external[i]
                    if self.effective_inv_mass[i] > 0.0 and push.norm_sqr() + change.norm_sqr() > 0.0:
                        self.target[i] += change
                        self.external[i] = push
                        s.dx[i] += self.effective_inv_mass[i] / s.inv_mass[i] * change
                        self.hold[i] = ti.max(self.hold[i], 1.0 / (self.effective_inv_mass[i] * s.dt[None] ** 2))

        return pairs

    def close(self):
        s = self.state

        @ti.kernel
        def close():
            ti.loop_config(serialize=s.serial)
            for i in range(s.V):
                if i < s.vertex_count[None]:
                    dt, g = s.dt[None], s.gravity[None]
                    a = g + (s.dx[i] - s.dx_predicted[i]) / dt**2
                    self.fall[i] = ti.math.clamp(a.dot(g) / ti.max(g.norm_sqr(), 1e-12), 0.0, 1.0)
                    commit(self, i, s.dx[i])

        return close

    def destroy(self) -> None:
        self.coarse.destroy()
        self.tree.destroy()


@ti.func
def inverse(H):
    """H^-1 of a symmetric positive definite matrix of any size: scaled, so that float32 holds its determinant."""
    scale = 3.0 / H.trace()
    return (H * scale).inverse() * scale
