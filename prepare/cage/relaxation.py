"""Mesh optimisation: move a cage's vertices so that a longer substep is stable.

Stuffing leaves thin tets and light corners on the surface whose kappa (prepare/cage/mesh_quality.py) is thirty times
the median. Gradient descent lowers a high power of kappa and of a measure of shape while surface vertices slide on the
surface; then the worst remaining tets are lifted by local search. Substeps become twice as long, and the smallest
dihedral angle rises from about 12 to about 17 degrees.
"""

import numpy as np

from assets.asset import Cage
from core.distance_grid import DistanceGrid
from core.tetmesh import tet_volumes, triangle_areas
from prepare.cage.mesh_quality import dihedral_cosines, quality_energy, smallest_angle

DESCENT_STEPS = 30  # of descent; 20 bring most of the substep, the others better angles
MAX_TRAVEL = 0.35  # lattice cells a vertex may move by descent
FIRST_STEP, LAST_STEP = 0.05, 1e-4  # lattice cells
FULL_STEP_PERCENTILE = 95  # vertices with larger gradients take the full step, the others one in proportion
MAX_OFFSET = 0.2  # lattice cells the surface may be moved to reach a volume
SMALL_QUANTILE = (
    0.05  # of the volumes, a quarter of a small tet's: of tets up to that only kappa counts. Where cells are
)
# alike these are the cut tets of the surface, a quarter of the others.
MIN_ANGLE = 12.0  # [degrees] the descent is undone if an angle fell below this and below the smallest before
MIN_SLOPE2 = 0.25  # squared: a distance has slope 1, less on its ridges

SEARCH_ANGLE = 14.0  # [degrees] tets with smaller angles are worked on by local search
SEARCH_ROUNDS = 8
SEARCH_STEPS = (0.02, 0.06, 0.15)  # cells
_neighbours = np.delete(np.indices((3, 3, 3)).reshape(3, -1).T - 1.0, 13, axis=0)  # all 26, without the middle
_directions = _neighbours / np.linalg.norm(_neighbours, axis=1, keepdims=True)
SEARCH_OFFSETS = np.concatenate([s * _directions for s in SEARCH_STEPS])  # (78, 3) [cells]


def project(distance: DistanceGrid, points: np.ndarray, level: np.ndarray) -> np.ndarray:
    """Points (M, 3) moved along the gradient to where the distance is `level` (M,): one Newton step."""
    h = 0.5 * distance.spacing
    change = [distance.sample(points + h * e) - distance.sample(points - h * e) for e in np.eye(3)]
    gradient = np.stack(change, 1) / (2 * h)
    slope2 = np.maximum((gradient**2).sum(1), MIN_SLOPE2)
    return points - ((distance.sample(points) - level) / slope2)[:, None] * gradient


def descended(
    x: np.ndarray, tets: np.ndarray, distance: DistanceGrid, outer: np.ndarray, level: np.ndarray, width, steps: int
) -> np.ndarray:
    """Positions x (V, 3) after at most `steps` steps of gradient descent of the quality energy.

    outer, level  vertices that stay on the surface (M,), and the level set each stays on (M,)
    width         width of a cell at each vertex (V,)
    """
    start, width, volume = x, width[:, None], tet_volumes(x, tets)
    kappa = quality_energy(x, tets, 1.0)[2]
    small = 4 * np.quantile(volume, SMALL_QUANTILE)  # in graded cages the smallest tets have the largest kappa
    unit = float(np.median(kappa * np.maximum(1, volume / small) ** (2 / 3)))
    total, gradient, _ = quality_energy(x, tets, unit)
    step = FIRST_STEP
    for _ in range(steps):
        slope = width * gradient
        length = np.linalg.norm(slope, axis=1, keepdims=True)
        full = max(np.percentile(length, FULL_STEP_PERCENTILE), 1e-300)
        while step > LAST_STEP:
            moved = x - step * width * slope / np.maximum(length, full)
            moved[outer] = project(distance, moved[outer], level)
            travel = moved - start
            far, most = np.linalg.norm(travel, axis=1, keepdims=True), MAX_TRAVEL * width
            moved -= (1 - most / np.maximum(far, most)) * travel
            energy, other, _ = quality_energy(moved, tets, unit)
            if energy < total:
                break
            step /= 2
        else:
            break
        x, gradient, total = moved, other, energy
        step = min(1.5 * step, 2 * FIRST_STEP)
    return x


def relax(
    cage: Cage, distance: DistanceGrid, volume: float, *, lift: np.ndarray | None = None, steps: int = DESCENT_STEPS
) -> Cage:
    """The same tets with vertices moved, for a longer stable substep.

    distance  that the cage was stuffed from
    volume    the surface is moved along its normal until the cage has about this volume
    lift      distance each vertex (V,) of the surface moves outwards before that; None: 0
    """
    x, tets = cage.vertices.astype(np.float64), cage.tets
    outer = np.flatnonzero(np.bincount(cage.surface.ravel()))
    of_tet = np.cbrt(12 * tet_volumes(x, tets))  # a BCC tet is a twelfth of a lattice cell
    width = np.bincount(tets.ravel(), np.repeat(of_tet, 4), len(x)) / np.bincount(tets.ravel(), minlength=len(x))
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
            missing = (volume - tet_volumes(x, tets).sum()) / float(triangle_areas(x, cage.surface).sum())
            x, level = offset(x, level, np.clip(missing, -MAX_OFFSET * width[outer], MAX_OFFSET * width[outer]))
        return x, level

    if lift is not None:
        x, level = offset(x, level, lift[outer])
    x, level = grown(x, level)
    start, x = x, descended(x, tets, distance, outer, level, width, steps)
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
