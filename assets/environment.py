"""A static scene to play in: its floor and level planes, where bodies drop, where the user stands."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import h5py
import numpy as np

from assets.hdf5 import Hdf5Reader, open_hdf5
from assets.quantisation import read_grid, write_grid
from core.distance_grid import DistanceGrid
from core.errors import BadInput

FINE_GRIDS_MAX = 16
PLANE_KINDS = ("floor", "table", "shelf", "unseen")


@dataclass(frozen=True)
class Environment:
    """The results of `prepare --static`; metres, +y up. In files the group is called `stage`.

    floor_height
    drop_point    on a table or the floor, with a free disc around it, (3,)
    eye_position  of the user, (3,)
    clear_radius  of the free disc
    planes        level planes, the floor first: (kind, height, x low, z low, x high, z high). One of the kind "unseen"
                  carries what is played with where nothing solid is
    target        that the user looks at from `eye_position`, where the view was searched, (3,); None: the drop point
    fine_grids    distance grids finer than the asset's own, where that one defers to them
    """

    floor_height: float
    drop_point: tuple[float, float, float]
    eye_position: tuple[float, float, float]
    clear_radius: float
    planes: tuple[tuple, ...] = ()
    fine_grids: tuple[DistanceGrid, ...] = ()
    target: tuple[float, float, float] | None = None

    @classmethod
    def load(cls, path: str | Path) -> Environment:
        """The environment of an asset file, without its Gaussians. Raises BadInput if there is none."""
        with open_hdf5(Path(path)) as file:
            if not file.has("stage"):
                raise BadInput(f"{path}: is no stage (make one: python vrgs.py prepare ROOM.ply --static)")
            return read_environment(file)


def read_environment(file: Hdf5Reader) -> Environment:
    """The environment of an open asset file, checked but for its grids. Raises BadInput."""
    floor, clear = (file.number("stage", key) for key in ("floor", "clear"))
    drop, eye = (tuple(map(float, file.vector("stage", key))) for key in ("drop", "eye"))
    rows = np.asarray(file.array("stage/planes", "f", (None, 6)), np.float64)
    fine = []
    while len(fine) < FINE_GRIDS_MAX and file.has(f"stage/fine{len(fine)}"):
        fine.append(read_grid(file, f"stage/fine{len(fine)}"))
    target = tuple(map(float, file.vector("stage", "target"))) if file.has_attribute("stage", "target") else None
    if not np.isfinite([floor, clear, *drop, *eye, *(target or ())]).all() or not np.isfinite(rows).all():
        raise file.error("a number of the stage is not finite")
    if clear <= 0 or not np.isin(rows[:, 0], range(len(PLANE_KINDS))).all():
        raise file.error("the stage's free radius or a kind of plane is out of range")
    planes = tuple((PLANE_KINDS[int(row[0])], *map(float, row[1:])) for row in rows)
    return Environment(floor, drop, eye, clear, planes, tuple(fine), target)


def write_environment(file: h5py.File, environment: Environment, *, quantised: bool) -> None:
    """Write the environment to an asset file."""
    group = file.create_group("stage")
    group.attrs["floor"], group.attrs["clear"] = float(environment.floor_height), float(environment.clear_radius)
    group.attrs["drop"] = np.array(environment.drop_point, np.float64)
    group.attrs["eye"] = np.array(environment.eye_position, np.float64)
    if environment.target is not None:
        group.attrs["target"] = np.array(environment.target, np.float64)
    rows = [(PLANE_KINDS.index(kind), *bounds) for kind, *bounds in environment.planes]
    group["planes"] = np.array(rows, np.float64).reshape(-1, 6)
    for k, grid in enumerate(environment.fine_grids):
        write_grid(file, f"stage/fine{k}", grid, quantised=quantised)
