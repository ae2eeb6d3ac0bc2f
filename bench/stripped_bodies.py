"""Bodies of `bench scene` at any size: splats and implicit shapes, prepared once and kept without their Gaussians.

An asset file NAME_VERTICES.h5 a body, of about 0.8 MB for 20,000 vertices: cage, distance grid, and one Gaussian, since
an asset has one. What a solver measures depends on nothing else.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from assets.asset import Asset
from assets.file_access import make_folder
from assets.gaussians import Gaussians
from assets.splat_files import read_gaussians
from bench.implicit_shapes import SHAPES
from core.distance_grid import DistanceGrid
from core.errors import BadInput
from prepare.cage.cage_generation import cage_of
from prepare.cage.component_cages import Grid
from prepare.cage.level_set import contact_grid
from prepare.pipeline import VERSION, Options, prepare

UNDER_SURFACE = (-1.5, -0.5)  # [grid cells] nodes at this distance must lie inside the cage
POINT = Gaussians.of(np.zeros((1, 3)), np.eye(4)[:1], np.full((1, 3), -5.0), np.zeros(1), np.zeros((1, 1, 3)))


def body_name(asset: str) -> str:
    """Name of an asset: a shape of SHAPES, a file's without its extension, or a body in the folder."""
    return asset if asset in SHAPES else Path(asset).stem


def stripped_body(asset: str, vertices: int, folder: Path) -> Asset:
    """The asset as a body of about this many vertices, from the folder, or made and kept there. Taichi must be running.

    asset  one of SHAPES, a splat file, or the name of a body that is in the folder; a prepared .h5 is taken as it is
    Raises BadInput where there is none, or no cage of this size.
    """
    made_by = f"vrgs prepare {VERSION}"
    if Path(asset).suffix == ".h5":
        return with_cage(Path(asset))
    path = folder / f"{body_name(asset)}_{vertices}.h5"
    if path.is_file():
        kept = with_cage(path)
        if kept.provenance.get("made_by") == made_by or not (asset in SHAPES or Path(asset).is_file()):
            return kept
    if asset in SHAPES:
        body = shape_body(asset, vertices)
    elif Path(asset).is_file():
        body = prepare(read_gaussians(Path(asset)), Options(vertices))
    else:
        raise BadInput(f"{asset}: neither a splat file nor a shape ({', '.join(SHAPES)}), and there is no {path}")
    kept = {"cage": body.cage, "sdf": body.sdf, "material": body.material}
    stripped = Asset(POINT, **kept, provenance={"made_by": made_by, "source": Path(asset).name})
    make_folder(folder)
    stripped.save(path)
    return stripped


def with_cage(path: Path) -> Asset:
    """The asset of a file that has a cage and a distance grid. Raises BadInput."""
    asset = Asset.load(path)
    if asset.cage is None or asset.sdf is None:
        raise BadInput(f"{path}: has no cage to simulate (make one: python vrgs.py prepare)")
    return asset


def shape_body(name: str, vertices: int) -> Asset:
    """A shape of SHAPES with a cage as `prepare` makes them, its lowest point at y = 0."""
    distance, reach = SHAPES[name]
    ends = np.array([[-reach] * 3, [reach] * 3])
    inside = np.argwhere(distance(ends[0] + 2 * reach / 96 * np.moveaxis(np.indices((97,) * 3), 0, -1)) < 0)
    grid = Grid.over(ends[0] + 2 * reach / 96 * inside, vertices)
    nodes = grid.origin + grid.spacing * np.moveaxis(np.indices(grid.shape), 0, -1)
    phi = (distance(nodes) / grid.spacing).astype(np.float32)
    near = np.argwhere((phi > UNDER_SURFACE[0]) & (phi < UNDER_SURFACE[1])).astype(np.float64)
    cage = cage_of(phi, near, vertices, lambda done: None)
    low = grid.origin.copy()
    low[1] -= (grid.origin + grid.spacing * cage.vertices)[:, 1].min()
    cage = replace(cage, vertices=(low + grid.spacing * cage.vertices).astype(np.float32))
    return Asset(POINT, cage, sdf=contact_grid([DistanceGrid(phi * grid.spacing, low, grid.spacing)]))
