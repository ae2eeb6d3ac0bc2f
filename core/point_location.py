"""Which tetrahedron of a cage holds a point, and which is nearest to a point outside. NumPy and SciPy only."""

from __future__ import annotations

from functools import cached_property

import numpy as np

from core.tetmesh import alone, cross, faces_of, keys_of

INSIDE = -1e-7  # a barycentric coordinate this small still counts as inside: float32 rounding of a face
CHUNK = 1 << 18  # points handled at once: a few tens of MB
MOST_PAIRS = 20_000_000  # (cell, tet) pairs of the grid: bounds its memory on badly graded meshes
SPLIT = 4  # a boundary triangle is searched through SPLIT^2 samples: the distance is right to an eighth of its edge


class Locator:
    """Point location in a tetrahedral mesh through a uniform grid of cells.

    vertices [m] (V, 3) and tets (T, 4) of positive volume. A cell lists the tets that may touch it,
    so `find` is exact up to rounding. Cells are half as wide as a tet: about eight candidates each.

    first (T, 3) [m], slopes (T, 3, 3) [1/m]: a tet's first vertex, gradients of its weights 1 to 3. edge (V,) [m]: of
    the tets at a vertex. Cell (i, j, k) of `shape`, corner at origin + cell (i, j, k) [m], flat index c, holds
    candidates[start[c] : start[c + 1]].
    """

    def __init__(self, vertices: np.ndarray, tets: np.ndarray) -> None:
        self.vertices = np.asarray(vertices, np.float64)
        self.tets = np.asarray(tets, np.int64)
        x = self.vertices.take(self.tets, axis=0)
        self.first = x[:, 0]
        a, b, c = np.moveaxis(x[:, 1:] - x[:, :1], 1, 0)
        normals = np.stack([cross(b, c), cross(c, a), cross(a, b)], 1)
        six = np.einsum("ni,ni->n", normals[:, 0], a)  # times the volume
        self.slopes = normals / six[:, None, None]  # rows: gradients of the weights 1 to 3
        edge = np.cbrt(np.abs(six) * np.sqrt(2))  # of the regular tet of that volume
        count = np.bincount(self.tets.ravel(), minlength=len(self.vertices))
        self.edge = np.bincount(self.tets.ravel(), np.repeat(edge, 4), len(self.vertices)) / np.maximum(count, 1)
        self._lay_grid(x.min(1), x.max(1))
        self._tree = None

    def weights(self, host: np.ndarray, points: np.ndarray) -> np.ndarray:
        """Barycentric weights (M, 4) of points [m] (M, 3) in the tets `host` (M,); outside one they extrapolate."""
        last = np.einsum("nij,nj->ni", self.slopes[host], points - self.first[host])
        first = 1 - last[:, 0] - last[:, 1] - last[:, 2]
        return np.concatenate([first[:, None], last], 1)

    def gradients(self, host: np.ndarray) -> np.ndarray:
        """Gradients [1/m] of the four barycentric weights of the tets `host`, (M, 4, 3)."""
        last = self.slopes[host]
        return np.concatenate([-last.sum(1, keepdims=True), last], 1)

    def size(self, host: np.ndarray, points: np.ndarray) -> np.ndarray:
        """Edge length [m] (M,) of the tets about points in `host`; continuous, for it is kept at the vertices."""
        weights = self.weights(host, points).clip(0)
        return (self.edge[self.tets[host]] * weights).sum(1) / weights.sum(1)

    def find(self, points: np.ndarray) -> np.ndarray:
        """Index of a tet that holds each point [m] (M, 3), or -1 where none does."""
        points = np.asarray(points, np.float64)
        index = np.floor((points - self.origin) / self.cell).astype(np.int64)
        within = np.logical_and.reduce([(index[:, i] >= 0) & (index[:, i] < self.shape[i]) for i in range(3)])
        cell = np.where(within, np.ravel_multi_index(np.where(within[:, None], index, 0).T, self.shape), 0)
        host = np.full(len(points), -1, np.int64)
        todo = np.flatnonzero(within & (self.start[cell + 1] > self.start[cell]))
        todo = todo[np.argsort(cell[todo], kind="stable")]  # neighbours share candidates: they stay in the cache
        for begin in range(0, len(todo), CHUNK):
            self._find_chunk(todo[begin : begin + CHUNK], cell, points, host)
        return host

    def nearest(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """For points [m] (M, 3) outside: the boundary tet next to each, and the point of its boundary, (M,), (M, 3)."""
        from scipy.spatial import cKDTree

        if self._tree is None:
            samples, self._owner = self.boundary_samples()
            self._tree = cKDTree(samples, balanced_tree=False, compact_nodes=False)  # built in a third of the time
        _, which = self._tree.query(points, workers=-1)
        return self._owner[which], self._tree.data[which]

    def _find_chunk(self, left: np.ndarray, cell: np.ndarray, points: np.ndarray, host: np.ndarray) -> None:
        """Try each cell's first candidate, then the second where that failed, and so on."""
        at, end, p = self.start[cell[left]], self.start[cell[left] + 1], points[left]
        while len(left):
            tet = self.candidates[at]
            a, b, c = np.einsum("nij,nj->ni", self.slopes[tet], p - self.first[tet]).T
            inside = (a >= INSIDE) & (b >= INSIDE) & (c >= INSIDE) & (a + b + c <= 1 - INSIDE)
            host[left[inside]] = tet[inside]
            at = at + 1
            keep = ~inside & (at < end)
            left, at, end, p = left[keep], at[keep], end[keep], p[keep]

    def _lay_grid(self, low: np.ndarray, high: np.ndarray) -> None:
        """Cells over the boxes low (T, 3) to high (T, 3) [m] of the tets; begin, extent (T, 3): cells of each box."""
        self.origin = low.min(0) - 1e-6
        cell = 0.5 * (high - low).mean()
        while True:
            begin = np.floor((low - self.origin) / cell).astype(np.int64)
            extent = np.floor((high - self.origin) / cell).astype(np.int64) - begin + 1
            if extent.prod(1).sum() <= MOST_PAIRS:
                break
            cell *= 1.5
        self.cell, self.begin, self.extent = cell, begin, extent
        self.shape = tuple((begin + extent).max(0))

    @cached_property
    def _lists(self) -> tuple[np.ndarray, np.ndarray]:
        """candidates and start, made when they are first asked for."""
        first, extent, cell = self.begin, self.extent, self.cell
        counts = extent.prod(1)
        tet = np.repeat(np.arange(len(counts), dtype=np.int32), counts)
        rank = np.arange(counts.sum(), dtype=np.int32) - np.repeat((counts.cumsum() - counts).astype(np.int32), counts)
        ey, ez = extent[:, 1].astype(np.int32)[tet], extent[:, 2].astype(np.int32)[tet]
        column = rank // ez
        step = column // ey, column % ey, rank - column * ez
        # A tet misses a cell if one of its weights is negative in all of it: at the centre plus half |gradient|_1.
        every = np.arange(len(counts))
        g = self.gradients(every)
        corner = self.weights(every, self.origin + cell * (first + 0.5)) + 0.5 * cell * np.abs(g).sum(2)
        may = np.ones(len(tet), bool)
        for k in range(4):
            most = corner[tet, k]
            for axis in range(3):
                most += (cell * g[:, k, axis])[tet] * step[axis]
            may &= most >= INSIDE
        tet = tet[may].astype(np.int64)
        flat = np.ravel_multi_index((first[tet] + np.stack([a[may] for a in step], 1)).T, self.shape)
        order = np.argsort(flat, kind="stable")
        return tet[order], np.searchsorted(flat[order], np.arange(np.prod(self.shape) + 1))

    @property
    def candidates(self) -> np.ndarray:
        """Tets that may touch a cell, cell after cell."""
        return self._lists[0]

    @property
    def start(self) -> np.ndarray:
        """Where in `candidates` the tets of each cell begin, and the end."""
        return self._lists[1]

    def boundary_samples(self) -> tuple[np.ndarray, np.ndarray]:
        """Points [m] (B, 3) all over the boundary, SPLIT^2 a triangle, and the tet of each (B,)."""
        faces = faces_of(self.tets)
        boundary = alone(keys_of(faces))
        a, b, c = np.moveaxis(self.vertices[faces[boundary]], 1, 0)
        samples = []
        for i in range(SPLIT):  # centroids of the SPLIT^2 small triangles
            for j in range(SPLIT - i):
                for up in (1 / 3, 2 / 3) if i + j < SPLIT - 1 else (1 / 3,):
                    u, v = (i + up) / SPLIT, (j + up) / SPLIT
                    samples.append(a + u * (b - a) + v * (c - a))
        return np.concatenate(samples), np.tile(boundary // 4, len(samples))
