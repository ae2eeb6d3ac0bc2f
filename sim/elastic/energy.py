"""Elasticity: XPBD with one strain-energy constraint a tetrahedron (VR-GS, Sec. 4.1; Macklin and Mueller 2021).

All tets are projected at once (Jacobi, corrections summed, **not** averaged: averaging is 12-19 times too soft)
in two loops: every tet writes the corrections of its corners into slots that lie together for each vertex, then
every vertex sums its slots. The order of summation is fixed, so repeated runs agree bit for bit.
"""

import numpy as np
import taichi as ti

from core.fields import Upload
from sim.body_model import RestShape
from sim.capacity import stacked
from sim.model import Model
from sim.state import State

FAR_STRETCHED = 3.5  # tr F^T F (3 at rest): a stretch by 1.3 along one axis
CRUSHED = -0.5  # J - 1: half the volume
BRAKE = 1 / 32  # of a tet's motion along its gradient, in a substep: with 1/8, crushed bodies take long to recover
SQUEEZED = 4.0  # the same for the volume's stiffness alone: what is stretched up to fourfold is not softened by it
CROWD = 8.0  # a vertex belongs to up to 24 tets, of which a third pull the same way: random starts recover from 4 to 16


@ti.func
def cofactor(F):
    """cof F = J F^-T, the derivative of J = det F."""
    f1 = ti.Vector([F[0, 0], F[1, 0], F[2, 0]])
    f2 = ti.Vector([F[0, 1], F[1, 1], F[2, 1]])
    f3 = ti.Vector([F[0, 2], F[1, 2], F[2, 2]])
    return ti.Matrix.cols([f2.cross(f3), f3.cross(f1), f1.cross(f2)])


@ti.func
def safe_step(F, g: ti.template(), w, q, lam, dt2):
    """What a single sweep does to a tet far from rest (see Elastic.project_tet): the step s <= dt^2 that is stable, and
    the share of its motion along the gradient that is taken away.

    g the 4 gradients of its shape functions, w (4) inverse masses times its volume; q = sum w |dU/dx|^2 / (2 U).
    """
    cof = cofactor(F)
    stiff = 0.0
    for k in ti.static(range(4)):
        stiff += w[k] * (cof @ g[k]).norm_sqr()
    s = ti.min(dt2, 1.0 / (CROWD * q), 1.0 / (SQUEEZED * lam * stiff + 1e-30))
    return s, BRAKE * (1.0 - s / dt2)


@ti.func
def stress(F, mu, lam):
    """First Piola-Kirchhoff stress P [Pa], with tr F^T F and J - 1.

    P = mu (1 - 2 max(1 - I1, 0)) F + (lam (J - 1) - mu) cof F,   cof F = [f2 x f3, f3 x f1, f1 x f2],   I1 = tr F^T F
    """
    cof = cofactor(F)
    f1 = ti.Vector([F[0, 0], F[1, 0], F[2, 0]])
    f2 = ti.Vector([F[0, 1], F[1, 1], F[2, 1]])
    f3 = ti.Vector([F[0, 2], F[1, 2], F[2, 2]])
    grow = f1.dot(ti.Vector([cof[0, 0], cof[1, 0], cof[2, 0]])) - 1.0
    I1 = f1.norm_sqr() + f2.norm_sqr() + f3.norm_sqr()
    return mu * (1.0 - 2.0 * ti.max(1.0 - I1, 0.0)) * F + (lam * grow - mu) * cof, I1, grow


@ti.func
def fine_stress(s: ti.template(), t, B):
    """F of tet t in the substep in progress, and its P [Pa], computed in double precision and rounded to single.

    In single precision, J - 1 is off by 1e-7: at 1e8 Pa that alone is a force like a vertex's weight, and it flickers.
    """
    a, b = s.tets[t], s.body_of_tet[t]
    x0, d0 = ti.cast(s.x[a[0]], ti.f64), ti.cast(s.dx[a[0]], ti.f64)
    e1 = (ti.cast(s.x[a[1]], ti.f64) - x0) + (ti.cast(s.dx[a[1]], ti.f64) - d0)
    e2 = (ti.cast(s.x[a[2]], ti.f64) - x0) + (ti.cast(s.dx[a[2]], ti.f64) - d0)
    e3 = (ti.cast(s.x[a[3]], ti.f64) - x0) + (ti.cast(s.dx[a[3]], ti.f64) - d0)
    F = ti.Matrix.cols([e1, e2, e3]) @ B
    P, _, _ = stress(F, s.mu[b], s.lam[b])
    return ti.cast(F, ti.f32), ti.cast(P, ti.f32)


@ti.func
def energy_density(I1, grow, mu, lam):
    """Psi = mu/2 (I1 - 3) - mu (J - 1) + lam/2 (J - 1)^2 + mu/2 max(1 - I1, 0)^2 [J/m^3],   lam = lambda_L + mu.

    Zero and stable at rest (Smith et al. 2018 without the logarithm), finite and repelling through inversion. Without
    the logarithm F = 0 would be a second stable state, into which a body of nu = 0 falls once it is pressed to half
    its size. The last term takes that away; it acts on tets only that are crushed in more than one direction.
    """
    crushed = ti.max(1.0 - I1, 0.0)
    return 0.5 * mu * (I1 - 3.0) - mu * grow + 0.5 * lam * grow * grow + 0.5 * mu * crushed * crushed


