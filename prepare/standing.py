"""A body set on its feet: turned by the few degrees by which its cage would lean over before it rests.

Files are seldom exactly level, and a coarse cage has feet of its own. Let go as it is, such a body lands on one of
them first, and the push that it gets there may throw it over.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.ndimage import affine_transform
from scipy.spatial.transform import Rotation

from assets.asset import Asset
from assets.reoriented import reoriented, turned_grid
from core.tetmesh import tet_volumes
from prepare.cage.flap import resting_normal
from prepare.cage.level_set import ComponentSolid

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
    axis = np.cross(normal, [0.0, -1.0, 0.0])
    rotation = Rotation.from_rotvec(np.radians(lean) * axis / np.linalg.norm(axis)).as_matrix()
    turned = reoriented(asset, rotation)
    shift = np.array(turned.provenance["reoriented"][-1][2])
    provenance = asset.provenance | {"stood_up": round(lean, 1)}
    return replace(turned, provenance=provenance), [turned_solid(solid, rotation, shift) for solid in solids]


def turned_solid(solid: ComponentSolid, rotation: np.ndarray, shift: np.ndarray) -> ComponentSolid:
    """The solid turned by `rotation` (3, 3), then moved by `shift` (3,) [m]."""
    old, new = solid.distance, turned_grid(solid.distance, rotation, 1.0, shift)
    offset = (rotation.T @ (new.origin - shift) - old.origin) / old.spacing
    cells = (
        affine_transform(c.astype(np.uint8), rotation.T, offset, new.values.shape, order=0).astype(bool)
        for c in (solid.shell, solid.solid)
    )
    return ComponentSolid(*cells, new)
