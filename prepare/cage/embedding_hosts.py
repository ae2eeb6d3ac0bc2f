"""Second level of the embedding: host tets and weights of the corners of each Gaussian's local tetrahedron.

The corners are mu + sqrt(3) H {(1,1,1), (1,-1,-1), (-1,1,-1), (-1,-1,1)}, H = (k^2 Sigma + floor^2 h^2 I)^(1/2), with
h [m] the edge of a tet of the cage there. They surround the k-sigma ellipsoid (VR-GS, Sec. 4.3.2) and, what the paper
leaves open, span a fraction of a cage tet even where the Gaussian is tiny or flat. With `floor=0` a small Gaussian lies
in one tet and its F jumps to its neighbour's as in the one-level scheme, and an F from corners 1e-6 m apart is noise.
Where the floor dominates, H tends to floor h I, however the Gaussian is rotated: all neighbours take the same
difference stencil, so their F differ little. (A stencil rotated with each Gaussian would see the second derivatives of
the deformation differently: that alone is as rough as one level.)

Defaults, measured on a stuffed bar with tets of 4.5 cm, twisted by 180 degrees per metre and stretched, Gaussians of
4.5 mm: F of neighbours jumps 3.7 times less than with one level (95th percentile; on the surface 6 times), and means, F
and Sigma are at least as near to the truth as there. At floor = 0.2 it is 4.9 and 7.4 times, but Sigma is off by a
quarter more: a tetrahedron of four corners takes a fraction of the second derivatives for F, in proportion to its size.
k = 1/3 puts the corners of a large Gaussian at one sigma; k = 1 is 2.5 times rougher. The corners of a small Gaussian
on the surface leave the cage by at most 0.45 h: less than the usual dilation.
"""

import numpy as np
import taichi as ti

from assets.asset import CageEmbedding
from core.point_location import WEIGHT_MIN, TetLocator
from core.quaternion import to_matrix
from prepare.cage.mesh_quality import device_array

vec3, vec4 = ti.types.vector(3, ti.f64), ti.types.vector(4, ti.f64)
ivec3 = ti.types.vector(3, ti.i32)
CellGrid = ti.types.struct(origin=vec3, size=ti.f64, shape=ivec3)  # corner [m], cell width [m], cells an axis
reals, indices = ti.types.ndarray(ti.f64), ti.types.ndarray(ti.i32)


class DeviceLocator:
    """Tables to find the tet that holds a point. Taichi must be running.

    host   the TetLocator these are made from
    maps   first vertex [m] of each tet and gradients [1/m] of its weights 1 to 3, (T, 12)
    begin, candidates  tets that may touch cell c, ascending: candidates[begin[c] : begin[c + 1]]
    grid   the CellGrid of the cells as 7 numbers on the device, see cell_grid
    """

    def __init__(self, vertices: np.ndarray, tets: np.ndarray) -> None:
        self.host = TetLocator(vertices, tets)
        # An array, since what a kernel captures is compiled in, Python's floats as float32, and since CUDA stops with a
        # misaligned address where a struct of float64 vectors is an argument (Taichi 1.7.4).
        self.grid = device_array(ti.f64, np.r_[self.host.origin, self.host.cell_size, self.host.grid_shape])
        gradients = self.host.weight_gradients.reshape(-1, 9)
        self.maps = device_array(ti.f64, np.concatenate([self.host.first_vertex, gradients], 1))
        self.begin, self.candidates = self._candidate_lists()

    def _candidate_lists(self) -> tuple[ti.Ndarray, ti.Ndarray]:
        boxes = device_array(ti.i32, self.host.box_begin), device_array(ti.i32, self.host.box_extent)
        cells = int(np.prod(self.host.grid_shape))
        used = device_array(ti.i32, np.zeros(cells))
        none = device_array(ti.i32, np.zeros(1))
        _list_candidates(self.maps, *boxes, self.grid, 0, none, used, none)
        ends = used.to_numpy().cumsum()
        begin, candidates = device_array(ti.i32, np.r_[0, ends]), ti.ndarray(ti.i32, max(int(ends[-1]), 1))
        used.fill(0)
        _list_candidates(self.maps, *boxes, self.grid, 1, begin, used, candidates)
        return begin, candidates

    def find(self, points: np.ndarray) -> np.ndarray:
        """Index (M,) of the first tet that holds each point [m] (M, 3), or -1 where none does: as TetLocator.find."""
        host = np.full(len(points), -1, np.int32)
        if len(points):
            points = np.ascontiguousarray(points, np.float64)
            _find(points, self.maps, self.begin, self.candidates, self.grid, host)
        return host

    def boundary_tables(self) -> tuple[ti.Ndarray, ti.Ndarray, ti.Ndarray]:
        """Boundary samples (B, 3) [m] sorted by cell, the tet of each (B,), and where those of each cell begin."""
        sample, owner = self.host.boundary_samples()
        shape = self.host.grid_shape
        index = np.floor((sample - self.host.origin) / self.host.cell_size).astype(np.int64)
        index = index.clip(0, np.array(shape) - 1)
        flat = np.ravel_multi_index(index.T, shape)
        order = np.sort(flat * len(flat) + np.arange(len(flat))) % len(flat)  # a stable argsort is four times slower
        begin = np.concatenate([[0], np.bincount(flat, minlength=int(np.prod(shape))).cumsum()])
        return device_array(ti.f64, sample[order]), device_array(ti.i32, owner[order]), device_array(ti.i32, begin)


