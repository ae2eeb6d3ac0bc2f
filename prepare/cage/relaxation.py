"""Move a cage's vertices so that a longer substep is stable.

Stuffing leaves thin tets and light corners on the surface whose kappa (prepare/cage/quality_energy.py) is thirty times the
median. Gradient steps lower a high power of kappa and of a measure of shape; surface vertices slide on the surface.
Substeps become twice as long, and the smallest dihedral angle rises from about 12 to about 17 degrees.
"""

from __future__ import annotations

import numpy as np
from scipy.ndimage import map_coordinates

from assets.asset import Cage
from core.tetmesh import tet_volumes
from prepare.cage.mesh_quality import smallest_angle
from prepare.cage.quality_descent import Descent
from prepare.cage.sliver_removal import polish

STEPS = 30  # 20 bring most of the substep, the others better angles
FURTHEST = 0.2  # lattice cells the surface may be moved for the volume
SMALL = 0.05  # quantile of the volumes; where cells are alike the surface's cut ones, a quarter of the others
ANGLE = 12.0  # [degrees] the result is taken only if no dihedral angle fell below this, or below the smallest before


class Surface:
    """The signed distance at points, and the way back for those that left their level."""

    def __init__(self, values: np.ndarray, origin: np.ndarray, spacing: float) -> None:
        self.values, self.origin, self.spacing = np.asarray(values), origin, spacing

    def at(self, points: np.ndarray) -> np.ndarray:
        """Signed distance (M,) at points (M, 3), trilinear."""
        cells = (points - self.origin) / self.spacing
        return map_coordinates(self.values, cells.T, order=1, mode="nearest", output=np.float64)

    def back(self, points: np.ndarray, level: np.ndarray) -> np.ndarray:
        """The points moved along the gradient to where the signed distance is `level` (M,): one Newton step."""
        h = 0.5 * self.spacing
        gradient = np.stack([self.at(points + h * e) - self.at(points - h * e) for e in np.eye(3)], 1) / (2 * h)
        slope = np.maximum((gradient**2).sum(1), 0.25)  # a distance has slope 1; on ridges it has less
        return points - ((self.at(points) - level) / slope)[:, None] * gradient


def sizes(x: np.ndarray, tets: np.ndarray) -> np.ndarray:
    """Width (V,) of the lattice's cells round each vertex, told from its tets: a BCC tet is a twelfth of a cell."""
    width = np.cbrt(12 * tet_volumes(x, tets).clip(0))
    count = np.bincount(tets.ravel(), minlength=len(x))
    return np.bincount(tets.ravel(), np.repeat(width, 4), len(x)) / np.maximum(count, 1)


def area(x: np.ndarray, surface: np.ndarray) -> float:
    """Area of the triangles (S, 3)."""
    a, b, c = np.moveaxis(x[surface], 1, 0)
    return float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2)


def relax(
    cage: Cage,
    values: np.ndarray,
    origin,
    spacing: float,
    *,
    volume: float | None = None,
    lift: np.ndarray | None = None,
    steps: int = STEPS,
    descent: Descent | None = None,
) -> Cage:
    """The same tets with vertices moved, for a longer stable substep. Taichi must be running.

    values, origin, spacing  the signed distance that the cage was stuffed from
    volume                   the surface is moved along its normal until the cage is about so large; None: it stays
    lift                     how far out each vertex (V,) of the surface goes before that; None: not at all
    descent                  of these tets and this distance, where several cages are relaxed; None: made here
    """
    x = cage.vertices.astype(np.float64)
    tets = cage.tets
    surface = Surface(values, np.asarray(origin, np.float64), spacing)
    outer = np.flatnonzero(np.bincount(cage.surface.ravel()))
    size = sizes(x, tets)[:, None]
    level = surface.at(x[outer])
    if lift is not None:
        x, level = _moved(x, cage, surface, outer, level, lift[outer])
    if volume is not None:
        x, level = _grown(x, cage, surface, outer, level, volume, size)
    small = 4 * np.quantile(tet_volumes(x, tets), SMALL)  # where cells differ in size, the smallest have the largest kappa
    descent = descent or Descent(tets, len(x), surface.values, surface.origin, spacing)
    start, x = x, descent.run(x, outer, level, size[:, 0], small, steps)
    if smallest_angle(x, tets) < min(ANGLE, smallest_angle(start, tets)):
        x = start
    if volume is not None:
        x, level = _grown(x, cage, surface, outer, level, volume, size)
    x = polish(x, tets, surface, outer, level, size[:, 0])
    return Cage(x.astype(np.float32), tets, cage.surface)


def _grown(x: np.ndarray, cage: Cage, surface: Surface, outer, level, volume: float, size: np.ndarray):
    """x with its surface moved along the normals so that the volume is right, and the new level (M,)."""
    for _ in range(2):
        missing = (volume - tet_volumes(x, cage.tets).sum()) / area(x, cage.surface)
        shift = np.clip(missing, -FURTHEST * size[outer, 0], FURTHEST * size[outer, 0])
        x, level = _moved(x, cage, surface, outer, level, shift)
    return x, level


def _moved(x: np.ndarray, cage: Cage, surface: Surface, outer, level, shift: np.ndarray):
    """x with its surface moved by `shift` (M,), or as much of that as inverts no tet, and the new level (M,)."""
    for _ in range(6):
        moved = x.copy()
        moved[outer] = surface.back(moved[outer], level + shift)
        if tet_volumes(moved, cage.tets).min() > 0:
            return moved, level + shift
        shift = shift / 2
    return x, level
