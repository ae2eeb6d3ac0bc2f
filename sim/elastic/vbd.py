"""Vertex block descent (Chen et al. 2024) for stiff bodies: implicit substeps of any length for any stiffness.

A substep minimises sum_i m_i/(2 dt^2) |dx_i - target_i|^2 + sum_t V Psi(F), Psi of MATH 7. J = det F is affine in one
vertex, so for that vertex alone the energy is a quadratic, and its minimum is met exactly:

    f = m/dt^2 (target - dx) - sum_t V P b,    H = m/dt^2 I + sum_t V (mu |b|^2 I + lam c c^T),    dx += H^-1 f

where F is that of dx - lag v (sim/state.py), and b is the gradient of the vertex's shape function at rest and c =
cof(F) b. H is positive definite whatever F is, so every update lowers the energy. Vertices of one colour share no tet
and are moved at the same time. After the sweeps of a substep each body moves along its softest modes
(sim/elastic/modal_correction.py): few sweeps bring a push only a few rings of tets far. The modes come last because
they include the rigid ones, so that momentum is kept.

    begin     dx = dt v + dt^2 a + x_lo, a = the part of the last acceleration along gravity, in [0, |g|] (Sec. 3.6):
              what rests starts at rest, so that few sweeps do not let it sag;   target = prediction + pushes
    sweep     colour by colour; after each vertex its static contacts, in the metric of H (sim/contact/response.py)
    phases    impulses push the target; dx itself moves by effective_inv_mass/w of that, which is tr(H^-1)/(3 dt^2)
    modes     the modal correction
    end       commit
"""

import numpy as np
import scipy.sparse as sp
import taichi as ti

from core.errors import BadInput
from core.fields import FieldGroup, Upload, round_up_capacity
from sim.body_model import RestShape
from sim.capacity import stacked
from sim.constraint import Constraint
from sim.elastic.energy import Elasticity, column, corners_of, fine_stress
from sim.elastic.modal_correction import ModalCorrection
from sim.elastic.substep import block_size, commit, phase_kernels
from sim.model import Model
from sim.reductions import ReductionBlocks
from sim.state import State

MAX_COLORS = 64
COLLAPSING_I1 = 1.5  # tr F^T F; below 1 the energy has a further term, mu/2 (1 - I1)^2 ...
COLLAPSING_STIFFNESS = 5.0  # ... whose second derivative along b is at most 4 mu |b|^2: mu + 4 mu in H never overshoots


