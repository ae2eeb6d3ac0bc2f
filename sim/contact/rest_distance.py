"""The signed distance grid of a cage at rest, for bodies that come without one."""

import numpy as np
import taichi as ti
from scipy.ndimage import distance_transform_edt

from core.distance_grid import DistanceGrid

PADDING = 4  # nodes around the cage's box: contact begins outside
BAND = 3.5  # [nodes] around the surface with exact distances; further away only the sign and the trend matter
UNREACHED = 1e9  # [m]


def rest_grid(vertices: np.ndarray, tets: np.ndarray, surface: np.ndarray, *, nodes: int = 48) -> DistanceGrid:
    """Distance grid [m] of a cage with about `nodes` nodes along its longest side.

    Exact within BAND nodes of the surface, grown from there by the distance between nodes; negative in the tets.
    """
    x = np.asarray(vertices, np.float32)
    spacing = float(np.ptp(x, axis=0).max()) / nodes
    origin = x.min(0).astype(np.float64) - PADDING * spacing
    dims = np.ceil((x.max(0) - origin) / spacing).astype(int) + PADDING + 1
    local = ((x - origin) / spacing).astype(np.float32)  # in nodes
    values, inside = np.full(dims, UNREACHED, np.float32), np.zeros(dims, np.int32)
    _surface_distances(values, np.ascontiguousarray(local[np.asarray(surface)]))
    _mark_inside(inside, np.ascontiguousarray(local[np.asarray(tets)]))
    far, nearest = distance_transform_edt(values > BAND, return_indices=True)
    phi = np.where(values <= BAND, values, far + values[tuple(nearest)])
    return DistanceGrid((spacing * np.where(inside > 0, -phi, phi)).astype(np.float32), origin, spacing)


@ti.func
def bounds(low, high, reach, values: ti.template()):
    """First and one past the last node of the box low - reach .. high + reach."""
    shape = ti.Vector([values.shape[0], values.shape[1], values.shape[2]])
    first = ti.max(ti.ceil(low - reach, ti.i32), 0)
    last = ti.min(ti.floor(high + reach, ti.i32) + 1, shape)
    return first, last


@ti.kernel
def _surface_distances(values: ti.types.ndarray(ti.f32, 3), corners: ti.types.ndarray(ti.f32, 3)):
    """values = min over triangles of the distance to them, in nodes, where that is below BAND."""
    for t in range(corners.shape[0]):
        c = ti.Matrix([[corners[t, row, axis] for axis in range(3)] for row in range(3)])
        a, b, d = c[0, :], c[1, :], c[2, :]
        first, last = bounds(ti.min(a, b, d), ti.max(a, b, d), BAND, values)
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
        first, last = bounds(ti.min(x0, x1, x2, x3), ti.max(x0, x1, x2, x3), 0.0, inside)
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
