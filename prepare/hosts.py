"""Host tets and weights of the local tetrahedra's corners, on the device: what prepare/embed.py says, Gaussian by
Gaussian.

Both use the grid and the boundary samples of `assets.locate.Locator` and compute in float64, so they agree but where
two tets, or two samples, are equally good.
"""

import numpy as np
import taichi as ti

from assets.asset import Embedded
from assets.locate import INSIDE, Locator
from prepare.embed import FURTHEST, LONGEST

CHUNK = 1 << 20  # Gaussians at once: 160 MB in and out
SHRINKING = 4  # times a local tetrahedron is tried at half the size before one tet holds it

vec3, vec4 = ti.types.vector(3, ti.f64), ti.types.vector(4, ti.f64)
reals, indices = ti.types.ndarray(ti.f64), ti.types.ndarray(ti.i32)


def embed_on_device(
    means: np.ndarray,
    quats: np.ndarray,
    scales: np.ndarray,
    vertices: np.ndarray,
    tets: np.ndarray,
    *,
    k: float = 1 / 3,
    floor: float = 0.15,
) -> Embedded:
    """`prepare.embed.embed` by one kernel: the same arguments and, but for ties, the same result. Taichi must run."""
    n = len(means)
    host, weights = np.zeros((n, 4), np.int32), np.zeros((n, 4, 4), np.float32)
    if n:
        search = Search(Locator(vertices, tets))
        for i in range(0, n, CHUNK):
            part = slice(i, min(i + CHUNK, n))
            f64 = (np.ascontiguousarray(a[part], np.float64) for a in (means, quats, scales))
            search.embed(*f64, float(k), float(floor), host[part], weights[part])
    return Embedded(host, weights)


class Search:
    """The tables of a Locator on the device.

    tet (T, 4) i32; first (T, 3) [m] and gradient (T, 9) [1/m] of its weights 1 to 3; edge (V,) [m]; cells of `cell` [m]
    from `origin`: tet_of[tet_begin[c] : tet_begin[c + 1]], and of the boundary samples (B, 3) [m] the same.
    """

    def __init__(self, cage: Locator):
        sample, owner = cage.boundary_samples()
        index = np.floor((sample - cage.origin) / cage.cell).astype(np.int64).clip(0, np.array(cage.shape) - 1)
        flat = np.ravel_multi_index(index.T, cage.shape)
        order = np.argsort(flat, kind="stable")
        begin = np.searchsorted(flat[order], np.arange(int(np.prod(cage.shape)) + 1))
        # all as arguments: what a kernel captures is compiled in, and Python's floats as float32
        self.grid = vec3(*map(float, cage.origin)), float(cage.cell), ti.Vector(list(map(int, cage.shape)))
        self.tables = (
            whole(cage.tets),
            real(cage.first),
            real(cage.slopes.reshape(-1, 9)),
            real(cage.edge),
            whole(cage.start),
            whole(cage.candidates),
            real(sample[order]),
            whole(owner[order]),
            whole(begin),
        )

    def embed(self, means, quats, scales, k: float, floor: float, host, weights) -> None:
        """Out: host (n, 4) int32, weights (n, 4, 4) float32; means, quats, scales float64."""
        _embed(means, quats, scales, *self.tables, *self.grid, k, floor, host, weights)


