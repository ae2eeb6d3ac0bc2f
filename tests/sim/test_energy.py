"""The elastic constraint against float64 twins: energy, stress, stiffness bound, projection, order of summation."""

import numpy as np
import pytest
import scipy.sparse as sp
import scipy.sparse.linalg as spla
import taichi as ti
from numpy.testing import assert_allclose

from bench.physics import box, fem_stiffness
from core.fields import Upload
from core.material import Material
from sim.bodies import SoftBody
from sim.elastic.energy import Elasticity, energy_density
from sim.elastic.energy import stress as device_stress
from sim.model import BodyModel, Model, RestShape
from sim.state import State
from sim.time_step import STABILITY_LIMIT, lame, largest_substep, stiffness_bounds

MATERIAL = Material(young=1e5, poisson=0.4, density=1000.0)
MU, LAM = lame(MATERIAL)


def bounds(x, tets, w, material) -> np.ndarray:
    """`stiffness_bounds` of a mesh at rest."""
    D = np.swapaxes(x[tets[:, 1:]] - x[tets[:, :1]], 1, 2)
    return stiffness_bounds(np.linalg.inv(D), np.linalg.det(D) / 6, w[tets], material)


def energy(F):
    """Twin of sim.elastic.energy.energy_density: Psi [J/m^3] of F (..., 3, 3)."""
    J, I1 = np.linalg.det(F), (F**2).sum((-2, -1))
    return MU / 2 * (I1 - 3) - MU * (J - 1) + LAM / 2 * (J - 1) ** 2 + MU / 2 * np.maximum(1 - I1, 0) ** 2


def stress(F):
    """Twin of sim.elastic.energy.stress: P = dPsi/dF [Pa]."""
    f1, f2, f3 = np.moveaxis(F, -1, 0)
    cof = np.stack([np.cross(f2, f3), np.cross(f3, f1), np.cross(f1, f2)], -1)
    J, I1 = np.linalg.det(F)[..., None, None], (F**2).sum((-2, -1))[..., None, None]
    return MU * (1 - 2 * np.maximum(1 - I1, 0)) * F + (LAM * (J - 1) - MU) * cof


def deformations() -> np.ndarray:
    """At rest, rotated, small, large, flat, inverted and crushed, (n, 3, 3)."""
    rng = np.random.default_rng(1)
    Q = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    Q *= np.sign(np.linalg.det(Q))
    small = np.eye(3) + 1e-3 * rng.normal(size=(3, 3))
    stretched, crushed = Q @ np.diag([2.0, 1.0, 0.6]), Q @ np.diag([0.8, 0.2, 0.1])
    flat, mirrored = np.diag([1.0, 1.0, 0.0]), np.diag([-1.0, 1.0, 1.0])
    random = rng.normal(size=(6, 3, 3))
    return np.array([np.eye(3), Q, small, stretched, flat, mirrored, 0.3 * Q, crushed, *random])


def test_the_stress_is_the_gradient_of_the_energy():
    F, h = deformations(), 1e-6
    for k in range(3):
        for l in range(3):
            d = np.zeros((3, 3))
            d[k, l] = h
            slope = (energy(F + d) - energy(F - d)) / (2 * h)
            assert_allclose(stress(F)[:, k, l], slope, rtol=1e-6, atol=1e-4 * MU)


def test_small_strains_are_linear_elasticity():
    """P = 2 mu eps + lambda_L tr(eps) I to first order: the constants mean what they say."""
    e = 1e-6 * np.random.default_rng(2).normal(size=(3, 3))
    eps, lam_L = (e + e.T) / 2, LAM - MU
    assert_allclose(stress(np.eye(3) + e), 2 * MU * eps + lam_L * np.trace(eps) * np.eye(3), rtol=1e-3, atol=1e-7 * MU)


def test_the_device_stress_and_energy_equal_their_twins(ti_cpu):
    F = deformations()
    n = len(F)
    inputs, P, psi = ti.Matrix.field(3, 3, ti.f32, n), ti.Matrix.field(3, 3, ti.f32, n), ti.field(ti.f32, n)

    @ti.kernel
    def run(mu: ti.f32, lam: ti.f32):
        for i in range(n):
            P[i], I1, grow = device_stress(inputs[i], mu, lam)
            psi[i] = energy_density(I1, grow, mu, lam)

    inputs.from_numpy(F.astype(np.float32))
    run(MU, LAM)
    F = F.astype(np.float32).astype(np.float64)
    scale = LAM * (1 + (F**2).sum((1, 2)) ** 2)  # fp32 rounds sums of terms of this size
    assert np.all(np.abs(psi.to_numpy() - energy(F)) < 2e-6 * scale)
    assert np.all(np.abs(P.to_numpy() - stress(F)) < 2e-6 * scale[:, None, None])


