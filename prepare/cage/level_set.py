"""Level sets: from solid cells to a smooth signed distance of closed components without holes (VR-GS, Sec. 4.2), their
surfaces as triangles, and distances between a surface and points.

Also the operations on boolean grids that this takes: dilations by shifts (a tenth of the time of SciPy's general
structuring elements) and distances to a mask.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import distance_transform_edt, gaussian_filter, label
from scipy.spatial import cKDTree

from core.distance_grid import DistanceGrid
from core.errors import BadInput
from core.tetmesh import enclosed_volume

SMOOTHING = 1.2  # cells; standard deviation of the filter that hides the staircase of the cells
MAX_DRIFT = (-0.6, 0.3)  # cells; how far smoothing may move the surface out and in, so that thin features survive
CONTACT_NODES = 56  # of the contact grid on the longest side: half a centimetre on a toy
MAX_CONTACT_NODES = 160  # the same for several components together, however far apart
CONTACT_MARGIN = 3  # nodes around the shape
SAMPLES = 60_000  # points that stand for a surface
NEAREST_SAMPLES = 12  # samples whose triangles are measured exactly for a point


@dataclass(frozen=True)
class ComponentSolid:
    """Solid of a component in the asset's frame, on the nodes of `distance`.

    shell, solid  cells (X, Y, Z) bool: dense ones, and these with what they enclose
    distance      signed distance [m], finer than the asset's contact grid
    """

    shell: np.ndarray
    solid: np.ndarray
    distance: DistanceGrid


def shifted_or(cells: np.ndarray, axis: int, step: int = 1) -> np.ndarray:
    """The cells (X, Y, Z), and those `step` before and after them along an axis."""
    grown = cells.copy()
    into, of = np.moveaxis(grown, axis, 0), np.moveaxis(cells, axis, 0)
    into[step:] |= of[:-step]
    into[:-step] |= of[step:]
    return grown


def dilated_26(cells: np.ndarray) -> np.ndarray:
    """The cells and all of their 26 neighbours."""
    return shifted_or(shifted_or(shifted_or(cells, 0), 1), 2)


def dilated_18(cells: np.ndarray) -> np.ndarray:
    """The cells and their 18 neighbours across faces and edges."""
    z, y = shifted_or(cells, 2), shifted_or(cells, 1)
    return shifted_or(y, 0) | shifted_or(z, 0) | shifted_or(z, 1)


def dilated_ball(cells: np.ndarray) -> np.ndarray:
    """The cells and all whose centre is at most two cells from that of one."""
    grown = dilated_26(cells)  # the corners of this cube are nearer than two, the next cells off its faces are not
    for axis in range(3):
        grown |= shifted_or(cells, axis, 2)
    return grown


def distance_to(mask: np.ndarray, limit: float = np.inf) -> np.ndarray:
    """Distance [cells] (X, Y, Z) float32 to the nearest cell of a mask (X, Y, Z) bool; infinite beyond `limit`."""
    if not mask.any():
        return np.full(mask.shape, np.inf, np.float32)
    found = distance_transform_edt(~mask)
    return np.where(found > limit, np.inf, found).astype(np.float32)


def level_sets(solid: np.ndarray, least: float = 1.0) -> np.ndarray:
    """Signed distance [cells] of each component of the solid cells, closed and smoothed, (P, X, Y, Z) float32.

    least  components with at least this fraction of the largest one's cells, the largest first; 1: it alone
    Raises BadInput where there is no solid cell.
    """
    if not solid.any():
        raise BadInput("nothing is opaque enough to be solid; there is no surface")
    closed = without_cavities(solid | ~dilated_ball(~dilated_ball(solid)))  # dents narrower than 4 cells are noise
    numbers, count = label(closed)
    if count == 1:
        return smoothed_distance(closed)[None]
    sizes = np.bincount(numbers[closed], minlength=count + 1)
    order = np.argsort(-sizes, kind="stable")
    kept = [k for k in order if sizes[k] >= least * sizes[order[0]]] if least < 1 else order[:1]
    return np.stack([smoothed_distance(numbers == k) for k in kept])


def without_cavities(solid: np.ndarray) -> np.ndarray:
    """The solid cells and what they enclose."""
    numbers, count = label(~solid)
    open_ = np.zeros(count + 1, bool)
    for axis in range(3):
        for end in (0, -1):
            open_[np.unique(np.take(numbers, end, axis))] = True
    open_[0] = True  # number 0 are the solid cells
    return solid if open_.all() else solid | ~open_[numbers]


def smoothed_distance(closed: np.ndarray) -> np.ndarray:
    """Signed distance [cells] to the cells `closed`, without their staircase."""
    exact = np.where(closed, 0.5 - distance_to(~closed), distance_to(closed) - 0.5)
    smooth = gaussian_filter(exact, SMOOTHING, mode="nearest")
    return np.clip(smooth, exact + MAX_DRIFT[0], exact + MAX_DRIFT[1]).astype(np.float32)


def volume_of(phi: np.ndarray) -> float:
    """Volume [cells] of the shape where the signed distance phi [cells] is negative: nodes near zero count in part."""
    return float((0.5 - phi).clip(0, 1).sum(dtype=np.float64))


def contact_grid(shapes: list[DistanceGrid]) -> DistanceGrid:
    """Signed distance [m] of the union of shapes, resampled for contact.

    float16, CONTACT_NODES on the longest side of the largest shape.
    """
    boxes = []
    for shape in shapes:
        solid = np.argwhere(shape.values < 0)
        boxes.append(shape.origin + shape.spacing * np.array([solid.min(0) - 1, solid.max(0) + 1]))
    boxes = np.array(boxes)  # (P, 2, 3)
    step = np.ptp(boxes, axis=1).max() / (CONTACT_NODES - 1 - 2 * CONTACT_MARGIN)
    low, high = boxes[:, 0].min(0), boxes[:, 1].max(0)
    step = max(step, (high - low).max() / (MAX_CONTACT_NODES - 1 - 2 * CONTACT_MARGIN))
    nodes = np.ceil((high - low) / step).astype(int) + 1 + 2 * CONTACT_MARGIN
    start = (low + high) / 2 - (nodes - 1) * step / 2
    points = start + step * np.moveaxis(np.indices(nodes), 0, -1)
    values = np.min([shape.sample_extended(points) for shape in shapes], axis=0)
    return DistanceGrid(values.astype(np.float16), start, float(step))


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


def surface_samples(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """SAMPLES points (N, 3) [m] spread evenly over the triangles, and the triangle (N,) of each."""
    import trimesh

    return trimesh.sample.sample_surface(trimesh.Trimesh(vertices, faces, process=False), SAMPLES, seed=0)


def distance_to_surface(points: np.ndarray, vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Distance [m] (N,) of points (N, 3) to a surface: exact for the triangles of the nearest samples."""
    from trimesh.triangles import closest_point

    samples, triangle = surface_samples(vertices, faces)
    corners = np.asarray(vertices, np.float64)[faces]
    _, near = cKDTree(samples).query(points, k=NEAREST_SAMPLES)
    best = np.full(len(points), np.inf)
    for k in range(NEAREST_SAMPLES):
        foot = closest_point(corners[triangle[near[:, k]]], points)
        best = np.minimum(best, np.linalg.norm(points - foot, axis=1))
    return best


def distance_statistics(distances: np.ndarray) -> dict:
    """Mean, 95th percentile and maximum of distances [m]."""
    return {
        "mean": float(distances.mean()),
        "p95": float(np.percentile(distances, 95)),
        "max": float(distances.max()),
    }
