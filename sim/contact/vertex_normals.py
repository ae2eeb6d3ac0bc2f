"""Normals of the bodies' surfaces at their vertices, as they are at a search."""

import taichi as ti

from sim.state import State

UNIT = 2.0**20  # integer steps in a unit normal: sums of integers do not depend on the order


@ti.data_oriented
class VertexNormals:
    """normal vec3[V]: unit mean of the normals of a vertex's triangles, 0 inside;   sum vec3i[V]."""

    def __init__(self, state: State):
        self.state = state
        self.builder = ti.FieldsBuilder()
        self.normal, self.sum = ti.Vector.field(3, ti.f32), ti.Vector.field(3, ti.i32)
        self.builder.dense(ti.i, state.V).place(self.normal, self.sum)
        self.tree = self.builder.finalize()

    @ti.kernel
    def update(self):
        s = self.state
        for i in range(s.V):
            self.sum[i] = ti.Vector([0, 0, 0])
        for k in range(s.S):
            if k < s.triangle_count[None]:
                a = s.triangles[k]
                n = (s.x[a[1]] - s.x[a[0]]).cross(s.x[a[2]] - s.x[a[0]])
                length = n.norm()
                if length > 0.0:
                    step = ti.cast(n * (UNIT / length), ti.i32)
                    for j in ti.static(range(3)):
                        for axis in ti.static(range(3)):
                            ti.atomic_add(self.sum[a[j]][axis], step[axis])
        for i in range(s.V):
            n = ti.cast(self.sum[i], ti.f32)
            self.normal[i] = n / ti.max(n.norm(), 1.0)

    def destroy(self) -> None:
        self.tree.destroy()
