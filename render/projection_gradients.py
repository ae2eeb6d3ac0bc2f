"""Backward pass of the projection: gradients of splats in a picture to those of Gaussians and camera."""

import taichi as ti

from core import spherical_harmonics as harmonics
from core.fields import FieldGroup
from core.quaternion import conjugate, rotate_inverse
from render.blend_gradients import LN2, BlendGradients
from render.projection import HALF_LOG2_E, times
from render.splats import color_of

vec3, vec4 = ti.math.vec3, ti.math.vec4
vec6 = ti.types.vector(6, ti.f32)


@ti.data_oriented
class ProjectionGradients:
    """Gradients of a loss with respect to the Gaussians of `Splats`, and to the camera.

    Out, of shape (capacity,), set for Gaussians in the picture and left as they are for all others, see `seen`:
    d_mean     vec3 [1/m]
    d_cov      vec6 [1/m^2], with respect to the six stored entries; an off-diagonal one counts for two
    d_opacity  scalar
    d_sh       vec3 (capacity, coefficients)
    d_camera   vec4 (3,): with respect to the rows of world_to_camera, a sum over all Gaussians; with `of_camera`
    """

    def __init__(self, blend: BlendGradients, *, of_camera: bool = True):
        self.blend, self.projection, self.of_camera = blend, blend.projection, of_camera
        self.splats = splats = self.projection.splats
        self.fields = f = FieldGroup()
        self.d_mean, self.d_cov = f.vector(splats.capacity), f.vector(splats.capacity, n=6)
        self.d_opacity = f.scalar(splats.capacity)
        self.d_sh = f.vector(splats.capacity, splats.coefficients)
        self.d_camera = f.vector(3, n=4)
        f.build()

    def destroy(self) -> None:
        """Free the device memory."""
        self.fields.destroy()

    @ti.func
    def seen(self, g: ti.i32):
        """True if Gaussian g is in the picture."""
        return self.projection.tile_mask[0, g][1] != 0

    @ti.func
    def backward(self, begin: ti.i32, end: ti.i32):
        """Compute the gradients of Gaussians [begin, end); outermost level of a kernel."""
        for k in range(3):
            self.d_camera[k] = vec4(0.0)
        for g in range(begin, end):
            if self.seen(g):
                self._backward(g)

    @ti.func
    def _backward(self, g: ti.i32):
        """Gradients of a Gaussian; S = M Sigma M^T + DILATION I is its covariance in the picture, with M = J W."""
        camera = ti.static(self.projection.camera)
        mean, s = self.splats.mean[g], self.splats.cov[g]
        W = ti.Matrix.rows([camera[0, 0].xyz, camera[0, 1].xyz, camera[0, 2].xyz])
        offset = vec3(camera[0, 0].w, camera[0, 1].w, camera[0, 2].w)
        p = W @ mean + offset
        d_mean2d = self.blend.d_mean2d(g)
        d_p = vec3(0.0, 0.0, d_mean2d.w)

        # the centre: x = fx p.x / p.z + cx
        scale_x, scale_y = camera[0, 3][0] / p.z, camera[0, 3][1] / p.z
        d_p += vec3(
            scale_x * d_mean2d.x,
            scale_y * d_mean2d.y,
            -(scale_x * p.x * d_mean2d.x + scale_y * p.y * d_mean2d.y) / p.z,
        )

        # the covariance
        x_free, y_free = p.x / p.z, p.y / p.z
        x, y = self.projection.held_tangents(0, x_free, y_free)
        right, down, forward = camera[0, 0].xyz, camera[0, 1].xyz, camera[0, 2].xyz
        mx, my = scale_x * (right - x * forward), scale_y * (down - y * forward)  # the rows of M
        sx, sy = times(s, mx), times(s, my)  # Sigma M^T
        d_xx, d_xy, d_yy, d_opacity = self._backward_splat(g, d_mean2d.z, mx, my, sx, sy)
        self.d_opacity[g] = d_opacity
        d_cov = vec6(0.0)
        for i, j in ti.static([(0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)]):
            at = ti.static(i * 3 + j - i * (i + 1) // 2)
            value = d_xx * mx[i] * mx[j] + d_xy * (mx[i] * my[j] + mx[j] * my[i]) + d_yy * my[i] * my[j]
            d_cov[at] = value if ti.static(i == j) else 2.0 * value
        self.d_cov[g] = d_cov
        d_mx, d_my = 2.0 * (d_xx * sx + d_xy * sy), 2.0 * (d_xy * sx + d_yy * sy)
        along_x, along_y = d_mx.dot(forward), d_my.dot(forward)
        d_p.z -= (d_mx.dot(mx) + d_my.dot(my)) / p.z  # through 1/z of the scales
        if x == x_free:
            d_p += scale_x * along_x / p.z * vec3(-1.0, 0.0, x)
        if y == y_free:
            d_p += scale_y * along_y / p.z * vec3(0.0, -1.0, y)
        d_forward = -scale_x * x * d_mx - scale_y * y * d_my

        # the colour, seen along mean - eye
        d_ray = self._backward_color(g, mean - self.eye())
        self.d_mean[g] = W.transpose() @ d_p + d_ray
        if ti.static(self.of_camera):
            d_eye = -d_ray  # eye = -W^T offset
            rows = ti.Matrix.rows([scale_x * d_mx, scale_y * d_my, d_forward])
            for k in ti.static(range(3)):
                d_row = d_p[k] * mean + vec3(rows[k, 0], rows[k, 1], rows[k, 2]) - offset[k] * d_eye
                d_w = d_p[k] - d_eye.dot(camera[0, k].xyz)
                self.d_camera[k] += vec4(d_row, d_w)

    @ti.func
    def _backward_splat(self, g: ti.i32, d_log_opacity: ti.f32, mx: vec3, my: vec3, sx: vec3, sy: vec3):
        """Gradients with respect to S (xx, xy, yy) and the opacity; mx, my: rows of M, sx, sy: columns of Sigma M^T."""
        conic = self.projection.conic[0, g] / HALF_LOG2_E  # S^-1 = [[a, b], [b, c]]
        a, b, c = conic[0], conic[1], conic[2]
        d_conic = self.blend.d_conic(g) * HALF_LOG2_E
        d_a, d_b, d_c = d_conic[0], 0.5 * d_conic[1], d_conic[2]  # a half for each off-diagonal entry
        # dL/dS = -S^-1 (dL/dS^-1) S^-1
        u, v, w = d_a * a + d_b * b, d_a * b + d_b * c, d_b * a + d_c * b
        t = d_b * b + d_c * c
        d_xx, d_xy, d_yy = -(a * u + b * w), -(a * v + b * t), -(b * v + c * t)
        d_opacity = 0.0
        opacity = self.splats.opacity[g]
        if opacity <= 1.0:
            d_opacity = d_log_opacity / (opacity * LN2)
        if ti.static(self.projection.antialias):
            # opacity sqrt(det S' / det S), S' = S - DILATION I: d log det S' = S'^-1
            xx, xy, yy = mx.dot(sx), mx.dot(sy), my.dot(sy)
            sharp = xx * yy - xy * xy
            if sharp > 0.0:
                factor = 0.5 / LN2 * d_log_opacity
                d_xx += factor * (yy / sharp - a)
                d_xy += factor * (-xy / sharp - b)
                d_yy += factor * (xx / sharp - c)
        return d_xx, d_xy, d_yy, d_opacity

    @ti.func
    def eye(self) -> vec3:
        """The camera's centre [m]."""
        eye = vec3(0.0)
        for k in ti.static(range(3)):
            eye -= self.projection.camera[0, k].w * self.projection.camera[0, k].xyz
        return eye

    @ti.func
    def _backward_color(self, g: ti.i32, ray: vec3) -> vec3:
        """Write the gradient of the harmonics; returns that of the ray from the eye to the mean."""
        value = color_of(self.splats, g, ray)
        d_value = self.blend.d_color(g) * self.splats.visibility[g]
        for k in ti.static(range(3)):
            d_value[k] = d_value[k] if value[k] > 0.0 else 0.0
        length = ti.max(ray.norm(), 1e-12)
        d = rotate_inverse(self.splats.rotation[g], ray / length)
        basis, slope = basis_and_slopes(d, self.splats.coefficients)
        d_direction = vec3(0.0)
        for k in ti.static(range(self.splats.coefficients)):
            self.d_sh[g, k] = basis[k] * d_value
            weight = self.splats.sh[g, k].dot(d_value)
            d_direction += weight * vec3(slope[k, 0], slope[k, 1], slope[k, 2])
        turned = rotate_inverse(conjugate(self.splats.rotation[g]), d_direction)
        unit = ray / length
        return (turned - unit * unit.dot(turned)) / length


@ti.func
def basis_and_slopes(d: vec3, count: ti.template()):
    """The first `count` basis functions at unit direction d, (count,), and their derivatives d/dd, (count, 3).

    Derivatives are those of the polynomials; the caller projects them onto the tangent plane of the sphere.
    """
    basis, slope = ti.Vector.zero(ti.f32, count), ti.Matrix.zero(ti.f32, count, 3)
    x, y, z = d.x, d.y, d.z
    C1, C2, C3 = ti.static(harmonics.C1), ti.static(harmonics.C2), ti.static(harmonics.C3)
    basis[0] = harmonics.C0
    if ti.static(count > 1):
        basis[1], basis[2], basis[3] = -C1 * y, C1 * z, -C1 * x
        slope[1, 1], slope[2, 2], slope[3, 0] = -C1, C1, -C1
    if ti.static(count > 4):
        xx, yy, zz = x * x, y * y, z * z
        set_row(basis, slope, 4, C2[0] * x * y, C2[0] * vec3(y, x, 0.0))
        set_row(basis, slope, 5, C2[1] * y * z, C2[1] * vec3(0.0, z, y))
        set_row(basis, slope, 6, C2[2] * (2 * zz - xx - yy), C2[2] * vec3(-2 * x, -2 * y, 4 * z))
        set_row(basis, slope, 7, C2[3] * x * z, C2[3] * vec3(z, 0.0, x))
        set_row(basis, slope, 8, C2[4] * (xx - yy), C2[4] * vec3(2 * x, -2 * y, 0.0))
        if ti.static(count > 9):
            set_row(basis, slope, 9, C3[0] * y * (3 * xx - yy), C3[0] * vec3(6 * x * y, 3 * (xx - yy), 0.0))
            set_row(basis, slope, 10, C3[1] * x * y * z, C3[1] * vec3(y * z, x * z, x * y))
            across = vec3(-2 * x * y, 4 * zz - xx - 3 * yy, 8 * y * z)
            set_row(basis, slope, 11, C3[2] * y * (4 * zz - xx - yy), C3[2] * across)
            up = vec3(-6 * x * z, -6 * y * z, 6 * zz - 3 * xx - 3 * yy)
            set_row(basis, slope, 12, C3[3] * z * (2 * zz - 3 * xx - 3 * yy), C3[3] * up)
            along = vec3(4 * zz - 3 * xx - yy, -2 * x * y, 8 * x * z)
            set_row(basis, slope, 13, C3[4] * x * (4 * zz - xx - yy), C3[4] * along)
            set_row(basis, slope, 14, C3[5] * z * (xx - yy), C3[5] * vec3(2 * x * z, -2 * y * z, xx - yy))
            set_row(basis, slope, 15, C3[6] * x * (xx - 3 * yy), C3[6] * vec3(3 * (xx - yy), -6 * x * y, 0.0))
    return basis, slope


@ti.func
def set_row(basis: ti.template(), slope: ti.template(), k: ti.template(), value: ti.f32, derivative: vec3):
    """Write basis function k and its derivatives."""
    basis[k] = value
    for c in ti.static(range(3)):
        slope[k, c] = derivative[c]
