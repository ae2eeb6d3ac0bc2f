"""A static scene to play in: its floor and level planes, where bodies drop, where the user stands."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import h5py
import numpy as np

from assets.gaussians import Gaussians, normals_and_areas
from assets.hdf5 import Hdf5Reader, open_hdf5
from assets.quantisation import read_grid, write_grid
from core.distance_grid import DistanceGrid
from core.errors import BadInput
from core.planes import LEVEL_COS

FINE_GRIDS_MAX = 16
PLANE_KINDS = ("floor", "table", "shelf")
# Planes and places of a room that has been tilted
PLANE_REACH = 0.3  # [m] over and under a tilted plane's middle in which its level part is looked for
PLANE_LAYER = 0.03  # [m] half the thickness of a level plane
PLANE_SHARE = 0.3  # of a rectangle's area, at least, that must be level for it to be a plane still
PLACES = 25  # along each side of the floor, that are tried for a drop
HEADROOM = (0.3, 0.6, 0.9)  # [m] over a drop at which there must be room
EYE_FREE = 0.2  # [m] between the eye and what is solid


@dataclass(frozen=True)
class Environment:
    """The results of `prepare --static`; metres, +y up. In files the group is called `stage`.

    floor_height
    drop_point    on a table or the floor, with a free disc around it, (3,)
    eye_position  of the user, (3,)
    clear_radius  of the free disc
    planes        level planes, the floor first: (kind, height, x low, z low, x high, z high)
    fine_grids    distance grids finer than the asset's own, where that one defers to them
    """

    floor_height: float
    drop_point: tuple[float, float, float]
    eye_position: tuple[float, float, float]
    clear_radius: float
    planes: tuple[tuple, ...] = ()
    fine_grids: tuple[DistanceGrid, ...] = ()

    @classmethod
    def load(cls, path: str | Path) -> Environment:
        """The environment of an asset file, without its Gaussians. Raises BadInput if there is none."""
        with open_hdf5(Path(path)) as file:
            if not file.has("stage"):
                raise BadInput(f"{path}: is no stage (make one: python vrgs.py prepare ROOM.ply --static)")
            return read_environment(file)

    def transformed(self, rotation: np.ndarray, translation: np.ndarray, scale: float = 1.0) -> Environment:
        """The same floor, planes and places after x -> scale * rotation @ x + translation.

        A plane is the bounding rectangle of its turned one, at its middle.
        """

        def at(point):
            return tuple((scale * rotation @ np.array(point) + translation).tolist())

        planes = []
        for kind, height, x0, z0, x1, z1 in self.planes:
            corners = np.array([[x, height, z] for x in (x0, x1) for z in (z0, z1)])
            corners = scale * corners @ rotation.T + translation
            (low_x, _, low_z), (high_x, _, high_z) = corners.min(0), corners.max(0)
            planes.append((kind, float(corners[:, 1].mean()), *map(float, (low_x, low_z, high_x, high_z))))
        return Environment(
            scale * self.floor_height + float(translation[1]),
            at(self.drop_point),
            at(self.eye_position),
            scale * self.clear_radius,
            tuple(planes),
            tuple(grid.transformed(rotation, translation, scale) for grid in self.fine_grids),
        )

    def relevelled(self, gaussians: Gaussians, grid: DistanceGrid, eye_height: float) -> Environment:
        """The environment of a room that has been tilted, whose floor is at y = 0 now: planes and places found anew.

        gaussians, grid  of the room as it stands now;  eye_height [m] over the floor
        Raises BadInput if there is no free place on the floor.
        """
        solid = gaussians.opaque()
        normals, areas = normals_and_areas(solid)
        level = np.abs(normals[:, 1]) > LEVEL_COS
        points, areas = solid.means.astype(np.float64)[level], areas[level]
        low, high = np.percentile(points[np.abs(points[:, 1]) < PLANE_LAYER][:, [0, 2]], [1, 99], axis=0)
        planes = [("floor", 0.0, *map(float, (low[0], low[1], high[0], high[1])))]
        planes += [found for plane in self.planes[1:] if (found := _level_part(plane, points, areas))]
        drop, clear = self._free_drop(planes, grid)
        eye = np.array([self.eye_position[0], eye_height, self.eye_position[2]])  # or nearer to the drop, if it is free
        way = eye + np.linspace(0.0, 0.8, 9)[:, None] * (np.array([drop[0], eye_height, drop[2]]) - eye)
        eye = way[int((grid.sample(way) > EYE_FREE).argmax())]
        return Environment(0.0, drop, tuple(eye.tolist()), clear, tuple(planes), self.fine_grids)

    def _free_drop(self, planes: list[tuple], grid: DistanceGrid) -> tuple[tuple[float, float, float], float]:
        """The drop on the plane under it if there is free space above, else the freest place of the floor; and its
        free radius [m]."""
        x, y, z = self.drop_point
        under = [p[1] for p in planes if p[2] <= x <= p[4] and p[3] <= z <= p[5]]
        kept = np.array([[x, h, z] for h in sorted(under, key=lambda h: abs(h - y))]).reshape(-1, 3)
        _, height, x0, z0, x1, z1 = planes[0]
        on_floor = np.meshgrid(np.linspace(x0, x1, PLACES), [height], np.linspace(z0, z1, PLACES))
        places = np.concatenate([kept, np.stack(on_floor, -1).reshape(-1, 3)])
        free = np.min([grid.sample(places + np.array([0.0, h, 0.0])).clip(None, h) for h in HEADROOM], axis=0)
        enough = free[: len(kept)] > 0.5 * self.clear_radius
        best = int(enough.argmax()) if enough.any() else len(kept) + int(free[len(kept) :].argmax())
        if free[best] <= 0.0:
            raise BadInput("its floor has no free place as the room stands now")
        limit = self.clear_radius if enough.any() else np.inf
        return tuple(places[best].tolist()), float(min(free[best], limit))


def _level_part(plane: tuple, points: np.ndarray, areas: np.ndarray) -> tuple | None:
    """The plane at the height at which most of its rectangle lies; None: too little of it is level."""
    kind, height, x0, z0, x1, z1 = plane
    x, y, z = points.T
    own = (x > x0) & (x < x1) & (z > z0) & (z < z1) & (np.abs(y - height) < PLANE_REACH)
    if not own.any():
        return None
    order = np.sort(y[own])
    count = np.searchsorted(order, order + 2 * PLANE_LAYER, side="right") - np.arange(len(order))
    middle = order[count.argmax()] + PLANE_LAYER
    own &= np.abs(y - middle) < PLANE_LAYER
    if areas[own].sum() < PLANE_SHARE * (x1 - x0) * (z1 - z0) or middle < PLANE_REACH / 2:
        return None
    found = np.percentile(y[own], 50, weights=areas[own], method="inverted_cdf")
    low, high = np.percentile(points[own][:, [0, 2]], [2, 98], axis=0)
    return (kind, float(found), *map(float, (low[0], low[1], high[0], high[1])))


def read_environment(file: Hdf5Reader) -> Environment:
    """The environment of an open asset file, checked but for its grids. Raises BadInput."""
    floor, clear = (file.number("stage", key) for key in ("floor", "clear"))
    drop, eye = (tuple(map(float, file.vector("stage", key))) for key in ("drop", "eye"))
    rows = np.asarray(file.array("stage/planes", "f", (None, 6)), np.float64)
    fine = []
    while len(fine) < FINE_GRIDS_MAX and file.has(f"stage/fine{len(fine)}"):
        fine.append(read_grid(file, f"stage/fine{len(fine)}"))
    if not np.isfinite([floor, clear, *drop, *eye]).all() or not np.isfinite(rows).all():
        raise file.error("a number of the stage is not finite")
    if (rows[:, 0] == len(PLANE_KINDS)).any():  # a level that nothing shows, as older versions made
        raise file.error("the stage has no floor to play on; a capture of its photographs may (vrgs.py capture)")
    if clear <= 0 or not np.isin(rows[:, 0], range(len(PLANE_KINDS))).all():
        raise file.error("the stage's free radius or a kind of plane is out of range")
    planes = tuple((PLANE_KINDS[int(row[0])], *map(float, row[1:])) for row in rows)
    return Environment(floor, drop, eye, clear, planes, tuple(fine))


def write_environment(file: h5py.File, environment: Environment, *, quantised: bool) -> None:
    """Write the environment to an asset file."""
    group = file.create_group("stage")
    group.attrs["floor"], group.attrs["clear"] = float(environment.floor_height), float(environment.clear_radius)
    group.attrs["drop"] = np.array(environment.drop_point, np.float64)
    group.attrs["eye"] = np.array(environment.eye_position, np.float64)
    rows = [(PLANE_KINDS.index(kind), *bounds) for kind, *bounds in environment.planes]
    group["planes"] = np.array(rows, np.float64).reshape(-1, 6)
    for k, grid in enumerate(environment.fine_grids):
        write_grid(file, f"stage/fine{k}", grid, quantised=quantised)
