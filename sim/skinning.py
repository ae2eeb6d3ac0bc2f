"""Linear blend skinning of kinematic vertices, on the device.

x_i = sum_k w_ik  M_j(i,k)  X_i,    M = world_from_body  world_j  inverse_bind_j; its twin: assets/animation.py, skin.
"""

import numpy as np
import taichi as ti

from core.fields import FieldGroup, Upload


@ti.data_oriented
class Skinning:
    """Kinematic vertices of one body that follow a skeleton.

    first     index of the body's first vertex among the solver's
    vertices  indices of the kinematic vertices, from the body's first, (D,)
    points    their rest positions [m], (D, 3)
    joints    that move each, (D, 4); weights of these, (D, 4)
    count     number of joints
    """

    def __init__(self, first: int, vertices, points, joints, weights, count: int):
        D, self.first = len(vertices), first
        f = FieldGroup()
        self.index, self.joint = f.scalar(D, dtype=ti.i32), f.vector(D, n=4, dtype=ti.i32)
        self.point, self.weight = f.vector(D), f.vector(D, n=4)
        self.matrix = f.matrix(count, n=3, m=4)
        f.build()
        Upload([self.index, self.joint, self.point, self.weight])([vertices, joints, points, weights])

    def pose(self, matrices: np.ndarray, targets, first: int | None = None) -> None:
        """Out: positions [m] of the vertices in the field `targets`, vec3 (V,), by the joints' matrices (J, 4, 4).

        `first`: first vertex of a copy of the body.
        """
        first = self.first if first is None else first
        self._pose(np.ascontiguousarray(matrices[:, :3], np.float32), first, targets)

    @ti.kernel
    def _pose(self, matrices: ti.types.ndarray(ti.f32, 3), first: ti.i32, targets: ti.template()):
        for j in self.matrix:
            for a, b in ti.static(ti.ndrange(3, 4)):
                self.matrix[j][a, b] = matrices[j, a, b]
        for i in self.index:
            x = self.point[i]
            y = ti.Vector([0.0, 0.0, 0.0])
            for k in ti.static(range(4)):
                M = self.matrix[self.joint[i][k]]
                y += self.weight[i][k] * (M @ ti.Vector([x[0], x[1], x[2], 1.0]))
            targets[first + self.index[i]] = y
