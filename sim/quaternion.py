"""Quaternions wxyz in kernels: products, rotation vectors, and increments that survive fp32."""

import taichi as ti


@ti.func
def multiply(a, b):
    """The rotation b, then a."""
    u, v = ti.Vector([a[1], a[2], a[3]]), ti.Vector([b[1], b[2], b[3]])
    w = a[0] * v + b[0] * u + u.cross(v)
    return ti.Vector([a[0] * b[0] - u.dot(v), w[0], w[1], w[2]])


@ti.func
def conjugate(q):
    return ti.Vector([q[0], -q[1], -q[2], -q[3]])


@ti.func
def gain(turn, q):
    """exp(turn) q - q for a rotation vector turn [rad]: exact however small it is."""
    angle = turn.norm()
    less = 2.0 * ti.sin(0.25 * angle) ** 2  # 1 - cos(angle/2)
    s = 0.5 if angle < 1e-4 else ti.sin(0.5 * angle) / angle
    return multiply(ti.Vector([-less, s * turn[0], s * turn[1], s * turn[2]]), q)


@ti.func
def turn_between(a, b):
    """The shorter rotation vector [rad] that takes b to a."""
    d = multiply(a, conjugate(b))
    d *= 1.0 if d[0] >= 0.0 else -1.0
    u = ti.Vector([d[1], d[2], d[3]])
    s = u.norm()
    return u * (2.0 if s < 1e-6 else 2.0 * ti.atan2(s, d[0]) / s)


@ti.func
def matrix(q):
    """Rotation matrix of a unit quaternion."""
    w, x, y, z = q[0], q[1], q[2], q[3]
    return ti.Matrix(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )
