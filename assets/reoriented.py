"""A prepared asset in another frame: turned and scaled as a whole, without being prepared again."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from assets.asset import Asset, Cage
from assets.environment import Environment
from assets.orientation import floor_height
from assets.relevelled import relevelled
from core.distance_grid import DistanceGrid
from core.errors import BadInput
from core.rotation import quaternions_from_matrices

SIZE_RANGE = (0.01, 10.0)  # [m] largest extent of a body
NODES_MAX = 40_000_000  # of a turned grid: 160 MB
LEVEL = 1 - 1e-6  # least cosine of the vertical to itself where floors stay level


def reoriented(asset: Asset, rotation: np.ndarray, factor: float = 1.0) -> Asset:
    """The asset turned by `rotation` (3, 3) and made `factor` times as large; a body stands on y = 0 again, in the
    middle of its footprint.

    A cage's tets and the embedding stay what they were: both are affine. Distance grids are interpolated, but only
    where there is a turn. In a room that is tilted, floor, tables and places are found anew; its floor comes to y = 0.
    Raises BadInput for a body with a motion of its own, for a room without a floor, and for a size that no body can
    have.
    """
    rotation = np.asarray(rotation, np.float64)
    if asset.animation is not None:
        raise BadInput("its frame is that of its motion: it can be turned and scaled for this play only")
    if not (np.isfinite(factor) and factor > 0.0):
        raise BadInput(f"an asset cannot be made {factor:g} times as large")
    shift, cage = np.zeros(3), asset.cage
    if cage is not None:
        x = factor * (cage.vertices.astype(np.float64) @ rotation.T)
        low, high = x.min(0), x.max(0)
        if not SIZE_RANGE[0] <= (high - low).max() <= SIZE_RANGE[1]:
            raise BadInput(
                f"a size of {(high - low).max():.3g} m is out of range ({SIZE_RANGE[0]} to {SIZE_RANGE[1]:g})"
            )
        shift = -np.array([(low[0] + high[0]) / 2, low[1], (low[2] + high[2]) / 2])
        cage = Cage((x + shift).astype(np.float32), cage.tets, cage.surface)
    tilted = asset.environment is not None and rotation[1, 1] < LEVEL
    if tilted:
        shift = np.array([0.0, -floor_height(asset.gaussians.transformed(rotation, shift, factor)), 0.0])
    g = asset.gaussians.transformed(rotation, shift, factor)
    grid = None if asset.sdf is None else turned_grid(asset.sdf, rotation, factor, shift)
    environment = asset.environment and turned_environment(asset.environment, rotation, factor, shift)
    if tilted:
        height = factor * (asset.environment.eye_position[1] - asset.environment.floor_height)
        environment = relevelled(environment, g, grid, height)
    provenance = asset.provenance | {"reoriented": _transforms(asset.provenance, rotation, factor, shift)}
    if "size" in provenance:
        provenance["size"] = float(provenance["size"]) * factor
    return replace(asset, gaussians=g, cage=cage, sdf=grid, environment=environment, provenance=provenance)


def _transforms(provenance: dict, rotation: np.ndarray, factor: float, shift: np.ndarray) -> list:
    """All turns and scales so far: [[quaternion wxyz, factor, shift], ...]."""
    last = [quaternions_from_matrices(rotation).tolist(), float(factor), shift.tolist()]
    return [*provenance.get("reoriented", []), last]


def turned_grid(grid: DistanceGrid, rotation: np.ndarray, factor: float, shift: np.ndarray) -> DistanceGrid:
    """The grid of the shape x -> factor rotation x + shift. Raises BadInput if a grid around it were too large."""
    scaled = grid.scaled(factor)
    if np.abs(rotation - np.eye(3)).max() < 1e-9:
        return DistanceGrid(scaled.values.astype(grid.values.dtype), scaled.origin + shift, scaled.spacing)
    ends = np.stack([np.asarray(scaled.origin), scaled.upper])
    corners = np.stack(np.meshgrid(*ends.T, indexing="ij"), -1).reshape(-1, 3) @ rotation.T
    low, high = corners.min(0), corners.max(0)
    shape = np.ceil((high - low) / scaled.spacing - 1e-6).astype(int) + 1
    if shape.prod() > NODES_MAX:
        raise BadInput(f"a turned grid would have {int(shape.prod()):,} nodes: prepare it again instead")
    values = np.empty(shape, np.float32)
    nodes = DistanceGrid(values, low, scaled.spacing)
    for i in range(shape[0]):  # a slice at a time: positions of all nodes take six times the memory
        plane = low + scaled.spacing * np.stack(np.meshgrid([i], *map(np.arange, shape[1:]), indexing="ij"), -1)[0]
        values[i] = scaled.sample_extended(plane @ rotation)
    return DistanceGrid(values.astype(grid.values.dtype), nodes.origin + shift, scaled.spacing)


def turned_environment(environment: Environment, rotation: np.ndarray, factor: float, shift: np.ndarray) -> Environment:
    """The same floor, planes and places; a plane is the bounding rectangle of its turned one, at its middle."""
    drop, eye, target = (
        p and tuple((factor * rotation @ np.array(p) + shift).tolist())
        for p in (environment.drop_point, environment.eye_position, environment.target)
    )
    return Environment(
        factor * environment.floor_height + float(shift[1]),
        drop,
        eye,
        factor * environment.clear_radius,
        tuple(_turned_plane(plane, rotation, factor, shift) for plane in environment.planes),
        tuple(turned_grid(grid, rotation, factor, shift) for grid in environment.fine_grids),
        target,
    )


def _turned_plane(plane: tuple, rotation: np.ndarray, factor: float, shift: np.ndarray) -> tuple:
    kind, height, x0, z0, x1, z1 = plane
    corners = factor * np.array([[x, height, z] for x in (x0, x1) for z in (z0, z1)]) @ rotation.T + shift
    (low_x, _, low_z), (high_x, _, high_z) = corners.min(0), corners.max(0)
    return (kind, float(corners[:, 1].mean()), *map(float, (low_x, low_z, high_x, high_z)))
