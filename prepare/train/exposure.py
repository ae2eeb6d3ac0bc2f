"""Exposure of a photograph: an affine map of the rendered colours that is learned with them, and its gradient."""

import numpy as np
import taichi as ti

from core.fields import FieldGroup

IDENTITY = np.eye(3, 4, dtype=np.float32)
BLOCK = 64  # [px] of a row that one thread sums

vec3, vec4 = ti.math.vec3, ti.math.vec4


@ti.data_oriented
class Exposure:
    """The map c' = A c + b of a picture of at most (height, width), and its gradient.

    affine    rows of [A b], vec4 (3,)
    rgb       Out: the mapped picture, (1, height, width) as a renderer's
    d_affine  Out: gradient with respect to the rows, vec4 (3,)
    """

    def __init__(self, height: int, width: int):
        self.fields = f = FieldGroup()
        self.rgb = f.vector(1, height, width)
        self.affine, self.d_affine = f.vector(3, n=4), f.vector(3, n=4)
        f.build()
        self.set(IDENTITY)

    def destroy(self) -> None:
        """Free the device memory."""
        self.fields.destroy()

    def set(self, affine: np.ndarray) -> None:
        """Use [A b], (3, 4)."""
        self.affine.from_numpy(np.ascontiguousarray(affine, np.float32))

    @ti.func
    def apply(self, rgb: ti.template(), height: ti.i32, width: ti.i32):
        """Map the picture `rgb`; outermost level of a kernel."""
        for y, x in ti.ndrange(height, width):
            c = rgb[0, y, x]
            color = vec4(c.r, c.g, c.b, 1.0)
            for k in ti.static(range(3)):
                self.rgb[0, y, x][k] = self.affine[k].dot(color)

    @ti.func
    def backward(self, rgb: ti.template(), d_rgb: ti.template(), height: ti.i32, width: ti.i32):
        """Turn d_rgb from the gradient of the mapped picture into that of `rgb`; outermost level of a kernel."""
        for k in range(3):
            self.d_affine[k] = vec4(0.0)
        blocks = (width + BLOCK - 1) // BLOCK
        for i in range(height * blocks):
            y, first = i // blocks, i % blocks * BLOCK
            sums = ti.Matrix.zero(ti.f32, 3, 4)
            for x in range(first, ti.min(first + BLOCK, width)):
                c, d = rgb[0, y, x], d_rgb[y, x]
                back = vec3(0.0)
                for k in ti.static(range(3)):
                    back += d[k] * self.affine[k].xyz
                    sums[k, 3] += d[k]
                    for j in ti.static(range(3)):
                        sums[k, j] += d[k] * c[j]
                d_rgb[y, x] = back
            for k in ti.static(range(3)):
                self.d_affine[k] += vec4(sums[k, 0], sums[k, 1], sums[k, 2], sums[k, 3])
