"""Vertex block descent (Chen et al. 2024) for stiff bodies: implicit substeps of any length for any stiffness.

A substep minimises sum_i m_i/(2 dt^2) |dx_i - target_i|^2 + sum_t V Psi(F), Psi of MATH 7. J = det F is affine in one
vertex, so for that vertex alone the energy is a quadratic, and its minimum is met exactly:

    f = m/dt^2 (target - dx) - sum_t V P b,    H = m/dt^2 I + s sum_t V (mu |b|^2 I + lam c c^T),    dx += H^-1 f

where F is that of s dx - lag v (sim/state.py), b the gradient of the vertex's shape function at rest, and c =
cof(F) b. H is positive definite whatever F is, so every update lowers the energy. Vertices of one colour share no tet
and are moved at the same time. Few sweeps bring a push only a few rings of tets far. So after them each body moves
along its softest modes (sim/elastic/modal_correction.py), and as a whole (sim/elastic/whole_bodies.py), which keeps
momentum.

    begin     dx = dt v + dt^2 a + x_lo, a = the last acceleration, its part along gravity brought into [0, |g|]
              (Sec. 3.6), then that across into the ball of diameter g: what floors and slopes leave of g. What rests
              starts at rest, so that few sweeps do not let it sag, and what slides is not pressed into its slope;
              target = prediction + pushes
    sweep     colour by colour; after each vertex its static contacts, in the metric of H (sim/contact/response.py)
    phases    impulses push the target; dx itself moves by effective_inv_mass/w of that, which is tr(H^-1)/(3 dt^2);
              before them bodies move as wholes
    modes     the modal correction; bodies move as wholes, last, since modes of a strained body have a spin
    end       commit
"""

import numpy as np
import scipy.sparse as sp
import taichi as ti

from core.errors import BadInput
from core.fields import FieldGroup, Upload, round_up_capacity
from core.runtime import Graph
from sim.elastic.energy import Elasticity, column, corners_of, row, tet_edges
from sim.elastic.modal_correction import ModalCorrection
from sim.elastic.substep import ALL_PASSES, Constraint, commit, phase_kernels
from sim.elastic.whole_bodies import WholeBodies
from sim.model import Model, RestShape, stacked
from sim.reductions import ReductionBlocks
from sim.state import State
from sim.time_step import SWEEPS

MAX_COLORS = 64
EARLY_PASSES = 1  # over rigid contacts in all sweeps but the last: the next sweep applies all impulses again
COLLAPSING_I1 = 1.5  # tr F^T F; below 1 the energy has a further term, mu/2 (1 - I1)^2 ...
COLLAPSING_STIFFNESS = 5.0  # ... whose second derivative along b is at most 4 mu |b|^2: mu + 4 mu in H never overshoots


@ti.func
def shape_gradient(B, corner):
    """Gradient [1/m] of the shape function of a tet's corner, from the rows of D_m^-1."""
    g = -(row(B, 0) + row(B, 1) + row(B, 2))
    if corner == 1:
        g = row(B, 0)
    elif corner == 2:
        g = row(B, 1)
    elif corner == 3:
        g = row(B, 2)
    return g


@ti.func
def tet_terms(e1, e2, e3, B, corner, V, mu, lam):
    """Force and stiffness at its `corner` of a tet of edges e (f64) from its first corner [m], D_m^-1 = B, volume V.

    Returns the force f on it [N], a and c of its part of H = a I + V lam c c^T [N/m], and J - 1. In double precision
    as far as there is cancellation: in single precision J - 1 is off by 1e-7, which at 1e8 Pa is a force like a
    vertex's weight, and flickers. P is never formed: P g = mu F g + (lam (J - 1) - mu) cof F g.
    """
    B64 = ti.cast(B, ti.f64)
    g = shape_gradient(B64, corner)
    F = ti.Matrix.cols([e1, e2, e3]) @ B64
    f1, f2, f3 = column(F, 0), column(F, 1), column(F, 2)
    c1 = f2.cross(f3)
    c = c1 * g[0] + f3.cross(f1) * g[1] + f1.cross(f2) * g[2]
    dJ, I1 = f1.dot(c1) - 1.0, f1.norm_sqr() + f2.norm_sqr() + f3.norm_sqr()
    force = mu * (1.0 - 2.0 * ti.max(1.0 - I1, 0.0)) * (F @ g) + (lam * dJ - mu) * c
    mu_t = mu * (COLLAPSING_STIFFNESS if I1 < COLLAPSING_I1 else 1.0)
    a = V * mu_t * shape_gradient(B, corner).norm_sqr()
    return -V * ti.cast(force, ti.f32), ti.cast(a, ti.f32), ti.cast(c, ti.f32), ti.cast(dJ, ti.f32)


