"""Signed distances on a regular grid, their trilinear interpolation on the host, and their level surfaces."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from core.errors import BadInput
from core.tetmesh import enclosed_volume

DISTANCE_MAX = float(np.finfo(np.float16).max)  # [m] files store distances as float16
TURNED_NODES_MAX = 40_000_000  # of a turned grid: 160 MB
SKIN_VOXELS = 2.0  # of a body's grid: so far from its visible surface contact allows for its cage being wider, at most


@dataclass(frozen=True)
class DistanceGrid:
    """Signed distances [m] on a regular grid, negative inside; node (i, j, k) lies at origin + spacing * (i, j, k).

    values   (X, Y, Z) float16, float32 or float64
    origin   (3,) [m]
    spacing  [m]
    """

    values: np.ndarray
    origin: np.ndarray
    spacing: float

    @property
    def shape(self) -> tuple[int, int, int]:
        """Nodes along each axis."""
        return self.values.shape

    @property
    def upper(self) -> np.ndarray:
        """Position of the last node [m], (3,)."""
        return np.asarray(self.origin) + self.spacing * (np.array(self.shape) - 1)

    def nodes(self) -> np.ndarray:
        """Positions of all nodes [m], (X, Y, Z, 3) float64."""
        return np.asarray(self.origin, np.float64) + self.spacing * np.moveaxis(np.indices(self.shape), 0, -1)

    def sample(self, points: np.ndarray) -> np.ndarray:
        """Trilinear distance [m] at points (..., 3), (...) float64; beyond the grid that of its nearest point."""
        return sample(self.values, self.origin, self.spacing, points)

    def sample_extended(self, points: np.ndarray) -> np.ndarray:
        """As `sample`, plus the distance to the grid for points beyond it: a shape that its border cuts is closed."""
        points = np.asarray(points, np.float64)
        beyond = np.linalg.norm(points - points.clip(self.origin, self.upper), axis=-1)
        distance = self.sample(points)
        return np.where(beyond > 0, np.maximum(distance, 0) + beyond, distance)

    def scaled(self, factor: float) -> DistanceGrid:
        """The grid of a shape `factor` times as large, values float32."""
        values = np.asarray(self.values, np.float32) * np.float32(factor)
        return DistanceGrid(values, np.asarray(self.origin, np.float64) * factor, float(self.spacing) * factor)

    def transformed(self, rotation: np.ndarray, translation=(0.0, 0.0, 0.0), scale: float = 1.0) -> DistanceGrid:
        """The grid of the shape x -> scale * rotation @ x + translation; interpolated only where there is a turn.

        Raises BadInput if a grid around the turned one were too large.
        """
        scaled, translation = self.scaled(scale), np.asarray(translation, np.float64)
        if np.abs(rotation - np.eye(3)).max() < 1e-9:
            return DistanceGrid(scaled.values.astype(self.values.dtype), scaled.origin + translation, scaled.spacing)
        ends = np.stack([np.asarray(scaled.origin), scaled.upper])
        corners = np.stack(np.meshgrid(*ends.T, indexing="ij"), -1).reshape(-1, 3) @ rotation.T
        low, high = corners.min(0), corners.max(0)
        shape = np.ceil((high - low) / scaled.spacing - 1e-6).astype(int) + 1
        if shape.prod() > TURNED_NODES_MAX:
            raise BadInput(f"a turned grid would have {int(shape.prod()):,} nodes: prepare it again instead")
        values = np.empty(shape, np.float32)
        for i in range(shape[0]):  # a slice at a time: positions of all nodes take six times the memory
            nodes = low + scaled.spacing * np.stack(np.meshgrid([i], *map(np.arange, shape[1:]), indexing="ij"), -1)[0]
            values[i] = scaled.sample_extended(nodes @ rotation)
        return DistanceGrid(values.astype(self.values.dtype), low + translation, scaled.spacing)

    def check(self, where: str) -> None:
        """Raise BadInput, naming `where`, unless the grid can be interpolated: two nodes an axis, all finite."""
        if self.values.ndim != 3 or min(self.shape) < 2:
            raise BadInput(f"{where}: the distance grid has shape {self.shape}, expected at least 2 nodes an axis")
        if not (np.abs(self.values) <= DISTANCE_MAX).all():
            raise BadInput(f"{where}: a signed distance is not finite")
        origin = np.asarray(self.origin, np.float64)
        if origin.shape != (3,) or not np.isfinite(origin).all():
            raise BadInput(f"{where}: the distance grid's origin is not three finite numbers")
        if not (np.isfinite(self.spacing) and self.spacing > 0):
            raise BadInput(f"{where}: the distance grid's spacing is not positive")


def marching_cubes(distance: DistanceGrid, level: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (V, 3) [m] float64 and triangles (F, 3) int32, counter-clockwise from outside, where distance = level.

    Raises BadInput where there is no such surface. scikit-image's version of Lewiner's: the surface is closed.
    """
    from skimage.measure import marching_cubes as lewiner

    phi = distance.values
    padded = np.pad(phi, 1, constant_values=max(float(phi.max()), level + 1.0))  # closed at the grid's border, too
    if not float(phi.min()) < level:
        raise BadInput("the level set has no surface")
    vertices, faces, _, _ = lewiner(padded, level, gradient_direction="ascent", allow_degenerate=False)
    vertices = np.asarray(distance.origin, np.float64) + distance.spacing * (vertices.astype(np.float64) - 1)
    if enclosed_volume(vertices, faces) < 0:
        faces = faces[:, ::-1]
    return vertices, np.ascontiguousarray(faces, np.int32)


def same_grid(a: DistanceGrid | None, b: DistanceGrid | None) -> bool:
    """True if two grids have equal nodes and values; None equals None alone."""
    if a is None or b is None:
        return a is b
    return a is b or (
        a.spacing == b.spacing and np.array_equal(a.origin, b.origin) and np.array_equal(a.values, b.values)
    )


def sample(values: np.ndarray, origin, spacing: float, points: np.ndarray) -> np.ndarray:
    """Trilinear interpolation of `values` (X, Y, Z) at points [m] (..., 3); beyond the grid the border's value.

    Node (i, j, k) lies at origin + spacing (i, j, k) [m]. Returns (...) float64.
    """
    from scipy.ndimage import map_coordinates

    values = values if values.dtype != np.float16 else values.astype(np.float32)
    cells = (np.asarray(points, np.float64) - origin) / spacing
    return map_coordinates(values, np.moveaxis(cells, -1, 0), order=1, mode="nearest", output=np.float64)