@ti.data_oriented
class VBDSubsteps:
    """Substeps of `iterations` sweeps each; `run(substeps)` replays several with one call from Python."""

    max_substeps = 16  # behind one call
    warm_started = True

    def __init__(
        self,
        state: State,
        elasticity: Elasticity,
        constraints: list[Constraint],
        rigid,
        blocks: ReductionBlocks,
        *,
        iterations: int,
    ):
        self.state, self.elasticity, self.rigid, self.iterations = state, elasticity, rigid, iterations
        self.has_rigid = rigid is not None
        self.on_vertex = [c for c in constraints if c.has_vertex]
        self.in_pairs = [c for c in constraints if c.has_pairs]
        V = state.V
        g = self._group = FieldGroup()
        self.order = g.scalar(V, dtype=ti.i32)  # vertices by colour
        self.color_begin = g.scalar(MAX_COLORS + 1, dtype=ti.i32)
        self.corner = g.scalar(4 * state.T, dtype=ti.i32)  # 4 t + k of each slot (sim/elastic/energy.py)
        self.target = g.vector(V)  # dx that inertia and impulses want [m]
        self.impulse_displacement = g.vector(V)  # part of the target that impulses push [m]
        self.reaction = g.vector(V)  # force of static shapes [N]
        self.fall = g.scalar(V)  # |a| / |g| of the last substep, in [0, 1]
        self.contact_stiffness = g.scalar(V)  # of the vertex where something touches it, else 0 [N/m]
        self.effective_inv_mass = g.scalar(V)  # displacement within the substep per impulse [1/kg]
        g.build()
        self.modal = ModalCorrection(state, elasticity, blocks, self.target, self.reaction, self.contact_stiffness)
        self._upload = Upload([self.order, self.corner, self.color_begin])
        last = [self.fall, self.reaction, self.contact_stiffness, self.impulse_displacement, self.effective_inv_mass]
        self._write_last = Upload(last)
        self.colors = 0
        self.kernels: tuple | None = None
        self.graphs: dict[int, ti.graph.Graph] = {}

    def load(self, model: Model) -> None:
        """Take the colours and modes of these bodies."""
        colors = [p.shape.root.once(colors_of, tuple((p.inv_mass == 0.0).tolist())) for p in model.bodies]
        order, begin = color_ranges(stacked(colors))
        if len(begin) > MAX_COLORS + 1:
            raise BadInput(f"a vertex has too many neighbours: {len(begin) - 1} colours, the limit is {MAX_COLORS}")
        slots = [p.shape.root.once(corners_of) for p in model.bodies]
        corners = stacked([c + o for c, o in zip(slots, 4 * model.tet_begin, strict=False)])
        self._upload([order, corners, np.r_[begin, np.full(MAX_COLORS + 1 - len(begin), begin[-1])]])
        self.modal.load(model)
        if self.colors != len(begin) - 1:
            self.colors = len(begin) - 1
            self.graphs.clear()

    def run(self, substeps: int) -> None:
        """Take `substeps` substeps; each number has a graph of its own, of the same kernels."""
        if substeps not in self.graphs:
            self.graphs[substeps] = self._record(substeps)
        self.graphs[substeps].run({f"color{k}": k for k in range(self.colors)})

    def _record(self, substeps: int):
        if self.kernels is None:
            phases = [self._phases()] if self.in_pairs else []
            if self.has_rigid:  # several kernels, as in sim/elastic/xpbd.py
                rigid = (phase_kernels(self.state, self, c, first=True, evaluate=False) for c in self.in_pairs)
                phases[:0] = [kernel for kernels in rigid for kernel in kernels]
            self.kernels = self._begin(), self._sweep(), phases, self.modal.kernels(), self._end()
        begin, sweep, phases, modal, end = self.kernels
        colors = [ti.graph.Arg(ti.graph.ArgKind.SCALAR, f"color{k}", ti.i32) for k in range(self.colors)]
        graph = ti.graph.GraphBuilder()
        for _ in range(substeps):
            graph.dispatch(begin)
            for k in range(self.iterations):
                for color in colors if k % 2 == 0 else reversed(colors):  # there and back: no direction is favoured
                    graph.dispatch(sweep, color)
                for kernel in phases:
                    graph.dispatch(kernel)
            for kernel in (*modal, end):
                graph.dispatch(kernel)
        return graph.compile()

    def reset(self) -> None:
        """Forget the last substep: its accelerations and contacts."""
        self._write_last([np.zeros(0)] * 5)

    @ti.func
    def local(self, i):
        """Force f [N] on vertex i at the present increments, and H [N/m]."""
        s = self.state
        e = self.elasticity
        b = s.body_of_vertex[i]
        mu, lam, stiffness = s.mu[b], s.lam[b], s.mass[i] / s.dt[None] ** 2
        f = stiffness * (self.target[i] - s.dx[i])
        H = ti.Matrix.identity(ti.f32, 3) * stiffness
        for slot in range(e.slot_begin[i], e.slot_begin[i + 1]):
            t, k = self.corner[slot] // 4, self.corner[slot] % 4
            B, V = e.rest_inverse[t], e.volume[t]
            g = -ti.Vector([B[0, 0] + B[1, 0] + B[2, 0], B[0, 1] + B[1, 1] + B[2, 1], B[0, 2] + B[1, 2] + B[2, 2]])
            if k > 0:
                g = ti.Vector([B[k - 1, 0], B[k - 1, 1], B[k - 1, 2]])
            F, P = fine_stress(s, t, B)
            f1, f2, f3 = column(F, 0), column(F, 1), column(F, 2)
            c = f2.cross(f3) * g[0] + f3.cross(f1) * g[1] + f1.cross(f2) * g[2]
            f -= V * (P @ g)
            mu_t = mu * (COLLAPSING_STIFFNESS if F.norm_sqr() < COLLAPSING_I1 else 1.0)
            H += V * (mu_t * g.norm_sqr() * ti.Matrix.identity(ti.f32, 3) + lam * c.outer_product(c))
        return f, H

    @ti.func
    def _descend(self, i):
        """Move vertex i to the least energy, its static contacts respected."""
        s = self.state
        f, H = self.local(i)
        A = inverse(H)
        d, reaction, stiffness = s.dx[i] + A @ f, ti.Vector([0.0, 0.0, 0.0]), 0.0
        for c in ti.static(self.on_vertex):
            d, p, k = c.project_vertex_implicit(i, d, H, A, self.reaction[i])
            reaction += p
            stiffness = ti.max(stiffness, k)
        s.dx[i] = d
        self.reaction[i] = reaction
        self.contact_stiffness[i] = stiffness
        self.effective_inv_mass[i] = A.trace() / (3.0 * s.dt[None] ** 2)

    def _begin(self):
        s, on_vertex, in_pairs = self.state, self.on_vertex, self.in_pairs

        @ti.kernel
        def begin():
            ti.loop_config(serialize=s.serial)
            for i in range(s.V):
                if i == 0:
                    s.substep_index[None] += 1
                if s.awake_vertex(i):
                    target = s.dx_predicted[i]
                    if s.inv_mass[i] > 0.0:
                        d = target - (1.0 - self.fall[i]) * s.dt[None] ** 2 * s.gravity[None]
                        for c in ti.static(on_vertex):
                            target += c.external_displacement(i, d)
                        s.dx[i] = d
                    self.target[i] = target + self.impulse_displacement[i]
            for c in ti.static(in_pairs):
                ti.loop_config(serialize=s.serial, block_dim=ti.static(block_size(s, c.phase_sizes[0])))
                for k in range(c.phase_sizes[0]):
                    c.evaluate(k)

        return begin

    def _sweep(self):
        s = self.state
        width = round_up_capacity(s.V // 6)  # about the size of a colour; a longer one takes another round
        block = block_size(s, width)

        @ti.kernel
        def sweep(color: ti.i32):
            ti.loop_config(serialize=s.serial, block_dim=block)
            for k in range(width):
                j = self.color_begin[color] + k
                while j < self.color_begin[color + 1]:
                    i = self.order[j]
                    if not s.asleep[s.body_of_vertex[i]]:
                        self._descend(i)
                    j += width

        return sweep

    def _phases(self):
        s, in_pairs = self.state, self.in_pairs

        @ti.kernel
        def phases():
            for c in ti.static([] if self.has_rigid else in_pairs):
                for phase in ti.static(range(len(c.phase_sizes))):
                    ti.loop_config(serialize=s.serial, block_dim=ti.static(block_size(s, c.phase_sizes[phase])))
                    for k in range(c.phase_sizes[phase]):
                        c.solve_phase(self, phase, k, True)
            ti.loop_config(serialize=s.serial)
            for i in range(s.V):
                if s.awake_vertex(i) and s.inv_mass[i] > 0.0:
                    push = ti.Vector([0.0, 0.0, 0.0])
                    for c in ti.static(in_pairs):
                        push = c.apply_impulses(i, push)
                    change, w = push - self.impulse_displacement[i], self.effective_inv_mass[i]
                    if w > 0.0 and push.norm_sqr() + change.norm_sqr() > 0.0:
                        self.target[i] += change
                        self.impulse_displacement[i] = push
                        s.dx[i] += w / s.inv_mass[i] * change
                        self.contact_stiffness[i] = ti.max(self.contact_stiffness[i], 1.0 / (w * s.dt[None] ** 2))

        return phases

    def _end(self):
        s = self.state

        @ti.kernel
        def end():
            ti.loop_config(serialize=s.serial)
            for i in range(s.V):
                if s.awake_vertex(i):
                    dt, g = s.dt[None], s.gravity[None]
                    a = g + (s.dx[i] - s.dx_predicted[i]) / dt**2
                    self.fall[i] = ti.math.clamp(a.dot(g) / ti.max(g.norm_sqr(), 1e-12), 0.0, 1.0)
                    commit(self, i, s.dx[i])

        return end

    def destroy(self) -> None:
        self.modal.destroy()
        self._group.destroy()


def color_vertices(tets: np.ndarray, movable: np.ndarray) -> np.ndarray:
    """Colours (V,) such that no two vertices of a tet share one; -1 where a vertex is not movable (V,) bool.

    Greedy, from the vertex with most neighbours to that with fewest, each into the least used of the colours that its
    neighbours leave: about as many vertices in each colour, 8 to 12 colours for meshes met in practice.
    """
    n = len(movable)
    corners = np.asarray(tets, np.int64)
    pairs = corners[:, [0, 0, 0, 1, 1, 2]].ravel(), corners[:, [1, 2, 3, 2, 3, 3]].ravel()
    graph = sp.coo_matrix((np.ones(len(pairs[0]), bool), pairs), shape=(n, n))
    graph = (graph + graph.T).tocsr()
    begin, neighbor = graph.indptr, graph.indices
    color, used = np.full(n, -1), []
    for i in np.argsort(-np.diff(begin), kind="stable"):
        if movable[i]:
            taken = {*color[neighbor[begin[i] : begin[i + 1]]].tolist()}
            usable = [c for c in range(len(used)) if c not in taken]
            if not usable:
                usable = [len(used)]
                used.append(0)
            color[i] = min(usable, key=lambda c: (used[c], c))
            used[color[i]] += 1
    return color


def color_ranges(color: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Vertices ordered by colour (n,), and the begin of each colour in them (colours + 1,); -1 is left out."""
    order = np.argsort(color, kind="stable")
    order = order[color[order] >= 0]
    return order, np.concatenate([[0], np.cumsum(np.bincount(color[color >= 0], minlength=1))])


def colors_of(shape: RestShape, pinned: tuple) -> np.ndarray:
    """color_vertices of a shape; `pinned`: bools of the vertices that stay."""
    return color_vertices(shape.tets, ~np.array(pinned))


@ti.func
def inverse(H):
    """H^-1 of a symmetric positive definite matrix of any size: scaled, so that float32 holds its determinant."""
    scale = 3.0 / H.trace()
    return (H * scale).inverse() * scale
