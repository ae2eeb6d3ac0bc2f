"""A thin flap under a body, such as the care label of a toy: as a part of the cage it would be a pillar.

The tets of a cage are wider than cloth, so that a label which hangs below the feet would carry the body, and the body
would topple from it. Where a body falls from the lowest thin part of it but stands without, that part gets no tets;
its Gaussians follow the tets that are nearest.
"""

from __future__ import annotations

import numpy as np
from scipy.ndimage import distance_transform_edt
from scipy.spatial import ConvexHull, QhullError

UPRIGHT = 8.0  # [degrees] from its place in the file; what comes to rest farther has fallen
THIN = 0.1  # of the extent: feet and legs are thicker, or the body stands on them
MOST = 0.01  # of the body's cells: a label has half as many; what is larger is a leg on which it should stand


def flap_of(solid: np.ndarray) -> np.ndarray:
    """Mask of the cells (X, Y, Z) bool of the flap from which a solid (X, Y, Z) bool, +y up, would fall; or empty."""
    none = np.zeros_like(solid)
    if not solid.any() or lean_at_rest(solid) <= UPRIGHT:
        return none
    radius = 0.5 * THIN * max(np.ptp(np.argwhere(solid), axis=0))
    padded = np.pad(solid, 1)
    inner = distance_transform_edt(padded) > radius
    if not inner.any():
        return none
    thick = padded & (distance_transform_edt(~inner) <= radius)
    flap = solid & ~thick[1:-1, 1:-1, 1:-1]
    flap[:, np.flatnonzero(thick.any((0, 2)))[0] - 1 :] = False
    helps = 0 < flap.sum() <= MOST * solid.sum() and lean_at_rest(solid & ~flap) <= UPRIGHT
    return flap if helps else none


def lean_at_rest(solid: np.ndarray) -> float:
    """Angle [degrees] by which a homogeneous solid, cells (X, Y, Z) bool, leans where it comes to rest."""
    points = np.argwhere(solid).astype(np.float64)
    return float(np.degrees(np.arccos(np.clip(-resting_normal(points, points.mean(0))[1], -1.0, 1.0))))


def resting_normal(points: np.ndarray, centre: np.ndarray) -> np.ndarray:
    """Unit normal (3,), outwards, of the face on which the hull of points (N, 3) rests, in the frame of the points.

    A body rests on a face over which its `centre` of mass is; of several the nearest to upright is taken. Points on a
    plane or a line have no faces; they are said to rest on -y.
    """
    try:
        hull = ConvexHull(points)
    except QhullError:
        return np.array([0.0, -1.0, 0.0])
    normal, offset = hull.equations[:, :3], hull.equations[:, 3]
    foot = centre - (normal @ centre + offset)[:, None] * normal
    a, b, c = (points[hull.simplices[:, k]] for k in range(3))
    sides = [np.einsum("ni,ni->n", np.cross(q - p, foot - p), normal) for p, q in ((a, b), (b, c), (c, a))]
    facing = np.sign(np.einsum("ni,ni->n", np.cross(b - a, c - a), normal))
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    rests = (np.array(sides) * facing > -1e-6 * area).all(0)
    return normal[rests][normal[rests, 1].argmin()]
