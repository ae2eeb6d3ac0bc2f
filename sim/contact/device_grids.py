"""Signed distance grids on the device: many grids, one flat field."""

import numpy as np
import taichi as ti

from core.distance_grid import DistanceGrid
from core.fields import Upload, round_up_capacity
from sim.body_model import same_grid
from sim.model import Capacity, fit

FAR = 1e3  # [m], the distance of what is nowhere near
MAX_GRIDS = 128  # per-grid fields are tiny; one size for all scenes keeps compiled kernels in the cache


@ti.func
def corner(value):
    """The vector (value, value, value)."""
    return ti.Vector([value, value, value])


@ti.data_oriented
class DistanceGrids:
    """Distance grids, each in its own frame, concatenated.

    values   f32[N]   signed distances [m], grid after grid, last axis fastest
    begin    i32[G]   where a grid's values begin
    dims     vec3i[G] nodes per axis;   origin vec3[G] [m];   spacing f32[G] [m]
    """

    def __init__(self, first: list[DistanceGrid], capacity: Capacity = Capacity()):
        self.size = round_up_capacity(capacity.sized("nodes", sum(g.values.size for g in distinct(first))))
        self.builder = ti.FieldsBuilder()
        self.values = ti.field(ti.f32)
        self.builder.dense(ti.i, self.size).place(self.values)
        self.begin, self.spacing = ti.field(ti.i32), ti.field(ti.f32)
        self.dims, self.origin = ti.Vector.field(3, ti.i32), ti.Vector.field(3, ti.f32)
        self.builder.dense(ti.i, MAX_GRIDS).place(self.begin, self.spacing, self.dims, self.origin)
        self.tree = self.builder.finalize()
        self._upload = Upload([self.begin, self.spacing, self.dims, self.origin])
        self.stored: list[tuple[int, DistanceGrid]] = []  # where values begin, in order

    def check_capacity(self, grids: list[DistanceGrid]) -> None:
        fit("grid nodes", sum(g.values.size for g in distinct(grids)), self.size)

    def load(self, grids: list[DistanceGrid]) -> None:
        """Take these grids; values that are here already are not copied again."""
        wanted = distinct(grids)
        kept = [(at, g) for at, g in self.stored if any(g is w for w in wanted)]
        new = [w for w in wanted if not any(g is w for _, g in kept)]
        at = max((at + g.values.size for at, g in kept), default=0)
        if at + sum(g.values.size for g in new) > self.size:  # close the gaps that other grids left
            at, kept, new = 0, [], wanted
        for grid in new:
            self._copy(np.ascontiguousarray(grid.values, np.float32).reshape(-1), at)
            kept.append((at, grid))
            at += grid.values.size
        self.stored = kept
        begins = [next(at for at, w in kept if same_grid(w, g)) for g in grids]
        spacings, origins = [float(g.spacing) for g in grids], [np.asarray(g.origin, np.float64) for g in grids]
        self._upload([begins, spacings, [g.values.shape for g in grids], origins])

    @ti.kernel
    def _copy(self, values: ti.types.ndarray(ti.f32, 1), first: ti.i32):
        for i in range(values.shape[0]):
            self.values[first + i] = values[i]

    @ti.func
    def box_distance(self, k, p):
        """Distance [m] from p (grid frame) to the box that grid k fills; 0 inside."""
        high = self.origin[k] + self.spacing[k] * ti.cast(self.dims[k] - 1, ti.f32)
        return ti.max(self.origin[k] - p, p - high, corner(0.0)).norm()

    @ti.func
    def sample(self, k, p):
        """Trilinear distance [m] and its gradient (not normalised) of grid k at p (grid frame).

        phi = sum over the cell's corners of prod_a (1 - f_a or f_a) phi_corner. Outside the grid: FAR, and no gradient.
        """
        phi, gradient = FAR, corner(0.0)
        q = (p - self.origin[k]) / self.spacing[k]
        n = self.dims[k]
        if q.min() >= 0.0 and (ti.cast(n - 1, ti.f32) - q).min() >= 0.0:
            i = ti.min(ti.cast(q, ti.i32), n - 2)
            f = q - ti.cast(i, ti.f32)
            at = self.begin[k] + (i[0] * n[1] + i[1]) * n[2] + i[2]
            dx, dy = n[1] * n[2], n[2]
            c = ti.static(self.values)
            # along z, then y, then x; d.. are differences along the axis that was blended
            c00, d00 = ti.math.mix(c[at], c[at + 1], f[2]), c[at + 1] - c[at]
            c01, d01 = ti.math.mix(c[at + dy], c[at + dy + 1], f[2]), c[at + dy + 1] - c[at + dy]
            c10, d10 = ti.math.mix(c[at + dx], c[at + dx + 1], f[2]), c[at + dx + 1] - c[at + dx]
            c11, d11 = ti.math.mix(c[at + dx + dy], c[at + dx + dy + 1], f[2]), c[at + dx + dy + 1] - c[at + dx + dy]
            c0, c1 = ti.math.mix(c00, c01, f[1]), ti.math.mix(c10, c11, f[1])
            phi = ti.math.mix(c0, c1, f[0])
            gz = ti.math.mix(ti.math.mix(d00, d01, f[1]), ti.math.mix(d10, d11, f[1]), f[0])
            gradient = ti.Vector([c1 - c0, ti.math.mix(c01 - c00, c11 - c10, f[0]), gz]) / self.spacing[k]
        return phi, gradient

    def destroy(self) -> None:
        self.tree.destroy()


def distinct(grids: list[DistanceGrid]) -> list[DistanceGrid]:
    """The grids without repetitions."""
    kept: list[DistanceGrid] = []
    for grid in grids:
        if not any(same_grid(grid, k) for k in kept):
            kept.append(grid)
    return kept
