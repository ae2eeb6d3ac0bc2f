"""Mesh optimisation: move a cage's vertices so that a longer substep is stable.

Stuffing leaves thin tets and light corners on the surface whose kappa (prepare/cage/mesh_quality.py) is thirty times
the median. Gradient descent lowers a high power of kappa and of a measure of shape while surface vertices slide on the
surface; then the worst remaining tets are lifted by local search. Substeps become twice as long, and the smallest
dihedral angle rises from about 12 to about 17 degrees.
"""

import numpy as np
import taichi as ti

from assets.asset import Cage
from core.distance_grid import DistanceGrid
from core.tetmesh import tet_volumes
from prepare.cage.level_set import areas
from prepare.cage.mesh_quality import (
    Matrix,
    QualityEnergy,
    Vector,
    device_array,
    dihedral_cosines,
    smallest_angle,
)

DESCENT_STEPS = 30  # of descent; 20 bring most of the substep, the others better angles
MAX_TRAVEL = 0.35  # lattice cells a vertex may move by descent
FIRST_STEP, LAST_STEP = 0.05, 1e-4  # lattice cells
FULL_STEP_PERCENTILE = 95  # vertices with larger gradients take the full step, the others one in proportion
INTERIOR = 2.0**100  # the level of a vertex that does not lie on the surface; float32 holds it exactly
MAX_OFFSET = 0.2  # lattice cells the surface may be moved to reach a volume
SMALL_QUANTILE = 0.05  # of the volumes; where cells are alike, the cut tets of the surface, a quarter of the others
MIN_ANGLE = 12.0  # [degrees] the descent is undone if an angle fell below this and below the smallest before
MIN_SLOPE2 = 0.25  # squared: a distance has slope 1, less on its ridges

SEARCH_ANGLE = 14.0  # [degrees] tets with smaller angles are worked on by local search
SEARCH_ROUNDS = 8
SEARCH_STEPS = (0.02, 0.06, 0.15)  # cells
_neighbours = np.delete(np.indices((3, 3, 3)).reshape(3, -1).T - 1.0, 13, axis=0)  # all 26, without the middle
_directions = _neighbours / np.linalg.norm(_neighbours, axis=1, keepdims=True)
SEARCH_OFFSETS = np.concatenate([s * _directions for s in SEARCH_STEPS])  # (78, 3) [cells]

vec3 = ti.types.vector(3, ti.f64)
Values = ti.types.ndarray(ti.f32, ndim=3)


def project(distance: DistanceGrid, points: np.ndarray, level: np.ndarray) -> np.ndarray:
    """Points (M, 3) moved along the gradient to where the distance is `level` (M,): one Newton step."""
    h = 0.5 * distance.spacing
    change = [distance.sample(points + h * e) - distance.sample(points - h * e) for e in np.eye(3)]
    gradient = np.stack(change, 1) / (2 * h)
    slope2 = np.maximum((gradient**2).sum(1), MIN_SLOPE2)
    return points - ((distance.sample(points) - level) / slope2)[:, None] * gradient


@ti.func
def distance_at(values: ti.template(), origin, spacing, p):
    """Signed distance at p, trilinear; beyond the grid that of its border."""
    last = vec3(values.shape[0] - 1, values.shape[1] - 1, values.shape[2] - 1)
    u = ti.min(ti.max((p - origin) / spacing, 0.0), last)
    i = ti.min(ti.cast(ti.floor(u), ti.i32), ti.cast(last, ti.i32) - 1)
    f = u - ti.cast(i, ti.f64)
    found = ti.cast(0.0, ti.f64)
    for a, b, c in ti.static(ti.ndrange(2, 2, 2)):
        weight = (f[0] if a else 1 - f[0]) * (f[1] if b else 1 - f[1]) * (f[2] if c else 1 - f[2])
        found += weight * values[i[0] + a, i[1] + b, i[2] + c]
    return found


