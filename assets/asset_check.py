"""What must hold for an asset, whether it was just read or is about to be written."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from assets.animation import check_animation
from assets.file_access import usable
from assets.gaussians import SH_COUNTS, Gaussians
from assets.images import check_thumbnail
from core.errors import BadInput
from core.tetmesh import enclosed_volume

if TYPE_CHECKING:
    from assets.asset import Asset, Cage, CageEmbedding

QUAT_TOLERANCE = 1e-3  # a unit quaternion rounded to float16 is off by less
WEIGHT_TOLERANCE = 1e-3  # of a row's sum, as float32 rounds weights of some hundreds
VOLUME_TOLERANCE = 1e-3  # relative, between a cage's tets and its surface


def check(asset: Asset, where: str) -> None:
    """Raise BadInput, naming `where`, unless the asset is sound and its parts agree."""
    check_gaussians(asset.gaussians, where)
    if asset.cage is not None:
        check_cage(asset.cage, where)
    if asset.embedded is not None:
        if asset.cage is None:
            raise BadInput(f"{where}: has an embedding but no cage")
        check_embedded(asset.embedded, len(asset.gaussians), len(asset.cage.tets), where)
    if asset.sdf is not None:
        asset.sdf.check(where)
    for grid in asset.environment.fine if asset.environment is not None else ():
        grid.check(where)
    if asset.material is not None:
        asset.material.check(where)
    if asset.animation is not None:
        if asset.cage is None:
            raise BadInput(f"{where}: has an animation but no cage")
        check_animation(asset.animation, len(asset.cage.vertices), where)
    if asset.thumbnail is not None:
        check_thumbnail(asset.thumbnail, where)


def check_gaussians(g: Gaussians, where: str) -> None:
    """Raise BadInput unless there are Gaussians and all of them can be drawn."""
    n = len(g.means)
    if n == 0:
        raise BadInput(f"{where}: holds no Gaussians")
    if g.sh.ndim != 3 or g.sh.shape[1] not in SH_COUNTS:
        raise BadInput(f"{where}: sh has shape {g.sh.shape}, expected (N, K, 3) with K one of {SH_COUNTS}")
    shapes = {
        "means": (n, 3),
        "quats": (n, 4),
        "log_scales": (n, 3),
        "logit_opacities": (n,),
        "sh": (n, g.sh.shape[1], 3),
        "object_id": (n,),
    }
    for name, shape in shapes.items():
        if getattr(g, name).shape != shape:
            raise BadInput(f"{where}: {name} has shape {getattr(g, name).shape}, expected {shape}")
    wrong = n - int(usable(g.means, g.quats, g.log_scales, g.logit_opacities, g.sh).sum())
    if wrong:
        raise BadInput(f"{where}: {wrong} of {n} Gaussians are not finite or have no rotation")
    if np.abs(np.linalg.norm(g.quats, axis=1) - 1).max() > QUAT_TOLERANCE:
        raise BadInput(f"{where}: the quaternions are not normalised")


def check_cage(cage: Cage, where: str) -> None:
    """Raise BadInput unless all tets are positive, all vertices have mass and the surface is theirs, outward."""
    v = len(cage.vertices)
    for name, width in (("vertices", 3), ("tets", 4), ("surface", 3)):
        shape = getattr(cage, name).shape
        if len(shape) != 2 or shape[1] != width or shape[0] == 0:
            raise BadInput(f"{where}: cage {name} has shape {shape}, expected (*, {width})")
    if not np.isfinite(cage.vertices).all():
        raise BadInput(f"{where}: a cage vertex is not finite")
    for name in ("tets", "surface"):
        index = getattr(cage, name)
        if index.min() < 0 or index.max() >= v:
            raise BadInput(f"{where}: cage {name} name a vertex outside 0..{v - 1}")
    volumes = cage.volumes()
    if not (volumes > 0).all():
        raise BadInput(f"{where}: {int((~(volumes > 0)).sum())} cage tets have no positive volume")
    if len(np.unique(cage.tets)) != v:
        raise BadInput(f"{where}: {v - len(np.unique(cage.tets))} cage vertices belong to no tet")
    enclosed = enclosed_volume(cage.vertices, cage.surface)
    if abs(enclosed - volumes.sum()) > VOLUME_TOLERANCE * volumes.sum():
        raise BadInput(f"{where}: the cage's surface encloses {enclosed:.4g} m^3, its tets fill {volumes.sum():.4g}")


def check_embedded(embedded: CageEmbedding, gaussians: int, tets: int, where: str) -> None:
    """Raise BadInput unless each Gaussian's corners have a host and weights that sum to 1."""
    host, weights = embedded.host, embedded.weights
    if host.shape != (gaussians, 4) or weights.shape != (gaussians, 4, 4):
        raise BadInput(f"{where}: the embedding has {len(host)} rows for {gaussians} Gaussians")
    if host.min() < 0 or host.max() >= tets:
        raise BadInput(f"{where}: the embedding names a tet outside 0..{tets - 1}")
    if not np.isfinite(weights).all():
        raise BadInput(f"{where}: an embedding weight is not finite")
    if np.abs(weights.sum(axis=2, dtype=np.float64) - 1).max() > WEIGHT_TOLERANCE:
        raise BadInput(f"{where}: embedding weights do not sum to 1")
