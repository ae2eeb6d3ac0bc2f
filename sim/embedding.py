"""Two-level embedding: the cage carries the local tetrahedra, these carry the Gaussians (VR-GS, Sec. 4.3.2)."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import accumulate

import numpy as np
import taichi as ti

from assets.gaussians import Gaussians
from core.errors import BadInput
from core.fields import FieldGroup, round_up_capacity
from core.lanes import dealt
from core.point_location import TetLocator
from core.quaternion import polar_quaternion

SLICE_LANES = 32  # Gaussians side by side in a slice: one warp reads 128 contiguous bytes at a time
SORT_WINDOW = 4096  # Gaussians, within which they are sorted by number of vertices: full warps, writes stay close
CHUNK = 1 << 16  # Gaussians prepared at once: bounds the float64 intermediates to about 200 MB
MIN_FLATNESS = 1e-9  # 6 volumes over the longest edge cubed; below it float32 weights do not span space


@dataclass(frozen=True)
class EmbeddedBody:
    """The Gaussians of one body and their embedding in its cage. Body frame: asset frame times scale.

    host             cage tet of each local corner, (N, 4)
    weights          barycentric weights of the corners in it, (N, 4, 4): row k = corner k
    gaussians        N Gaussians [m]
    rest             rest vertices of the cage [m], (V, 3)
    tets             (T, 4), indices into `rest`
    vertex_offset    index of the body's first vertex among the solver's
    gaussian_offset  index of its first Gaussian among the splats
    """

    host: np.ndarray
    weights: np.ndarray
    gaussians: Gaussians
    rest: np.ndarray
    tets: np.ndarray
    vertex_offset: int = 0
    gaussian_offset: int = 0


@dataclass(frozen=True)
class PackedBody:
    """Vertex factors of one body as the device holds them: a sorted, sliced ELLPACK matrix.

    Gaussians lie in slices of SLICE_LANES; a slice has a slot for each vertex of its Gaussian with the most vertices.
    Indices count from the body's first vertex and first Gaussian.

    target    Gaussian of each lane, -1 if none, (slices * SLICE_LANES,) int32
    anchor    its anchor vertex, (slices * SLICE_LANES,) int32
    begin     first slot of each slice, and the end of the last, (slices + 1,) int32
    rest_cov  rest covariances [m^2], a component of all lanes after the other, (slices * 6 * SLICE_LANES,) float32
    vertex    vertices, slot by slot, (slots * SLICE_LANES,) int32
    factor    gradient [1/m] and weight, a component of all lanes after the other, (slots * 4 * SLICE_LANES,) float32
    """

    target: np.ndarray
    anchor: np.ndarray
    begin: np.ndarray
    rest_cov: np.ndarray
    vertex: np.ndarray
    factor: np.ndarray

    @property
    def slices(self) -> int:
        return len(self.target) // SLICE_LANES

    @property
    def slots(self) -> int:
        return len(self.vertex) // SLICE_LANES

    @property
    def count(self) -> int:
        """Number of Gaussians."""
        return int((self.target >= 0).sum())


def two_level_factors(body: EmbeddedBody, rows: slice):
    """Vertices (n, 16), weights m (n, 16) and gradients g [1/m] (n, 16, 3) of the local tetrahedra."""
    vertex = body.tets[body.host[rows]]
    W = np.asarray(body.weights[rows], np.float64)
    W = W / W.sum(2, keepdims=True)  # float32 rows sum to 1 only within rounding
    y = np.einsum("nkj,nkjc->nkc", W, np.asarray(body.rest, np.float64)[vertex])
    d1, d2, d3 = np.moveaxis(y[:, 1:] - y[:, :1], 1, 0)  # columns of D
    cofactors = np.stack([np.cross(d2, d3), np.cross(d3, d1), np.cross(d1, d2)], 1)
    volume = np.einsum("ni,ni->n", d1, cofactors[:, 0])
    longest = np.max([np.einsum("ni,ni->n", d, d) for d in (d1, d2, d3)], axis=0)
    flat = np.abs(volume) <= MIN_FLATNESS * longest**1.5
    if flat.any():
        where = rows.start + int(np.flatnonzero(flat)[0])
        raise BadInput(f"embedding: the local tetrahedron of Gaussian {where} (and {flat.sum() - 1} more) is flat")
    inverse = cofactors / volume[:, None, None]
    corner = np.concatenate([-inverse.sum(1, keepdims=True), inverse], 1)  # F = sum_k y_k corner_k^T
    g = (W[..., None] * corner[:, :, None]).reshape(len(W), 16, 3)
    offset = body.gaussians.means[rows] - y.mean(1)  # the centre need not be the centroid: clamped corners
    m = W.reshape(len(W), 16) / 4 + np.einsum("nvc,nc->nv", g, offset)
    return vertex.reshape(len(W), 16), m, g


def one_level_factors(body: EmbeddedBody, rows: slice, locator: TetLocator):
    """As `two_level_factors`, of the tet that contains the centre, or the nearest: (n, 4), (n, 4), (n, 4, 3)."""
    means = np.asarray(body.gaussians.means[rows], np.float64)
    host = locator.find(means)
    out = host < 0
    if out.any():
        host[out] = locator.nearest(means[out])[0]
    return locator.tets[host], locator.weights(host, means), locator.gradients(host)


def vertex_factors(body: EmbeddedBody, scheme: str) -> tuple[np.ndarray, ...]:
    """Entries of all Gaussians, equal vertices summed: row (E,) ascending, vertex (E,), factors (E, 4) = (g, m)."""
    locator = TetLocator(body.rest, body.tets) if scheme == "one-level" else None
    found = []
    for start in range(0, len(body.gaussians), CHUNK):
        rows = slice(start, start + CHUNK)
        vertex, m, g = two_level_factors(body, rows) if locator is None else one_level_factors(body, rows, locator)
        n, width = vertex.shape
        order = np.argsort(vertex, 1, kind="stable")
        order = (order + width * np.arange(n)[:, None]).ravel()
        vertex = vertex.ravel()[order]
        factors = np.concatenate([g, m[..., None]], 2).reshape(-1, 4)[order]
        row = np.repeat(np.arange(n), width)
        first = np.flatnonzero(np.r_[True, (np.diff(vertex) != 0) | (np.diff(row) != 0)])
        found.append((row[first] + start, vertex[first], np.add.reduceat(factors, first, 0).astype(np.float32)))
    return tuple(np.concatenate(a) for a in zip(*found, strict=True))


def pack(body: EmbeddedBody, scheme: str) -> PackedBody:
    """Arrange the entries in slices of SLICE_LANES Gaussians. Raises BadInput if a local tetrahedron is flat."""
    n = len(body.gaussians)
    if n == 0:
        none = np.zeros(0, np.int32)
        return PackedBody(none, none, np.zeros(1, np.int32), none.astype(np.float32), none, none.astype(np.float32))
    row, vertex, factors = vertex_factors(body, scheme)
    # The anchor, the vertex of the largest weight, needs no factors: the weights sum to 1, the gradients to 0.
    starts = np.searchsorted(row, np.arange(n))
    largest = np.maximum.reduceat(factors[:, 3], starts)
    heaviest = np.flatnonzero(factors[:, 3] == largest[row])
    heaviest = heaviest[np.searchsorted(row[heaviest], np.arange(n))]
    anchor = vertex[heaviest]
    row, vertex, factors = (np.delete(a, heaviest, 0) for a in (row, vertex, factors))
    counts = np.bincount(row, minlength=n)
    order = np.lexsort((counts, np.arange(n) // SORT_WINDOW))
    slices = -(-n // SLICE_LANES)
    target = np.full(slices * SLICE_LANES, -1)
    target[:n] = order
    padded = np.zeros(slices * SLICE_LANES, np.int64)
    padded[:n] = counts[order]
    begin = np.r_[0, padded.reshape(-1, SLICE_LANES).max(1).cumsum()]
    position = np.empty(n, np.int64)
    position[order] = np.arange(n)
    at = position[row]  # of each entry's Gaussian
    rank = np.arange(len(row)) - (counts.cumsum() - counts)[row]
    slot, lane = begin[at // SLICE_LANES] + rank, at % SLICE_LANES
    anchors = np.where(target >= 0, anchor[target], 0)
    # An empty slot points at the anchor with factors 0.
    owner = np.repeat(np.arange(slices), np.diff(begin))
    vertices = anchors.reshape(-1, SLICE_LANES)[owner]
    vertices[slot, lane] = vertex
    table = np.zeros(begin[-1] * 4 * SLICE_LANES, np.float32)
    for c in range(4):
        table[slot * (4 * SLICE_LANES) + c * SLICE_LANES + lane] = factors[:, c]
    cov = np.zeros((slices * SLICE_LANES, 6), np.float32)
    cov[:n] = body.gaussians.covariances[order]
    return PackedBody(
        target=target.astype(np.int32),
        anchor=anchors.astype(np.int32),
        begin=begin.astype(np.int32),
        rest_cov=np.ascontiguousarray(np.moveaxis(cov.reshape(-1, SLICE_LANES, 6), 1, 2)).ravel(),
        vertex=vertices.astype(np.int32).ravel(),
        factor=table,
    )


MAX_STRETCH = 4.0  # of a Gaussian, root mean square over its axes: up to here its neighbours hide the gaps


@dataclass(frozen=True)
class BodySpan:
    """An embedded copy of a packed body.

    body      index of the packed body
    vertex    index of its first vertex among the solver's
    gaussian  index of its first Gaussian among the splats
    scale     size relative to the packed body
    """

    body: int
    vertex: int
    gaussian: int
    scale: float = 1.0


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
    Without `with_rotation` (colours of SH degree 0) no polar rotation is computed. The capacity is `headroom`
    times what `bodies` need, and at least twice what those of `reserve` do. Raises BadInput if a local tetrahedron is
    flat.
    """

    def __init__(
        self,
        bodies: list[EmbeddedBody],
        *,
        scheme: str = "two-level",
        with_rotation: bool = True,
        headroom: float = 1.0,
        reserve: Sequence[EmbeddedBody] = (),
    ) -> None:
        if scheme not in ("two-level", "one-level"):
            raise ValueError(f"scheme must be two-level or one-level, not {scheme!r}")
        self.with_rotation, self.scheme = with_rotation, scheme
        self.spans: list[BodySpan] = []
        self.count = 0  # Gaussians
        self._starts: list[tuple[int, int]] = [(0, 0)]  # first slice and slot of each span, and the ends
        self.bodies = packed = [pack(b, scheme) for b in bodies]  # stay on the host, for copies of them
        self._allocate(packed, headroom, [pack(b, scheme) for b in reserve])
        self.load([BodySpan(k, b.vertex_offset, b.gaussian_offset) for k, b in enumerate(bodies)], packed)

    def deform(self, x, mean, cov, rotation=None) -> None:
        """Out: mean [m], cov (xx, xy, xz, yy, yz, zz) [m^2] and rotation (wxyz) of the Gaussians of all bodies.

        x: vec3 field of all the solver's vertices [m]; mean vec3, cov vec6, rotation vec4 fields of the splats.
        `rotation` is the polar rotation of F: it turns the frame in which the SH colour was trained into the world.
        """
        if self.count:
            self._deform(x, mean, cov, rotation, self._starts[-1][0] * SLICE_LANES)

    def destroy(self) -> None:
        """Free the device memory."""
        self.fields.destroy()
        self.count = 0

    @ti.kernel
    def _deform(
        self, x: ti.template(), mean: ti.template(), cov: ti.template(), rotation: ti.template(), end: ti.i32
    ):  # fmt: skip
        """F = sum_v (x_v - x_a) g_v^T,  mu = x_a + sum_v m_v (x_v - x_a),  Sigma = s F Sigma_0 F^T,
        s <= 1 such that tr Sigma <= MAX_STRETCH^2 tr Sigma_0.

        Bytes a Gaussian: 20 for each of about 9 vertices, 8 + 24 of constants, 52 written: 0.26 GB a million,
        0.07 ms at 4 TB/s. The gathers of x (12 bytes each) hit the L1 cache: a cage is about 100 kB.
        """
        ti.loop_config(block_dim=128)
        for k in range(end):
            i = dealt(k, end)
            g = self.target[i]
            if g >= 0:
                slice_, lane = i // SLICE_LANES, i % SLICE_LANES
                xa = x[self.anchor[i]]
                F = ti.Matrix.zero(ti.f32, 3, 3)
                mu = xa
                for s in range(self.begin[slice_], self.begin[slice_ + 1]):
                    d = x[self.vertex[s * SLICE_LANES + lane]] - xa
                    c = s * (4 * SLICE_LANES) + lane
                    grad = ti.Vector([self.factor[c], self.factor[c + SLICE_LANES], self.factor[c + 2 * SLICE_LANES]])
                    F += d.outer_product(grad)
                    mu += self.factor[c + 3 * SLICE_LANES] * d
                r = slice_ * (6 * SLICE_LANES) + lane
                xx, xy, xz = self.rest_cov[r], self.rest_cov[r + SLICE_LANES], self.rest_cov[r + 2 * SLICE_LANES]
                yy, yz, zz = (
                    self.rest_cov[r + 3 * SLICE_LANES],
                    self.rest_cov[r + 4 * SLICE_LANES],
                    self.rest_cov[r + 5 * SLICE_LANES],
                )
                S = F @ ti.Matrix([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]) @ F.transpose()
                # an extreme stretch, of a body pulled apart or blown up, must not throw spikes across the view
                S *= ti.min(1.0, MAX_STRETCH**2 * (xx + yy + zz) / ti.max(S.trace(), 1e-30))
                mean[g] = mu
                cov[g] = ti.Vector([S[0, 0], S[0, 1], S[0, 2], S[1, 1], S[1, 2], S[2, 2]])
                if ti.static(self.with_rotation):
                    rotation[g] = polar_quaternion(F)

    def packed(self, body: EmbeddedBody) -> PackedBody:
        """A body as this embedding takes it."""
        return pack(body, self.scheme)

    def _allocate(self, packed: list[PackedBody], headroom: float, reserve: list[PackedBody]) -> None:
        """Allocate fields of rounded sizes, so that scenes of similar size share their compiled kernels."""
        slices, slots = sum(p.slices for p in packed), sum(p.slots for p in packed)
        reserved = 2 * sum(p.slices for p in reserve), 2 * sum(p.slots for p in reserve)
        self.slice_capacity = round_up_capacity(max(int(np.ceil(headroom * slices)), reserved[0]))
        self.slot_capacity = round_up_capacity(max(int(np.ceil(headroom * slots)), reserved[1]))
        self.fields = f = FieldGroup()  # as the arrays of PackedBody
        self.target = f.scalar(self.slice_capacity * SLICE_LANES, dtype=ti.i32)
        self.anchor = f.scalar(self.slice_capacity * SLICE_LANES, dtype=ti.i32)
        self.begin = f.scalar(self.slice_capacity + 1, dtype=ti.i32)
        self.rest_cov = f.scalar(self.slice_capacity * 6 * SLICE_LANES)
        self.vertex = f.scalar(self.slot_capacity * SLICE_LANES, dtype=ti.i32)
        self.factor = f.scalar(self.slot_capacity * 4 * SLICE_LANES)
        f.build()
        self.target.fill(-1)

    def fits(self, spans: list[BodySpan], packed: list[PackedBody]) -> bool:
        """True if `load` has the capacity for these."""
        slices, slots = sum(packed[s.body].slices for s in spans), sum(packed[s.body].slots for s in spans)
        return slices <= self.slice_capacity and slots <= self.slot_capacity

    def load(self, spans: list[BodySpan], packed: list[PackedBody]) -> None:
        """Carry these copies of `packed` bodies, which fit, and no others; those already in place are not rewritten."""
        bodies = [packed[s.body] for s in spans]
        slices = accumulate((b.slices for b in bodies), initial=0)
        starts = list(zip(slices, accumulate((b.slots for b in bodies), initial=0), strict=True))
        for k, (span, body, (first_slice, first_slot)) in enumerate(zip(spans, bodies, starts, strict=False)):
            loaded = k < len(self.spans) and self.spans[k] == span and self._starts[k] == (first_slice, first_slot)
            if body.slices == 0 or loaded:
                continue
            self._write(
                first_slice, first_slot, span.vertex, span.gaussian, span.scale**2, 1.0 / span.scale,
                body.target, body.anchor, body.begin, body.rest_cov, body.vertex, body.factor,
            )  # fmt: skip
        self._clear(starts[-1][0] * SLICE_LANES)
        self.spans, self._starts = list(spans), starts
        self.count = sum(b.count for b in bodies)

    @ti.kernel
    def _write(
        self, slice_: ti.i32, slot: ti.i32, first_vertex: ti.i32, first_gaussian: ti.i32, area_scale: ti.f32,
        gradient_scale: ti.f32, target: ti.types.ndarray(ti.i32, 1), anchor: ti.types.ndarray(ti.i32, 1),
        begin: ti.types.ndarray(ti.i32, 1), rest_cov: ti.types.ndarray(ti.f32, 1),
        vertex: ti.types.ndarray(ti.i32, 1), factor: ti.types.ndarray(ti.f32, 1),
    ):  # fmt: skip
        """Write slices and slots from these on, scaled. Indices are offset by the body's first vertex and Gaussian."""
        for i in range(target.shape[0]):
            self.target[slice_ * SLICE_LANES + i] = target[i] + first_gaussian if target[i] >= 0 else -1
            self.anchor[slice_ * SLICE_LANES + i] = anchor[i] + first_vertex
        for i in range(begin.shape[0]):
            self.begin[slice_ + i] = begin[i] + slot
        for i in range(rest_cov.shape[0]):
            self.rest_cov[slice_ * 6 * SLICE_LANES + i] = rest_cov[i] * area_scale
        for i in range(vertex.shape[0]):
            self.vertex[slot * SLICE_LANES + i] = vertex[i] + first_vertex
        for i in range(factor.shape[0]):  # three of the four factors of a vertex are its gradient [1/m]
            self.factor[slot * 4 * SLICE_LANES + i] = factor[i] * (gradient_scale if i // SLICE_LANES % 4 < 3 else 1.0)

    @ti.kernel
    def _clear(self, first: ti.i32):
        """Empty all lanes from `first` on."""
        for i in self.target:
            if i >= first:
                self.target[i] = -1
