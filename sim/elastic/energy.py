"""Stable neo-Hookean energy of tetrahedra, and what integrators take from it: steps of XPBD, and forces.

XPBD has one strain-energy constraint a tetrahedron (VR-GS, Sec. 4.1; Macklin and Mueller 2021). All tets are projected
at once (Jacobi, corrections summed, **not** averaged: averaging is 12-19 times too soft) in two loops: every tet writes
the corrections of its corners into slots that lie together for each vertex, then every vertex sums its slots. The order
of summation is fixed, so repeated runs agree bit for bit.
"""

import numpy as np
import taichi as ti

from core.fields import FieldGroup, Upload
from sim.model import Model, RestShape, stacked
from sim.state import State

# Beyond these a tet's XPBD step is shortened and braked (see Elasticity.project_tet)
STRETCHED_I1 = 3.5  # tr F^T F (3 at rest): a stretch by 1.3 along one axis
CRUSHED_DJ = -0.5  # J - 1: half the volume
TET_OVERLAP = 8.0  # tets that push a vertex the same way, of up to 24: random starts recover from 4 to 16
VOLUME_OVERLAP = 4.0  # the same for the volume's stiffness alone: a body stretched up to fourfold is not softened by it
BRAKE = 1 / 32  # of a tet's motion along its gradient, in a substep: with 1/8, crushed bodies take long to recover


@ti.func
def column(F, k: ti.template()):
    """Column k of a 3x3 matrix."""
    return ti.Vector([F[0, k], F[1, k], F[2, k]])


@ti.func
def row(B, k: ti.template()):
    """Row k of a 3x3 matrix."""
    return ti.Vector([B[k, 0], B[k, 1], B[k, 2]])


@ti.func
def cofactor(F):
    """cof F = J F^-T = [f2 x f3, f3 x f1, f1 x f2], the derivative of J = det F."""
    f1, f2, f3 = column(F, 0), column(F, 1), column(F, 2)
    return ti.Matrix.cols([f2.cross(f3), f3.cross(f1), f1.cross(f2)])


@ti.func
def stress(F, mu, lam):
    """First Piola-Kirchhoff stress P [Pa], with I1 = tr F^T F and J - 1.

    P = mu (1 - 2 max(1 - I1, 0)) F + (lam (J - 1) - mu) cof F
    """
    cof = cofactor(F)
    f1, f2, f3 = column(F, 0), column(F, 1), column(F, 2)
    dJ = f1.dot(column(cof, 0)) - 1.0
    I1 = f1.norm_sqr() + f2.norm_sqr() + f3.norm_sqr()
    return mu * (1.0 - 2.0 * ti.max(1.0 - I1, 0.0)) * F + (lam * dJ - mu) * cof, I1, dJ


@ti.func
def fine_edge(x, dx, x0, dx0):
    """Edge from x0 + dx0 to x + dx in double precision, in which their difference keeps every bit."""
    return (ti.cast(x, ti.f64) - ti.cast(x0, ti.f64)) + (ti.cast(dx, ti.f64) - ti.cast(dx0, ti.f64))


@ti.func
def tet_edges(s: ti.template(), t):
    """Edges of tet t from its first corner in the substep in progress, where the stress is evaluated, f64."""
    a = s.tets[t]
    lag = s.stress_lag[s.body_of_tet[t]]
    x0, d0 = s.x[a[0]], s.strain_increment(a[0], lag)
    e1 = fine_edge(s.x[a[1]], s.strain_increment(a[1], lag), x0, d0)
    e2 = fine_edge(s.x[a[2]], s.strain_increment(a[2], lag), x0, d0)
    return e1, e2, fine_edge(s.x[a[3]], s.strain_increment(a[3], lag), x0, d0)


@ti.func
def energy_density(I1, dJ, mu, lam):
    """Psi = mu/2 (I1 - 3) - mu (J - 1) + lam/2 (J - 1)^2 + mu/2 max(1 - I1, 0)^2 [J/m^3],   lam = lambda_L + mu.

    Zero and stable at rest (Smith et al. 2018 without the logarithm), finite and repelling through inversion. Without
    the logarithm F = 0 would be a second stable state, into which a body of nu = 0 falls once it is pressed to half
    its size. The last term takes that away; it acts on tets only that are crushed in more than one direction.
    """
    crushed = ti.max(1.0 - I1, 0.0)
    return 0.5 * mu * (I1 - 3.0) - mu * dJ + 0.5 * lam * dJ * dJ + 0.5 * mu * crushed * crushed


