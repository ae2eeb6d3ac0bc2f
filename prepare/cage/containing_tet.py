"""Which tet of a cage holds each of many points that stay where they are while the cage changes, by a kernel.

The points are sorted into a grid once; then tets look for their points, which needs no table of tets.
"""

import numpy as np
import taichi as ti

from core.point_location import WEIGHT_MIN

CELLS = 64  # of the grid on the longest side: a few points in each cell of a surface
NOWHERE = 2**31 - 1

vec3 = ti.types.vector(3, ti.f64)
reals, indices = ti.types.ndarray(ti.f64), ti.types.ndarray(ti.i32)


class Points:
    """Points (N, 3), any number of them. Taichi must be running."""

    def __init__(self, points: np.ndarray) -> None:
        points = np.asarray(points, np.float64)
        self.count = len(points)
        if not self.count:
            return
        low, high = points.min(0), points.max(0)
        self.size = max(float((high - low).max()) / CELLS, 1e-12)
        index = ((points - low) / self.size).astype(np.int64)
        self.shape = index.max(0) + 1
        flat = np.ravel_multi_index(index.T, self.shape)
        self.order = np.argsort(flat)
        begin = np.concatenate([[0], np.bincount(flat, minlength=int(self.shape.prod())).cumsum()])
        self.low = low
        self.points, self.begin = ti.ndarray(ti.f64, points.shape), ti.ndarray(ti.i32, len(begin))
        self.points.from_numpy(points[self.order])
        self.begin.from_numpy(begin.astype(np.int32))

    def hosts(self, vertices: np.ndarray, tets: np.ndarray) -> np.ndarray:
        """Index (N,) of the first tet that holds each point, or -1 where none does: as TetLocator.find."""
        found = np.full(self.count, -1, np.int32)
        if self.count:
            x, t = np.ascontiguousarray(vertices, np.float64), np.ascontiguousarray(tets, np.int32)
            host = np.empty(self.count, np.int32)
            grid = vec3(*map(float, self.low)), self.size, ti.Vector(list(map(int, self.shape)))
            _hold(self.points, self.begin, x, t, *grid, host)
            found[self.order] = np.where(host == NOWHERE, -1, host)
        return found

    def share(self, vertices: np.ndarray, tets: np.ndarray) -> float:
        """Share of the points that lie in a tet; 1 where there are none."""
        return float((self.hosts(vertices, tets) >= 0).mean()) if self.count else 1.0


@ti.kernel
def _hold(
    points: reals,
    begin: indices,
    x: reals,
    tets: indices,
    low: vec3,
    size: ti.f64,
    shape: ti.types.vector(3, ti.i32),
    host: indices,
):
    """host = the least tet whose barycentric weights of the point are all at least INSIDE."""
    for p in range(host.shape[0]):
        host[p] = NOWHERE
    for t in range(tets.shape[0]):
        corner = [vec3(x[tets[t, k], 0], x[tets[t, k], 1], x[tets[t, k], 2]) for k in ti.static(range(4))]
        a, b, c = corner[1] - corner[0], corner[2] - corner[0], corner[3] - corner[0]
        ga, gb, gc = b.cross(c), c.cross(a), a.cross(b)
        six = a.dot(ga)
        least = ti.min(ti.min(corner[0], corner[1]), ti.min(corner[2], corner[3]))
        most = ti.max(ti.max(corner[0], corner[1]), ti.max(corner[2], corner[3]))
        edge = ti.cast(shape, ti.f64)
        first = ti.cast(ti.floor(ti.min(ti.max((least - low) / size - 0.01, 0.0), edge)), ti.i32)
        last = ti.cast(ti.floor(ti.min(ti.max((most - low) / size + 0.01, -1.0), edge - 1.0)), ti.i32)
        if first[2] <= last[2]:
            for i in range(first[0], last[0] + 1):
                for j in range(first[1], last[1] + 1):
                    row = (i * shape[1] + j) * shape[2]
                    for p in range(begin[row + first[2]], begin[row + last[2] + 1]):
                        d = vec3(points[p, 0], points[p, 1], points[p, 2]) - corner[0]
                        u, v, w = ga.dot(d) / six, gb.dot(d) / six, gc.dot(d) / six
                        if ti.min(ti.min(u, v), ti.min(w, 1.0 - u - v - w)) >= WEIGHT_MIN:
                            ti.atomic_min(host[p], t)
