"""Surface of a level set as triangles, and distances between a surface and points."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from core.distance_grid import DistanceGrid
from core.errors import BadInput
from core.tetmesh import enclosed_volume

SAMPLES = 60_000  # points that stand for a surface
NEAREST_SAMPLES = 12  # samples whose triangles are measured exactly for a point


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


def areas(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Area of each triangle [m^2], (F,)."""
    a, b, c = np.moveaxis(np.asarray(vertices, np.float64)[faces], 1, 0)
    return 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1)


def surface_samples(vertices: np.ndarray, faces: np.ndarray, n: int = SAMPLES, seed: int = 0):
    """Points (n, 3) [m] spread evenly over the triangles, and the triangle (n,) of each.

    Stratified: one point in each n-th of the area, so that no region is missed.
    """
    rng = np.random.default_rng(seed)
    along = np.cumsum(areas(vertices, faces))
    triangle = np.searchsorted(along, (np.arange(n) + rng.uniform(size=n)) / n * along[-1]).clip(max=len(faces) - 1)
    u, v = np.sqrt(rng.uniform(size=n)), rng.uniform(size=n)
    weights = np.stack([1 - u, u * (1 - v), u * v], 1)
    return np.einsum("nk,nki->ni", weights, np.asarray(vertices, np.float64)[faces[triangle]]), triangle


def distance_to_triangles(p: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Distance [m] (N,) of each point p (N, 3) to its own triangle, corners (N, 3, 3).

    To the plane where the foot falls inside, else to the nearest edge.
    """
    a, b, c = np.moveaxis(corners, 1, 0)
    best = np.full(len(p), np.inf)
    normal = np.cross(b - a, c - a)
    inside = np.ones(len(p), bool)
    for start, end in ((a, b), (b, c), (c, a)):
        edge, to = end - start, p - start
        inside &= np.einsum("ni,ni->n", np.cross(edge, to), normal) >= 0
        t = np.einsum("ni,ni->n", to, edge) / np.maximum(np.einsum("ni,ni->n", edge, edge), 1e-300)
        best = np.minimum(best, np.linalg.norm(to - t.clip(0, 1)[:, None] * edge, axis=1))
    length = np.linalg.norm(normal, axis=1)
    plane = np.abs(np.einsum("ni,ni->n", p - a, normal)) / np.maximum(length, 1e-300)
    return np.where(inside & (length > 0), plane, best)


def distance_to_surface(points: np.ndarray, vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Distance [m] (N,) of points (N, 3) to a surface: exact for the triangles of the nearest samples."""
    samples, triangle = surface_samples(vertices, faces)
    corners = np.asarray(vertices, np.float64)[faces]
    _, near = cKDTree(samples).query(points, k=NEAREST_SAMPLES)
    best = np.full(len(points), np.inf)
    for k in range(NEAREST_SAMPLES):
        best = np.minimum(best, distance_to_triangles(points, corners[triangle[near[:, k]]]))
    return best


def distance_statistics(distances: np.ndarray) -> dict:
    """Mean, 95th percentile and maximum of distances [m]."""
    return {
        "mean": float(distances.mean()),
        "p95": float(np.percentile(distances, 95)),
        "max": float(distances.max()),
    }