def fraction_inside(vertices: np.ndarray, tets: np.ndarray, points: np.ndarray) -> float:
    """Fraction of the points (N, 3) [m] that lie in a tet; 1 where there are none. Taichi must be running."""
    return float((DeviceLocator(vertices, tets).find(points) >= 0).mean()) if len(points) else 1.0


@ti.kernel
def _list_candidates(
    maps: reals, box: indices, extent: indices, cells: reals, store: ti.i32, begin: indices, used: indices,
    candidates: indices,
):  # fmt: skip
    """Out: used = number of tets that may touch each cell; if `store`, these in `candidates`, ascending."""
    for t in range(box.shape[0]):
        grid = cell_grid(cells)
        low = ti.Vector([box[t, 0], box[t, 1], box[t, 2]])
        size, shape = grid.size, grid.shape
        at = weights_of(maps, t, grid.origin + size * (ti.cast(low, ti.f64) + 0.5))
        x, y, z = _column(maps, t, 0), _column(maps, t, 1), _column(maps, t, 2)
        # A tet misses a cell if one of its weights is negative in all of it: at the centre plus half |gradient|_1.
        most = at + (ti.abs(x) + ti.abs(y) + ti.abs(z)) * size / 2
        for i, j, k in ti.ndrange(extent[t, 0], extent[t, 1], extent[t, 2]):
            if (most + size * (i * x + j * y + k * z)).min() >= WEIGHT_MIN:
                cell = ((low[0] + i) * shape[1] + low[1] + j) * shape[2] + low[2] + k
                slot = ti.atomic_add(used[cell], 1)
                if store:
                    candidates[begin[cell] + slot] = t
    for cell in range(used.shape[0]):
        if store:
            for i in range(begin[cell] + 1, begin[cell + 1]):  # they arrive in any order: insertion sort
                t, j = candidates[i], i
                while j > begin[cell] and candidates[j - 1] > t:
                    candidates[j] = candidates[j - 1]
                    j -= 1
                candidates[j] = t


@ti.kernel
def _find(points: reals, maps: reals, begin: indices, candidates: indices, cells: reals, host: indices):
    """Out: host = tet of each point, or -1."""
    for p in range(host.shape[0]):
        point = vec3(points[p, 0], points[p, 1], points[p, 2])
        host[p] = find_tet(maps, begin, candidates, cell_grid(cells), point)


@ti.func
def cell_grid(cells: ti.template()):
    """The CellGrid of a DeviceLocator's numbers: origin, cell width, cells an axis."""
    shape = ti.cast(vec3(cells[4], cells[5], cells[6]), ti.i32)
    return CellGrid(origin=vec3(cells[0], cells[1], cells[2]), size=cells[3], shape=shape)


