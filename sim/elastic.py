"""Elasticity: XPBD with one strain-energy constraint a tetrahedron (VR-GS, Sec. 4.1; Macklin and Mueller 2021).

All tets are projected at once (Jacobi, corrections summed, **not** averaged: averaging is 12-19 times too soft)
in two loops: every tet writes the corrections of its corners into slots that lie together for each vertex, then
every vertex sums its slots. The order of summation is fixed, so repeated runs agree bit for bit.
"""

import numpy as np
import taichi as ti

from sim.state import State, upload


@ti.func
def neo_hookean(F, mu, lam):
    """Energy density and first Piola-Kirchhoff stress [Pa], stable at rest and through inversion.

    Psi = mu/2 (tr F^T F - 3) - mu (J - 1) + lam/2 (J - 1)^2,   P = mu F + (lam (J - 1) - mu) cof F,
    lam = lambda_L + mu, cof F = [f2 x f3, f3 x f1, f1 x f2].            Smith et al. 2018 without the log term
    """
    f1 = ti.Vector([F[0, 0], F[1, 0], F[2, 0]])
    f2 = ti.Vector([F[0, 1], F[1, 1], F[2, 1]])
    f3 = ti.Vector([F[0, 2], F[1, 2], F[2, 2]])
    cof = ti.Matrix.cols([f2.cross(f3), f3.cross(f1), f1.cross(f2)])
    grow = f1.dot(f2.cross(f3)) - 1.0
    I1 = f1.norm_sqr() + f2.norm_sqr() + f3.norm_sqr()
    psi = 0.5 * mu * (I1 - 3.0) - mu * grow + 0.5 * lam * grow * grow
    P = mu * F + (lam * grow - mu) * cof
    return psi, P, I1


