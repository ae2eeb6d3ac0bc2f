"""Point location in a tetrahedral mesh: the tet that holds a point, and the boundary nearest to one outside."""

from __future__ import annotations

from functools import cached_property

import numpy as np

from core.tetmesh import cross_columns, edge_vectors, indices_of_unique, tet_faces, vertex_set_keys

WEIGHT_MIN = -1e-7  # a barycentric weight this small still counts as inside: float32 rounding of a face
POINTS_AT_ONCE = 1 << 18  # a few tens of MB
CELL_TET_PAIRS_MAX = 20_000_000  # bounds the grid's memory on badly graded meshes
SAMPLES_PER_EDGE = 4  # of a boundary triangle, squared: the nearest distance is right to an eighth of its edge


class TetLocator:
    """Point location in a tetrahedral mesh through a uniform grid of cells, in NumPy and SciPy.

    A cell lists the tets that may touch it, so `find` is exact up to rounding. Cells are half as wide as a tet: about
    eight candidates each. Cell (i, j, k) has its corner at origin + cell_size (i, j, k).

    vertices, tets    [m] (V, 3) float64, (T, 4) of positive volume
    first_vertex      position of each tet's first vertex [m], (T, 3)
    weight_gradients  gradients of the barycentric weights of its other three [1/m], (T, 3, 3), a row each
    vertex_edge       mean edge length of the tets at each vertex [m], (V,)
    origin, cell_size, grid_shape   [m] (3,), [m], cells along each axis
    box_begin, box_extent   first cell of each tet's bounding box and cells along each axis, (T, 3)
    """

    def __init__(self, vertices: np.ndarray, tets: np.ndarray) -> None:
        self.vertices = np.asarray(vertices, np.float64)
        self.tets = np.asarray(tets, np.int64)
        corners = self.vertices.take(self.tets, axis=0)
        self.first_vertex = corners[:, 0]
        a, b, c = edge_vectors(self.vertices, self.tets)
        normals = np.stack([cross_columns(b, c), cross_columns(c, a), cross_columns(a, b)])
        six_volumes = np.einsum("it,it->t", normals[0], a)
        self.weight_gradients = np.ascontiguousarray(np.moveaxis(normals / six_volumes, 2, 0))
        edge = np.cbrt(np.abs(six_volumes) * np.sqrt(2))  # of the regular tet of that volume
        count = np.bincount(self.tets.ravel(), minlength=len(self.vertices))
        total = np.bincount(self.tets.ravel(), np.repeat(edge, 4), len(self.vertices))
        self.vertex_edge = total / np.maximum(count, 1)
        self._lay_grid(corners.min(1), corners.max(1))

    def weights(self, host: np.ndarray, points: np.ndarray) -> np.ndarray:
        """Barycentric weights (M, 4) of points [m] (M, 3) in the tets `host` (M,); outside one they extrapolate."""
        last = np.einsum("nij,nj->ni", self.weight_gradients[host], points - self.first_vertex[host])
        first = 1 - last[:, 0] - last[:, 1] - last[:, 2]
        return np.concatenate([first[:, None], last], 1)

    def gradients(self, host: np.ndarray) -> np.ndarray:
        """Gradients [1/m] of the four barycentric weights of the tets `host`, (M, 4, 3)."""
        last = self.weight_gradients[host]
        return np.concatenate([-last.sum(1, keepdims=True), last], 1)

    def edge_length(self, host: np.ndarray, points: np.ndarray) -> np.ndarray:
        """Edge length [m] (M,) of the tets about points in `host`; continuous, for it is kept at the vertices."""
        weights = self.weights(host, points).clip(0)
        return (self.vertex_edge[self.tets[host]] * weights).sum(1) / weights.sum(1)

    def find(self, points: np.ndarray) -> np.ndarray:
        """Index of a tet that holds each point [m] (M, 3), or -1 where none does."""
        points = np.asarray(points, np.float64)
        index = np.floor((points - self.origin) / self.cell_size).astype(np.int64)
        within = np.logical_and.reduce([(index[:, i] >= 0) & (index[:, i] < self.grid_shape[i]) for i in range(3)])
        cell = np.where(within, np.ravel_multi_index(np.where(within[:, None], index, 0).T, self.grid_shape), 0)
        host = np.full(len(points), -1, np.int64)
        _, cell_start = self._cell_lists
        todo = np.flatnonzero(within & (cell_start[cell + 1] > cell_start[cell]))
        todo = todo[np.argsort(cell[todo], kind="stable")]  # neighbours share candidates: they stay in the cache
        for begin in range(0, len(todo), POINTS_AT_ONCE):
            self._find_some(todo[begin : begin + POINTS_AT_ONCE], cell, points, host)
        return host

    def nearest(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """For points [m] (M, 3) outside: the nearest boundary tet and the nearest boundary sample, (M,), (M, 3)."""
        tree, tet = self._sample_tree
        _, nearest = tree.query(points, workers=-1)
        return tet[nearest], tree.data[nearest]

    def boundary_samples(self) -> tuple[np.ndarray, np.ndarray]:
        """Points [m] (B, 3) all over the boundary, SAMPLES_PER_EDGE^2 a triangle, and the tet of each (B,)."""
        faces = tet_faces(self.tets)
        boundary = indices_of_unique(vertex_set_keys(faces))
        a, b, c = np.moveaxis(self.vertices[faces[boundary]], 1, 0)
        samples, n = [], SAMPLES_PER_EDGE
        for i in range(n):  # centroids of the n^2 small triangles
            for j in range(n - i):
                for third in (1 / 3, 2 / 3) if i + j < n - 1 else (1 / 3,):
                    u, v = (i + third) / n, (j + third) / n
                    samples.append(a + u * (b - a) + v * (c - a))
        return np.concatenate(samples), np.tile(boundary // 4, len(samples))

    def _find_some(self, left: np.ndarray, cell: np.ndarray, points: np.ndarray, host: np.ndarray) -> None:
        """Try each cell's first candidate, then the second where that failed, and so on."""
        candidates, cell_start = self._cell_lists
        at, end, p = cell_start[cell[left]], cell_start[cell[left] + 1], points[left]
        while len(left):
            tet = candidates[at]
            a, b, c = np.einsum("nij,nj->ni", self.weight_gradients[tet], p - self.first_vertex[tet]).T
            inside = (a >= WEIGHT_MIN) & (b >= WEIGHT_MIN) & (c >= WEIGHT_MIN) & (a + b + c <= 1 - WEIGHT_MIN)
            host[left[inside]] = tet[inside]
            at = at + 1
            keep = ~inside & (at < end)
            left, at, end, p = left[keep], at[keep], end[keep], p[keep]

    def _lay_grid(self, low: np.ndarray, high: np.ndarray) -> None:
        """Lay cells over the bounding boxes low (T, 3) to high (T, 3) [m] of the tets."""
        self.origin = low.min(0) - 1e-6
        cell_size = 0.5 * (high - low).mean()
        while True:
            begin = np.floor((low - self.origin) / cell_size).astype(np.int64)
            extent = np.floor((high - self.origin) / cell_size).astype(np.int64) - begin + 1
            if extent.prod(1).sum() <= CELL_TET_PAIRS_MAX:
                break
            cell_size *= 1.5
        self.cell_size, self.box_begin, self.box_extent = cell_size, begin, extent
        self.grid_shape = tuple((begin + extent).max(0))

    @cached_property
    def _sample_tree(self):
        """k-d tree of the boundary samples, and the tet of each."""
        from scipy.spatial import cKDTree

        samples, tet = self.boundary_samples()
        return cKDTree(samples, balanced_tree=False, compact_nodes=False), tet  # built in a third of the time

    @cached_property
    def _cell_lists(self) -> tuple[np.ndarray, np.ndarray]:
        """Tets that may touch a cell, cell after cell, and where those of each cell begin (and the last end).

        Made on first use: a device search makes its own.
        """
        first, extent, cell_size = self.box_begin, self.box_extent, self.cell_size
        counts = extent.prod(1)
        tet = np.repeat(np.arange(len(counts), dtype=np.int32), counts)
        rank = np.arange(counts.sum(), dtype=np.int32) - np.repeat((counts.cumsum() - counts).astype(np.int32), counts)
        ey, ez = extent[:, 1].astype(np.int32)[tet], extent[:, 2].astype(np.int32)[tet]
        column = rank // ez
        step = column // ey, column % ey, rank - column * ez
        # A tet misses a cell if one of its weights is negative in all of it: at the centre plus half |gradient|_1.
        every = np.arange(len(counts))
        g = self.gradients(every)
        centre = self.origin + cell_size * (first + 0.5)
        largest = self.weights(every, centre) + 0.5 * cell_size * np.abs(g).sum(2)  # in the box's first cell
        touches = np.ones(len(tet), bool)
        for k in range(4):
            bound = largest[tet, k]
            for axis in range(3):
                bound += (cell_size * g[:, k, axis])[tet] * step[axis]
            touches &= bound >= WEIGHT_MIN
        tet = tet[touches].astype(np.int64)
        flat = np.ravel_multi_index((first[tet] + np.stack([a[touches] for a in step], 1)).T, self.grid_shape)
        order = np.argsort(flat, kind="stable")
        return tet[order], np.searchsorted(flat[order], np.arange(np.prod(self.grid_shape) + 1))