@ti.func
def weight_change(maps: ti.template(), t, d):
    """Change of the four barycentric weights of tet t over the displacement d [m]."""
    last = vec3(0.0, 0.0, 0.0)
    for i in ti.static(range(3)):
        last[i] = maps[t, 3 + 3 * i] * d[0] + maps[t, 4 + 3 * i] * d[1] + maps[t, 5 + 3 * i] * d[2]
    return vec4(-last.sum(), last[0], last[1], last[2])


@ti.func
def _column(maps: ti.template(), t, axis: ti.template()):
    """Derivatives of the four weights of tet t along an axis."""
    x, y, z = maps[t, 3 + axis], maps[t, 6 + axis], maps[t, 9 + axis]
    return vec4(-x - y - z, x, y, z)


@ti.func
def weights_of(maps: ti.template(), t, p):
    """Barycentric weights of p in tet t."""
    w = weight_change(maps, t, p - vec3(maps[t, 0], maps[t, 1], maps[t, 2]))
    w[0] += 1.0
    return w


@ti.func
def find_tet(maps: ti.template(), begin: ti.template(), candidates: ti.template(), grid, p):
    """The first candidate of p's cell that holds p, or -1."""
    i, shape = ti.cast(ti.floor((p - grid.origin) / grid.size), ti.i32), grid.shape
    found = -1
    if i.min() >= 0 and (shape - i).min() > 0:
        cell = (i[0] * shape[1] + i[1]) * shape[2] + i[2]
        at, end = begin[cell], begin[cell + 1]
        while at < end:
            if weights_of(maps, candidates[at], p).min() >= WEIGHT_MIN:
                found = candidates[at]
                at = end
            at += 1
    return found


@ti.func
def nearest_sample(sample: ti.template(), begin: ti.template(), grid, p):
    """Index of the boundary sample nearest to p.

    Cells are visited in growing shells around p, or around the point of the grid's box next to it, until no sample
    outside the visited shells can be nearer.
    """
    origin, size, shape = grid.origin, grid.size, grid.shape
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
                on_shell = ti.abs(u - i[0]) == r or ti.abs(v - i[1]) == r
                w = i[2] - r
                while w <= i[2] + r:
                    if w >= 0 and w < shape[2]:
                        cell = (u * shape[1] + v) * shape[2] + w
                        for s in range(begin[cell], begin[cell + 1]):
                            d = (vec3(sample[s, 0], sample[s, 1], sample[s, 2]) - p).norm_sqr()
                            if d < best:
                                found, best = s, d
                    w += 1 if on_shell else ti.max(2 * r, 1)
        if best <= out + (r * size) ** 2:
            r = shape.max()
        r += 1
    return found


CORNERS = np.sqrt(3.0) * np.array([[1.0, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]])  # around the unit sphere
MAX_WEIGHT = 3.0  # absolute barycentric weight of a corner: two tet heights outside of the face it is seen through
MAX_HALF_AXIS = 4.0  # of a local tetrahedron, in tets of the cage: bounds its aspect ratio, whatever the file holds
CHUNK = 1 << 20  # Gaussians at once: 160 MB in and out
HALVINGS = 4  # attempts, each at half the size of the last, before all corners share one tet


def embed(
    means: np.ndarray,
    quats: np.ndarray,
    scales: np.ndarray,
    vertices: np.ndarray,
    tets: np.ndarray,
    *,
    k: float = 1 / 3,
    floor: float = 0.15,
) -> CageEmbedding:
    """Find the host tets and the weights of the local tetrahedra's corners. Taichi must be running.

    means [m] (N, 3), quats wxyz (N, 4), scales = standard deviations [m] (N, 3); vertices [m] (V, 3), tets (T, 4).
    """
    n = len(means)
    host, weights = np.zeros((n, 4), np.int32), np.zeros((n, 4, 4), np.float32)
    if n:
        cage = DeviceLocator(vertices, tets)
        corner_edge = device_array(ti.f64, cage.host.vertex_edge[cage.host.tets])
        tables = corner_edge, cage.maps, cage.begin, cage.candidates, *cage.boundary_tables(), cage.grid
        for i in range(0, n, CHUNK):
            chunk = slice(i, min(i + CHUNK, n))
            f64 = (np.ascontiguousarray(a[chunk], np.float64) for a in (means, quats, scales))
            _embed(*f64, *tables, float(k), float(floor), host[chunk], weights[chunk])
    return CageEmbedding(host, weights)


