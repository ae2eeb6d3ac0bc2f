"""How a body stands: without the thin flap that would topple it, and turned so that it rests where it is.

A thin flap under a body, such as the care label of a toy, would become a pillar of the cage, whose tets are wider than
cloth: the body would topple from it. Where a body falls from the lowest thin part of it but stands without, that part
gets no tets; its Gaussians follow the nearest ones.

Files are seldom exactly level, and a coarse cage has feet of its own. Let go as it is, such a body lands on one of them
first, and that push may throw it over: it is turned by the few degrees by which its cage would lean before it rests.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.ndimage import affine_transform, distance_transform_edt
from scipy.spatial import ConvexHull, QhullError

from assets.asset import Asset
from core.rotation import rotation_between
from core.tetmesh import tet_volumes
from prepare.cage.level_set import ComponentSolid

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


LEANS = (1.0, 20.0)  # [degrees] that are taken out: less is not seen, and what leans more has fallen


def stood_up(asset: Asset, solids: list[ComponentSolid]) -> tuple[Asset, list[ComponentSolid]]:
    """The asset, and its solids, turned so that it rests where it is; the same if it does, or would fall far.

    The angle [degrees] is `stood_up` of the provenance.
    """
    x, tets = asset.cage.vertices.astype(np.float64), asset.cage.tets
    volume = tet_volumes(x, tets)
    normal = resting_normal(x, (x[tets].mean(1) * volume[:, None]).sum(0) / volume.sum())
    lean = float(np.degrees(np.arccos(np.clip(-normal[1], -1.0, 1.0))))
    if not LEANS[0] <= lean <= LEANS[1]:
        return asset, solids
    rotation = rotation_between(normal, (0.0, -1.0, 0.0))
    turned = asset.transformed(rotation)
    shift = np.array(turned.provenance["reoriented"][-1][2])
    provenance = asset.provenance | {"stood_up": round(lean, 1)}
    return replace(turned, provenance=provenance), [turned_solid(solid, rotation, shift) for solid in solids]


def turned_solid(solid: ComponentSolid, rotation: np.ndarray, shift: np.ndarray) -> ComponentSolid:
    """The solid turned by `rotation` (3, 3), then moved by `shift` (3,) [m]."""
    old, new = solid.distance, solid.distance.transformed(rotation, shift)
    offset = (rotation.T @ (new.origin - shift) - old.origin) / old.spacing
    cells = (
        affine_transform(c.astype(np.uint8), rotation.T, offset, new.values.shape, order=0).astype(bool)
        for c in (solid.shell, solid.solid)
    )
    return ComponentSolid(*cells, new)