@ti.kernel
def _step(
    x: Matrix, gradient: Matrix, start: Matrix, width: Vector, level: Vector, values: Values, origin: vec3,
    spacing: ti.f64, step: ti.f64, full: ti.f64, max_travel: ti.f64, moved: Matrix,
):  # fmt: skip
    """Out: moved = x against the gradient, projected onto its level, at most `max_travel` cells from the start."""
    for v in width:
        p = vec3(x[v, 0], x[v, 1], x[v, 2])
        direction = width[v] * vec3(gradient[v, 0], gradient[v, 1], gradient[v, 2])
        p -= step * width[v] * direction / ti.max(direction.norm(), full)
        if level[v] < INTERIOR:  # one Newton step, as `project`
            slope = vec3(0.0, 0.0, 0.0)
            for d in ti.static(range(3)):
                h = vec3(0.0, 0.0, 0.0)
                h[d] = 0.5 * spacing
                slope[d] = (
                    distance_at(values, origin, spacing, p + h) - distance_at(values, origin, spacing, p - h)
                ) / spacing
            off = distance_at(values, origin, spacing, p) - level[v]
            p -= off / ti.max(slope.norm_sqr(), MIN_SLOPE2) * slope
        from_start = p - vec3(start[v, 0], start[v, 1], start[v, 2])
        travel = from_start.norm()
        if travel > max_travel * width[v]:
            p -= (1 - max_travel * width[v] / travel) * from_start
        for d in ti.static(range(3)):
            moved[v, d] = p[d]


class Descent:
    """Gradient descent of QualityEnergy for given tets (T, 4) in a given signed distance. Taichi must be running."""

    def __init__(self, tets: np.ndarray, count: int, distance: DistanceGrid) -> None:
        self.quality, self.distance = QualityEnergy(tets, count), distance
        self._values = ti.ndarray(ti.f32, distance.shape)
        self._values.from_numpy(np.ascontiguousarray(distance.values, np.float32))
        self._place = vec3(*map(float, distance.origin)), float(distance.spacing)

    def run(self, x: np.ndarray, outer: np.ndarray, level: np.ndarray, width: np.ndarray, small: float, steps: int):
        """Positions x (V, 3) after at most `steps` steps.

        outer, level  vertices that stay on the surface (M,), and the level set each stays on (M,)
        width         width of a cell at each vertex (V,)
        small         volume of a small tet: tets of that size and smaller count as much as their kappa
        """
        quality = self.quality
        start, now, moved = (quality.vectors(x) for _ in range(3))
        slope, other = quality.vectors(), quality.vectors()
        quality.energy(now, slope, 1.0)
        volume, kappa = quality.volume.to_numpy(), quality.kappa.to_numpy()
        unit = float(np.median(kappa * np.maximum(1, volume / small) ** (2 / 3)))
        total = quality.energy(now, slope, unit)
        levels = np.full(len(x), INTERIOR)
        levels[outer] = level
        fixed = device_array(ti.f64, width), device_array(ti.f64, levels), self._values, *self._place
        step = FIRST_STEP
        for _ in range(steps):
            full = float(np.percentile(np.linalg.norm(slope.to_numpy(), axis=1) * width, FULL_STEP_PERCENTILE))
            while step > LAST_STEP:
                _step(now, slope, start, *fixed, step, full, MAX_TRAVEL, moved)
                energy = quality.energy(moved, other, unit)
                if energy < total:
                    break
                step /= 2
            else:
                break
            now, moved, slope, other, total = moved, now, other, slope, energy
            step = min(1.5 * step, 2 * FIRST_STEP)
        return now.to_numpy()


def cell_widths(x: np.ndarray, tets: np.ndarray) -> np.ndarray:
    """Width (V,) of the lattice cells around each vertex, from its tets: a BCC tet is a twelfth of a cell."""
    width = np.cbrt(12 * tet_volumes(x, tets).clip(0))
    count = np.bincount(tets.ravel(), minlength=len(x))
    return np.bincount(tets.ravel(), np.repeat(width, 4), len(x)) / np.maximum(count, 1)


