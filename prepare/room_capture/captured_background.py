"""The background of a captured room as a static environment: its collider, its level planes, where things fall.

Unlike `prepare --static` it relies on the cameras: the up axis and the floor come with the room's frame, the space that
the cameras looked through is free, and the player stands where a photograph was taken.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from assets.asset import Asset
from assets.environment import Environment
from assets.gaussians import Gaussians
from core.camera import Camera
from core.errors import BadInput
from prepare.environment.environment_pipeline import (
    BELOW_FLOOR,
    VIEWERS,
    distance_grids,
    figures,
    fine_boxes,
    level_surface,
    orient_surface,
    plane_row,
)
from prepare.environment.support_planes import CELL, EYE_HEIGHT, SupportPlane, cell_centres, drop_point, support_planes
from prepare.progress import Progress

AROUND_CAMERAS = 0.6  # [m] the room extends at least this far beyond the outermost camera
SHOWN = 1.0, 99.0  # percentiles of what the pictures show that bound the room
REACH = 4.0  # [m] the room extends at most this far beyond the cameras; the rest is a backdrop
UNKNOWN_CLEARANCE = 0.05  # [m] radius of free space where no level plane was seen
FOV_RANGE = 0.6, 1.1  # [rad] of the player's view


@dataclass(frozen=True)
class RoomView:
    """Cameras of the photographs in the room [m], +y up, and what each shows: its median depth, (V,) [m].

    floor_seen  whether y = 0 is a floor that the cameras saw; else it is the lowest surface
    """

    cameras: Sequence[Camera]
    depths: np.ndarray
    floor_seen: bool

    @property
    def places(self) -> np.ndarray:
        """Centres of the cameras, (V, 3)."""
        return np.array([c.position for c in self.cameras])

    @property
    def targets(self) -> np.ndarray:
        """The point on each camera's axis at its depth, (V, 3)."""
        ahead = np.array([c.world_to_camera[2, :3] for c in self.cameras])
        return self.places + np.nan_to_num(self.depths, nan=1.0)[:, None] * ahead

    @property
    def floor(self) -> float:
        """Height on which the player stands: the floor, or one that lies under the cameras where none was seen."""
        return 0.0 if self.floor_seen else min(0.0, float(np.median(self.places[:, 1])) - EYE_HEIGHT)

    def photographer(self) -> int:
        """The camera where the player stands: about as high and as far as most, on the front side (+z)."""
        places, targets = self.places, self.targets
        toward = places - np.median(targets, axis=0)
        away = np.linalg.norm(toward, axis=1)
        front = toward[:, 2] / np.maximum(np.hypot(toward[:, 0], toward[:, 2]), 1e-9)
        high = np.abs(places[:, 1] - np.median(places[:, 1]))
        typical = np.abs(away - np.median(away))
        return int(np.argmin((high + typical) / np.median(away) - front))


def room_extent(gaussians: Gaussians, weight: np.ndarray, view: RoomView) -> tuple[np.ndarray, np.ndarray]:
    """Corners [m] of the part of a capture that collides: around the cameras, and what they show near them.

    weight  of the Gaussians in the pictures, (N,)
    """
    places = view.places
    low, high = places.min(0) - AROUND_CAMERAS, places.max(0) + AROUND_CAMERAS
    inside = ((gaussians.means > low - REACH) & (gaussians.means < high + REACH)).all(1) & (weight > 0)
    if inside.sum() < 100:
        raise BadInput("the cameras show nothing that lies near them")
    points, w = gaussians.means[inside].astype(np.float64), weight[inside]
    for axis in range(3):
        order = np.argsort(points[:, axis])
        share = np.cumsum(w[order]) / w.sum()
        shown = np.interp(np.divide(SHOWN, 100.0), share, points[order, axis])
        low[axis], high[axis] = min(low[axis], shown[0]), max(high[axis], shown[1])
    low[1] = -BELOW_FLOOR
    return low, high


def captured_environment(
    gaussians: Gaussians,
    view: RoomView,
    extent: tuple[np.ndarray, np.ndarray],
    *,
    near: Sequence[tuple[np.ndarray, np.ndarray]],
    cell: float | None,
    progress: Progress,
) -> Asset:
    """The static environment of a background [m] with its floor at y = 0. Taichi must be running.

    extent  corners of what collides
    near    corners (low, high) of the boxes of the objects, in which the grids are fine
    cell    spacing [m] of the coarse distance grid; None: by size
    """
    low, high = extent
    progress("surface", 0.0)
    places, k = view.places, view.photographer()
    chosen = np.linspace(0, len(places) - 1, min(VIEWERS, len(places))).round().astype(int)
    surface = orient_surface(gaussians, low, high, cell, places[chosen])
    progress("planes", 0.0)
    floor, planes = seen_planes(*level_surface(surface, low, high), view)
    known = [floor, *planes] if view.floor_seen else planes
    if known:
        on, drop, clear = drop_point(known, surface.surfels.points)
    else:  # over what the photographer looks at
        x, y, z = view.targets[k]
        on, drop, clear = None, np.array([x, max(y, view.floor), z]), UNKNOWN_CLEARANCE
    progress("distance", 0.0)
    grid, fine = distance_grids(surface, known, fine_boxes(surface, known, on, drop, near), progress)
    environment = Environment(
        view.floor,
        tuple(map(float, drop)),
        tuple(map(float, places[k])),
        clear,
        tuple(plane_row(p) for p in (floor, *planes)),
        tuple(fine),
    )
    provenance = {
        "made_by": "vrgs capture",
        "floor_seen": view.floor_seen,
        "drop_on": "nothing" if on is None else on.kind,
        **figures(surface, grid, fine),
    }
    progress("distance", 1.0)
    return Asset(gaussians, sdf=grid, provenance=provenance, environment=environment)


def seen_planes(points: np.ndarray, normals: np.ndarray, view: RoomView) -> tuple[SupportPlane, list[SupportPlane]]:
    """The floor, seen or assumed under the cameras, and the tables and shelves over it, of level points and normals."""
    places = view.places
    corner = places.min(0)[[0, 2]] - AROUND_CAMERAS
    cells = np.ceil((places.max(0)[[0, 2]] + AROUND_CAMERAS - corner) / CELL).astype(int)
    assumed = SupportPlane("floor", view.floor, corner, np.ones(cells, bool))
    if not view.floor_seen:  # planes are searched over the height on which the player stands
        under = np.insert(cell_centres(assumed).reshape(-1, 2), 1, view.floor, axis=1)
        points = np.concatenate([points, under])
        normals = np.concatenate([normals, np.tile([0.0, 1.0, 0.0], (len(under), 1))])
    try:
        floor, *planes = support_planes(points, normals, view.floor)
    except BadInput:  # the floor was seen in few places
        return assumed, []
    return floor if view.floor_seen else assumed, planes


def view_of(view: RoomView) -> tuple[tuple, tuple, float]:
    """Eye, target [m] and vertical field of view [rad] of the player: those of the photographer.

    The picture is as high as the photograph; of an upright one less, as in a wide picture it would be small.
    """
    k = view.photographer()
    camera = view.cameras[k]
    high, wide = camera.height / camera.fy, camera.width / camera.fx
    fov = 2.0 * float(np.arctan(0.5 * min(high, np.sqrt(high * wide))))
    eye, target = view.places[k], view.targets[k]
    return tuple(map(float, eye)), tuple(map(float, target)), float(np.clip(fov, *FOV_RANGE))
