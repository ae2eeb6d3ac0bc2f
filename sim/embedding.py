"""Two-level embedding: the cage carries the local tetrahedra, these carry the Gaussians (VR-GS, Sec. 4.3.2)."""

from dataclasses import dataclass

import numpy as np
import taichi as ti

from assets.errors import BadInput
from assets.gaussians import Gaussians, matrices_of_quats
from assets.locate import Locator
from sim.polar import polar_quaternion

LANES = 32  # Gaussians side by side in a slice: one warp reads 128 contiguous bytes at a time
WINDOW = 4096  # Gaussians sorted by their number of vertices within this many: full warps, writes stay close
CHUNK = 1 << 16  # Gaussians prepared at once: bounds the float64 intermediates to about 200 MB
MOST_STRETCH = 4.0  # of a Gaussian, root mean square over its axes: so far its neighbours hide the gaps
FLATTEST = 1e-9  # 6 volumes over the longest edge cubed; below this float32 weights do not span space


@dataclass(frozen=True)
class EmbeddedPart:
    """The Gaussians of one body and how its cage holds them. Body frame: asset frame times scale.

    host           cage tet of each local corner, (N, 4)
    weights        barycentric weights of the corners in it, (N, 4, 4): row k = corner k
    gaussians      N Gaussians [m]
    rest           rest vertices of the cage [m], (V, 3)
    tets           (T, 4), indices into `rest`
    vertex_offset  index of the body's first vertex among the solver's
    gaussian_offset index of its first Gaussian among the splats
    """

    host: np.ndarray
    weights: np.ndarray
    gaussians: Gaussians
    rest: np.ndarray
    tets: np.ndarray
    vertex_offset: int = 0
    gaussian_offset: int = 0


