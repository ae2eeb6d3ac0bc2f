"""Host tets and weights of the local tetrahedra's corners, on the device: what prepare/cage/embedding_hosts_reference.py says, Gaussian by
Gaussian.

Both use the grid and the boundary samples of `core.point_location.TetLocator` and compute in float64, so they agree but where
two tets, or two samples, are equally good.
"""

import numpy as np
import taichi as ti

from assets.asset import CageEmbedding
from core.point_location import TetLocator
from prepare.cage.device_point_location import Search, find, indices, nearest, reals, slopes, vec3, weights_of
from prepare.cage.embedding_hosts_reference import FURTHEST, LONGEST

CHUNK = 1 << 20  # Gaussians at once: 160 MB in and out
SHRINKING = 4  # times a local tetrahedron is tried at half the size before one tet holds it


def embed_on_device(
    means: np.ndarray,
    quats: np.ndarray,
    scales: np.ndarray,
    vertices: np.ndarray,
    tets: np.ndarray,
    *,
    k: float = 1 / 3,
    floor: float = 0.15,
) -> CageEmbedding:
    """`prepare.cage.embedding_hosts_reference.embed` by one kernel: the same arguments and, but for ties, the same result. Taichi must run."""
    n = len(means)
    host, weights = np.zeros((n, 4), np.int32), np.zeros((n, 4, 4), np.float32)
    if n:
        search = Search(TetLocator(vertices, tets))
        for i in range(0, n, CHUNK):
            part = slice(i, min(i + CHUNK, n))
            f64 = (np.ascontiguousarray(a[part], np.float64) for a in (means, quats, scales))
            _embed(*f64, *search.tables, *search.grid, float(k), float(floor), host[part], weights[part])
    return CageEmbedding(host, weights)


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
    """See `prepare.cage.embedding_hosts_reference`: corners mu + sqrt(3) H {...}, H = (k^2 Sigma + floor^2 h^2 I)^(1/2)."""
    ti.loop_config(block_dim=64)
    for g in range(means.shape[0]):
        mu = vec3(means[g, 0], means[g, 1], means[g, 2])
        centre, depth = mu, ti.cast(0.0, ti.f64)
        home = find(first, gradient, tet_begin, tet_of, origin, size, shape, mu)
        if home < 0:  # pulled towards the cage as far as the bound on the weights asks
            b = nearest(sample, sample_begin, origin, size, shape, mu)
            home = owner[b]
            foot = vec3(sample[b, 0], sample[b, 1], sample[b, 2])
            depth = (mu - foot).norm()
            at, to = weights_of(first, gradient, home, foot), weights_of(first, gradient, home, mu)
            t = ti.cast(1.0, ti.f64)
            for c in ti.static(range(4)):
                d = to[c] - at[c]
                if ti.abs(d) > 0.0:
                    t = ti.min(t, (FURTHEST - ti.math.sign(d) * at[c]) / ti.abs(d))
            centre = foot + t * (mu - foot)
        own = weights_of(first, gradient, home, centre)
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
                    holder = find(first, gradient, tet_begin, tet_of, origin, size, shape, corner)
                    if holder < 0:
                        holder = home  # a tetrahedron wholly outside follows one tet
                        if depth <= off.norm():
                            holder = owner[nearest(sample, sample_begin, origin, size, shape, corner)]
                    weight = weights_of(first, gradient, holder, corner)
                    host[g, c] = holder
                    for j in ti.static(range(4)):
                        weights[g, c, j] = ti.cast(weight[j], ti.f32)
                        most = ti.max(most, ti.abs(weight[j]))
                done = most <= FURTHEST
                shrink *= 0.5
        if not done:  # one tet holds all corners, as small as needed
            most = ti.cast(1.0, ti.f64)
            for c in range(4):
                most = ti.max(most, ti.abs(slopes(gradient, home, H @ side(c))).max())
            for c in range(4):
                weight = own + slopes(gradient, home, H @ side(c)) / most
                host[g, c] = home
                for j in ti.static(range(4)):
                    weights[g, c, j] = ti.cast(weight[j], ti.f32)


@ti.func
def side(c):
    """Corner c of a regular tetrahedron round the unit sphere."""
    r = ti.sqrt(ti.cast(3.0, ti.f64))
    y = r if c == 0 or c == 2 else -r
    return vec3(r if c < 2 else -r, y, r if c == 0 or c == 3 else -r)