class OneMesh:
    """A small mesh on the device, with the loops of one sweep."""

    def __init__(self):
        self.x, self.tets, _ = box((0.2, 0.1, 0.1), (2, 1, 1))
        rng = np.random.default_rng(3)
        self.x = self.x + rng.uniform(-0.01, 0.01, self.x.shape)
        self.w = rng.uniform(50.0, 100.0, len(self.x))
        self.w[0] = 0.0
        self.kappa = bounds(self.x, self.tets, self.w, MATERIAL)
        self.dt = largest_substep(self.kappa.max())
        body = SoftBody("mesh", self.x, self.tets, self.tets[:1, :3], MATERIAL)
        part = BodyModel(body, RestShape.of(body))
        part.inv_mass = self.w
        self.mu, self.lam = lame(MATERIAL)
        bodies = Model([part])
        self.state = s = State(bodies.sizes)
        s.load(bodies)
        s.dt[None] = self.dt
        self.elastic = e = Elasticity(s)
        e.load(bodies)
        self.moved = ti.Vector.field(3, ti.f32, s.V)
        moved = self.moved

        @ti.kernel
        def sweep():
            for t in range(s.T):
                if t < s.tet_count[None]:
                    e.project_tet(t)
            for i in range(s.V):
                if i < s.vertex_count[None]:
                    moved[i] = e.correction(i)

        self.sweep = sweep

    def run(self, y, moving: bool = True) -> np.ndarray:
        """Corrections (V, 3) of positions y: x and the increments to y if `moving`, or y itself at rest."""
        Upload([self.state.x, self.state.dx])([self.x, y - self.x] if moving else [y, 0 * y])
        self.sweep()
        return self.moved.to_numpy()[: len(self.x)].astype(np.float64)

    def gradients(self, y):
        """dU/dx of each tet (T, 4, 3), and U (T,), in float64."""
        X, Y = self.x[self.tets], y[self.tets]
        D = np.swapaxes(X[:, 1:] - X[:, :1], 1, 2)
        B, V = np.linalg.inv(D), np.linalg.det(D) / 6
        F = np.swapaxes(Y[:, 1:] - Y[:, :1], 1, 2) @ B
        H = V[:, None, None] * stress(F) @ np.swapaxes(B, 1, 2)
        g = np.concatenate([-H.sum(-1)[:, None], np.swapaxes(H, 1, 2)], axis=1)
        return g, V * energy(F)

    def gather(self, s, g):
        total = np.zeros_like(self.x)
        np.add.at(total, self.tets, s[:, None, None] * g)
        return self.w[:, None] * total


def strained(mesh: OneMesh) -> np.ndarray:
    """Positions of the mesh, slightly strained and rotated."""
    c, s = np.cos(0.7), np.sin(0.7)
    rotated = mesh.x @ np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]).T
    return rotated + 1e-3 * np.random.default_rng(4).normal(size=mesh.x.shape)


@pytest.fixture(scope="module")
def mesh(ti_cpu):
    return OneMesh()


def test_a_sweep_of_small_strain_is_the_explicit_step(mesh):
    y = strained(mesh)
    g, _ = mesh.gradients(y)
    expected = mesh.gather(np.full(len(g), -(mesh.dt**2)), g)
    assert_allclose(mesh.run(y), expected, atol=2e-5 * np.abs(expected).max())


def test_the_stress_is_that_of_the_positions_before_the_motion_that_lags(mesh):
    """x + share dx - lag v, share = 1 - 3 lag / dt: with lag = dt/4 the motion dt v of the substep is not seen."""
    s, y, share, lag = mesh.state, strained(mesh), 0.55, 0.15 * mesh.dt
    v = np.random.default_rng(6).normal(0, 1e-3 / mesh.dt, y.shape)
    expected = mesh.run(y)
    Upload([s.x, s.dx, s.v, s.stress_lag])([mesh.x, (y - mesh.x + lag * v) / share, v, [lag]])
    mesh.sweep()
    moved = mesh.moved.to_numpy()[: len(y)]
    Upload([s.v, s.stress_lag])([0 * v, [0.0]])
    assert_allclose(moved, expected, atol=2e-5 * np.abs(expected).max())


