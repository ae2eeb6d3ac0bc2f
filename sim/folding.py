"""Which bodies are bent so far that they may touch themselves: the others are not searched for that.

With the best affine map A of the rest shape onto a body, and r the largest distance of a vertex from where A has it,
two points that are APART at rest are at least sigma_min(A) APART - 2 r from each other. While that exceeds the margin
in which contacts are looked for, nothing of the body can meet itself. A follows from sums over the vertices with
X, x relative to the first one,

    A = C S^-1,   C = sum m (x - x_c) (X - X_c)^T,   S = sum m (X - X_c) (X - X_c)^T

and sigma_min from |A^T A - I|, or from |A^-1| where the body is squeezed as a whole.
"""

import numpy as np
import taichi as ti

from sim.assembly import MAX_BODIES
from sim.broad import MARGIN, Bounds
from sim.damping import Chunks
from sim.parts import RestShape
from sim.state import State

APART = 5.0  # times a body's reach, which is half an edge: what is closer at rest does not meet
LONG = 5.0  # edges: what is shorter has no two ends that are APART and could still meet
SUMS = 22  # m; m x, m X; m x X^T; m X X^T, its upper half


@ti.data_oriented
class Folding:
    """folded i32[B];   sums f32[chunks,22], fit mat3[B] = A, center, rest_center vec3[B];   strayed f32[B] [m] = r."""

    def __init__(self, state: State, chunks: Chunks, bounds: Bounds):
        self.state, self.chunks, self.bounds = state, chunks, bounds
        self.builder = ti.FieldsBuilder()
        self.sums, self.folded, self.strayed = ti.field(ti.f32), ti.field(ti.i32), ti.field(ti.f32)
        self.fit = ti.Matrix.field(3, 3, ti.f32)
        self.center, self.rest_center = ti.Vector.field(3, ti.f32), ti.Vector.field(3, ti.f32)
        self.builder.dense(ti.ij, (chunks.size, SUMS)).place(self.sums)
        self.builder.dense(ti.i, MAX_BODIES).place(self.folded, self.strayed, self.fit, self.center, self.rest_center)
        self.tree = self.builder.finalize()

    @ti.func
    def apart(self, b):
        """How far apart two points of body b must be at rest, so that they may meet [m]."""
        return APART * self.state.reach[b]

    @ti.kernel
    def update(self):
        """Take `folded` anew; the bounds must be up to date."""
        s = self.state
        c = self.chunks
        for j in range(c.size):
            span = c.span[j]
            if span[1] > span[0]:
                first = s.vertex_begin[span[2]]
                M, p, P = 0.0, ti.Vector([0.0, 0.0, 0.0]), ti.Vector([0.0, 0.0, 0.0])
                C, S = ti.Matrix.zero(ti.f32, 3, 3), ti.Matrix.zero(ti.f32, 3, 3)
                for i in range(span[0], span[1]):
                    m, x, X = s.mass[i], s.x[i] - s.x[first], s.rest[i] - s.rest[first]
                    M += m
                    p += m * x
                    P += m * X
                    C += m * x.outer_product(X)
                    S += m * X.outer_product(X)
                self.sums[j, 0] = M
                for k in ti.static(range(3)):
                    self.sums[j, 1 + k], self.sums[j, 4 + k] = p[k], P[k]
                    for l in ti.static(range(3)):
                        self.sums[j, 7 + 3 * k + l] = C[k, l]
                for k in ti.static(range(3)):
                    self.sums[j, 16 + k], self.sums[j, 19 + k] = S[k, k], S[k, (k + 1) % 3]
        for b in range(MAX_BODIES):
            if b < s.body_count[None]:
                self._fit(b)
        for i in range(s.V):
            if i < s.vertex_count[None]:
                b = s.body_of_vertex[i]
                r = (s.x[i] - self.center[b] - self.fit[b] @ (s.rest[i] - self.rest_center[b])).norm()
                if r > self.strayed[b]:
                    ti.atomic_max(self.strayed[b], r)
        for b in range(MAX_BODIES):
            self.folded[b] = 0
            if b < s.body_count[None]:
                A = self.fit[b]
                stretch = A.transpose() @ A - ti.Matrix.identity(ti.f32, 3)
                least = ti.sqrt(ti.max(1.0 - stretch.norm(), 0.0))
                if ti.abs(A.determinant()) > 1e-6:
                    least = ti.max(least, 1.0 / A.inverse().norm())
                meeting = (self.bounds.fast[b] - self.bounds.slow[b]).norm() * s.detect_dt[None] + MARGIN
                self.folded[b] = ti.cast(least * self.apart(b) < 2.0 * self.strayed[b] + meeting, ti.i32)

    @ti.func
    def _fit(self, b):
        """The affine map of body b from the sums of its chunks."""
        s = self.state
        c = self.chunks
        total = ti.Vector.zero(ti.f32, SUMS)
        for j in range(c.of_body[b], c.of_body[b + 1]):
            for k in ti.static(range(SUMS)):
                total[k] += self.sums[j, k]
        M, first = total[0], s.vertex_begin[b]
        p, P = total[1:4] / M, total[4:7] / M
        C = ti.Matrix([[total[7 + 3 * k + l] - M * p[k] * P[l] for l in range(3)] for k in range(3)])
        xx, yy, zz = total[16] - M * P[0] * P[0], total[17] - M * P[1] * P[1], total[18] - M * P[2] * P[2]
        xy, yz, zx = total[19] - M * P[0] * P[1], total[20] - M * P[1] * P[2], total[21] - M * P[2] * P[0]
        S = ti.Matrix([[xx, xy, zx], [xy, yy, yz], [zx, yz, zz]])
        self.fit[b] = C @ S.inverse()
        self.center[b], self.rest_center[b] = s.x[first] + p, s.rest[first] + P
        self.strayed[b] = 0.0

    def destroy(self) -> None:
        self.tree.destroy()


def foldable(shape: RestShape) -> bool:
    """Whether a body is long enough for one end to reach the other."""
    return float(np.ptp(shape.vertices, axis=0).max()) > LONG * shape.edge
