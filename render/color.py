"""Colour of a Gaussian as seen from a direction: spherical harmonics in its own, turning frame."""

import taichi as ti

from core import spherical_harmonics as harmonics

vec3, vec4 = ti.math.vec3, ti.math.vec4


@ti.func
def color_of(splats: ti.template(), g: ti.i32, ray: vec3) -> vec3:
    """0.5 + SH(R^T d), d = the direction of `ray`, from the eye to the Gaussian's mean; negative is black."""
    value = harmonics.C0 * splats.sh[g, 0]
    if ti.static(splats.coefficients > 1):
        depends_on_view = g >= splats.banded[0] and g < splats.banded[1]
        if depends_on_view:
            value += bands(splats, g, rotate_back(splats.rotation[g], ray.normalized(1e-12)))
    return 0.5 + value


@ti.func
def rotate_back(q: vec4, d: vec3) -> vec3:
    """R(q)^T d for a unit quaternion wxyz."""
    u = vec3(q[1], q[2], q[3])
    t = 2.0 * u.cross(d)
    return d - q[0] * t + u.cross(t)


@ti.func
def bands(splats: ti.template(), g: ti.i32, d: vec3) -> vec3:
    """Degrees 1 to 3 of the harmonics at unit direction d; the basis of core/spherical_harmonics.py."""
    sh = ti.static(splats.sh)
    x, y, z = d.x, d.y, d.z
    value = harmonics.C1 * (z * sh[g, 2] - y * sh[g, 1] - x * sh[g, 3])
    if ti.static(splats.coefficients > 4):
        xx, yy, zz = x * x, y * y, z * z
        C2 = ti.static(harmonics.C2)
        value += C2[0] * x * y * sh[g, 4] + C2[1] * y * z * sh[g, 5] + C2[2] * (2 * zz - xx - yy) * sh[g, 6]
        value += C2[3] * x * z * sh[g, 7] + C2[4] * (xx - yy) * sh[g, 8]
        if ti.static(splats.coefficients > 9):
            C3 = ti.static(harmonics.C3)
            value += C3[0] * y * (3 * xx - yy) * sh[g, 9] + C3[1] * x * y * z * sh[g, 10]
            value += C3[2] * y * (4 * zz - xx - yy) * sh[g, 11]
            value += C3[3] * z * (2 * zz - 3 * xx - 3 * yy) * sh[g, 12]
            value += C3[4] * x * (4 * zz - xx - yy) * sh[g, 13]
            value += C3[5] * z * (xx - yy) * sh[g, 14] + C3[6] * x * (xx - 3 * yy) * sh[g, 15]
    return value