def relax(
    cage: Cage, descent: Descent, volume: float, *, lift: np.ndarray | None = None, steps: int = DESCENT_STEPS
) -> Cage:
    """The same tets with vertices moved, for a longer stable substep.

    descent  of these tets, in the signed distance that the cage was stuffed from
    volume   the surface is moved along its normal until the cage has about this volume
    lift     distance each vertex (V,) of the surface moves outwards before that; None: 0
    """
    x, tets, distance = cage.vertices.astype(np.float64), cage.tets, descent.distance
    outer = np.flatnonzero(np.bincount(cage.surface.ravel()))
    width = cell_widths(x, tets)
    level = distance.sample(x[outer])

    def offset(x: np.ndarray, level: np.ndarray, shift) -> tuple[np.ndarray, np.ndarray]:
        """x with its surface offset by `shift`, or as much of that as inverts no tet, and the new levels."""
        for _ in range(6):
            moved = x.copy()
            moved[outer] = project(distance, moved[outer], level + shift)
            if tet_volumes(moved, tets).min() > 0:
                return moved, level + shift
            shift = shift / 2
        return x, level

    def grown(x: np.ndarray, level: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """x with its surface offset so that the volume is right, and the new levels."""
        for _ in range(2):
            missing = (volume - tet_volumes(x, tets).sum()) / float(areas(x, cage.surface).sum())
            x, level = offset(x, level, np.clip(missing, -MAX_OFFSET * width[outer], MAX_OFFSET * width[outer]))
        return x, level

    if lift is not None:
        x, level = offset(x, level, lift[outer])
    x, level = grown(x, level)
    small = 4 * np.quantile(tet_volumes(x, tets), SMALL_QUANTILE)  # in graded cages the smallest have the largest kappa
    start, x = x, descent.run(x, outer, level, width, small, steps)
    if smallest_angle(x, tets) < min(MIN_ANGLE, smallest_angle(start, tets)):
        x = start
    x, level = grown(x, level)
    x = lift_slivers(x, tets, distance, outer, level, width)
    return Cage(x.astype(np.float32), tets, cage.surface)


def min_angles(corners: np.ndarray) -> np.ndarray:
    """Smallest dihedral angle [degrees] (...) of tets with corners (..., 4, 3); -1 where one is inverted."""
    vertices = corners.reshape(-1, 3)
    tets = np.arange(len(vertices)).reshape(-1, 4)
    angles = np.degrees(np.arccos(dihedral_cosines(vertices, tets).max(0)))
    return np.where(tet_volumes(vertices, tets) > 0, angles, -1.0).reshape(corners.shape[:-2])


def lift_slivers(x: np.ndarray, tets: np.ndarray, distance: DistanceGrid, outer, level, width: np.ndarray):
    """Positions (V, 3) with the smallest dihedral angles raised towards SEARCH_ANGLE.

    Each vertex of the worst tets tries offsets around it and takes that where the smallest angle of its tets is largest
    (Freitag and Ollivier-Gooch 1997 do so by gradients). Few tets need it: NumPy suffices.

    outer, level  vertices that stay on the surface (M,), and the level set each stays on (M,)
    width         width of a cell at each vertex (V,)
    """
    x = x.copy()
    outer_index = np.full(len(x), -1)
    outer_index[outer] = np.arange(len(outer))
    angle = min_angles(x[tets])
    if angle.min() >= SEARCH_ANGLE:
        return x
    order = np.argsort(tets.ravel(), kind="stable")
    first = np.concatenate([[0], np.bincount(tets.ravel(), minlength=len(x)).cumsum()])
    for _ in range(SEARCH_ROUNDS):
        bad = np.flatnonzero(angle < SEARCH_ANGLE)
        if not len(bad):
            break
        moved = False
        for v in dict.fromkeys(tets[bad[np.argsort(angle[bad])]].ravel().tolist()):
            around = order[first[v] : first[v + 1]]
            own, k = around // 4, around % 4
            before = angle[own].min()
            if before >= SEARCH_ANGLE:
                continue
            places = x[v] + width[v] * SEARCH_OFFSETS
            if outer_index[v] >= 0:
                places = project(distance, places, np.full(len(places), level[outer_index[v]]))
            corners = np.repeat(x[tets[own]][None], len(places), 0)
            corners[:, np.arange(len(own)), k] = places[:, None]
            found = min_angles(corners)
            best = found.min(1).argmax()
            if found[best].min() > before + 0.01:
                x[v], angle[own] = places[best], found[best]
                moved = True
        if not moved:
            break
    return x
