"""Modal correction of VBD: each body as a whole moves along its softest modes.

Each sweep over vertices propagates a push by one ring of tets, so a few sweeps do not move a stiff body as a
whole. The modes do: those of the body embedded in a coarse lattice of trilinear cells (Galerkin, so they are no softer
than the body itself), the six rigid ones included unless vertices are prescribed.

With the residual force f_i of every vertex (elastic, inertial, and of its contacts as they are), the body's best-fit
rotation R and modes U_k of squared frequency w_k, all at the substep's dt and its share s (sim/state.py),

    q_k = sum_i U_ki . R^T f_i / (1/dt^2 + s w_k),   d_i = R sum_k q_k U_ki,   dx_i += a d_i,

    b = f . d / (f . d + h),   a = b f . d / (f . d - f(dx + b d) . d + b h)  in [0, b],   h = sum_i c_i |d_i|^2:

the secant step to the least energy along d, so the energy does not rise however far the body is from its rest shape.
c_i is the stiffness of vertex i where it touches something: the step may not outrun a contact. With b it would be
the least energy if the body were linear, as it is for small steps; the secant is taken there and not at d itself, for
what pushes one vertex of a light stiff body hard enough asks for rotations by many radians, and the energy out there
says nothing of the energy here: the step would become nothing, and what the push left in the body would stay and grow.
"""

from dataclasses import dataclass

import numpy as np
import scipy.linalg as sl
import scipy.sparse as sp
import taichi as ti

from core.fields import FieldGroup, Upload
from core.lanes import from_lane, sum_lanes
from core.material import Material
from core.quaternion import polar_quaternion, to_matrix
from sim.elastic.energy import Elasticity
from sim.model import MAX_BODIES, Model, RestShape, stacked
from sim.reductions import ReductionBlocks
from sim.state import State
from sim.time_step import lame

MODES = 24  # of a body: six rigid, and a bar's bending, twist and stretch to about the third overtone
LATTICE_CELLS = 4  # along the body's longest side
MIN_RELATIVE_MASS = 1e-6  # of the heaviest lattice motion's mass: a lighter one moves next to no vertex
MOMENTS = 15  # sums for the rotation: m x rest^T (9), m x (3), m rest (3)


