"""Signed distance grids on the device, many in one flat field, and the grid of a cage that has none."""

from typing import TYPE_CHECKING

import numpy as np
import taichi as ti
from scipy.ndimage import distance_transform_edt
from taichi.math import vec3

from core.distance_grid import DistanceGrid, same_grid
from core.fields import FieldGroup, Upload, round_up_capacity
from sim.model import Capacity, fit

if TYPE_CHECKING:
    from sim.model import RestShape

UNKNOWN_DISTANCE = 1e3  # [m], the distance where a grid says nothing
MAX_GRIDS = 128  # per-grid fields are tiny; one size for all scenes keeps compiled kernels in the cache
# [nodes] around the surface with exact distances, and of the grid around the cage's box: skins are up to two nodes
# thick, and a gradient there asks for the corners of its cell, another 1.7 away. Elsewhere sign and trend matter only.
EXACT_BAND = 4
UNREACHED = 1e9  # [nodes] where no triangle is near


@ti.func
def known(phi):
    """True if phi [m] is a distance, not UNKNOWN_DISTANCE."""
    return phi < 0.5 * UNKNOWN_DISTANCE


@ti.data_oriented
class DistanceGrids:
    """Distance grids, each in its own frame, concatenated.

    values   f32[N]   signed distances [m], grid after grid, last axis fastest
    begin    i32[G]   where a grid's values begin
    dims     vec3i[G] nodes per axis;   origin vec3[G] [m];   spacing f32[G] [m]
    """

    def __init__(self, first: list[DistanceGrid], capacity: Capacity = Capacity()):
        self.size = round_up_capacity(capacity.sized("nodes", sum(g.values.size for g in distinct(first))))
        group = self._group = FieldGroup()
        self.values = group.scalar(self.size)
        self.begin, self.spacing = group.scalar(MAX_GRIDS, dtype=ti.i32), group.scalar(MAX_GRIDS)
        self.dims, self.origin = group.vector(MAX_GRIDS, dtype=ti.i32), group.vector(MAX_GRIDS)
        group.build()
        self._upload = Upload([self.begin, self.spacing, self.dims, self.origin])
        self.stored: list[tuple[int, DistanceGrid]] = []  # where values begin, in order

    def check_capacity(self, grids: list[DistanceGrid]) -> None:
        fit("grid nodes", sum(g.values.size for g in distinct(grids)), self.size)

    def load(self, grids: list[DistanceGrid]) -> None:
        """Take these grids; values already on the device are not copied again."""
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
        return ti.max(self.origin[k] - p, p - high, vec3(0.0)).norm()

    @ti.func
    def sample(self, k, p):
        """Trilinear distance [m] and its gradient (not normalised) of grid k at p (grid frame).

        phi = sum over the cell's corners of prod_a (1 - f_a or f_a) phi_corner; outside the grid UNKNOWN_DISTANCE, 0.
        """
        phi, gradient = UNKNOWN_DISTANCE, vec3(0.0)
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

    @ti.func
    def extrapolated(self, k, p):
        """As `sample`, and outside the grid by way of its nearest point; and how far [m] p is outside.

        With e the nearest point of the grid, e - phi grad phi is on the surface: phi is the distance from p to there.
        """
        low = self.origin[k]
        high = low + self.spacing[k] * ti.cast(self.dims[k] - 1, ti.f32)
        inset = vec3(1e-3 * self.spacing[k])  # rounding must not put it outside again
        edge = ti.min(ti.max(p, low + inset), high - inset)
        phi, gradient = self.sample(k, edge)
        beyond = self.box_distance(k, p)
        if known(phi) and beyond > 0.0:
            total = p - edge + ti.max(phi, 0.0) * gradient / ti.max(gradient.norm(), 1e-9)
            phi = total.norm()
            gradient = total / ti.max(phi, 1e-9)
        return phi, gradient, beyond


def distinct(grids: list[DistanceGrid]) -> list[DistanceGrid]:
    """The grids without repetitions."""
    kept: list[DistanceGrid] = []
    for grid in grids:
        if not any(same_grid(grid, k) for k in kept):
            kept.append(grid)
    return kept