@ti.func
def shortened_step(F, g: ti.template(), w, W, motion, V, I1, dJ, kappa, mu, lam, dt2):
    """Stable step for a tet far from rest, with its brake: -s of Elasticity.project_tet.

    q exceeds kappa (of the rest shape) at most like |cof F|^2; beyond, it is rounding noise over a small C.
    g: the 4 gradients of its shape functions; W = sum w |h|^2 and motion = sum h . dx of the gradients h of Psi, which
    come as sums because four vectors more would cost the persistent kernel its registers.
    """
    energy = ti.max(2.0 * energy_density(I1, dJ, mu, lam), 1e-12 * mu)
    q = ti.min(V * W / energy, kappa * ti.max(1.0, I1 * I1 / 9.0))
    cof, volume_stiffness = cofactor(F), 0.0
    for k in ti.static(range(4)):
        volume_stiffness += V * w[k] * (cof @ g[k]).norm_sqr()
    step = ti.min(dt2, 1.0 / (TET_OVERLAP * q), 1.0 / (VOLUME_OVERLAP * lam * volume_stiffness + 1e-30))
    return V * step + BRAKE * (1.0 - step / dt2) * motion / ti.max(W, 1e-30)


@ti.data_oriented
class Elasticity:
    """Rest shape of all tets, their projection, and their forces."""

    def __init__(self, state: State):
        self.state = state
        T, V = state.T, state.V
        g = self._group = FieldGroup()
        self.rest_inverse = g.matrix(T)  # B = D_m^-1 [1/m]; row k is the gradient of the shape function of corner k + 1
        self.volume = g.scalar(T)  # at rest [m^3]
        self.kappa = g.scalar(T)  # stiffness bound [1/s^2]
        self.slot = g.vector(T, n=4, dtype=ti.i32)  # slot of each corner
        self.slots = g.vector(4 * T)  # corrections or forces of corners; those of a vertex lie together
        self.slot_begin = g.scalar(V + 1, dtype=ti.i32)  # first slot of each vertex
        g.build()
        self._upload = Upload([self.rest_inverse, self.volume, self.kappa, self.slot, self.slot_begin])

    def load(self, model: Model) -> None:
        """Take the rest shapes of these bodies."""
        shapes, first = model.shapes, 4 * model.tet_begin
        slots = [s.root.once(slots_of) for s in shapes]  # the same at any size
        self._upload(
            [
                stacked([s.inverse.reshape(-1, 9) for s in shapes], 9),
                stacked([s.volumes for s in shapes]),
                stacked([p.kappa for p in model.bodies]),
                stacked([slot + o for (slot, _), o in zip(slots, first, strict=False)], 4),
                stacked([*(begin[:-1] + o for (_, begin), o in zip(slots, first, strict=False)), first[-1:]]),
            ]
        )

    @ti.func
    def project_tet(self, t):
        """Corrections s g_i of one tet (without the inverse masses), written to its corners' slots.

        U = V Psi, C = sqrt(2 U), [g1 g2 g3] = V P B^T, g0 = -(g1 + g2 + g3), q = sum w |g|^2 / C^2:
            s = -min(dt^2, 1 / (TET_OVERLAP q), 1 / (VOLUME_OVERLAP q_J)),   q_J = lam V sum w |cof F grad N|^2
        One Jacobi sweep never converges, so XPBD's 1/(q + 1/dt^2) of each tet, which differs from tet to tet, would
        only soften it by up to dt^2 kappa (9% at the stability limit) and leave a wrong shape at rest. The stability
        rule already makes s = -dt^2 safe at small strain, where q <= kappa. The step is shortened, by enough for all
        tets that a vertex shares, only where q is far larger: in crushed, inverted and far stretched tets. There q says
        too little of one that keeps its volume: J - 1 is 0, but what keeps it so grows stiffer with |cof F|^2.
        A step that depends on the shape is no longer the step of an energy: an oscillation could gain by it.
        So such a tet is braked as well, along its gradient, by a fraction of what moves it that way.
        Elsewhere q is not even computed, which saves a third of the time.
        """
        s_ = self.state
        a = s_.tets[t]
        b = s_.body_of_tet[t]
        mu, lam = s_.mu[b], s_.lam[b]
        dt = s_.dt[None]
        lag = s_.stress_lag[b]
        x0, d0 = s_.x[a[0]], s_.strain_increment(a[0], lag)
        # differences of positions first, then of increments: what lies under the last bit of x survives
        e1 = (s_.x[a[1]] - x0) + (s_.strain_increment(a[1], lag) - d0)
        e2 = (s_.x[a[2]] - x0) + (s_.strain_increment(a[2], lag) - d0)
        e3 = (s_.x[a[3]] - x0) + (s_.strain_increment(a[3], lag) - d0)
        B = self.rest_inverse[t]
        F = ti.Matrix.cols([e1, e2, e3]) @ B
        P, I1, dJ = stress(F, mu, lam)
        H = P @ B.transpose()
        V = self.volume[t]
        s = -V * dt * dt
        if I1 > STRETCHED_I1 or dJ < CRUSHED_DJ:
            if dJ < -1.0:
                s_.inverted[b] = 1
            kappa = self.kappa[t]
            h1, h2, h3 = column(H, 0), column(H, 1), column(H, 2)
            h0 = -(h1 + h2 + h3)
            w = ti.Vector([s_.inv_mass[a[0]], s_.inv_mass[a[1]], s_.inv_mass[a[2]], s_.inv_mass[a[3]]])
            W = w[0] * h0.norm_sqr() + w[1] * h1.norm_sqr()
            W += w[2] * h2.norm_sqr() + w[3] * h3.norm_sqr()
            g1, g2, g3 = row(B, 0), row(B, 1), row(B, 2)
            g = ti.static([-(g1 + g2 + g3), g1, g2, g3])
            motion = h0.dot(s_.dx[a[0]]) + h1.dot(s_.dx[a[1]]) + h2.dot(s_.dx[a[2]]) + h3.dot(s_.dx[a[3]])
            s = -shortened_step(F, g, w, W, motion, V, I1, dJ, kappa, mu, lam, dt * dt)
        self._write(t, H, s)

    @ti.func
    def write_forces(self, t):
        """Elastic forces of tet t [N], f_k = -V P B^T e_k, written to its corners' slots.

        P is computed in double precision and rounded to single. In single precision, J - 1 is off by 1e-7: at 1e8 Pa
        that alone is a force like a vertex's weight, and it flickers.
        """
        s = self.state
        B, b = self.rest_inverse[t], s.body_of_tet[t]
        e1, e2, e3 = tet_edges(s, t)
        F = ti.Matrix.cols([e1, e2, e3]) @ B
        P, _, _ = stress(F, s.mu[b], s.lam[b])
        if ti.cast(F, ti.f32).determinant() < 0.0:
            s.inverted[b] = 1
        self._write(t, -self.volume[t] * (ti.cast(P, ti.f32) @ B.transpose()), 1.0)

    @ti.func
    def _write(self, t, H, s):
        """Write s times the columns of H, and minus their sum, to the slots of corners 1, 2, 3, and 0."""
        h1, h2, h3, k = column(H, 0), column(H, 1), column(H, 2), self.slot[t]
        self.slots[k[0]] = s * -(h1 + h2 + h3)
        self.slots[k[1]] = s * h1
        self.slots[k[2]] = s * h2
        self.slots[k[3]] = s * h3

    @ti.func
    def add_slots(self, i, value):
        """Add the slots of vertex i to a value, in their order."""
        total = value
        for k in range(self.slot_begin[i], self.slot_begin[i + 1]):
            total += self.slots[k]
        return total

    @ti.func
    def correction(self, i):
        """Correction of vertex i [m]: w_i times the sum of its slots."""
        return self.state.inv_mass[i] * self.add_slots(i, ti.Vector([0.0, 0.0, 0.0]))


def corners_of(shape: RestShape) -> np.ndarray:
    """Corner 4 t + k that writes each slot, (4T,): the slots of a vertex lie together."""
    return np.argsort(shape.tets.ravel(), kind="stable")


def slots_of(shape: RestShape) -> tuple[np.ndarray, np.ndarray]:
    """Slot of each tet corner (T, 4) and first slot of each vertex, and the end of the last (V+1,)."""
    counts = np.bincount(shape.tets.ravel(), minlength=len(shape.vertices))
    return np.argsort(shape.once(corners_of)).reshape(-1, 4), np.concatenate([[0], np.cumsum(counts)])
