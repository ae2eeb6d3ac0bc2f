"""Which tet of a cage holds a point, and which boundary sample is next to it, on the device: `core.point_location` there."""

import numpy as np
import taichi as ti

from core.point_location import WEIGHT_MIN, TetLocator

vec3, vec4 = ti.types.vector(3, ti.f64), ti.types.vector(4, ti.f64)
reals, indices = ti.types.ndarray(ti.f64), ti.types.ndarray(ti.i32)


class Search:
    """The tables of a TetLocator on the device.

    tet (T, 4) i32; first (T, 3) [m] and gradient (T, 9) [1/m] of its weights 1 to 3; edge (V,) [m]; cells of `cell` [m]
    from `origin`: tet_of[tet_begin[c] : tet_begin[c + 1]], and of the boundary samples (B, 3) [m] the same.
    """

    def __init__(self, cage: TetLocator):
        sample, owner = cage.boundary_samples()
        index = np.floor((sample - cage.origin) / cage.cell_size).astype(np.int64).clip(0, np.array(cage.grid_shape) - 1)
        flat = np.ravel_multi_index(index.T, cage.grid_shape)
        order = np.sort(flat * len(flat) + np.arange(len(flat))) % len(
            flat
        )  # a stable argsort takes four times as long
        cells = int(np.prod(cage.grid_shape))
        begin = np.concatenate([[0], np.bincount(flat, minlength=cells).cumsum()])
        # all as arguments: what a kernel captures is compiled in, and Python's floats as float32
        self.grid = vec3(*map(float, cage.origin)), float(cage.cell_size), ti.Vector(list(map(int, cage.grid_shape)))
        first, gradient = real(cage.first_vertex), real(cage.weight_gradients.reshape(-1, 9))
        self.tables = (
            whole(cage.tets),
            first,
            gradient,
            real(cage.vertex_edge),
            *lists(cage, first, gradient, self.grid),
            real(sample[order]),
            whole(owner[order]),
            whole(begin),
        )


def lists(cage: TetLocator, first: ti.Ndarray, gradient: ti.Ndarray, grid: tuple) -> tuple[ti.Ndarray, ti.Ndarray]:
    """`cell_start` and `candidates` of a TetLocator, made on the device."""
    boxes = whole(cage.box_begin), whole(cage.box_extent)
    used, begin, of = whole(np.zeros(int(np.prod(cage.grid_shape)))), whole(np.zeros(1)), whole(np.zeros(1))
    _list(first, gradient, *boxes, *grid, 0, begin, used, of)
    ends = used.to_numpy().cumsum()
    begin, of = whole(np.concatenate([[0], ends])), ti.ndarray(ti.i32, max(int(ends[-1]), 1))
    used.fill(0)
    _list(first, gradient, *boxes, *grid, 1, begin, used, of)
    return begin, of


@ti.kernel
def _list(
    first: reals,
    gradient: reals,
    box: indices,
    extent: indices,
    origin: vec3,
    size: ti.f64,
    shape: ti.types.vector(3, ti.i32),
    store: ti.i32,
    begin: indices,
    used: indices,
    of: indices,
):
    """used = number of tets that may touch each cell; if `store`, these in `of` from `begin` on, rising."""
    for t in range(box.shape[0]):
        low = ti.Vector([box[t, 0], box[t, 1], box[t, 2]])
        middle = origin + size * (ti.cast(low, ti.f64) + 0.5)
        at = weights_of(first, gradient, t, middle)
        x, y, z = _column(gradient, t, 0), _column(gradient, t, 1), _column(gradient, t, 2)
        # A tet misses a cell if one of its weights is negative in all of it: at the centre plus half |gradient|_1.
        most = at + (ti.abs(x) + ti.abs(y) + ti.abs(z)) * size / 2
        for i, j, k in ti.ndrange(extent[t, 0], extent[t, 1], extent[t, 2]):
            if (most + size * (i * x + j * y + k * z)).min() >= WEIGHT_MIN:
                cell = ((low[0] + i) * shape[1] + low[1] + j) * shape[2] + low[2] + k
                slot = ti.atomic_add(used[cell], 1)
                if store:
                    of[begin[cell] + slot] = t
    for cell in range(used.shape[0]):
        if store:
            for i in range(begin[cell] + 1, begin[cell + 1]):  # they come in any order
                t, j = of[i], i
                while j > begin[cell] and of[j - 1] > t:
                    of[j] = of[j - 1]
                    j -= 1
                of[j] = t


@ti.func
def slopes(gradient: ti.template(), t, d):
    """Change of the four weights of tet t over the way d [m]."""
    last = vec3(0.0, 0.0, 0.0)
    for i in ti.static(range(3)):
        last[i] = gradient[t, 3 * i] * d[0] + gradient[t, 3 * i + 1] * d[1] + gradient[t, 3 * i + 2] * d[2]
    return vec4(-last.sum(), last[0], last[1], last[2])


@ti.func
def _column(gradient: ti.template(), t, axis: ti.template()):
    """Derivatives of the four weights of tet t along an axis."""
    x, y, z = gradient[t, axis], gradient[t, 3 + axis], gradient[t, 6 + axis]
    return vec4(-x - y - z, x, y, z)


@ti.func
def weights_of(first: ti.template(), gradient: ti.template(), t, p):
    """Barycentric weights of p in tet t."""
    w = slopes(gradient, t, p - vec3(first[t, 0], first[t, 1], first[t, 2]))
    w[0] += 1.0
    return w


@ti.func
def find(
    first: ti.template(), gradient: ti.template(), begin: ti.template(), of: ti.template(), origin, size, shape, p
):
    """The first tet of p's cell that holds p, or -1."""
    i = ti.cast(ti.floor((p - origin) / size), ti.i32)
    found = -1
    if i.min() >= 0 and (shape - i).min() > 0:
        cell = (i[0] * shape[1] + i[1]) * shape[2] + i[2]
        at, end = begin[cell], begin[cell + 1]
        while at < end:
            if weights_of(first, gradient, of[at], p).min() >= WEIGHT_MIN:
                found = of[at]
                at = end
            at += 1
    return found


@ti.func
def nearest(sample: ti.template(), begin: ti.template(), origin, size, shape, p):
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
