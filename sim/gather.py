"""Elasticity gathered by the vertices: each sums, by itself, the corrections of all tets around it.

The same corrections as those of sim/elastic.py, of one sweep, but in one loop instead of two: no tet writes anything,
and the four corners of a tet each work it out again. That is more arithmetic and less waiting, which suits a GPU.
"""

import numpy as np
import taichi as ti

from sim.assembly import Assembly, stacked
from sim.elastic import CROWD, CRUSHED, FAR_STRETCHED, energy_density, slots_of, stress
from sim.state import State, Upload

OTHERS = [[1, 2, 3], [0, 3, 2], [0, 1, 3], [0, 2, 1]]  # the other corners of each corner, in positive order


@ti.data_oriented
class Gather:
    """What a vertex needs of each tet around it, in the slots of sim/elastic.py: those of a vertex lie together.

    The fields are one scalar each, because neighbouring threads read neighbouring slots:
        other 3 x i32[4T]      the tet's other three vertices
        gradient 9 x f32[4T]   gradients of their shape functions [1/m]; the vertex's own is minus their sum
        tet i32[4T];           begin i32[V+1] slots of each vertex
        place vec3 f64[2, V]   x + dx at the start of a substep, of even and of odd ones; in double precision, because
                               the difference of two must keep what lies under the last bit of x
    """

    def __init__(self, state: State):
        self.state = state
        N = 4 * state.T
        self.builder = ti.FieldsBuilder()
        self.other = [ti.field(ti.i32) for _ in range(3)]
        self.gradient = [ti.field(ti.f32) for _ in range(9)]
        self.tet, self.kappa, self.begin = ti.field(ti.i32), ti.field(ti.f32), ti.field(ti.i32)
        for f in (*self.other, *self.gradient, self.tet):
            self.builder.dense(ti.i, N).place(f)
        self.builder.dense(ti.i, state.T).place(self.kappa)
        self.builder.dense(ti.i, state.V + 1).place(self.begin)
        self.place = ti.Vector.field(3, ti.f64)
        self.builder.dense(ti.ij, (2, state.V)).place(self.place)
        self.tree = self.builder.finalize()
        self._upload = Upload([*self.other, *self.gradient, self.tet, self.kappa, self.begin])

    def load(self, assembly: Assembly) -> None:
        """Take the rest shapes of these bodies."""
        a, shapes = assembly, assembly.shapes
        slots = [s.root.once(slots_of) for s in shapes]  # the same at any size
        slot = stacked([slot + 4 * o for (slot, _), o in zip(slots, a.tet_begin, strict=False)], 4)
        begin = [begin[:-1] + 4 * o for (_, begin), o in zip(slots, a.tet_begin, strict=False)]
        inner = stacked([s.inverse.reshape(-1, 9) for s in shapes], 9).reshape(-1, 3, 3)
        gradients = np.concatenate([-inner.sum(1, keepdims=True), inner], axis=1)  # (T, 4, 3)
        n = len(slot)
        other, gradient = np.empty((4 * n, 3), np.int32), np.empty((4 * n, 9), np.float32)
        tet = np.empty(4 * n, np.int32)
        for c, others in enumerate(OTHERS):
            other[slot[:, c]] = a.tets[:, others]
            gradient[slot[:, c]] = gradients[:, others].reshape(-1, 9)
            tet[slot[:, c]] = np.arange(n)
        kappa = stacked([p.kappa for p in a.parts])
        self._upload([*other.T, *gradient.T, tet, kappa, stacked([*begin, [4 * n]])])

    @ti.func
    def publish(self, i, parity):
        """Let the neighbours of vertex i see where it is, in substeps of this parity."""
        s = self.state
        self.place[parity, i] = ti.cast(s.x[i], ti.f64) + ti.cast(s.dx[i], ti.f64)

    @ti.func
    def correction(self, k, parity, here, mu, lam):
        """Correction (without the inverse mass) that the tet of slot k gives to its vertex, which is `here`."""
        s = self.state
        e1 = ti.cast(self.place[parity, self.other[0][k]] - here, ti.f32)
        e2 = ti.cast(self.place[parity, self.other[1][k]] - here, ti.f32)
        e3 = ti.cast(self.place[parity, self.other[2][k]] - here, ti.f32)
        g = ti.static(self.gradient)
        g1 = ti.Vector([g[0][k], g[1][k], g[2][k]])
        g2 = ti.Vector([g[3][k], g[4][k], g[5][k]])
        g3 = ti.Vector([g[6][k], g[7][k], g[8][k]])
        V = 1.0 / (6.0 * g1.dot(g2.cross(g3)))
        P, I1, grow = stress(e1.outer_product(g1) + e2.outer_product(g2) + e3.outer_product(g3), mu, lam)
        dt2 = s.dt[None] * s.dt[None]
        step = dt2
        if I1 > FAR_STRETCHED or grow < CRUSHED:
            t = self.tet[k]
            a = s.tets[t]
            if grow < -1.0:
                s.inverted[s.body_of_tet[t]] = 1
            own = P @ (g1 + g2 + g3)
            W = self._others_weight(k, P @ g1, P @ g2, P @ g3) + s.w[self._own(k, a)] * own.norm_sqr()
            energy = ti.max(2.0 * energy_density(I1, grow, mu, lam), 1e-12 * mu)
            q = ti.min(V * W / energy, self.kappa[t] * ti.max(1.0, I1 * I1 / 9.0))
            step = ti.min(dt2, 1.0 / (CROWD * q))
        return V * step * (P @ (g1 + g2 + g3))

    @ti.func
    def _others_weight(self, k, h1, h2, h3):
        """sum w |h|^2 of the other three corners."""
        s = self.state
        o = ti.static(self.other)
        return s.w[o[0][k]] * h1.norm_sqr() + s.w[o[1][k]] * h2.norm_sqr() + s.w[o[2][k]] * h3.norm_sqr()

    @ti.func
    def _own(self, k, a):
        """The corner of tet a that is none of slot k's other three."""
        o = ti.static(self.other)
        return a[0] + a[1] + a[2] + a[3] - o[0][k] - o[1][k] - o[2][k]

    def destroy(self) -> None:
        self.tree.destroy()