FAR_FROM_REST = {
    "stretched": [2.0, 0.8, 0.8],
    "stretched far, its volume kept": [12.0, 0.3, 0.28],
    "crushed": [0.3, 0.3, 0.3],
    "mirrored": [-1.0, 1.0, 1.0],
}


@pytest.mark.parametrize("scale", FAR_FROM_REST.values(), ids=FAR_FROM_REST)
def test_a_sweep_far_from_rest_is_a_shorter_step_that_lowers_the_energy(mesh, scale):
    """Along the gradient of each tet, no longer than the explicit step; motion along the gradient is braked."""
    y = mesh.x * scale
    g, U = mesh.gradients(y)

    def steps(moving: bool):
        moved = mesh.run(y, moving=moving)
        slots = mesh.elastic.slots.to_numpy()[mesh.elastic.slot.to_numpy()[: len(g)]].astype(np.float64)
        s = (slots * g).sum((1, 2)) / (g**2).sum((1, 2))
        assert_allclose(slots, s[:, None, None] * g, atol=2e-5 * np.abs(slots).max())
        return s, moved

    s, moved = steps(False)
    assert (-(mesh.dt**2) * (1 + 1e-5) <= s).all() and (s < 0).all()
    assert (s > -0.9 * mesh.dt**2).any() == (np.ptp(scale) > 10)  # the extremely stretched ones are shortened
    _, lower = mesh.gradients(y + moved)
    assert lower.sum() < U.sum()
    braked, _ = steps(True)
    along = np.einsum("tkc,tkc->t", g, (y - mesh.x)[mesh.tets])
    assert ((braked - s) * along <= 1e-6 * np.abs(s * along)).all()


def test_corrections_keep_momentum(mesh):
    """sum_i dx_i / w_i = 0, the prescribed vertex's share included: forces of a tet cancel."""
    mesh.run(strained(mesh))
    e = mesh.elastic
    forces = e.slots.to_numpy()[e.slot.to_numpy()[: len(mesh.tets)]].astype(np.float64)
    assert np.abs(forces.sum((0, 1))).max() < 1e-6 * np.abs(forces).sum()


def test_nothing_happens_at_rest_and_in_rigid_motion(mesh):
    c, s = np.cos(2.0), np.sin(2.0)
    turned = mesh.x @ np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]]).T + [0.3, 0.1, 0.2]
    size = np.abs(mesh.x).max()
    for y in (mesh.x, turned):
        assert np.abs(mesh.run(y)).max() < 1e-6 * size


def test_kappa_bounds_the_stiffness_of_every_tet():
    """The largest eigenvalue of W^1/2 K W^1/2 of one tet, K from linear FEM, is at most kappa and not far below."""
    rng = np.random.default_rng(5)
    x, tets, _ = box((0.3, 0.2, 0.2), (3, 2, 2))
    x = x + rng.uniform(-0.02, 0.02, x.shape)
    w = rng.uniform(10.0, 100.0, len(x))
    kappa = bounds(x, tets, w, MATERIAL)
    for t in range(len(tets)):
        K = fem_stiffness(x[tets[t]], np.array([[0, 1, 2, 3]]), MATERIAL.young, MATERIAL.poisson).toarray()
        root = np.sqrt(np.repeat(w[tets[t]], 3))
        largest = np.linalg.eigvalsh(root[:, None] * K * root).max()
        assert 0.3 * kappa[t] < largest <= kappa[t] * (1 + 1e-9)


def test_the_rule_keeps_the_jacobi_sum_stable():
    """Forces at x + theta dt v: stable while dt^2 (largest eigenvalue of the assembled W K) < 4 / (1 + 2 theta)."""
    x, tets, surface = box((1.0, 0.2, 0.2), (10, 2, 2), mirror=False)
    for nu in (0.0, 0.3, 0.45, 0.49):
        material = Material(1e5, nu, 1000.0)
        w = 1 / SoftBody("bar", x, tets, surface, material).masses()
        root = sp.diags(np.sqrt(np.repeat(w, 3)))
        A = root @ fem_stiffness(x, tets, material.young, nu) @ root
        largest = spla.eigsh(A, k=1, return_eigenvectors=False)[0]
        dt = largest_substep(bounds(x, tets, w, material).max())
        assert dt * np.sqrt(bounds(x, tets, w, material).max()) == pytest.approx(STABILITY_LIMIT)
        assert dt**2 * largest < 4 / 3
