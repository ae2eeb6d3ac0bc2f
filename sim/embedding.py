"""Two-level embedding: the cage carries the local tetrahedra, these carry the Gaussians (VR-GS, Sec. 4.3.2)."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import accumulate

import numpy as np
import taichi as ti

from core.fields import FieldGroup, round_up_capacity
from core.quaternion import polar_quaternion
from sim.embedding_weights import SLICE_LANES, EmbeddedBody, PackedBody, pack

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
        packed = [pack(b, scheme) for b in bodies]
        self._allocate(packed, headroom, [pack(b, scheme) for b in reserve])
        self.load([BodySpan(k, b.vertex_offset, b.gaussian_offset) for k, b in enumerate(bodies)], packed)

    def deform(self, x, mean, cov, rotation=None) -> None:
        """Out: mean [m], cov (xx, xy, xz, yy, yz, zz) [m^2] and rotation (wxyz) of the Gaussians of all bodies.

        x: vec3 field of all the solver's vertices [m]; mean vec3, cov vec6, rotation vec4 fields of the splats.
        `rotation` is the polar rotation of F: it turns the frame in which the SH colour was trained into the world.
        """
        if self.count:
            self._deform(x, mean, cov, rotation)

    @property
    def bytes_moved(self) -> int:
        """Bytes that a call of `deform` reads and writes, but for the vertices, which stay in a cache."""
        slices, slots = self._starts[-1]
        written = 12 + 24 + (16 if self.with_rotation else 0)
        return 20 * SLICE_LANES * slots + (4 + 4 + 24) * SLICE_LANES * slices + written * self.count

    def destroy(self) -> None:
        """Free the device memory."""
        if self.fields is not None:
            self.fields.destroy()
            self.fields, self.count = None, 0

    @ti.kernel
    def _deform(self, x: ti.template(), mean: ti.template(), cov: ti.template(), rotation: ti.template()):
        """F = sum_v (x_v - x_a) g_v^T,  mu = x_a + sum_v m_v (x_v - x_a),  Sigma = s F Sigma_0 F^T,
        s <= 1 such that tr Sigma <= MAX_STRETCH^2 tr Sigma_0.

        Bytes a Gaussian: 20 for each of about 9 vertices, 8 + 24 of constants, 52 written: 0.26 GB a million,
        0.07 ms at 4 TB/s. The gathers of x (12 bytes each) hit the L1 cache: a cage is about 100 kB.
        """
        ti.loop_config(block_dim=128)
        for i in self.target:
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
        return pack(replace(body, vertex_offset=0, gaussian_offset=0), self.scheme)

    def _allocate(self, packed: list[PackedBody], headroom: float, reserve: list[PackedBody]) -> None:
        """Allocate fields of rounded sizes, so that scenes of similar size share their compiled kernels."""
        slices, slots = sum(p.slices for p in packed), sum(p.slots for p in packed)
        self.fields = None
        if slices == 0:
            return
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

    def read(self) -> list[PackedBody]:
        """The packed body of each span, on the host."""
        ends = self._starts[1:]
        if self.fields is None:
            return [PackedBody.empty() for _ in self.spans]
        all_ = self._fetch(*self._starts[-1])
        bodies = []
        for span, (a, c), (b, d) in zip(self.spans, self._starts, ends, strict=False):  # slices a to b, slots c to d
            target = all_.target[a * SLICE_LANES : b * SLICE_LANES]
            bodies.append(
                PackedBody(
                    target=np.where(target >= 0, target - span.gaussian, -1).astype(np.int32),
                    anchor=all_.anchor[a * SLICE_LANES : b * SLICE_LANES] - np.int32(span.vertex),
                    begin=all_.begin[a : b + 1] - np.int32(c),
                    rest_cov=all_.rest_cov[a * 6 * SLICE_LANES : b * 6 * SLICE_LANES].copy(),
                    vertex=all_.vertex[c * SLICE_LANES : d * SLICE_LANES] - np.int32(span.vertex),
                    factor=all_.factor[c * 4 * SLICE_LANES : d * 4 * SLICE_LANES].copy(),
                )
            )
        return bodies

    def _fetch(self, slices: int, slots: int) -> PackedBody:
        """The first slices and slots of all fields, on the host."""

        def zeros(count: int, kind=np.int32) -> np.ndarray:
            return np.zeros(max(count, 1), kind)  # Taichi takes no empty arrays

        front = PackedBody(
            zeros(slices * SLICE_LANES), zeros(slices * SLICE_LANES), zeros(slices + 1),
            zeros(slices * 6 * SLICE_LANES, np.float32), zeros(slots * SLICE_LANES),
            zeros(slots * 4 * SLICE_LANES, np.float32),
        )  # fmt: skip
        self._copy_front(
            slices, slots, front.target, front.anchor, front.begin, front.rest_cov, front.vertex, front.factor
        )
        return front

    @ti.kernel
    def _copy_front(
        self, slices: ti.i32, slots: ti.i32,
        target: ti.types.ndarray(ti.i32, 1), anchor: ti.types.ndarray(ti.i32, 1), begin: ti.types.ndarray(ti.i32, 1),
        rest_cov: ti.types.ndarray(ti.f32, 1), vertex: ti.types.ndarray(ti.i32, 1), factor: ti.types.ndarray(ti.f32, 1),
    ):  # fmt: skip
        for i in range(slices * SLICE_LANES):
            target[i], anchor[i] = self.target[i], self.anchor[i]
        for i in range(slices + 1):
            begin[i] = self.begin[i]
        for i in range(slices * 6 * SLICE_LANES):
            rest_cov[i] = self.rest_cov[i]
        for i in range(slots * SLICE_LANES):
            vertex[i] = self.vertex[i]
        for i in range(slots * 4 * SLICE_LANES):
            factor[i] = self.factor[i]

    def warm_up(self) -> None:
        """Compile the kernels of `read` and `load`; the first slice is written as it is."""
        if self.fields is not None:
            p = self._fetch(1, 1)
            self._write_slices(0, 0, 0, 0, 1.0, p.target, p.anchor, p.begin, p.rest_cov)
            self._write_slots(0, 0, 1.0, p.vertex, p.factor)
            self._clear(self.target.shape[0])

    def fits(self, spans: list[BodySpan], packed: list[PackedBody]) -> bool:
        """True if `load` has the capacity for these."""
        slices, slots = sum(packed[s.body].slices for s in spans), sum(packed[s.body].slots for s in spans)
        return self.fields is not None and slices <= self.slice_capacity and slots <= self.slot_capacity

    def load(self, spans: list[BodySpan], packed: list[PackedBody]) -> None:
        """Carry these copies of `packed` bodies, which fit, and no others; those already in place are not rewritten."""
        bodies = [packed[s.body] for s in spans]
        slices, slots = (
            accumulate((b.slices for b in bodies), initial=0),
            accumulate((b.slots for b in bodies), initial=0),
        )
        starts = list(zip(slices, slots, strict=True))
        for k, (span, body, (first_slice, first_slot)) in enumerate(zip(spans, bodies, starts, strict=False)):
            loaded = k < len(self.spans) and self.spans[k] == span and self._starts[k] == (first_slice, first_slot)
            if body.slices == 0 or loaded:
                continue
            self._write_slices(
                first_slice, first_slot, span.vertex, span.gaussian, span.scale**2,
                body.target, body.anchor, body.begin, body.rest_cov,
            )  # fmt: skip
            self._write_slots(first_slot, span.vertex, 1.0 / span.scale, body.vertex, body.factor)
        if self.fields is not None:
            self._clear(starts[-1][0] * SLICE_LANES)
        self.spans, self._starts = list(spans), starts
        self.count = sum(b.count for b in bodies)

    @ti.kernel
    def _write_slices(
        self, slice_: ti.i32, slot: ti.i32, first_vertex: ti.i32, first_gaussian: ti.i32, area_scale: ti.f32,
        target: ti.types.ndarray(ti.i32, 1), anchor: ti.types.ndarray(ti.i32, 1), begin: ti.types.ndarray(ti.i32, 1),
        rest_cov: ti.types.ndarray(ti.f32, 1),
    ):  # fmt: skip
        """Write slices whose covariances are scaled; indices are offset by the body's first vertex and Gaussian."""
        for i in range(target.shape[0]):
            self.target[slice_ * SLICE_LANES + i] = target[i] + first_gaussian if target[i] >= 0 else -1
            self.anchor[slice_ * SLICE_LANES + i] = anchor[i] + first_vertex
        for i in range(begin.shape[0]):
            self.begin[slice_ + i] = begin[i] + slot
        for i in range(rest_cov.shape[0]):
            self.rest_cov[slice_ * 6 * SLICE_LANES + i] = rest_cov[i] * area_scale

    @ti.kernel
    def _write_slots(
        self, slot: ti.i32, first_vertex: ti.i32, gradient_scale: ti.f32,
        vertex: ti.types.ndarray(ti.i32, 1), factor: ti.types.ndarray(ti.f32, 1),
    ):  # fmt: skip
        """Write slots; the gradients [1/m], three of the four factors of a vertex, are scaled."""
        for i in range(vertex.shape[0]):
            self.vertex[slot * SLICE_LANES + i] = vertex[i] + first_vertex
        for i in range(factor.shape[0]):
            self.factor[slot * 4 * SLICE_LANES + i] = factor[i] * (gradient_scale if i // SLICE_LANES % 4 < 3 else 1.0)

    @ti.kernel
    def _clear(self, first: ti.i32):
        """Empty all lanes from `first` on."""
        for i in self.target:
            if i >= first:
                self.target[i] = -1