def rest_grid(vertices: np.ndarray, tets: np.ndarray, surface: np.ndarray, *, nodes: int = 48) -> DistanceGrid:
    """Distance grid [m] of a cage (V, 3), (T, 4), (S, 3) with about `nodes` nodes along its longest side.

    Exact within EXACT_BAND nodes of the surface, grown from there by the distance between nodes; negative in the tets.
    """
    x = np.asarray(vertices, np.float32)
    spacing = float(np.ptp(x, axis=0).max()) / nodes
    origin = x.min(0).astype(np.float64) - EXACT_BAND * spacing
    dims = np.ceil((x.max(0) - origin) / spacing).astype(int) + EXACT_BAND + 1
    local = ((x - origin) / spacing).astype(np.float32)  # in nodes
    values, inside = np.full(dims, UNREACHED, np.float32), np.zeros(dims, np.int32)
    _surface_distances(values, np.ascontiguousarray(local[np.asarray(surface)]))
    _mark_inside(inside, np.ascontiguousarray(local[np.asarray(tets)]))
    far, nearest = distance_transform_edt(values > EXACT_BAND, return_indices=True)
    phi = np.where(values <= EXACT_BAND, values, far + values[tuple(nearest)])
    return DistanceGrid((spacing * np.where(inside > 0, -phi, phi)).astype(np.float32), origin, spacing)


@ti.func
def node_range(low, high, padding, values: ti.template()):
    """First and one past the last node of the box low - padding .. high + padding."""
    shape = ti.Vector([values.shape[0], values.shape[1], values.shape[2]])
    first = ti.max(ti.ceil(low - padding, ti.i32), 0)
    last = ti.min(ti.floor(high + padding, ti.i32) + 1, shape)
    return first, last


@ti.kernel
def _surface_distances(values: ti.types.ndarray(ti.f32, 3), corners: ti.types.ndarray(ti.f32, 3)):
    """values = min over triangles of the distance to them, in nodes, where that is below EXACT_BAND."""
    for t in range(corners.shape[0]):
        c = ti.Matrix([[corners[t, row, axis] for axis in range(3)] for row in range(3)])
        a, b, d = c[0, :], c[1, :], c[2, :]
        first, last = node_range(ti.min(a, b, d), ti.max(a, b, d), EXACT_BAND, values)
        for i, j, k in ti.ndrange((first[0], last[0]), (first[1], last[1]), (first[2], last[2])):
            p = ti.Vector([i, j, k], ti.f32)
            ti.atomic_min(values[i, j, k], ti.sqrt(triangle_distance_squared(a - p, b - p, d - p)))


@ti.kernel
def _mark_inside(inside: ti.types.ndarray(ti.i32, 3), corners: ti.types.ndarray(ti.f32, 3)):
    """inside = 1 at nodes that some tet holds."""
    for t in range(corners.shape[0]):
        c = ti.Matrix([[corners[t, row, axis] for axis in range(3)] for row in range(4)])
        x0, x1, x2, x3 = c[0, :], c[1, :], c[2, :], c[3, :]
        inverse = ti.Matrix.cols([x1 - x0, x2 - x0, x3 - x0]).inverse()
        first, last = node_range(ti.min(x0, x1, x2, x3), ti.max(x0, x1, x2, x3), 0.0, inside)
        for i, j, k in ti.ndrange((first[0], last[0]), (first[1], last[1]), (first[2], last[2])):
            b = inverse @ (ti.Vector([i, j, k], ti.f32) - x0)
            if b.min() >= -1e-5 and b.sum() <= 1.00001:
                inside[i, j, k] = 1


@ti.func
def segment_distance_squared(a, b):
    """Squared distance from the origin to the segment a-b."""
    e = b - a
    return (a + e * ti.math.clamp(-a.dot(e) / ti.max(e.norm_sqr(), 1e-20), 0.0, 1.0)).norm_sqr()


@ti.func
def triangle_distance_squared(a, b, c):
    """Squared distance from the origin to the triangle a, b, c."""
    n = (b - a).cross(c - a)
    nearest = ti.min(segment_distance_squared(a, b), segment_distance_squared(b, c), segment_distance_squared(c, a))
    within = n.dot(a.cross(b)) >= 0.0 and n.dot(b.cross(c)) >= 0.0 and n.dot(c.cross(a)) >= 0.0
    if within and n.norm_sqr() > 1e-20:
        nearest = ti.min(nearest, n.dot(a) ** 2 / n.norm_sqr())
    return nearest


def grid_of(shape: "RestShape") -> DistanceGrid:
    """Distance grid of a rest shape: its body's own, else one made of the mesh; an empty one of a box."""
    if shape.boxed:
        return DistanceGrid(np.full((2, 2, 2), UNKNOWN_DISTANCE, np.float32), np.zeros(3), 1e-3)
    if shape.sdf is not None:
        return shape.sdf
    if shape.root is not shape:
        return shape.root.once(grid_of).scaled(shape.factor)
    return rest_grid(shape.vertices, shape.solid, shape.surface)