@ti.data_oriented
class ModalCorrection:
    """The correction: its steps, each by `lanes` threads for a block of vertices or a body, and CPU kernels of them.

    descent is the VertexDescent whose target, reaction and contact_stiffness are read (sim/elastic/vbd.py).
    A block is a run of at most 64 vertices of one body (ReductionBlocks). In a persistent kernel a warp takes a block,
    and all threads meet between the steps, which are, after a substep's last sweep:

        sum_moments, fit_rotation             R of each body (a persistent kernel does it before the sweeps: x stays)
                                              force: R^T f of each vertex
        project, find_amplitude               q_k
        find_step, sum_products, find_trial   d, and b
        move                                  dx += b d
        set_products, sum_products            the sums of the secant
        shortening                            a / b
    """

    def __init__(self, state: State, elasticity: Elasticity, blocks: ReductionBlocks, descent, lanes: int = 1):
        self.state, self.elasticity, self.blocks, self.descent, self.lanes = state, elasticity, blocks, descent, lanes
        V, B, N = state.V, MAX_BODIES, blocks.size
        g = self._group = FieldGroup()
        self.mode = g.vector(MODES * V)  # U_ki at k * vertex_count + i [kg^-1/2]
        self.frequency_sqr = g.scalar(B * MODES)  # w_k at b * MODES + k [1/s^2]
        self.amplitude = g.scalar(B * MODES)  # q_k
        self.rotation = g.matrix(B)  # R
        self.moments = g.scalar(N, MOMENTS)  # of the blocks
        self.force = g.vector(V)  # residual in the body's frame [N]
        self.step = g.vector(V)  # d, then b d [m]
        self.product = g.scalar(V, 2)  # f . d, then the terms of the secant's two sums [J]
        self.product_sums = g.scalar(N, 2)  # of the blocks
        self.mode_sums = g.scalar(N, MODES)  # of the blocks
        self.trial, self.step_scale = g.scalar(B), g.scalar(B)  # b, and a / b
        g.build()
        self._upload = Upload([self.mode, self.frequency_sqr])

    def load(self, model: Model) -> None:
        """Take the modes of these bodies."""
        modes = body_modes(model)
        U = np.zeros((MODES, model.sizes.vertices, 3), np.float32)
        for (shape, _), begin in zip(modes, model.vertex_begin, strict=False):
            U[:, begin : begin + len(shape)] = shape.transpose(1, 0, 2)
        self._upload([U.reshape(-1, 3), stacked([squares for _, squares in modes])])

    def kernels(self) -> list:
        """Kernels of one correction with a single lane, for a device without persistent kernels."""
        s, blocks = self.state, self.blocks

        @ti.kernel
        def fit_rotations():
            ti.loop_config(serialize=s.serial)
            for j in range(blocks.size):
                if self._awake(j):
                    self.sum_moments(j, s.x[s.vertex_begin[blocks.span[j][2]]], 0)
            ti.loop_config(serialize=s.serial)
            for b in range(MAX_BODIES):
                if s.awake_body(b):
                    self.fit_rotation(b, 0)

        @ti.kernel
        def move():
            self._write_tet_forces()
            s.each_vertex(self._set_force)
            self._find_amplitudes()
            s.each_vertex(self.find_step)
            self._sum_products_of_blocks()
            ti.loop_config(serialize=s.serial)
            for b in range(MAX_BODIES):
                if s.awake_body(b):
                    self.trial[b] = self.find_trial(b, 0)
            s.each_vertex(self._move_by_trial)

        @ti.kernel
        def shorten():
            self._write_tet_forces()
            s.each_vertex(self._set_products_of_residual)
            self._sum_products_of_blocks()
            ti.loop_config(serialize=s.serial)
            for b in range(MAX_BODIES):
                if s.awake_body(b):
                    self.step_scale[b] = self.shortening(b, 0)
            s.each_vertex(self._shorten)

        return [fit_rotations, move, shorten]

    @ti.func
    def _write_tet_forces(self):
        """Outermost level of a kernel, as the next two."""
        s = self.state
        ti.loop_config(serialize=s.serial)
        for t in range(s.T):
            if s.awake_tet(t):
                self.elasticity.write_forces(t)

    @ti.func
    def _sum_products_of_blocks(self):
        ti.loop_config(serialize=self.state.serial)
        for j in range(self.blocks.size):
            if self._awake(j):
                self.sum_products(j, 0)

    @ti.func
    def _find_amplitudes(self):
        """`project` and `find_amplitude`, spread over the modes."""
        s, blocks = self.state, self.blocks
        ti.loop_config(serialize=s.serial)
        for jk in range(blocks.size * MODES):
            j, k = jk // MODES, jk % MODES
            if self._awake(j):
                span, total = blocks.span[j], 0.0
                for i in range(span[0], span[1]):
                    total += self.mode[k * s.vertex_count[None] + i].dot(self.force[i])
                self.mode_sums[j, k] = total
        ti.loop_config(serialize=s.serial)
        for bk in range(MAX_BODIES * MODES):
            if s.awake_body(bk // MODES):
                self.find_amplitude(bk, 0)

    @ti.func
    def _set_force(self, i):
        f = ti.Vector([0.0, 0.0, 0.0])
        if self.state.inv_mass[i] > 0.0:
            f = self.rotation[self.state.body_of_vertex[i]].transpose() @ self._residual(i)
        self.force[i] = f

    @ti.func
    def _move_by_trial(self, i):
        self.move(i, self.trial[self.state.body_of_vertex[i]])

    @ti.func
    def _set_products_of_residual(self, i):
        self.set_products(i, self._residual(i))

    @ti.func
    def _shorten(self, i):
        self.state.dx[i] += (self.step_scale[self.state.body_of_vertex[i]] - 1.0) * self.step[i]

    @ti.func
    def _awake(self, j):
        """True if block j is of a body that is awake."""
        span = self.blocks.span[j]
        return span[0] < span[1] and not self.state.asleep[span[2]]

    @ti.func
    def _sum(self, value):
        """Sum of a float over the lanes, in the first of them."""
        return sum_lanes(value, self.lanes)

    @ti.func
    def sum_moments(self, j, origin, lane):
        """Moments of block j for the rotation, with x about this point of the body."""
        s, span = self.state, self.blocks.span[j]
        total = ti.Matrix.zero(ti.f32, 3, 3)
        p, q = ti.Vector([0.0, 0.0, 0.0]), ti.Vector([0.0, 0.0, 0.0])
        first = s.vertex_begin[span[2]]
        i = span[0] + lane
        while i < span[1]:
            mass, x, X = s.mass[i], s.x[i] - origin, s.rest[i] - s.rest[first]
            total += mass * x.outer_product(X)
            p += mass * x
            q += mass * X
            i += self.lanes
        for k in ti.static(range(3)):
            for l in ti.static(range(3)):
                total[k, l] = self._sum(total[k, l])
            p[k], q[k] = self._sum(p[k]), self._sum(q[k])
        if lane == 0:
            for k in ti.static(range(3)):
                for l in ti.static(range(3)):
                    self.moments[j, 3 * k + l] = total[k, l]
                self.moments[j, 9 + k], self.moments[j, 12 + k] = p[k], q[k]

    @ti.func
    def fit_rotation(self, b, lane):
        """R of body b: the polar rotation of sum m x (rest - mean rest)^T."""
        total = ti.Matrix.zero(ti.f32, 3, 3)
        p, q = ti.Vector([0.0, 0.0, 0.0]), ti.Vector([0.0, 0.0, 0.0])
        j = self.blocks.begin[b] + lane
        while j < self.blocks.begin[b + 1]:
            for k in ti.static(range(3)):
                for l in ti.static(range(3)):
                    total[k, l] += self.moments[j, 3 * k + l]
                p[k] += self.moments[j, 9 + k]
                q[k] += self.moments[j, 12 + k]
            j += self.lanes
        for k in ti.static(range(3)):
            for l in ti.static(range(3)):
                total[k, l] = self._sum(total[k, l])
            p[k], q[k] = self._sum(p[k]), self._sum(q[k])
        if lane == 0:
            self.rotation[b] = to_matrix(polar_quaternion(total - p.outer_product(q) / self.state.body_mass[b]))

    @ti.func
    def _residual(self, i):
        """Residual force of vertex i [N], after the tets have written theirs to its slots."""
        s, d = self.state, self.descent
        f = d.reaction[i] + s.mass[i] / s.dt[None] ** 2 * (d.target[i] - s.dx[i])
        return self.elasticity.add_slots(i, f)

    @ti.func
    def set_products(self, i, f: ti.template()):
        """Take the residual force f [N] of vertex i after the step b d, for the secant."""
        d, b = self.step[i], self.trial[self.state.body_of_vertex[i]]
        self.product[i, 0] *= b
        contact = self.descent.contact_stiffness[i] * d.norm_sqr()
        self.product[i, 1] = self.product[i, 0] + contact - d.dot(f)

    @ti.func
    def project(self, j, lane):
        """Sums of block j for the amplitudes."""
        s, span = self.state, self.blocks.span[j]
        total = ti.Vector([0.0] * MODES)
        i = span[0] + lane
        while i < span[1]:
            f = self.force[i]
            for k in ti.static(range(MODES)):
                total[k] += self.mode[k * s.vertex_count[None] + i].dot(f)
            i += self.lanes
        for k in ti.static(range(MODES)):
            total[k] = self._sum(total[k])
        if lane == 0:
            for k in ti.static(range(MODES)):
                self.mode_sums[j, k] = total[k]

    @ti.func
    def find_amplitude(self, bk, lane):
        """q_k of body b, at bk = b * MODES + k."""
        total = self.blocks.sum_by_lanes(self.mode_sums, bk // MODES, bk % MODES, lane, self.lanes)
        if lane == 0:
            s = self.state
            stiffness = s.stress_share(s.stress_lag[bk // MODES]) * self.frequency_sqr[bk]
            self.amplitude[bk] = total / (1.0 / s.dt[None] ** 2 + stiffness)

    @ti.func
    def find_step(self, i):
        """d of vertex i, and its terms of f . d and h."""
        s, b, d = self.state, self.state.body_of_vertex[i], ti.Vector([0.0, 0.0, 0.0])
        for k in range(MODES):
            d += self.amplitude[b * MODES + k] * self.mode[k * s.vertex_count[None] + i]
        self.product[i, 0] = d.dot(self.force[i])
        self.product[i, 1] = self.descent.contact_stiffness[i] * d.norm_sqr()
        self.step[i] = self.rotation[b] @ d

    @ti.func
    def sum_products(self, j, lane):
        """Sums of the products of block j."""
        span = self.blocks.span[j]
        for k in ti.static(range(2)):
            total, i = 0.0, span[0] + lane
            while i < span[1]:
                total += self.product[i, k]
                i += self.lanes
            total = self._sum(total)
            if lane == 0:
                self.product_sums[j, k] = total

    @ti.func
    def find_trial(self, b, lane):
        """The b of a body's step, in all lanes."""
        gain, h = self._body_sum(b, 0, lane), self._body_sum(b, 1, lane)
        return gain / ti.max(gain + h, 1e-30) if gain > 0.0 else 0.0

    @ti.func
    def move(self, i, b):
        """Move vertex i by b d."""
        d = b * self.step[i]
        self.step[i] = d
        self.state.dx[i] += d

    @ti.func
    def shortening(self, b, lane):
        """a / b of body b, in all lanes: what is kept of the trial's step."""
        gain, curvature = self._body_sum(b, 0, lane), self._body_sum(b, 1, lane)
        kept = 1.0
        if curvature > gain:
            kept = ti.max(gain / curvature, 0.0)
        return kept

    @ti.func
    def _body_sum(self, b, k: ti.template(), lane):
        """Sum k of `product_sums` over body b, in all lanes."""
        return from_lane(self.blocks.sum_by_lanes(self.product_sums, b, k, lane, self.lanes), 0, self.lanes)

    def destroy(self) -> None:
        self._group.destroy()


def lattice_weights(x: np.ndarray) -> sp.csr_matrix:
    """Trilinear weights (V, nodes) of points x (V, 3) in a lattice of nearly cubic cells around them."""
    low, size = x.min(0), np.maximum(np.ptp(x, axis=0), 1e-9 * np.ptp(x))
    cells = np.clip(np.round(LATTICE_CELLS * size / size.max()), 1, LATTICE_CELLS).astype(int)
    u = (x - low) / size * cells
    cell = np.minimum(u.astype(int), cells - 1)
    u -= cell
    corners = np.stack(np.meshgrid(*[(0, 1)] * 3, indexing="ij"), -1).reshape(-1, 3)
    node = cell[:, None] + corners
    node = (node[..., 0] * (cells[1] + 1) + node[..., 1]) * (cells[2] + 1) + node[..., 2]
    weight = np.where(corners, u[:, None], 1 - u[:, None]).prod(-1)
    rows = np.repeat(np.arange(len(x)), 8)
    return sp.csr_matrix((weight.ravel(), (rows, node.ravel())), shape=(len(x), int(np.prod(cells + 1))))


@dataclass(frozen=True)
class LatticeMotions:
    """Motions (W q) of a lattice around a mesh, orthonormal in the vertices' masses, and their stiffness.

    weights (V, nodes), W (nodes, r), K = lame_1 dilation + mu shear with both (3 r, 3 r), q by axis.
    """

    weights: sp.csr_matrix
    W: np.ndarray
    dilation: np.ndarray
    shear: np.ndarray


def lattice_motions(x, tets, masses, movable) -> LatticeMotions:
    """Motions of rest positions x (V, 3) [m] of these masses (V,) [kg]; movable (V,) bool: the others stay at rest."""
    x, tets = np.asarray(x, np.float64), np.asarray(tets, np.int64)
    P = sp.diags(np.asarray(movable, np.float64)) @ lattice_weights(x)
    D = np.swapaxes(x[tets[:, 1:]] - x[tets[:, :1]], 1, 2)
    inner = np.linalg.inv(D)
    gradient = np.concatenate([-inner.sum(1, keepdims=True), inner], axis=1)  # (T, 4, 3)
    rows, volume = np.repeat(np.arange(len(tets)), 4), sp.diags(np.linalg.det(D) / 6)
    shape = (len(tets), len(x))
    G = [sp.csr_matrix((gradient[..., k].ravel(), (rows, tets.ravel())), shape=shape) @ P for k in range(3)]
    # The lattice of a coarse mesh has motions that move no vertex. Without mass or stiffness they would come first, and
    # be all the modes of a body of some thirty vertices: so only what moves the body is looked at, at unit mass.
    weight, W = np.linalg.eigh((P.T @ sp.diags(np.asarray(masses)) @ P).toarray())
    kept = weight > MIN_RELATIVE_MASS * weight[-1]
    W = W[:, kept] / np.sqrt(weight[kept])
    products = [[W.T @ (G[k].T @ volume @ G[l]).toarray() @ W for l in range(3)] for k in range(3)]
    shear = np.block([[products[l][k] for l in range(3)] for k in range(3)])
    shear += np.kron(np.eye(3), products[0][0] + products[1][1] + products[2][2])
    return LatticeMotions(P, W, np.block(products), shear)


def softest_modes(motions: LatticeMotions, mu: float, lame_1: float) -> tuple[np.ndarray, np.ndarray]:
    """Shapes U (V, MODES, 3) [kg^-1/2] with sum_i m_i U_ki . U_li = delta_kl, and squared frequencies (MODES,) [1/s^2].

    mu, lame_1: Lame constants [Pa]. Missing modes of the smallest meshes are zero.
    """
    U, all_squares = np.zeros((motions.weights.shape[0], MODES, 3)), np.zeros(MODES)
    r = motions.W.shape[1]
    if r > 0:
        stiffness = lame_1 * motions.dilation + mu * motions.shear
        squares, Q = sl.eigh(stiffness, subset_by_index=(0, min(MODES, 3 * r) - 1))
        for k in range(3):
            U[:, : len(squares), k] = motions.weights @ (motions.W @ Q[k * r : (k + 1) * r])
        all_squares[: len(squares)] = np.maximum(squares, 0.0)
    return U, all_squares


def motions_of(shape: RestShape, pinned: tuple) -> LatticeMotions:
    """lattice_motions of a shape at 1 kg/m^3: these take long. `pinned`: bools of the vertices that stay."""
    return lattice_motions(shape.vertices, shape.tets, shape.vertex_volumes, ~np.array(pinned))


def unit_modes_of(shape: RestShape, pinned: tuple, poisson: float) -> tuple[np.ndarray, np.ndarray]:
    """softest_modes of a shape at 1 kg/m^3 and mu = 1 Pa."""
    return softest_modes(shape.once(motions_of, pinned), 1.0, 2 * poisson / (1 - 2 * poisson))


def body_modes(model: Model) -> list[tuple[np.ndarray, np.ndarray]]:
    """softest_modes of each body."""
    return [modes_of(p.shape, tuple((p.inv_mass == 0.0).tolist()), p.material) for p in model.bodies]


def modes_of(shape: RestShape, pinned: tuple, material: Material) -> tuple[np.ndarray, np.ndarray]:
    """softest_modes of a body of this shape and material.

    Of a scaled shape masses go with f^3 and stiffness with f, so that only Poisson's ratio makes other shapes of modes.
    """
    U, squares = shape.root.once(unit_modes_of, pinned, material.poisson)
    mu, _ = lame(material)
    mass = material.density * shape.factor**3
    return U / np.sqrt(mass), squares * mu * shape.factor / mass