@ti.data_oriented
class Embedding:
    """Carries the Gaussians of all deformable bodies along with their cages.

    The corner k of a local tetrahedron lies at y_k = sum_j W_kj x_j, and
        F = [y1-y0, y2-y0, y3-y0] D^-1,   mu = mean(y),   Sigma = F Sigma_0 F^T.
    All of this is linear in the vertices, so the constants are collected once, in float64, into
    one weight and one gradient for each of the n <= 16 different vertices of a Gaussian:
        F = sum_v (x_v - x_a) g_v^T,   mu = x_a + sum_v m_v (x_v - x_a),
    with an anchor vertex a of its own. Both sums are of differences between near vertices: a 0.1 mm Gaussian
    3 m from the origin keeps its digits, which y1 - y0 in float32 does not. m includes
    F (mu_0 - mean(y_0)), so rest gives the rest centre, and affine motion is exact.

    `scheme="one-level"` is the paper's ablation: gradient and weights of the tet that holds the centre.
    Without `with_rotation` (colours of SH degree 0) no polar rotation is computed.
    Raises BadInput if a local tetrahedron is flat.
    """

    def __init__(self, parts: list[EmbeddedPart], *, scheme: str = "two-level", with_rotation: bool = True) -> None:
        if scheme not in ("two-level", "one-level"):
            raise ValueError(f"scheme must be two-level or one-level, not {scheme!r}")
        self.with_rotation = with_rotation
        self.count = sum(len(p.gaussians) for p in parts)
        self.bytes = 0  # that a call of `deform` moves, but for the vertices, which stay in a cache
        self._tree = None
        if self.count == 0:
            return
        collect = _two_level if scheme == "two-level" else _one_level
        packed = [_pack(p, *_merge(p, collect)) for p in parts if len(p.gaussians)]
        self._upload(packed)

    def deform(self, x, mean, cov, rotation=None) -> None:
        """Out: mean [m], cov (xx, xy, xz, yy, yz, zz) [m^2] and rotation (wxyz) of the Gaussians of all parts.

        x: vec3 field of all the solver's vertices [m]; mean vec3, cov vec6, rotation vec4 fields of the splats.
        `rotation` is the polar rotation of F: the frame in which the SH colour was trained.
        """
        if self.count:
            self._deform(x, mean, cov, rotation)

    def destroy(self) -> None:
        """Free the device memory."""
        if self._tree is not None:
            self._tree.destroy()
            self._tree, self.count = None, 0

    @ti.kernel
    def _deform(self, x: ti.template(), mean: ti.template(), cov: ti.template(), rotation: ti.template()):
        """F = sum_v (x_v - x_a) g_v^T,  mu = x_a + sum_v m_v (x_v - x_a),  Sigma = s F Sigma_0 F^T,
        s <= 1 such that tr Sigma <= MOST_STRETCH^2 tr Sigma_0.

        Bytes a Gaussian: 20 for each of about 9 vertices, 8 + 24 of constants, 52 written: 0.26 GB a million,
        0.07 ms at 4 TB/s. The gathers of x (12 bytes each) hit the L1 cache: a cage is some 100 kB.
        """
        ti.loop_config(block_dim=128)
        for i in self.target:
            g = self.target[i]
            if g >= 0:
                piece, lane = i // LANES, i % LANES
                xa = x[self.anchor[i]]
                F = ti.Matrix.zero(ti.f32, 3, 3)
                mu = xa
                for s in range(self.begin[piece], self.begin[piece + 1]):
                    d = x[self.vertex[s * LANES + lane]] - xa
                    c = s * (4 * LANES) + lane
                    grad = ti.Vector([self.factor[c], self.factor[c + LANES], self.factor[c + 2 * LANES]])
                    F += d.outer_product(grad)
                    mu += self.factor[c + 3 * LANES] * d
                r = piece * (6 * LANES) + lane
                xx, xy, xz = self.rest_cov[r], self.rest_cov[r + LANES], self.rest_cov[r + 2 * LANES]
                yy, yz, zz = self.rest_cov[r + 3 * LANES], self.rest_cov[r + 4 * LANES], self.rest_cov[r + 5 * LANES]
                S = F @ ti.Matrix([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]) @ F.transpose()
                # an extreme stretch, of a body torn at or blown up, must not throw spikes across the view
                S *= ti.min(1.0, MOST_STRETCH**2 * (xx + yy + zz) / ti.max(S.trace(), 1e-30))
                mean[g] = mu
                cov[g] = ti.Vector([S[0, 0], S[0, 1], S[0, 2], S[1, 1], S[1, 2], S[2, 2]])
                if ti.static(self.with_rotation):
                    rotation[g] = polar_quaternion(F)

    def _upload(self, packed: list[dict]) -> None:
        """Join the parts' slices and put them into fields of rounded sizes (compiled kernels are reused)."""
        base = np.cumsum([0] + [len(p["vertex"]) // LANES for p in packed])
        written = 12 + 24 + (16 if self.with_rotation else 0)
        lanes = sum(len(p["target"]) for p in packed)
        self.bytes = int(20 * LANES * base[-1] + (4 + 4 + 24) * lanes + written * self.count)
        pieces = np.concatenate([p["begin"][:-1] + b for p, b in zip(packed, base[:-1], strict=True)])
        join = {n: np.concatenate([p[n] for p in packed]) for n in ("target", "anchor", "vertex", "factor", "rest_cov")}
        rows = _rounded(len(pieces))
        join["begin"] = np.concatenate([pieces, np.full(rows + 1 - len(pieces), base[-1])]).astype(np.int32)
        sizes = {"target": rows * LANES, "anchor": rows * LANES, "rest_cov": rows * 6 * LANES, "begin": rows + 1}
        slots = _rounded(int(base[-1]))
        sizes |= {"vertex": slots * LANES, "factor": slots * 4 * LANES}
        builder = ti.FieldsBuilder()
        for name, size in sizes.items():
            field = ti.field(ti.f32 if join[name].dtype == np.float32 else ti.i32)
            builder.dense(ti.i, size).place(field)
            setattr(self, name, field)
        self._tree = builder.finalize()
        for name, size in sizes.items():
            values = np.full(size, -1 if name == "target" else 0, join[name].dtype)
            values[: len(join[name])] = join[name]
            getattr(self, name).from_numpy(values)


def _rounded(n: int) -> int:
    """Next of 4, 5, 6, 7 times a power of two: at most a quarter more."""
    step = 1 << max(0, n.bit_length() - 3)
    return max(1, -(-n // step) * step)


def rest_covariances(gaussians: Gaussians) -> np.ndarray:
    """Sigma_0 = R S S R^T as (xx, xy, xz, yy, yz, zz) [m^2], float64 (N, 6)."""
    A = matrices_of_quats(gaussians.quats) * np.exp(np.asarray(gaussians.log_scales, np.float64))[:, None]
    S = A @ np.moveaxis(A, 1, 2)
    return S[:, [0, 0, 0, 1, 1, 2], [0, 1, 2, 1, 2, 2]]


def _two_level(part: EmbeddedPart, rows: slice, locator: Locator | None):
    """Vertices (n, 16), weights m (n, 16) and gradients g [1/m] (n, 16, 3) of the local tetrahedra."""
    vertex = part.tets[part.host[rows]]
    W = np.asarray(part.weights[rows], np.float64)
    W = W / W.sum(2, keepdims=True)  # float32 rows sum to 1 only within rounding
    y = np.einsum("nkj,nkjc->nkc", W, np.asarray(part.rest, np.float64)[vertex])
    d1, d2, d3 = np.moveaxis(y[:, 1:] - y[:, :1], 1, 0)  # columns of D
    cofactors = np.stack([np.cross(d2, d3), np.cross(d3, d1), np.cross(d1, d2)], 1)
    volume = np.einsum("ni,ni->n", d1, cofactors[:, 0])
    longest = np.max([np.einsum("ni,ni->n", d, d) for d in (d1, d2, d3)], axis=0)
    flat = np.abs(volume) <= FLATTEST * longest**1.5
    if flat.any():
        where = rows.start + int(np.flatnonzero(flat)[0])
        raise BadInput(f"embedding: the local tetrahedron of Gaussian {where} (and {flat.sum() - 1} more) is flat")
    inverse = cofactors / volume[:, None, None]
    corner = np.concatenate([-inverse.sum(1, keepdims=True), inverse], 1)  # F = sum_k y_k corner_k^T
    g = (W[..., None] * corner[:, :, None]).reshape(len(W), 16, 3)
    offset = part.gaussians.means[rows] - y.mean(1)  # the centre need not be the centroid: clamped corners
    m = W.reshape(len(W), 16) / 4 + np.einsum("nvc,nc->nv", g, offset)
    return vertex.reshape(len(W), 16), m, g


def _one_level(part: EmbeddedPart, rows: slice, locator: Locator):
    """The same of the single tet that holds the centre, or the nearest: (n, 4), (n, 4), (n, 4, 3)."""
    means = np.asarray(part.gaussians.means[rows], np.float64)
    host = locator.find(means)
    out = host < 0
    if out.any():
        host[out] = locator.nearest(means[out])[0]
    return locator.tets[host], locator.weights(host, means), locator.gradients(host)


def _merge(part: EmbeddedPart, collect) -> tuple[np.ndarray, ...]:
    """Sum up the entries of equal vertices: row (E,) ascending, vertex (E,), factors (E, 4) = (g, m)."""
    locator = Locator(part.rest, part.tets) if collect is _one_level else None
    found = []
    for start in range(0, len(part.gaussians), CHUNK):
        vertex, m, g = collect(part, slice(start, start + CHUNK), locator)
        n, width = vertex.shape
        order = np.argsort(vertex, 1, kind="stable")
        order = (order + width * np.arange(n)[:, None]).ravel()
        vertex = vertex.ravel()[order]
        factors = np.concatenate([g, m[..., None]], 2).reshape(-1, 4)[order]
        row = np.repeat(np.arange(n), width)
        first = np.flatnonzero(np.r_[True, (np.diff(vertex) != 0) | (np.diff(row) != 0)])
        found.append((row[first] + start, vertex[first], np.add.reduceat(factors, first, 0).astype(np.float32)))
    return tuple(np.concatenate(a) for a in zip(*found, strict=True))


def _pack(part: EmbeddedPart, row: np.ndarray, vertex: np.ndarray, factors: np.ndarray) -> dict:
    """Lay the entries out in slices of LANES Gaussians, slot by slot: a sorted, sliced ELLPACK matrix."""
    n = len(part.gaussians)
    # The anchor, the vertex of the largest weight, needs no factors: the weights sum to 1, the gradients to 0.
    starts = np.searchsorted(row, np.arange(n))
    most = np.maximum.reduceat(factors[:, 3], starts)
    heaviest = np.flatnonzero(factors[:, 3] == most[row])
    heaviest = heaviest[np.searchsorted(row[heaviest], np.arange(n))]
    anchor = vertex[heaviest]
    row, vertex, factors = (np.delete(a, heaviest, 0) for a in (row, vertex, factors))
    counts = np.bincount(row, minlength=n)
    order = np.lexsort((counts, np.arange(n) // WINDOW))
    pieces = -(-n // LANES)
    target = np.full(pieces * LANES, -1)
    target[:n] = order
    padded = np.zeros(pieces * LANES, np.int64)
    padded[:n] = counts[order]
    begin = np.r_[0, padded.reshape(-1, LANES).max(1).cumsum()]
    place = np.empty(n, np.int64)
    place[order] = np.arange(n)
    at = place[row]  # where each entry's Gaussian stands
    rank = np.arange(len(row)) - (counts.cumsum() - counts)[row]
    slot, lane = begin[at // LANES] + rank, at % LANES
    anchors = np.where(target >= 0, anchor[target], 0)
    # An empty slot points at the anchor with factors 0.
    owner = np.repeat(np.arange(pieces), np.diff(begin))
    vertices = anchors.reshape(-1, LANES)[owner]
    vertices[slot, lane] = vertex
    table = np.zeros(begin[-1] * 4 * LANES, np.float32)
    for c in range(4):
        table[slot * (4 * LANES) + c * LANES + lane] = factors[:, c]
    cov = np.zeros((pieces * LANES, 6), np.float32)
    cov[:n] = rest_covariances(part.gaussians)[order]
    shift = np.where(target >= 0, part.gaussian_offset, 0)
    return {
        "target": (target + shift).astype(np.int32),
        "anchor": (anchors + part.vertex_offset).astype(np.int32),
        "begin": begin,
        "vertex": (vertices + part.vertex_offset).astype(np.int32).ravel(),
        "factor": table,
        "rest_cov": np.ascontiguousarray(np.moveaxis(cov.reshape(-1, LANES, 6), 1, 2)).ravel(),
    }
