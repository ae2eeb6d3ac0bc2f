"""Level sets: from Gaussians to solid cells, to a smooth signed distance of closed components without holes (VR-GS,
Sec. 4.2), to their surfaces as triangles; and distances between a surface and points.

Solid are the dense shell of the Gaussians and what it encloses (PhysGaussian, Sec. 3.5). A splat is a shell with a hole
where no camera looked, mostly the underside: a cell is interior if rays along the axes hit the shell in five of six
directions and one of them crosses it an odd number of times.

Boolean grids are dilated by shifts (a tenth of the time of SciPy's general structuring elements).
"""

from dataclasses import dataclass

import numpy as np
import taichi as ti
from scipy.ndimage import distance_transform_edt, gaussian_filter, label
from scipy.spatial import cKDTree

from assets.gaussians import Gaussians
from core.distance_grid import DistanceGrid
from core.errors import BadInput
from core.rotation import matrices_from_quaternions

DENSE = 0.5  # summed opacity; the visible surface is about where half of the light is absorbed
BLUR = 0.5  # cells; standard deviation added to each Gaussian, so that none falls between the nodes
CUTOFF = 3.0  # standard deviations splatted
MAX_CUTOFF_CELLS = 12.0  # a smear must not cost more than thousands of other Gaussians
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
    """The cells, and those whose centres are at most two cells away."""
    grown = dilated_26(cells)  # the corners of this cube are nearer than two, the next cells off its faces are not
    for axis in range(3):
        grown |= shifted_or(cells, axis, 2)
    return grown


@ti.kernel
def _add(
    mean: ti.types.ndarray(dtype=ti.f32, ndim=2),
    inverse: ti.types.ndarray(dtype=ti.f32, ndim=2),
    opacity: ti.types.ndarray(dtype=ti.f32, ndim=1),
    radius: ti.types.ndarray(dtype=ti.f32, ndim=2),
    density: ti.types.ndarray(dtype=ti.f32, ndim=3),
):
    """density(x) += sum_g o_g exp(-1/2 (x - mu)^T Sigma^-1 (x - mu)); all in cells, node (i, j, k) at (i, j, k)."""
    for g in range(opacity.shape[0]):
        mu = ti.Vector([mean[g, 0], mean[g, 1], mean[g, 2]])
        r = ti.Vector([radius[g, 0], radius[g, 1], radius[g, 2]])
        last = ti.Vector([density.shape[0], density.shape[1], density.shape[2]]) - 1.0
        low = ti.cast(ti.ceil(ti.math.clamp(mu - r, 0.0, last)), ti.i32)  # clamped as floats: no integer overflow
        high = ti.cast(ti.floor(ti.math.clamp(mu + r, -1.0, last)), ti.i32)
        for i in range(low[0], high[0] + 1):
            for j in range(low[1], high[1] + 1):
                for k in range(low[2], high[2] + 1):
                    d = ti.Vector([i, j, k]) - mu
                    q = inverse[g, 0] * d[0] * d[0] + inverse[g, 3] * d[1] * d[1] + inverse[g, 5] * d[2] * d[2]
                    q += 2 * (inverse[g, 1] * d[0] * d[1] + inverse[g, 2] * d[0] * d[2] + inverse[g, 4] * d[1] * d[2])
                    if q < CUTOFF * CUTOFF:
                        density[i, j, k] += opacity[g] * ti.exp(-0.5 * q)


def density_of(gaussians: Gaussians, origin: np.ndarray, spacing: float, shape: tuple[int, int, int]) -> np.ndarray:
    """Summed opacity (X, Y, Z) float32 at the nodes origin + spacing (i, j, k) [m]. Taichi must be running."""
    variances = (np.exp(gaussians.log_scales.astype(np.float64)) / spacing) ** 2 + BLUR**2
    axes = matrices_from_quaternions(gaussians.quats)
    spread = np.einsum("nik,nk->ni", axes**2, variances)
    radius = np.minimum(CUTOFF * np.sqrt(spread), MAX_CUTOFF_CELLS)
    scaled = axes / variances[:, None]
    inverse = np.stack([(scaled[:, i] * axes[:, j]).sum(1) for i in range(3) for j in range(i, 3)], 1)
    means, density = (gaussians.means - origin) / spacing, np.zeros(shape, np.float32)
    _add(*(np.ascontiguousarray(a, np.float32) for a in (means, inverse, gaussians.opacities, radius)), density)
    return density


def interior(shell: np.ndarray, *, up: tuple[int, int] | None = (1, 1)) -> np.ndarray:
    """Cells (X, Y, Z) bool that the shell (X, Y, Z) bool encloses, up to a hole on one side.

    up  axis and sign of the direction that must hit, so that a cup is not filled to its rim; None: any may miss
    """
    hits = np.zeros(shell.shape, np.uint8)
    odd = np.zeros(shell.shape, bool)
    capped = np.ones(shell.shape, bool)
    for axis in range(3):
        for sign in (1, -1):
            ray = np.flip(shell, axis) if sign > 0 else shell  # accumulates from the ray's end
            enters = ray.copy()
            np.moveaxis(enters, axis, 0)[1:] &= ~np.moveaxis(ray, axis, 0)[:-1]
            crossings = np.cumsum(enters, axis, dtype=np.uint8)  # at most 128: grids are below 256
            crossings = np.flip(crossings, axis) if sign > 0 else crossings
            hits += crossings > 0
            odd |= (crossings & 1).view(bool)
            if up == (axis, sign):
                capped = crossings > 0
    return ~shell & (hits >= 5) & odd & capped


def solid_cells(density: np.ndarray) -> np.ndarray:
    """Solid cells (X, Y, Z) bool: the dense shell with its hairline gaps closed, and its interior."""
    shell = np.pad(density > DENSE, 2)  # closing must not see the border
    shell = ~dilated_18(~dilated_18(shell))[2:-2, 2:-2, 2:-2]
    return shell | interior(shell)


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
        best = np.fmin(best, np.linalg.norm(points - foot, axis=1))  # without the feet of triangles that are a line
    return best


def distance_statistics(distances: np.ndarray) -> dict:
    """Mean, 95th percentile and maximum of distances [m]."""
    return {
        "mean": float(distances.mean()),
        "p95": float(np.percentile(distances, 95)),
        "max": float(distances.max()),
    }
