"""Elasticity gathered by the vertices: each sums, by itself, the corrections of all tets around it.

The same corrections as those of sim/elastic/energy.py, of one sweep, but in one loop instead of two: no tet writes anything,
and the four corners of a tet each work it out again. That is more arithmetic and less waiting, which suits a GPU.
All four do so from the same numbers in the same order, so that what they take for its stress is equal to the bit and
their corrections cancel: otherwise rounding would push the whole body.
"""

import numpy as np
import taichi as ti

from core.fields import Upload
from sim.capacity import stacked
from sim.elastic.energy import CRUSHED, FAR_STRETCHED, energy_density, safe_step, slots_of, stress
from sim.model import Model
from sim.state import State

OTHERS = [[1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 1, 2]]  # the other corners of each corner


@ti.data_oriented
class VertexGather:
    """What a vertex needs of each tet around it, in the slots of sim/elastic/energy.py: those of a vertex lie together.

    The fields are one scalar each, because neighbouring threads read neighbouring slots:
        other 3 x i32[4T]      the tet's other three vertices, in its order
        gradient 9 x f32[4T]   gradients of the shape functions of its corners 1, 2, 3 [1/m]; of 0, minus their sum
        corner i32[4T]         4 t + c: the slot's vertex is corner c of tet t
        begin i32[V+1]         slots of each vertex
        place vec3 f64[2, V]   x + dx at the start of a substep, of even and of odd ones; in double precision, because
                               the difference of two must keep what lies under the last bit of x
        way vec3[2, V]         dx at the start of a substep, likewise
    """

    def __init__(self, state: State):
        self.state = state
        N = 4 * state.T
        self.builder = ti.FieldsBuilder()
        self.other = [ti.field(ti.i32) for _ in range(3)]
        self.gradient = [ti.field(ti.f32) for _ in range(9)]
        self.corner, self.kappa, self.begin = ti.field(ti.i32), ti.field(ti.f32), ti.field(ti.i32)
        for f in (*self.other, *self.gradient, self.corner):
            self.builder.dense(ti.i, N).place(f)
        self.builder.dense(ti.i, state.T).place(self.kappa)
        self.builder.dense(ti.i, state.V + 1).place(self.begin)
        self.place = ti.Vector.field(3, ti.f64)
        self.builder.dense(ti.ij, (2, state.V)).place(self.place)
        self.way = ti.Vector.field(3, ti.f32)
        self.builder.dense(ti.ij, (2, state.V)).place(self.way)
        self.tree = self.builder.finalize()
        self._upload = Upload([*self.other, *self.gradient, self.corner, self.kappa, self.begin])

    def load(self, model: Model) -> None:
        """Take the rest shapes of these bodies."""
        a, shapes = model, model.shapes
        slots = [s.root.once(slots_of) for s in shapes]  # the same at any size
        slot = stacked([slot + 4 * o for (slot, _), o in zip(slots, a.tet_begin, strict=False)], 4)
        begin = [begin[:-1] + 4 * o for (_, begin), o in zip(slots, a.tet_begin, strict=False)]
        gradients = stacked([s.inverse.reshape(-1, 9) for s in shapes], 9)  # rows of D_m^-1
        n = len(slot)
        other, gradient = np.empty((4 * n, 3), np.int32), np.empty((4 * n, 9), np.float32)
        corner = np.empty(4 * n, np.int32)
        for c, others in enumerate(OTHERS):
            other[slot[:, c]], gradient[slot[:, c]] = a.tets[:, others], gradients
            corner[slot[:, c]] = 4 * np.arange(n) + c
        kappa = stacked([p.kappa for p in a.bodies])
        self._upload([*other.T, *gradient.T, corner, kappa, stacked([*begin, [4 * n]])])

    @ti.func
    def publish(self, i, parity):
        """Let the neighbours of vertex i see where it is and where it goes, in substeps of this parity."""
        s = self.state
        self.way[parity, i] = s.dx[i]
        self.place[parity, i] = ti.cast(s.x[i], ti.f64) + ti.cast(s.dx[i], ti.f64)

    @ti.func
    def correction(self, k, parity, here, mu, lam):
        """Correction (without the inverse mass) that the tet of slot k gives to its vertex, which is `here`."""
        s = self.state
        o, g = ti.static(self.other, self.gradient)
        t, c = self.corner[k] >> 2, self.corner[k] & 3
        p, q, r = self.place[parity, o[0][k]], self.place[parity, o[1][k]], self.place[parity, o[2][k]]
        x0 = here if c == 0 else p
        x1 = here if c == 1 else (p if c == 0 else q)
        x2 = here if c == 2 else (r if c == 3 else q)
        x3 = here if c == 3 else r
        e1, e2, e3 = ti.cast(x1 - x0, ti.f32), ti.cast(x2 - x0, ti.f32), ti.cast(x3 - x0, ti.f32)
        g1 = ti.Vector([g[0][k], g[1][k], g[2][k]])
        g2 = ti.Vector([g[3][k], g[4][k], g[5][k]])
        g3 = ti.Vector([g[6][k], g[7][k], g[8][k]])
        V = 1.0 / (6.0 * g1.dot(g2.cross(g3)))
        F = e1.outer_product(g1) + e2.outer_product(g2) + e3.outer_product(g3)
        P, I1, grow = stress(F, mu, lam)
        g0 = -(g1 + g2 + g3)
        step, brake = s.dt[None] * s.dt[None], 0.0
        if I1 > FAR_STRETCHED or grow < CRUSHED:
            a = s.tets[t]
            if grow < -1.0:
                s.inverted[s.body_of_tet[t]] = 1
            G, w, way, W = ti.static([g0, g1, g2, g3]), ti.Vector([s.inv_mass[a[n]] for n in range(4)]), 0.0, 0.0
            for n in ti.static(range(4)):
                h = P @ G[n]
                W += w[n] * h.norm_sqr()
                way += h.dot(self.way[parity, a[n]])
            energy = ti.max(2.0 * energy_density(I1, grow, mu, lam), 1e-12 * mu)
            bound = self.kappa[t] * ti.max(1.0, I1 * I1 / 9.0)
            step, brake = safe_step(F, [g0, g1, g2, g3], V * w, ti.min(V * W / energy, bound), lam, step)
            brake *= way / ti.max(W, 1e-30)
        own = g0 if c == 0 else (g1 if c == 1 else (g2 if c == 2 else g3))
        return -(V * step + brake) * (P @ own)

    def destroy(self) -> None:
        self.tree.destroy()
