"""ROOM/, a captured room: its manifest room.json, and the assets of its background and of its objects.

    room.json        this manifest
    room.h5          the background: what remains of the capture without its objects, with its collider
    objects/NAME.h5  a body with a cage for each object
    room.jpg         picture for the menu of scenes

All is data: nothing in such a folder is run.
"""

from __future__ import annotations

import math
import os
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from assets.camera_file import parse_camera
from assets.file_access import read_json, write_json
from assets.gaussians import MAGNITUDE_MAX, UNIT_TOLERANCE
from core.camera import Camera
from core.errors import BadInput
from core.rotation import matrices_from_quaternions, quaternions_from_matrices
from core.typed import Form, Range, Shape, Size, from_plain, to_plain
from core.vocabulary import Quat

FORMAT, VERSION = "vrgs-room", 1
MANIFEST, PICTURE = "room.json", "room.jpg"
SIZE_MAX = 16 << 20  # [bytes] of a manifest: ten thousand cameras fill 4 MB
OBJECTS_MAX = 200
Length = Annotated[float, Range(-MAGNITUDE_MAX, MAGNITUDE_MAX)]  # [m]
Point = tuple[Length, Length, Length]
FILE_NAME = Form(r"(objects/)?[\w][\w. -]{0,99}\.h5", "the name of an .h5 file in this folder or its objects/")
FilePath = Annotated[str, FILE_NAME]


@dataclass(frozen=True)
class RoomObject:
    """An object of a captured room: x_room = R(rotation) x_asset + position, all in metres.

    asset        path of its body, within the folder
    rotation     unit quaternion, wxyz
    fixed_below  [m] in the asset's frame, whose +y leads away from what holds it: what lies below is held fast there,
                 as a trophy is by a wall; None: it stands free
    """

    name: Annotated[str, Form(r"[^\x00-\x1f\x7f]{1,100}", "a text of 1 to 100 characters in one line")]
    asset: FilePath
    position: Point
    rotation: Quat
    fixed_below: Length | None = None

    def __post_init__(self):
        if abs(math.hypot(*self.rotation) - 1.0) > UNIT_TOLERANCE:
            raise ValueError("rotation is no unit quaternion")


@dataclass(frozen=True)
class RoomManifest:
    """Content of room.json; metres, +y up.

    background           path of its asset, within the folder
    eye, target, fov_y   of the photographer, and where to look; fov_y [rad]
    floor                height [m] on which the player stands
    metres_per_unit      of the capture
    room_from_capture    (4, 4), a rotation, that factor and a translation
    cameras              of the photographs, in the room
    """

    background: FilePath
    objects: Annotated[tuple[RoomObject, ...], Size(OBJECTS_MAX)]
    eye: Point
    target: Point
    fov_y: Annotated[float, Range(0.05, 3.0)]
    floor: Length
    metres_per_unit: Annotated[float, Range(1e-12, MAGNITUDE_MAX)]
    room_from_capture: Annotated[np.ndarray, Shape(4, 4), Range(-MAGNITUDE_MAX, MAGNITUDE_MAX)]
    cameras: tuple[Camera, ...]

    def __post_init__(self):
        m = self.room_from_capture
        factor = np.cbrt(np.linalg.det(m[:3, :3]))
        skewed = np.abs(m[:3, :3] @ m[:3, :3].T - factor**2 * np.eye(3)).max() > 1e-3 * factor**2
        if not factor > 0 or skewed or not np.array_equal(m[3], [0, 0, 0, 1]):
            raise ValueError("room_from_capture is no rotation, factor and translation")
        if len({o.name for o in self.objects}) < len(self.objects):
            raise ValueError("two objects have the same name")
        if math.dist(self.eye, self.target) < 1e-6:
            raise ValueError("the eye is at its target")

    def transformed(self, rotation: np.ndarray, translation: np.ndarray) -> RoomManifest:
        """The manifest of the room after x -> rotation @ x + translation, which puts its floor at y = 0."""
        by = np.eye(4)
        by[:3, :3], by[:3, 3] = rotation, translation
        back = np.linalg.inv(by)

        def at(point: Point) -> Point:
            return tuple((rotation @ np.array(point) + translation).tolist())

        def turned(o: RoomObject) -> RoomObject:
            q = quaternions_from_matrices(rotation @ matrices_from_quaternions(np.array(o.rotation)))
            return replace(o, position=at(o.position), rotation=tuple(q.tolist()))

        return replace(
            self,
            objects=tuple(map(turned, self.objects)),
            eye=at(self.eye),
            target=at(self.target),
            floor=0.0,
            room_from_capture=by @ self.room_from_capture,
            cameras=tuple(replace(c, world_to_camera=c.world_to_camera @ back) for c in self.cameras),
        )


def is_room_folder(path: str | Path) -> bool:
    """True for a folder with a manifest."""
    return os.path.isfile(Path(path) / MANIFEST)


def write_room(folder: Path, room: RoomManifest, name: str = MANIFEST) -> None:
    """Write the manifest of a room to this file of its folder. Raises BadInput."""
    write_json(folder / name, {"format": FORMAT, "version": VERSION, **to_plain(room)})


def read_room(folder: str | Path) -> RoomManifest:
    """The manifest of a room, checked, whose assets are there. Raises BadInput."""
    path = Path(folder) / MANIFEST
    if not path.is_file():
        raise BadInput(f"{path}: no such file; vrgs.py capture makes a room")
    data = read_json(path, SIZE_MAX)
    if not isinstance(data, dict) or data.pop("format", None) != FORMAT:
        raise BadInput(f"{path}: not a {FORMAT} file")
    version = from_plain(int, data.pop("version", None), f"{path}: version")
    if version != VERSION:
        raise BadInput(f"{path}: version {version} of the format, this program reads {VERSION}")
    cameras = from_plain(list[dict[str, Any]], data.pop("cameras", None), f"{path}: cameras")
    room = from_plain(RoomManifest, {**data, "cameras": []}, str(path))
    cameras = tuple(parse_camera(f"{path}: camera {k}", item) for k, item in enumerate(cameras))
    for asset in (room.background, *(o.asset for o in room.objects)):
        if not (path.parent / asset).is_file():
            raise BadInput(f"{path}: {asset} is missing")
    return replace(room, cameras=cameras)
