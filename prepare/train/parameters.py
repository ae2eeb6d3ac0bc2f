"""Learned parameters of Gaussians: their activation, and the gradient through it."""

import taichi as ti

from core.fields import FieldGroup
from core.quaternion import to_matrix
from render.splats import Splats

vec3, vec4 = ti.math.vec3, ti.math.vec4


@ti.data_oriented
class Parameters:
    """Rotations, scales and opacities of `splats` in unconstrained form, of shape (capacity,).

    quat       wxyz of any length
    log_scale  vec3, natural logarithm [m]
    logit      of the opacity

    Means and harmonics need no activation and are learned in `splats`.
    """

    def __init__(self, splats: Splats):
        self.splats = splats
        self.fields = f = FieldGroup()
        self.quat, self.log_scale = f.vector(splats.capacity, n=4), f.vector(splats.capacity)
        self.logit = f.scalar(splats.capacity)
        f.build()

    def destroy(self) -> None:
        """Free the device memory."""
        self.fields.destroy()

    @ti.func
    def activate(self, begin: ti.i32, end: ti.i32):
        """Write covariances and opacities of Gaussians [begin, end) to the splats; outermost level of a kernel.

        Sigma = R S S R^T.                                                                        Kerbl 2023, eq. 6
        """
        for g in range(begin, end):
            axes = self.axes(g)
            s = axes @ axes.transpose()
            self.splats.cov[g] = ti.Vector([s[0, 0], s[0, 1], s[0, 2], s[1, 1], s[1, 2], s[2, 2]])
            self.splats.opacity[g] = 1.0 / (1.0 + ti.exp(-self.logit[g]))

    @ti.func
    def axes(self, g: ti.i32):
        """R S: the columns are the axes of a Gaussian, one standard deviation long [m]."""
        axes = to_matrix(self.quat[g].normalized(1e-12))
        for k in ti.static(range(3)):
            scale = ti.exp(self.log_scale[g][k])
            for i in ti.static(range(3)):
                axes[i, k] *= scale
        return axes

    @ti.func
    def backward(self, g: ti.i32, gradients: ti.template()):
        """Gradients (quat, log_scale, logit) of a Gaussian from those of its covariance and opacity."""
        d = gradients.d_cov[g]
        d_cov = ti.Matrix(
            [[d[0], 0.5 * d[1], 0.5 * d[2]], [0.5 * d[1], d[3], 0.5 * d[4]], [0.5 * d[2], 0.5 * d[4], d[5]]]
        )
        length = ti.max(self.quat[g].norm(), 1e-12)
        q = self.quat[g] / length
        axes = self.axes(g)
        d_axes = 2.0 * d_cov @ axes
        d_log_scale, D = vec3(0.0), ti.Matrix.zero(ti.f32, 3, 3)  # D = dL/dR
        for k in ti.static(range(3)):
            scale = ti.exp(self.log_scale[g][k])
            for i in ti.static(range(3)):
                d_log_scale[k] += d_axes[i, k] * axes[i, k]
                D[i, k] = d_axes[i, k] * scale
        w, x, y, z = q[0], q[1], q[2], q[3]
        d_q = 2.0 * vec4(
            x * (D[2, 1] - D[1, 2]) + y * (D[0, 2] - D[2, 0]) + z * (D[1, 0] - D[0, 1]),
            w * (D[2, 1] - D[1, 2]) - 2 * x * (D[1, 1] + D[2, 2]) + y * (D[0, 1] + D[1, 0]) + z * (D[0, 2] + D[2, 0]),
            w * (D[0, 2] - D[2, 0]) + x * (D[0, 1] + D[1, 0]) - 2 * y * (D[0, 0] + D[2, 2]) + z * (D[1, 2] + D[2, 1]),
            w * (D[1, 0] - D[0, 1]) + x * (D[0, 2] + D[2, 0]) + y * (D[1, 2] + D[2, 1]) - 2 * z * (D[0, 0] + D[1, 1]),
        )
        d_quat = (d_q - q * q.dot(d_q)) / length
        opacity = self.splats.opacity[g]
        return d_quat, d_log_scale, gradients.d_opacity[g] * opacity * (1.0 - opacity)
