"""Two-level embedding: the cage carries the local tetrahedra, these carry the Gaussians (VR-GS, Sec. 4.3.2)."""

from dataclasses import dataclass

import numpy as np
import taichi as ti

from core.fields import round_up_capacity
from core.quaternion import polar_quaternion
from sim.embedding_weights import LANES, EmbeddedBody, merge, one_level, pack, two_level

MOST_STRETCH = 4.0  # of a Gaussian, root mean square over its axes: so far its neighbours hide the gaps
NOTHING = {
    **{name: np.zeros(0, np.int32) for name in ("target", "anchor", "vertex")},
    **{name: np.zeros(0, np.float32) for name in ("factor", "rest_cov")},
    "begin": np.zeros(1, np.int32),
}  # a part without Gaussians


@dataclass(frozen=True)
class Run:
    """A part as it is carried: where its vertices and Gaussians begin, and how many times its first size it has."""

    part: int
    vertex: int
    gaussian: int
    scale: float = 1.0


def lengths(part: dict) -> tuple[int, int]:
    """How many slices and slots a packed part has."""
    return len(part["target"]) // LANES, len(part["vertex"]) // LANES


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
    There is room for `room` times as much. Raises BadInput if a local tetrahedron is flat.
    """

    def __init__(
        self,
        parts: list[EmbeddedBody],
        *,
        scheme: str = "two-level",
        with_rotation: bool = True,
        room: float = 1.0,
    ) -> None:
        if scheme not in ("two-level", "one-level"):
            raise ValueError(f"scheme must be two-level or one-level, not {scheme!r}")
        self.with_rotation = with_rotation
        self.count = sum(len(p.gaussians) for p in parts)
        self.bytes = 0  # that a call of `deform` moves, but for the vertices, which stay in a cache
        self._tree = None
        self.runs = [Run(k, p.vertex_offset, p.gaussian_offset) for k, p in enumerate(parts)]
        self._lengths, self._where = [], []
        if self.count == 0:
            return
        collect = two_level if scheme == "two-level" else one_level
        packed = [pack(p, *merge(p, collect)) if len(p.gaussians) else dict(NOTHING) for p in parts]
        self._lengths = [lengths(p) for p in packed]
        ends = np.cumsum([(0, 0), *self._lengths], axis=0)
        self._where = [tuple(at) for at in ends[:-1].tolist()]
        self._upload([p for p in packed if len(p["target"])], room)

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

    def _upload(self, parts: list[dict], room: float) -> None:
        """Join the parts' slices and put them into fields of rounded sizes (compiled kernels are reused)."""
        base = np.cumsum([0] + [len(p["vertex"]) // LANES for p in parts])
        written = 12 + 24 + (16 if self.with_rotation else 0)
        lanes = sum(len(p["target"]) for p in parts)
        self.bytes = int(20 * LANES * base[-1] + (4 + 4 + 24) * lanes + written * self.count)
        pieces = np.concatenate([p["begin"][:-1] + b for p, b in zip(parts, base[:-1], strict=True)])
        join = {n: np.concatenate([p[n] for p in parts]) for n in ("target", "anchor", "vertex", "factor", "rest_cov")}
        rows = round_up_capacity(int(np.ceil(room * len(pieces))))
        join["begin"] = np.concatenate([pieces, np.full(rows + 1 - len(pieces), base[-1])]).astype(np.int32)
        self._place(rows, round_up_capacity(int(np.ceil(room * base[-1]))))
        for name, size in self._sizes.items():
            values = np.full(size, -1 if name == "target" else 0, join[name].dtype)
            values[: len(join[name])] = join[name]
            getattr(self, name).from_numpy(values)

    def _place(self, rows: int, slots: int) -> None:
        """Fields for so many slices and slots of vertices."""
        self._sizes = {"target": rows * LANES, "anchor": rows * LANES, "rest_cov": rows * 6 * LANES, "begin": rows + 1}
        self._sizes |= {"vertex": slots * LANES, "factor": slots * 4 * LANES}
        builder = ti.FieldsBuilder()
        for name, size in self._sizes.items():
            field = ti.field(ti.f32 if name in ("rest_cov", "factor") else ti.i32)
            builder.dense(ti.i, size).place(field)
            setattr(self, name, field)
        self._tree = builder.finalize()

    def read(self) -> list[dict]:
        """The parts as they are packed, on the host; vertices and Gaussians counted from each one's own first."""
        if self._tree is None:
            return [dict(NOTHING) for _ in self.runs]
        whole = self._fetch(*(sum(n) for n in zip(*self._lengths, strict=True)))
        parts, row, slot = [], 0, 0
        for run, (rows, slots) in zip(self.runs, self._lengths, strict=True):
            at, slot_at = slice(row * LANES, (row + rows) * LANES), slice(slot * LANES, (slot + slots) * LANES)
            target = whole["target"][at]
            part = {
                "target": np.where(target >= 0, target - run.gaussian, -1).astype(np.int32),
                "anchor": whole["anchor"][at] - np.int32(run.vertex),
                "rest_cov": whole["rest_cov"][6 * at.start : 6 * at.stop],
                "begin": whole["begin"][row : row + rows + 1] - np.int32(slot),
                "vertex": whole["vertex"][slot_at] - np.int32(run.vertex),
                "factor": whole["factor"][4 * slot_at.start : 4 * slot_at.stop],
            }
            parts.append({name: np.ascontiguousarray(values) for name, values in part.items()})
            row, slot = row + rows, slot + slots
        return parts

    def _fetch(self, rows: int, slots: int) -> dict:
        """The front of all fields, so many slices and slots, on the host."""
        sizes = {"target": rows * LANES, "anchor": rows * LANES, "begin": rows + 1, "rest_cov": rows * 6 * LANES}
        sizes |= {"vertex": slots * LANES, "factor": slots * 4 * LANES}
        front = {
            name: np.zeros(max(n, 1), np.float32 if name in ("rest_cov", "factor") else np.int32)
            for name, n in sizes.items()
        }
        self._get(rows, slots, *front.values())
        return front

    @ti.kernel
    def _get(
        self, rows: ti.i32, slots: ti.i32,
        target: ti.types.ndarray(ti.i32, 1), anchor: ti.types.ndarray(ti.i32, 1), begin: ti.types.ndarray(ti.i32, 1),
        rest_cov: ti.types.ndarray(ti.f32, 1), vertex: ti.types.ndarray(ti.i32, 1), factor: ti.types.ndarray(ti.f32, 1),
    ):  # fmt: skip
        for i in range(rows * LANES):
            target[i], anchor[i] = self.target[i], self.anchor[i]
        for i in range(rows + 1):
            begin[i] = self.begin[i]
        for i in range(rows * 6 * LANES):
            rest_cov[i] = self.rest_cov[i]
        for i in range(slots * LANES):
            vertex[i] = self.vertex[i]
        for i in range(slots * 4 * LANES):
            factor[i] = self.factor[i]

    def warm_up(self) -> None:
        """Compile what `read` and `load` need: the first slice is written as it is."""
        if self._tree is not None:
            p = self._fetch(1, 1)
            self._put_slices(0, 0, 0, 0, 1.0, p["target"], p["anchor"], p["begin"], p["rest_cov"])
            self._put_slots(0, 0, 1.0, p["vertex"], p["factor"])
            self._clear(self._sizes["target"])

    def larger(self, parts: list[dict], times: float) -> "Embedding":
        """An empty one with room for `times` as much as these `parts` are."""
        other = Embedding([], with_rotation=self.with_rotation)
        rows, slots = (sum(n) for n in zip(*map(lengths, parts), strict=True))
        other._place(round_up_capacity(int(np.ceil(rows * times))), round_up_capacity(int(np.ceil(slots * times))))
        other.target.fill(-1)
        return other

    def fits(self, runs: list[Run], parts: list[dict]) -> bool:
        """Whether there is room for these."""
        rows, slots = (sum(n) for n in zip((0, 0), *(lengths(parts[r.part]) for r in runs), strict=True))
        return self._tree is not None and rows < self._sizes["begin"] and slots * LANES <= self._sizes["vertex"]

    def load(self, runs: list[Run], parts: list[dict]) -> None:
        """Carry these runs of `parts` (of `read`), which fit, and nothing else; what stays in place is not written."""
        before, row, slot = self.runs, 0, 0
        where, self._lengths = [], []
        for k, run in enumerate(runs):
            rows, slots = lengths(parts[run.part])
            where.append((row, slot))
            if rows and not (k < len(before) and before[k] == run and self._where[k] == (row, slot)):
                p = parts[run.part]
                self._put_slices(
                    row,
                    slot,
                    run.vertex,
                    run.gaussian,
                    run.scale**2,
                    p["target"],
                    p["anchor"],
                    p["begin"],
                    p["rest_cov"],
                )
                self._put_slots(slot, run.vertex, 1.0 / run.scale, p["vertex"], p["factor"])
            self._lengths.append((rows, slots))
            row, slot = row + rows, slot + slots
        self._clear(row * LANES)
        self.runs, self._where = list(runs), where
        self.count = sum(int((parts[r.part]["target"] >= 0).sum()) for r in runs)

    @ti.kernel
    def _put_slices(
        self, row: ti.i32, slot: ti.i32, first_vertex: ti.i32, first_gaussian: ti.i32, size: ti.f32,
        target: ti.types.ndarray(ti.i32, 1), anchor: ti.types.ndarray(ti.i32, 1), begin: ti.types.ndarray(ti.i32, 1),
        rest_cov: ti.types.ndarray(ti.f32, 1),
    ):  # fmt: skip
        for i in range(target.shape[0]):
            self.target[row * LANES + i] = target[i] + first_gaussian if target[i] >= 0 else -1
            self.anchor[row * LANES + i] = anchor[i] + first_vertex
        for i in range(begin.shape[0]):
            self.begin[row + i] = begin[i] + slot
        for i in range(rest_cov.shape[0]):
            self.rest_cov[row * 6 * LANES + i] = rest_cov[i] * size

    @ti.kernel
    def _put_slots(
        self, slot: ti.i32, first_vertex: ti.i32, shrink: ti.f32,
        vertex: ti.types.ndarray(ti.i32, 1), factor: ti.types.ndarray(ti.f32, 1),
    ):  # fmt: skip
        """Gradients [1/m], three of the four factors of a vertex, shrink as the body grows."""
        for i in range(vertex.shape[0]):
            self.vertex[slot * LANES + i] = vertex[i] + first_vertex
        for i in range(factor.shape[0]):
            self.factor[slot * 4 * LANES + i] = factor[i] * (shrink if i // LANES % 4 < 3 else 1.0)

    @ti.kernel
    def _clear(self, first: ti.i32):
        for i in self.target:
            if i >= first:
                self.target[i] = -1