@ti.data_oriented
class Elasticity:
    """Rest shape of all tets, and their projection.

    rest_inverse (3,3)[T] = D_m^-1 [1/m], volume f32[T] [m^3], kappa f32[T] [1/s^2] stiffness bound of each tet
    slot vec4i[T] where corner k writes; correction vec3[4T]; slot_begin i32[V+1]; multiplier f32[T] (lambda of XPBD)
    """

    def __init__(self, state: State):
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
        self._upload = Upload([self.rest_inverse, self.volume, self.kappa, self.slot, self.slot_begin])

    def load(self, model: Model) -> None:
        """Take the rest shapes of these bodies."""
        a, shapes = model, model.shapes
        slots = [s.root.once(slots_of) for s in shapes]  # the same at any size
        first = 4 * a.tet_begin
        self._upload(
            [
                stacked([s.inverse.reshape(-1, 9) for s in shapes], 9),
                stacked([s.volumes for s in shapes]),
                stacked([p.kappa for p in a.bodies]),
                stacked([slot + o for (slot, _), o in zip(slots, first, strict=False)], 4),
                stacked([*(begin[:-1] + o for (_, begin), o in zip(slots, first, strict=False)), first[-1:]]),
            ]
        )

    @ti.func
    def project_tet(self, t, first: ti.template(), single: ti.template()):
        """Corrections s g_i of one tet (without the inverse masses), written to its corners' slots.

        U = V Psi, C = sqrt(2 U), [g1 g2 g3] = V P B^T, g0 = -(g1 + g2 + g3), q = sum w |g|^2 / C^2:
        many sweeps   s = -(1 + lambda / (dt^2 C)) / (q + 1/dt^2),   lambda += C s
        single sweep  s = -min(dt^2, 1 / (CROWD q), 1 / (SQUEEZED q_J)),   q_J = lam V sum w |cof F grad N|^2
        One Jacobi sweep never converges, so there the 1/(q + 1/dt^2) of each tet, which differs from tet to tet, would
        only soften it by up to dt^2 kappa (9% at the stability limit) and leave a wrong shape at rest. The stability
        rule already makes s = -dt^2 safe at small strain, where q <= kappa. The step is shortened, by enough for all
        tets that a vertex shares, only where q is far larger: in crushed, inverted and far stretched tets. There q says
        too little of one that keeps its volume: J - 1 is 0, but what keeps it so grows stiffer with |cof F|^2.
        A step that depends on the shape is no longer the step of an energy: what goes to and fro could gain by it.
        So such a tet is braked as well, along its gradient, by a share of what moves it that way.
        Elsewhere q is not even computed, which saves a third of the time.
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
        P, I1, grow = stress(F, mu, lam)
        H = P @ B.transpose()
        h1 = ti.Vector([H[0, 0], H[1, 0], H[2, 0]])
        h2 = ti.Vector([H[0, 1], H[1, 1], H[2, 1]])
        h3 = ti.Vector([H[0, 2], H[1, 2], H[2, 2]])
        h0 = -(h1 + h2 + h3)
        V = self.volume[t]
        s = -V * dt * dt
        if ti.static(not single) or I1 > FAR_STRETCHED or grow < CRUSHED:
            if grow < -1.0:
                s_.inverted[b] = 1
            # q exceeds kappa (of the rest shape) at most like |cof F|^2; beyond, it is rounding noise over a small C
            kappa = self.kappa[t]
            bound = kappa * ti.max(1.0, I1 * I1 / 9.0)
            energy = ti.max(2.0 * energy_density(I1, grow, mu, lam), 1e-12 * mu)
            W = s_.inv_mass[a[0]] * h0.norm_sqr() + s_.inv_mass[a[1]] * h1.norm_sqr()
            W += s_.inv_mass[a[2]] * h2.norm_sqr() + s_.inv_mass[a[3]] * h3.norm_sqr()
            q = ti.min(V * W / energy, bound)
            if ti.static(single):
                g1 = ti.Vector([B[0, 0], B[0, 1], B[0, 2]])
                g2 = ti.Vector([B[1, 0], B[1, 1], B[1, 2]])
                g3 = ti.Vector([B[2, 0], B[2, 1], B[2, 2]])
                w = V * ti.Vector([s_.inv_mass[a[0]], s_.inv_mass[a[1]], s_.inv_mass[a[2]], s_.inv_mass[a[3]]])
                step, brake = safe_step(F, [-(g1 + g2 + g3), g1, g2, g3], w, q, lam, dt * dt)
                way = h0.dot(d0) + h1.dot(s_.dx[a[1]]) + h2.dot(s_.dx[a[2]]) + h3.dot(s_.dx[a[3]])
                s = -(V * step + brake * way / ti.max(W, 1e-30))
            else:
                C = ti.sqrt(V * energy)
                before = 0.0
                if ti.static(not first):
                    before = self.multiplier[t]
                step = -(1.0 + before / (dt * dt * C)) / (q + 1.0 / (dt * dt))
                self.multiplier[t] = before + C * step
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
        return self.state.inv_mass[i] * total


def slots_of(shape: RestShape) -> tuple[np.ndarray, np.ndarray]:
    return corner_slots(shape.tets, len(shape.vertices))


def corner_slots(tets: np.ndarray, vertices: int) -> tuple[np.ndarray, np.ndarray]:
    """Slot of each tet corner (T, 4) and first slot of each vertex (V+1,): the slots of a vertex lie together."""
    order = np.argsort(tets.ravel(), kind="stable")
    slot = np.empty(4 * len(tets), np.int64)
    slot[order] = np.arange(len(order))
    begin = np.concatenate([[0], np.cumsum(np.bincount(tets.ravel(), minlength=vertices))])
    return slot.reshape(-1, 4), begin


def corners_of(shape: RestShape) -> np.ndarray:
    """The corner 4 t + k that writes each slot, (4T,)."""
    slot, _ = slots_of(shape)
    corner = np.empty(slot.size, np.int64)
    corner[slot.ravel()] = np.arange(slot.size)
    return corner