@ti.data_oriented
class VertexDescent:
    """State of the descent of the vertices, and its steps for one vertex, in the order of a substep."""

    def __init__(self, state: State, constraints: list[Constraint], rigid):
        self.state, self.rigid, self.has_rigid = state, rigid, rigid is not None
        self.on_vertex = [c for c in constraints if c.has_vertex]
        self.in_pairs = [c for c in constraints if c.has_pairs]
        V = state.V
        g = self._group = FieldGroup()
        self.target = g.vector(V)  # dx that inertia and impulses want [m]
        self.impulse_displacement = g.vector(V)  # part of the target that impulses push [m]
        self.reaction = g.vector(V)  # force of static shapes [N]
        self.fall = g.vector(V)  # what is expected of the acceleration [m/s^2]
        self.contact_stiffness = g.scalar(V)  # of the vertex where something touches it, else 0 [N/m]
        self.contact_matrix, self.held = g.matrix(V), g.matrix(V)  # where static shapes do: K [N/m] and H^-1 K
        self.effective_inv_mass = g.scalar(V)  # displacement within the substep per impulse [1/kg]
        g.build()
        last = [self.fall, self.reaction, self.contact_stiffness, self.impulse_displacement, self.effective_inv_mass]
        self._write_last = Upload(last)

    def reset(self) -> None:
        """Forget the last substep: its accelerations and contacts."""
        self._write_last([np.zeros(0)] * 5)

    @ti.func
    def begin(self, i, predicted):
        """Set the first increment of vertex i, and what inertia wants, from the prediction of the last commit."""
        s = self.state
        d, target, impulse = predicted, predicted, self.impulse_displacement[i]
        if s.inv_mass[i] > 0.0:
            d = target - s.dt[None] ** 2 * (s.gravity[None] - self.fall[i])
            for c in ti.static(self.on_vertex):
                target += c.external_displacement(i, d)
        s.dx[i] = d
        self.target[i] = target + impulse

    @ti.func
    def find_contacts(self, i):
        """Evaluate the contacts of vertex i with static shapes, which are the same in all sweeps."""
        for c in ti.static(self.on_vertex):
            c.evaluate_vertex(i)

    @ti.func
    def load(self, i):
        """All that `descend` reads of vertex i but its contacts: dx and target [m], last reaction [N], mass [kg]."""
        return self.state.dx[i], self.target[i], self.reaction[i], self.state.mass[i]

    @ti.func
    def descend(self, i, dx, target, prior, mass, f, H):
        """Move vertex i to the least energy, its static contacts respected; returns its increment.

        dx, target, prior, mass of `load`; f [N], H [N/m] of its tets where their stress is.
        """
        s = self.state
        dt = s.dt[None]
        stiffness = mass / dt**2
        A_inverse = s.stress_share(s.stress_lag[s.body_of_vertex[i]]) * H + ti.Matrix.identity(ti.f32, 3) * stiffness
        A = inverse(A_inverse)
        d = dx + A @ (f + stiffness * (target - dx))
        reaction, contact_stiffness = ti.Vector([0.0, 0.0, 0.0]), 0.0
        for c in ti.static(self.on_vertex):
            d, reaction, contact_stiffness, K = c.project_vertex_implicit(i, d, A_inverse, A, prior)
            if reaction.norm_sqr() > 0.0:
                self.contact_matrix[i], self.held[i] = K, A @ K
        s.dx[i] = d
        self.reaction[i] = reaction
        self.contact_stiffness[i] = contact_stiffness
        self.effective_inv_mass[i] = A.trace() / (3.0 * dt**2)
        return d

    @ti.func
    def push(self, i):
        """Let the impulses of all pairs push vertex i and its target."""
        s = self.state
        if s.inv_mass[i] > 0.0:
            push = ti.Vector([0.0, 0.0, 0.0])
            for c in ti.static(self.in_pairs):
                push = c.apply_impulses(i, push)
            change, w = push - self.impulse_displacement[i], self.effective_inv_mass[i]
            if w > 0.0 and push.norm_sqr() + change.norm_sqr() > 0.0:
                self.target[i] += change
                self.impulse_displacement[i] = push
                s.dx[i] += w / s.inv_mass[i] * change
                self.contact_stiffness[i] = ti.max(self.contact_stiffness[i], 1.0 / (w * s.dt[None] ** 2))

    @ti.func
    def release(self, i):
        """Forget the impulses of pairs on vertex i."""
        for c in ti.static(self.in_pairs):
            c.apply_impulses(i, ti.Vector([0.0, 0.0, 0.0]))
        self.impulse_displacement[i] = ti.Vector([0.0, 0.0, 0.0])

    @ti.func
    def end(self, i, d):
        """Commit the increment d of vertex i; returns the predicted next one."""
        s = self.state
        dt, g = s.dt[None], s.gravity[None]
        a = g + (d - s.dx_predicted[i]) / dt**2
        down = ti.math.clamp(a.dot(g) / ti.max(g.norm_sqr(), 1e-12), 0.0, 1.0)
        across, most = a - a.dot(g) / ti.max(g.norm_sqr(), 1e-12) * g, ti.sqrt(down * (1.0 - down)) * g.norm()
        self.fall[i] = down * g + ti.min(most / ti.max(across.norm(), 1e-12), 1.0) * across
        _x, _v, predicted = commit(self, i, d)
        return predicted

    def destroy(self) -> None:
        self._group.destroy()


