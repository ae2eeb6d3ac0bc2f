"""How each body is turned as a whole, for the coarse step (sim/elastic/modal_correction.py)."""

import taichi as ti

from core.quaternion import polar_quaternion, to_matrix
from sim.capacity import MAX_BODIES
from sim.reductions import ReductionBlocks
from sim.state import State

TURN = 15  # sums for the rotation: m x rest^T (9), m x (3), m rest (3)


@ti.data_oriented
class BestFitRotation:
    """turn mat3[B] = R of each body, which `rotations()` finds, a kernel."""

    def __init__(self, state: State, blocks: ReductionBlocks):
        self.state, self.blocks = state, blocks
        self.builder = ti.FieldsBuilder()
        self.turn, self.sums = ti.Matrix.field(3, 3, ti.f32), ti.field(ti.f32)
        self.builder.dense(ti.i, MAX_BODIES).place(self.turn)
        self.builder.dense(ti.ij, (blocks.size, TURN)).place(self.sums)
        self.tree = self.builder.finalize()

    def rotations(self):
        """R of each body: the polar rotation of sum m x (rest - mean rest)^T."""
        s, c = self.state, self.blocks

        @ti.kernel
        def rotations():
            ti.loop_config(serialize=s.serial)
            for j in range(c.size):
                span = c.span[j]
                total = ti.Matrix.zero(ti.f32, 3, 3)
                p, q = ti.Vector([0.0, 0.0, 0.0]), ti.Vector([0.0, 0.0, 0.0])
                first = s.vertex_begin[span[2]]
                for i in range(span[0], span[1]):
                    m, x, X = s.mass[i], s.x[i] - s.x[first], s.rest[i] - s.rest[first]
                    total += m * x.outer_product(X)
                    p += m * x
                    q += m * X
                for k in ti.static(range(3)):
                    for l in ti.static(range(3)):
                        self.sums[j, 3 * k + l] = total[k, l]
                    self.sums[j, 9 + k] = p[k]
                    self.sums[j, 12 + k] = q[k]
            ti.loop_config(serialize=s.serial)
            for b in range(MAX_BODIES):
                if b < s.body_count[None]:
                    total = ti.Matrix.zero(ti.f32, 3, 3)
                    p, q = ti.Vector([0.0, 0.0, 0.0]), ti.Vector([0.0, 0.0, 0.0])
                    for j in range(c.begin[b], c.begin[b + 1]):
                        for k in ti.static(range(3)):
                            for l in ti.static(range(3)):
                                total[k, l] += self.sums[j, 3 * k + l]
                            p[k] += self.sums[j, 9 + k]
                            q[k] += self.sums[j, 12 + k]
                    self.turn[b] = to_matrix(polar_quaternion(total - p.outer_product(q) / s.body_mass[b]))

        return rotations

    def destroy(self) -> None:
        self.tree.destroy()
