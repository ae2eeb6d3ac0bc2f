"""A prepared room to play in: where its floor and tables are, where a body is dropped and where the user stands."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import h5py
import numpy as np

from assets.hdf5 import Hdf5Reader, open_hdf5
from core.distance_grid import DistanceGrid
from core.errors import BadInput

MAX_FINE = 16  # finer grids of a stage
KINDS = ("floor", "table", "shelf")


@dataclass(frozen=True)
class Environment:
    """What `prepare --static` found in a scene; metres, +y up.

    floor     height of the floor
    drop      a point on a table or the floor where there is room for a body, (3,)
    eye       where the user's head is, (3,)
    clear     radius of the free disc around `drop`
    planes    level planes, the floor first: (kind, height, x low, z low, x high, z high)
    fine      distance grids finer than the asset's own, where that leaves the work to them
    """

    floor: float
    drop: tuple[float, float, float]
    eye: tuple[float, float, float]
    clear: float
    planes: tuple[tuple, ...] = ()
    fine: tuple[DistanceGrid, ...] = field(default=())

    @classmethod
    def load(cls, path: str | Path) -> Environment:
        """The stage in an asset file, without its Gaussians. Raises BadInput where there is none."""
        with open_hdf5(Path(path)) as file:
            if not file.has("stage"):
                raise BadInput(f"{path}: is no stage (make one: python vrgs.py prepare ROOM.ply --static)")
            return read_environment(file)


def read_environment(file: Hdf5Reader) -> Environment:
    """The stage of an open asset file; checked. Raises BadInput."""
    numbers = {key: file.number("stage", key) for key in ("floor", "clear")}
    points = {key: tuple(map(float, file.vector("stage", key))) for key in ("drop", "eye")}
    rows = np.asarray(file.array("stage/planes", "f", (None, 6)), np.float64)
    fine = []
    while len(fine) < MAX_FINE and file.has(f"stage/fine{len(fine)}"):
        name = f"stage/fine{len(fine)}"
        values = file.array(name, "f", (None, None, None))
        fine.append(DistanceGrid(values, file.vector(name, "origin"), file.number(name, "spacing")))
    if not np.isfinite([*numbers.values(), *points["drop"], *points["eye"]]).all() or not np.isfinite(rows).all():
        raise file.bad("a number of the stage is not finite")
    if numbers["clear"] <= 0 or not np.isin(rows[:, 0], range(len(KINDS))).all():
        raise file.bad("the stage's free radius or a kind of plane is out of range")
    planes = tuple((KINDS[int(r[0])], *map(float, r[1:])) for r in rows)
    return Environment(**numbers, **points, planes=planes, fine=tuple(fine))


def write_environment(file: h5py.File, stage: Environment) -> None:
    """Put a stage into an asset file."""
    group = file.create_group("stage")
    group.attrs["floor"], group.attrs["clear"] = float(stage.floor), float(stage.clear)
    group.attrs["drop"], group.attrs["eye"] = np.array(stage.drop, np.float64), np.array(stage.eye, np.float64)
    rows = [(KINDS.index(p[0]), *p[1:]) for p in stage.planes]
    group["planes"] = np.array(rows, np.float64).reshape(-1, 6)
    for k, grid in enumerate(stage.fine):
        values = np.asarray(grid.values, np.float16)
        data = group.create_dataset(f"fine{k}", data=values, compression="gzip", shuffle=True)
        data.attrs["origin"], data.attrs["spacing"] = np.asarray(grid.origin, np.float64), float(grid.spacing)