@ti.data_oriented
class VBDSubsteps:
    """Substeps of two sweeps each; `run(substeps)` replays several with one call from Python."""

    max_substeps = 16  # behind one call
    warm_started, iterations = True, SWEEPS["vbd"]
    patches = None  # its kernels read the rest shapes where plastic flow writes them

    def __init__(
        self, state: State, elasticity: Elasticity, constraints: list[Constraint], rigid, blocks: ReductionBlocks
    ):
        self.state, self.elasticity = state, elasticity
        self.descent = d = VertexDescent(state, constraints, rigid)
        self.in_pairs, self.effective_inv_mass = d.in_pairs, d.effective_inv_mass
        g = self._group = FieldGroup()
        self.order = g.scalar(state.V, dtype=ti.i32)  # vertices by colour
        self.color_begin = g.scalar(MAX_COLORS + 1, dtype=ti.i32)
        self.corner = g.scalar(4 * state.T, dtype=ti.i32)  # 4 t + k of each slot (sim/elastic/energy.py)
        g.build()
        self.whole = WholeBodies(state, blocks, d)
        self.modal = ModalCorrection(state, elasticity, blocks, d)
        self._upload = Upload([self.order, self.corner, self.color_begin])
        self.colors = 0
        self.kernels: tuple | None = None
        self.graphs: dict[int, Graph] = {}

    def load(self, model: Model) -> None:
        """Take the colours and modes of these bodies."""
        order, begin = color_ranges(stacked(body_colors(model)))
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
        self.graphs[substeps].run()

    def _record(self, substeps: int) -> Graph:
        if self.kernels is None:
            phases = [[self._phases()] if self.in_pairs else []] * 2  # of all sweeps but the last, and of that
            if self.descent.has_rigid:  # several kernels, as in sim/elastic/xpbd.py
                rigid = [phase_kernels(self.state, self, c, (EARLY_PASSES, ALL_PASSES)) for c in self.in_pairs]
                phases = [[k for kernels in rigid for k in kernels[n]] + phases[n] for n in range(2)]
            modal = self.modal.kernels()
            balance = self.whole.kernel()
            if self.in_pairs:
                phases = [[balance, *p] for p in phases]
            modal = [*modal, balance]
            self.kernels = self._begin(), self._sweep(), phases, modal, self._end()
        begin, sweep, phases, modal, end = self.kernels
        colors, graph = range(self.colors), Graph()
        for _ in range(substeps):
            graph.launch(begin)
            for k in range(self.iterations):
                for color in colors if k % 2 == 0 else reversed(colors):  # there and back: no direction is favoured
                    graph.launch(sweep, color)
                for kernel in phases[k == self.iterations - 1]:
                    graph.launch(kernel)
            for kernel in (*modal, end):
                graph.launch(kernel)
        return graph

    def reset(self) -> None:
        """Forget the last substep: its accelerations and contacts."""
        self.descent.reset()

    @ti.func
    def local(self, i):
        """Elastic force f [N] on vertex i at the present increments, and H [N/m]."""
        s, e = self.state, self.elasticity
        b = s.body_of_vertex[i]
        mu, lam = s.mu[b], s.lam[b]
        f, H = ti.Vector([0.0, 0.0, 0.0]), ti.Matrix.zero(ti.f32, 3, 3)
        for slot in range(e.slot_begin[i], e.slot_begin[i + 1]):
            t = self.corner[slot] // 4
            B, V = e.rest_inverse[t], e.volume[t]
            e1, e2, e3 = tet_edges(s, t)
            force, diagonal, c, _ = tet_terms(e1, e2, e3, B, self.corner[slot] % 4, V, mu, lam)
            f += force
            H += diagonal * ti.Matrix.identity(ti.f32, 3) + V * lam * c.outer_product(c)
        return f, H

    def _begin(self):
        s, in_pairs = self.state, self.in_pairs

        @ti.kernel
        def begin():
            s.substep_index[None] += 1  # before the loop: its threads read it
            ti.loop_config(serialize=s.few)
            for i in range(s.vertex_count[None]):
                if s.awake_vertex(i):
                    self.descent.begin(i, s.dx_predicted[i])
                    self.descent.find_contacts(i)
            for c in ti.static(in_pairs):
                ti.loop_config(serialize=s.few)
                for k in range(c.phase_count(0)):
                    c.evaluate(k)

        return begin

    def _sweep(self):
        s = self.state
        width = round_up_capacity(s.V // 6)  # about the size of a colour; a longer one takes another round

        @ti.kernel
        def sweep(color: ti.i32):
            ti.loop_config(serialize=s.serial)
            for k in range(width):
                j = self.color_begin[color] + k
                while j < self.color_begin[color + 1]:
                    i = self.order[j]
                    if not s.asleep[s.body_of_vertex[i]]:
                        f, H = self.local(i)
                        dx, target, prior, mass = self.descent.load(i)
                        self.descent.descend(i, dx, target, prior, mass, f, H)
                    j += width

        return sweep

    def _phases(self):
        s, in_pairs = self.state, self.in_pairs

        @ti.kernel
        def phases():
            for c in ti.static([] if self.descent.has_rigid else in_pairs):
                for phase in ti.static(range(len(c.phase_sizes))):
                    ti.loop_config(serialize=s.few)
                    for k in range(c.phase_count(phase)):
                        c.solve_phase(self, ti.static(phase > 0), phase, k)
            ti.loop_config(serialize=s.few)
            for i in range(s.vertex_count[None]):
                if s.awake_vertex(i):
                    self.descent.push(i)

        return phases

    def _end(self):
        s = self.state

        @ti.kernel
        def end():
            ti.loop_config(serialize=s.few)
            for i in range(s.vertex_count[None]):
                if s.awake_vertex(i):
                    self.descent.end(i, s.dx[i])

        return end


def color_vertices(tets: np.ndarray, movable: np.ndarray) -> np.ndarray:
    """Colours (V,) such that no two vertices of a tet share one; -1 where a vertex is not movable (V,) bool.

    Greedy, in the smallest-last order of Matula and Beck (1983): 6 to 8 colours for meshes met in practice, 11 if the
    vertices with most neighbours come first. Then vertices leave colours that have more than their part for those that
    have less: a colour costs a GPU a barrier, and the time of its largest block.
    """
    n = len(movable)
    corners = np.asarray(tets, np.int64)
    pairs = corners[:, [0, 0, 0, 1, 1, 2]].ravel(), corners[:, [1, 2, 3, 2, 3, 3]].ravel()
    graph = sp.coo_matrix((np.ones(len(pairs[0]), bool), pairs), shape=(n, n))
    graph = (graph + graph.T).tocsr()
    begin, flat = graph.indptr.tolist(), graph.indices.tolist()
    neighbors = [[j for j in flat[begin[i] : begin[i + 1]] if movable[j]] if movable[i] else [] for i in range(n)]
    color, order = [-1] * n, smallest_last(neighbors, np.flatnonzero(movable).tolist())
    used: list[int] = []
    for i in order:
        taken = {color[j] for j in neighbors[i]}
        color[i] = next(c for c in range(len(used) + 1) if c not in taken)
        if color[i] == len(used):
            used.append(0)
        used[color[i]] += 1
    for i in order:
        if used[color[i]] * len(used) > len(order):
            taken = {color[j] for j in neighbors[i]}
            least = min((c for c in range(len(used)) if c not in taken), key=lambda c: used[c])
            if used[least] * len(used) < len(order):
                used[color[i]] -= 1
                used[least] += 1
                color[i] = least
    return np.array(color, np.int64)


def smallest_last(neighbors: list[list[int]], vertices: list[int]) -> list[int]:
    """Order of `vertices` in which each has the fewest neighbours among those before it, and itself, of those left."""
    degree = {i: len(neighbors[i]) for i in vertices}
    buckets: list[list[int]] = [[] for _ in range(max(degree.values(), default=0) + 1)]
    for i in vertices:
        buckets[degree[i]].append(i)
    order, d = [], 0
    while len(order) < len(vertices):
        while not buckets[d]:
            d += 1
        i = buckets[d].pop()
        if degree.get(i) == d:  # else it has moved to another bucket
            del degree[i]
            order.append(i)
            for j in neighbors[i]:
                if j in degree:
                    degree[j] -= 1
                    buckets[degree[j]].append(j)
            d = max(d - 1, 0)
    return order[::-1]


def color_ranges(color: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Vertices ordered by colour (n,), and the begin of each colour in them (colours + 1,); -1 is left out."""
    order = np.argsort(color, kind="stable")
    order = order[color[order] >= 0]
    return order, np.concatenate([[0], np.cumsum(np.bincount(color[color >= 0], minlength=1))])


def body_colors(model: Model) -> list[np.ndarray]:
    """Colours of each body's vertices, the same arrays at any size. Raises BadInput beyond MAX_COLORS."""
    colors = [p.shape.root.once(colors_of, tuple((p.inv_mass == 0.0).tolist())) for p in model.bodies]
    count = 1 + max((int(c.max(initial=-1)) for c in colors), default=-1)
    if count > MAX_COLORS:
        raise BadInput(f"a vertex has too many neighbours: {count} colours, the limit is {MAX_COLORS}")
    return colors


def colors_of(shape: RestShape, pinned: tuple) -> np.ndarray:
    """color_vertices of a shape; `pinned`: bools of the vertices that stay."""
    return color_vertices(shape.tets, ~np.array(pinned))


@ti.func
def inverse(H):
    """H^-1 of a symmetric positive definite matrix of any size: scaled, so that float32 holds its determinant."""
    scale = 3.0 / H.trace()
    return (H * scale).inverse() * scale