@ti.kernel
def _embed(
    means: reals,
    quats: reals,
    scales: reals,
    tet: indices,
    first: reals,
    gradient: reals,
    edge: reals,
    tet_begin: indices,
    tet_of: indices,
    sample: reals,
    owner: indices,
    sample_begin: indices,
    origin: vec3,
    size: ti.f64,
    shape: ti.types.vector(3, ti.i32),
    k: ti.f64,
    floor: ti.f64,
    host: indices,
    weights: ti.types.ndarray(ti.f32),
):
    """See `prepare.embed`: corners mu + sqrt(3) H {...}, H = (k^2 Sigma + floor^2 h^2 I)^(1/2)."""
    ti.loop_config(block_dim=64)
    for g in range(means.shape[0]):
        mu = vec3(means[g, 0], means[g, 1], means[g, 2])
        centre, depth = mu, ti.cast(0.0, ti.f64)
        home = _find(first, gradient, tet_begin, tet_of, origin, size, shape, mu)
        if home < 0:  # pulled towards the cage as far as the bound on the weights asks
            b = _nearest(sample, sample_begin, origin, size, shape, mu)
            home = owner[b]
            foot = vec3(sample[b, 0], sample[b, 1], sample[b, 2])
            depth = (mu - foot).norm()
            at, to = _weights(first, gradient, home, foot), _weights(first, gradient, home, mu)
            t = ti.cast(1.0, ti.f64)
            for c in ti.static(range(4)):
                d = to[c] - at[c]
                if ti.abs(d) > 0.0:
                    t = ti.min(t, (FURTHEST - ti.math.sign(d) * at[c]) / ti.abs(d))
            centre = foot + t * (mu - foot)
        own = _weights(first, gradient, home, centre)
        inside = ti.max(own, 0.0)
        h = ti.cast(0.0, ti.f64)
        for c in ti.static(range(4)):
            h += edge[tet[home, c]] * inside[c]
        h /= inside.sum()
        w, x, y, z = quats[g, 0], quats[g, 1], quats[g, 2], quats[g, 3]
        R = ti.Matrix(
            [
                [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
                [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
                [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
            ]
        )
        half = vec3(0.0, 0.0, 0.0)
        for c in ti.static(range(3)):
            wide = ti.min(k * scales[g, c], LONGEST * h)
            half[c] = ti.sqrt(wide * wide + floor * floor * h * h)
        H = ti.Matrix([[R[i, j] * half[j] for j in range(3)] for i in range(3)]) @ R.transpose()
        done, shrink = False, ti.cast(1.0, ti.f64)
        for _ in range(SHRINKING):
            if not done:
                most = ti.cast(0.0, ti.f64)
                for c in range(4):
                    off = shrink * (H @ side(c))
                    corner = centre + off
                    holder = _find(first, gradient, tet_begin, tet_of, origin, size, shape, corner)
                    if holder < 0:
                        holder = home  # a tetrahedron wholly outside follows one tet
                        if depth <= off.norm():
                            holder = owner[_nearest(sample, sample_begin, origin, size, shape, corner)]
                    weight = _weights(first, gradient, holder, corner)
                    host[g, c] = holder
                    for j in ti.static(range(4)):
                        weights[g, c, j] = ti.cast(weight[j], ti.f32)
                        most = ti.max(most, ti.abs(weight[j]))
                done = most <= FURTHEST
                shrink *= 0.5
        if not done:  # one tet holds all corners, as small as needed
            most = ti.cast(1.0, ti.f64)
            for c in range(4):
                most = ti.max(most, ti.abs(_slopes(gradient, home, H @ side(c))).max())
            for c in range(4):
                weight = own + _slopes(gradient, home, H @ side(c)) / most
                host[g, c] = home
                for j in ti.static(range(4)):
                    weights[g, c, j] = ti.cast(weight[j], ti.f32)


@ti.func
def _slopes(gradient: ti.template(), t, d):
    """Change of the four weights of tet t over the way d [m]."""
    last = vec3(0.0, 0.0, 0.0)
    for i in ti.static(range(3)):
        last[i] = gradient[t, 3 * i] * d[0] + gradient[t, 3 * i + 1] * d[1] + gradient[t, 3 * i + 2] * d[2]
    return vec4(-last.sum(), last[0], last[1], last[2])


@ti.func
def _weights(first: ti.template(), gradient: ti.template(), t, p):
    """Barycentric weights of p in tet t."""
    w = _slopes(gradient, t, p - vec3(first[t, 0], first[t, 1], first[t, 2]))
    w[0] += 1.0
    return w


@ti.func
def _find(
    first: ti.template(), gradient: ti.template(), begin: ti.template(), of: ti.template(), origin, size, shape, p
):
    """The first tet of p's cell that holds p, or -1."""
    i = ti.cast(ti.floor((p - origin) / size), ti.i32)
    found = -1
    if i.min() >= 0 and (shape - i).min() > 0:
        cell = (i[0] * shape[1] + i[1]) * shape[2] + i[2]
        at, end = begin[cell], begin[cell + 1]
        while at < end:
            if _weights(first, gradient, of[at], p).min() >= INSIDE:
                found = of[at]
                at = end
            at += 1
    return found


@ti.func
def _nearest(sample: ti.template(), begin: ti.template(), origin, size, shape, p):
    """Index of the boundary sample that is nearest to p: cells in ever wider shells round p, or round the point of
    the grid's box next to it, from where no sample is nearer than that point and its shell allow."""
    high = origin + size * ti.cast(shape, ti.f64)
    inner = ti.min(ti.max(p, origin), high)
    i = ti.min(ti.cast(ti.floor((inner - origin) / size), ti.i32), shape - 1)
    out = (p - inner).norm_sqr()
    found, best = 0, ti.cast(1e300, ti.f64)
    r = 0
    while r <= shape.max():
        a, b = ti.max(i - r, 0), ti.min(i + r, shape - 1)
        for u in range(a[0], b[0] + 1):
            for v in range(a[1], b[1] + 1):
                rim = ti.abs(u - i[0]) == r or ti.abs(v - i[1]) == r
                w = i[2] - r
                while w <= i[2] + r:
                    if w >= 0 and w < shape[2]:
                        cell = (u * shape[1] + v) * shape[2] + w
                        for s in range(begin[cell], begin[cell + 1]):
                            d = (vec3(sample[s, 0], sample[s, 1], sample[s, 2]) - p).norm_sqr()
                            if d < best:
                                found, best = s, d
                    w += 1 if rim else ti.max(2 * r, 1)
        if best <= out + (r * size) ** 2:
            r = shape.max()
        r += 1
    return found


@ti.func
def side(c):
    """Corner c of a regular tetrahedron round the unit sphere."""
    r = ti.sqrt(ti.cast(3.0, ti.f64))
    y = r if c == 0 or c == 2 else -r
    return vec3(r if c < 2 else -r, y, r if c == 0 or c == 3 else -r)


def real(values: np.ndarray) -> ti.Ndarray:
    """On the device, float64."""
    return stored(ti.f64, np.ascontiguousarray(values, np.float64))


def whole(values: np.ndarray) -> ti.Ndarray:
    """On the device, int32."""
    return stored(ti.i32, np.ascontiguousarray(values, np.int32))


def stored(dtype, values: np.ndarray) -> ti.Ndarray:
    """A copy on the device."""
    array = ti.ndarray(dtype, values.shape or (1,))
    array.from_numpy(values)
    return array