@ti.data_oriented
class Elastic:
    """Rest shape of all tets, and their projection.

    rest_inverse (3,3)[T] = D_m^-1 [1/m], volume f32[T] [m^3], kappa f32[T] [1/s^2] stiffness bound of each tet
    slot vec4i[T] where corner k writes; correction vec3[4T]; slot_begin i32[V+1]; multiplier f32[T] (lambda of XPBD)
    """

    def __init__(self, state: State, rest: np.ndarray, tets: np.ndarray, kappa: np.ndarray):
        self.state = state
        T, V = state.T, state.V
        self.builder = ti.FieldsBuilder()
        self.rest_inverse = ti.Matrix.field(3, 3, ti.f32)
        self.volume, self.kappa, self.multiplier = (ti.field(ti.f32) for _ in range(3))
        self.slot = ti.Vector.field(4, ti.i32)
        self.correction = ti.Vector.field(3, ti.f32)
        self.slot_begin = ti.field(ti.i32)
        self.builder.dense(ti.i, T).place(self.rest_inverse)
        self.builder.dense(ti.i, T).place(self.slot)
        for f in (self.volume, self.kappa, self.multiplier):
            self.builder.dense(ti.i, T).place(f)
        self.builder.dense(ti.i, 4 * T).place(self.correction)
        self.builder.dense(ti.i, V + 1).place(self.slot_begin)
        self.tree = self.builder.finalize()
        D = np.swapaxes(rest[tets[:, 1:]] - rest[tets[:, :1]], 1, 2)
        inverse = np.zeros((T, 3, 3), np.float32)
        inverse[: len(tets)] = np.linalg.inv(D)
        self.rest_inverse.from_numpy(inverse)
        upload(self.volume, np.linalg.det(D) / 6)
        upload(self.kappa, kappa)
        slot, begin = corner_slots(tets, len(rest))
        upload(self.slot, slot)
        upload(self.slot_begin, begin)

    @ti.func
    def project_tet(self, t, first: ti.template(), single: ti.template()):
        """Corrections s g_i of one tet (without the inverse masses), written to its corners' slots.

        U = V Psi, C = sqrt(2 U), [g1 g2 g3] = V P B^T, g0 = -(g1 + g2 + g3), q = sum w |g|^2 / C^2:
        many sweeps   s = -(1 + lambda / (dt^2 C)) / (q + 1/dt^2),   lambda += C s
        single sweep  s = -1 / (max(q - kappa, 0) + 1/dt^2)
        With one sweep lambda = 0 and the Jacobi sum over the tets of a vertex is never converged; q, which differs
        from tet to tet, then only softens a tet by up to dt^2 kappa (9% at the stability limit) and leaves the wrong
        shape at rest. At small strain q <= kappa and the stability rule already makes the step safe, so q acts only
        beyond kappa, in crushed, inverted and far stretched tets, where it shortens the step.
        """
        s_ = self.state
        a = s_.tets[t]
        b = s_.body_of_tet[t]
        mu, lam = s_.mu[b], s_.lam[b]
        dt = s_.dt[None]
        x0, d0 = s_.x[a[0]], s_.dx[a[0]]
        # differences of positions first, then of increments: what lies under the last bit of x survives
        e1 = (s_.x[a[1]] - x0) + (s_.dx[a[1]] - d0)
        e2 = (s_.x[a[2]] - x0) + (s_.dx[a[2]] - d0)
        e3 = (s_.x[a[3]] - x0) + (s_.dx[a[3]] - d0)
        B = self.rest_inverse[t]
        F = ti.Matrix.cols([e1, e2, e3]) @ B
        psi, P, I1 = neo_hookean(F, mu, lam)
        H = P @ B.transpose()
        h1 = ti.Vector([H[0, 0], H[1, 0], H[2, 0]])
        h2 = ti.Vector([H[0, 1], H[1, 1], H[2, 1]])
        h3 = ti.Vector([H[0, 2], H[1, 2], H[2, 2]])
        h0 = -(h1 + h2 + h3)
        V = self.volume[t]
        W = (
            s_.w[a[0]] * h0.norm_sqr()
            + s_.w[a[1]] * h1.norm_sqr()
            + s_.w[a[2]] * h2.norm_sqr()
            + s_.w[a[3]] * h3.norm_sqr()
        )
        # The stiffness of a tet stretched to I1 grows like |cof F|^2; beyond that bound q is rounding noise over a small C.
        kappa = self.kappa[t]
        bound = kappa * ti.max(1.0, I1 * I1 / 9.0)
        energy = ti.max(2.0 * psi, 1e-12 * mu)  # [J/m^3]
        q = ti.min(V * W / energy, bound)
        s = 0.0
        if ti.static(single):
            s = -V / (ti.max(q - kappa, 0.0) + 1.0 / (dt * dt))
        else:
            C = ti.sqrt(V * energy)
            lam_t = 0.0
            if ti.static(not first):
                lam_t = self.multiplier[t]
            step = -(1.0 + lam_t / (dt * dt * C)) / (q + 1.0 / (dt * dt))
            self.multiplier[t] = lam_t + C * step
            s = V * step
        k = self.slot[t]
        self.correction[k[0]] = s * h0
        self.correction[k[1]] = s * h1
        self.correction[k[2]] = s * h2
        self.correction[k[3]] = s * h3

    @ti.func
    def summed(self, i):
        """Correction of vertex i [m]: w_i times the sum of its slots."""
        total = ti.Vector([0.0, 0.0, 0.0])
        for k in range(self.slot_begin[i], self.slot_begin[i + 1]):
            total += self.correction[k]
        return self.state.w[i] * total


def corner_slots(tets: np.ndarray, vertices: int) -> tuple[np.ndarray, np.ndarray]:
    """Slot of each tet corner (T, 4) and first slot of each vertex (V+1,): the slots of a vertex lie together."""
    order = np.argsort(tets.ravel(), kind="stable")
    slot = np.empty(4 * len(tets), np.int64)
    slot[order] = np.arange(len(order))
    begin = np.concatenate([[0], np.cumsum(np.bincount(tets.ravel(), minlength=vertices))])
    return slot.reshape(-1, 4), begin
