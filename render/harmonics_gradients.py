"""Spherical harmonics up to degree 3 and their derivatives, as device functions for the backward pass."""

import taichi as ti

from core import spherical_harmonics as harmonics

vec3 = ti.math.vec3


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
