"""Device functions of unit quaternions wxyz: products, rotation vectors, small increments, polar decomposition."""

import taichi as ti

NEWTON_STEPS_MAX = 24  # 1 to 3 are taken near a rotation, up to 15 for a collapsed F


@ti.func
def multiply(a, b):
    """Hamilton product a b: the rotation b, then a."""
    u, v = ti.Vector([a[1], a[2], a[3]]), ti.Vector([b[1], b[2], b[3]])
    w = a[0] * v + b[0] * u + u.cross(v)
    return ti.Vector([a[0] * b[0] - u.dot(v), w[0], w[1], w[2]])


@ti.func
def conjugate(q):
    """The inverse rotation of a unit quaternion."""
    return ti.Vector([q[0], -q[1], -q[2], -q[3]])


@ti.func
def rotation_increment(rotation, q):
    """exp(rotation) q - q for a rotation vector [rad]: exact however small it is, since 1 - cos is not subtracted."""
    angle = rotation.norm()
    one_minus_cos = 2.0 * ti.sin(0.25 * angle) ** 2  # of angle / 2
    s = 0.5 if angle < 1e-4 else ti.sin(0.5 * angle) / angle
    return multiply(ti.Vector([-one_minus_cos, s * rotation[0], s * rotation[1], s * rotation[2]]), q)


@ti.func
def rotation_vector_between(a, b):
    """The shorter rotation vector [rad] that takes b to a."""
    d = multiply(a, conjugate(b))
    d *= 1.0 if d[0] >= 0.0 else -1.0
    u = ti.Vector([d[1], d[2], d[3]])
    s = u.norm()
    return u * (2.0 if s < 1e-6 else 2.0 * ti.atan2(s, d[0]) / s)


@ti.func
def to_matrix(q):
    """Rotation matrix of a unit quaternion."""
    w, x, y, z = q[0], q[1], q[2], q[3]
    return ti.Matrix(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


@ti.func
def polar_quaternion(F):
    """Unit quaternion wxyz of the rotation R that maximises tr(R^T F).

    R is the polar rotation where det F > 0; for an inverted F it is U V^T of the SVD whose
    smallest singular value carries the sign, so that R never is a reflection.

    tr(R^T F) = q^T K q (Horn 1987), so q is the eigenvector of the largest root of
    det(K - l I) = l^4 - 2 |F|^2 l^2 - 8 det(F) l + 2 |F^T F|^2 - |F|^4        (Theobald 2005).
    Newton's method falls on that root from sqrt(3) |F|, which it never exceeds; a rotation is
    met at the start. The adjugate of K - l I is a multiple of q q^T. No branches on F, no SVD,
    no state from the last frame. F = 0 gives the identity.
    """
    q = ti.Vector([1.0, 0.0, 0.0, 0.0])
    norm = ti.sqrt(F.norm_sqr())
    if norm > 1e-20:
        A = F * (1.7320508 / norm)  # |A|^2 = 3, as for a rotation
        C = A.transpose() @ A
        c1 = -8.0 * A.determinant()
        c0 = 2.0 * C.norm_sqr() - 9.0
        root = 3.0
        for _ in range(NEWTON_STEPS_MAX):
            value = ((root * root - 6.0) * root + c1) * root + c0
            slope = (4.0 * root * root - 12.0) * root + c1
            step = value / ti.max(slope, 1e-6)  # the slope is positive above the largest root
            root -= step
            if ti.abs(step) < 1e-6 * root:
                break
        q = _eigenvector(A, root)
    return q


@ti.func
def _eigenvector(A, root):
    """Largest column of the adjugate of K - root I, normalised."""
    k00, k11 = A[0, 0] + A[1, 1] + A[2, 2] - root, A[0, 0] - A[1, 1] - A[2, 2] - root
    k22, k33 = A[1, 1] - A[0, 0] - A[2, 2] - root, A[2, 2] - A[0, 0] - A[1, 1] - root
    k01, k02, k03 = A[2, 1] - A[1, 2], A[0, 2] - A[2, 0], A[1, 0] - A[0, 1]
    k12, k13, k23 = A[0, 1] + A[1, 0], A[2, 0] + A[0, 2], A[1, 2] + A[2, 1]
    # 2x2 minors of the rows 0, 1 (s) and 2, 3 (c)
    s0, s1, s2 = k00 * k11 - k01 * k01, k00 * k12 - k02 * k01, k00 * k13 - k03 * k01
    s3, s4, s5 = k01 * k12 - k02 * k11, k01 * k13 - k03 * k11, k02 * k13 - k03 * k12
    c5, c4, c3 = k22 * k33 - k23 * k23, k12 * k33 - k13 * k23, k12 * k23 - k13 * k22
    c2, c1 = k02 * k33 - k03 * k23, k02 * k23 - k03 * k22
    # the adjugate, which is symmetric
    a00 = k11 * c5 - k12 * c4 + k13 * c3
    a01 = -k01 * c5 + k02 * c4 - k03 * c3
    a02 = k13 * s5 - k23 * s4 + k33 * s3
    a03 = -k12 * s5 + k22 * s4 - k23 * s3
    a11 = k00 * c5 - k02 * c2 + k03 * c1
    a12 = -k03 * s5 + k23 * s2 - k33 * s1
    a13 = k02 * s5 - k22 * s2 + k23 * s1
    a22 = k03 * s4 - k13 * s2 + k33 * s0
    a23 = -k02 * s4 + k12 * s2 - k23 * s0
    a33 = k02 * s3 - k12 * s1 + k22 * s0
    q = ti.Vector([a00, a01, a02, a03])
    best = ti.abs(a00)
    if ti.abs(a11) > best:
        best = ti.abs(a11)
        q = ti.Vector([a01, a11, a12, a13])
    if ti.abs(a22) > best:
        best = ti.abs(a22)
        q = ti.Vector([a02, a12, a22, a23])
    if ti.abs(a33) > best:
        q = ti.Vector([a03, a13, a23, a33])
    length = q.norm()
    if length > 1e-12:
        q *= ti.select(q[0] < 0.0, -1.0, 1.0) / length
    else:  # no single best rotation: two singular values vanish, or F is a reflection of a sphere
        q = ti.Vector([1.0, 0.0, 0.0, 0.0])
    return q


@ti.func
def rotate_inverse(q, d):
    """R(q)^T d for a unit quaternion wxyz."""
    u = ti.math.vec3(q[1], q[2], q[3])
    t = 2.0 * u.cross(d)
    return d - q[0] * t + u.cross(t)
