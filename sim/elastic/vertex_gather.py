"""Elasticity gathered by the vertices: each sums, by itself, the corrections of all tets around it.

The same corrections as those of sim/elastic/energy.py, of one sweep, but in one loop instead of two: no tet writes
anything, and the four corners of a tet each work it out again. That is more arithmetic and less waiting, which suits a
GPU. All four do so from the same numbers in the same order, so that their stresses are equal to the bit and their
corrections cancel: otherwise rounding would push the whole body.
"""

import numpy as np
import taichi as ti

from core.fields import FieldGroup, Upload
from sim.capacity import stacked
from sim.elastic.energy import CRUSHED_DJ, STRETCHED_I1, shortened_step, slots_of, stress
from sim.model import Model
from sim.state import State

OTHER_CORNERS = [[1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 1, 2]]  # of each corner


@ti.data_oriented
class VertexGather:
    """The tets around each vertex, in the slots of sim/elastic/energy.py: those of a vertex lie together.

    The fields over slots are one scalar each, because neighbouring threads read neighbouring slots.
    """

    def __init__(self, state: State):
        self.state = state
        N, V = 4 * state.T, state.V
        g = self._group = FieldGroup()
        self.other = [g.scalar(N, dtype=ti.i32) for _ in range(3)]  # the tet's other vertices, in its order
        self.gradient = [g.scalar(N) for _ in range(9)]  # of the shape functions of its corners 1, 2, 3 [1/m]
        self.corner = g.scalar(N, dtype=ti.i32)  # 4 t + c: the slot's vertex is corner c of tet t
        self.kappa = g.scalar(state.T)  # 1/s^2
        self.begin = g.scalar(V + 1, dtype=ti.i32)  # slots of each vertex
        # At the start of a substep, of even and of odd ones. Positions are in double precision, because the difference
        # of two must keep what lies under the last bit of x.
        self.position = g.vector(2, V, dtype=ti.f64)  # at which the stress is evaluated [m]
        self.increment = g.vector(2, V)  # dx [m]
        g.build()
        self._upload = Upload([*self.other, *self.gradient, self.corner, self.kappa, self.begin])

    def load(self, model: Model) -> None:
        """Take the rest shapes of these bodies."""
        shapes = model.shapes
        slots = [s.root.once(slots_of) for s in shapes]  # the same at any size
        slot = stacked([slot + 4 * o for (slot, _), o in zip(slots, model.tet_begin, strict=False)], 4)
        begin = [begin[:-1] + 4 * o for (_, begin), o in zip(slots, model.tet_begin, strict=False)]
        gradients = stacked([s.inverse.reshape(-1, 9) for s in shapes], 9)  # rows of D_m^-1
        n = len(slot)
        other, gradient = np.empty((4 * n, 3), np.int32), np.empty((4 * n, 9), np.float32)
        corner = np.empty(4 * n, np.int32)
        for c, others in enumerate(OTHER_CORNERS):
            other[slot[:, c]], gradient[slot[:, c]] = model.tets[:, others], gradients
            corner[slot[:, c]] = 4 * np.arange(n) + c
        kappa = stacked([p.kappa for p in model.bodies])
        self._upload([*other.T, *gradient.T, corner, kappa, stacked([*begin, [4 * n]])])

    @ti.func
    def publish(self, i, parity):
        """Show the neighbours of vertex i its position and increment, in substeps of this parity."""
        s = self.state
        self.increment[parity, i] = s.dx[i]
        offset = s.strain_increment(i, s.stress_lag[s.body_of_vertex[i]])
        self.position[parity, i] = ti.cast(s.x[i], ti.f64) + ti.cast(offset, ti.f64)

    @ti.func
    def correction(self, k, parity, here, mu, lam):
        """Correction (without the inverse mass) that the tet of slot k gives to its vertex, which is `here`."""
        s = self.state
        o, B = ti.static(self.other, self.gradient)
        t, c = self.corner[k] >> 2, self.corner[k] & 3
        p, q, r = self.position[parity, o[0][k]], self.position[parity, o[1][k]], self.position[parity, o[2][k]]
        x0 = here if c == 0 else p
        x1 = here if c == 1 else (p if c == 0 else q)
        x2 = here if c == 2 else (r if c == 3 else q)
        x3 = here if c == 3 else r
        e1, e2, e3 = ti.cast(x1 - x0, ti.f32), ti.cast(x2 - x0, ti.f32), ti.cast(x3 - x0, ti.f32)
        g1 = ti.Vector([B[0][k], B[1][k], B[2][k]])
        g2 = ti.Vector([B[3][k], B[4][k], B[5][k]])
        g3 = ti.Vector([B[6][k], B[7][k], B[8][k]])
        V = 1.0 / (6.0 * g1.dot(g2.cross(g3)))
        F = e1.outer_product(g1) + e2.outer_product(g2) + e3.outer_product(g3)
        P, I1, dJ = stress(F, mu, lam)
        g0 = -(g1 + g2 + g3)
        dt2 = s.dt[None] * s.dt[None]
        step = V * dt2
        if I1 > STRETCHED_I1 or dJ < CRUSHED_DJ:
            a = s.tets[t]
            if dJ < -1.0:
                s.inverted[s.body_of_tet[t]] = 1
            w = ti.Vector([s.inv_mass[a[n]] for n in range(4)])
            g = ti.static([g0, g1, g2, g3])
            W, motion = 0.0, 0.0
            for n in ti.static(range(4)):
                h = P @ g[n]
                W += w[n] * h.norm_sqr()
                motion += h.dot(self.increment[parity, a[n]])
            step = shortened_step(F, g, w, W, motion, V, I1, dJ, self.kappa[t], mu, lam, dt2)
        own = g0 if c == 0 else (g1 if c == 1 else (g2 if c == 2 else g3))
        return -step * (P @ own)

    def destroy(self) -> None:
        self._group.destroy()