@ti.kernel
def _embed(
    means: reals, quats: reals, scales: reals, corner_edge: reals, maps: reals, begin: indices, candidates: indices,
    sample: reals, owner: indices, sample_begin: indices, cells: reals, k: ti.f64, floor: ti.f64, host: indices,
    weights: ti.types.ndarray(ti.f32),
):  # fmt: skip
    """Out: host, weights. corner_edge (T, 4) [m]; the other tables as of DeviceLocator."""
    ti.loop_config(block_dim=64)
    for g in range(means.shape[0]):
        grid, mu = cell_grid(cells), vec3(means[g, 0], means[g, 1], means[g, 2])
        centre, depth = mu, ti.cast(0.0, ti.f64)
        home = find_tet(maps, begin, candidates, grid, mu)
        if home < 0:  # pulled towards the cage as far as the bound on the weights asks
            b = nearest_sample(sample, sample_begin, grid, mu)
            home = owner[b]
            foot = vec3(sample[b, 0], sample[b, 1], sample[b, 2])
            depth = (mu - foot).norm()
            at, to = weights_of(maps, home, foot), weights_of(maps, home, mu)
            t = ti.cast(1.0, ti.f64)
            for c in ti.static(range(4)):
                d = to[c] - at[c]
                if ti.abs(d) > 0.0:
                    t = ti.min(t, (MAX_WEIGHT - ti.math.sign(d) * at[c]) / ti.abs(d))
            centre = foot + t * (mu - foot)
        own = weights_of(maps, home, centre)
        inside = ti.max(own, 0.0)
        h = ti.cast(0.0, ti.f64)
        for c in ti.static(range(4)):
            h += corner_edge[home, c] * inside[c]
        h /= inside.sum()
        R = to_matrix(vec4(quats[g, 0], quats[g, 1], quats[g, 2], quats[g, 3]))
        half = vec3(0.0, 0.0, 0.0)
        for c in ti.static(range(3)):
            wide = ti.min(k * scales[g, c], MAX_HALF_AXIS * h)
            half[c] = ti.sqrt(wide * wide + floor * floor * h * h)
        H = ti.Matrix([[R[i, j] * half[j] for j in range(3)] for i in range(3)]) @ R.transpose()
        done, shrink = False, ti.cast(1.0, ti.f64)
        for _ in range(HALVINGS):
            if not done:
                most = ti.cast(0.0, ti.f64)
                for c in range(4):
                    off = shrink * (H @ corner_direction(c))
                    corner = centre + off
                    holder = find_tet(maps, begin, candidates, grid, corner)
                    if holder < 0:
                        # The extension of each boundary tet meets that of the next with a gap that grows with the
                        # distance, which would tear a tetrahedron wholly outside: its corners share one tet.
                        holder = home
                        if depth <= off.norm():
                            holder = owner[nearest_sample(sample, sample_begin, grid, corner)]
                    weight = weights_of(maps, holder, corner)
                    host[g, c] = holder
                    for j in ti.static(range(4)):
                        weights[g, c, j] = ti.cast(weight[j], ti.f32)
                        most = ti.max(most, ti.abs(weight[j]))
                done = most <= MAX_WEIGHT
                shrink *= 0.5
        if not done:  # one tet holds all corners, as small as needed: |w| grows by at most 1 from the centre's
            most = ti.cast(1.0, ti.f64)
            for c in range(4):
                most = ti.max(most, ti.abs(weight_change(maps, home, H @ corner_direction(c))).max())
            for c in range(4):
                weight = own + weight_change(maps, home, H @ corner_direction(c)) / most
                host[g, c] = home
                for j in ti.static(range(4)):
                    weights[g, c, j] = ti.cast(weight[j], ti.f32)


@ti.func
def corner_direction(c):
    """Row c of CORNERS: corner c of a regular tetrahedron around the unit sphere."""
    r = ti.sqrt(ti.cast(3.0, ti.f64))
    y = r if c == 0 or c == 2 else -r
    return vec3(r if c < 2 else -r, y, r if c == 0 or c == 3 else -r)
