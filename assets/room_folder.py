"""ROOM/, a captured room: its manifest room.json, and the assets of its background and of its objects.

    room.json        this manifest
    room.h5          the background: what remains of the capture without its objects, with its collider
    objects/NAME.h5  a body with a cage for each object
    room.jpg         picture for the menu of scenes

All is data: nothing in such a folder is run.
"""

from __future__ import annotations

import json
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from assets.camera_file import camera_entry, parse_camera
from assets.file_access import atomic_write, read_json
from assets.gaussians import MAGNITUDE_MAX
from core.camera import Camera
from core.errors import BadInput

FORMAT, VERSION = "vrgs-room", 1
MANIFEST, PICTURE = "room.json", "room.jpg"
SIZE_MAX = 16 << 20  # [bytes] of a manifest: ten thousand cameras fill 4 MB
OBJECTS_MAX = 200
FILE_NAME = re.compile(r"(objects/)?[\w][\w. -]{0,99}\.h5")  # within the folder, wherever that lies
UNIT_TOLERANCE = 1e-3


@dataclass(frozen=True)
class RoomObject:
    """An object of a captured room: x_room = R(rotation) x_asset + position, all in metres.

    asset        path of its body, within the folder
    fixed_below  [m] in the asset's frame, whose +y leads away from what holds it: what lies below is held fast there,
                 as a trophy is by a wall; None: it stands free
    """

    name: str
    asset: str
    position: tuple[float, float, float]
    rotation: tuple[float, float, float, float]
    fixed_below: float | None = None


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

    background: str
    objects: tuple[RoomObject, ...]
    eye: tuple[float, float, float]
    target: tuple[float, float, float]
    fov_y: float
    floor: float
    metres_per_unit: float
    room_from_capture: np.ndarray
    cameras: tuple[Camera, ...]


def is_room_folder(path: str | Path) -> bool:
    """True for a folder with a manifest."""
    return (Path(path) / MANIFEST).is_file()


def write_room(folder: Path, room: RoomManifest) -> None:
    """Write the manifest of a room. Raises BadInput."""
    with atomic_write(folder / MANIFEST) as beside:
        write_manifest(beside, room)


def write_manifest(path: Path, room: RoomManifest) -> None:
    """Write the manifest of a room to this file."""
    objects = []
    for o in room.objects:
        entry = {"name": o.name, "asset": o.asset, "position": list(o.position), "rotation": list(o.rotation)}
        objects.append(entry | ({} if o.fixed_below is None else {"fixed_below": o.fixed_below}))
    data = {
        "format": FORMAT,
        "version": VERSION,
        "background": room.background,
        "eye": list(room.eye),
        "target": list(room.target),
        "fov_y": room.fov_y,
        "floor": room.floor,
        "metres_per_unit": room.metres_per_unit,
        "room_from_capture": np.asarray(room.room_from_capture, np.float64).tolist(),
        "objects": objects,
        "cameras": [camera_entry(c) for c in room.cameras],
    }
    path.write_text(json.dumps(data, indent=1) + "\n", encoding="utf-8")


def read_room(folder: str | Path) -> RoomManifest:
    """The manifest of a room, checked, whose assets are there. Raises BadInput."""
    path = Path(folder) / MANIFEST
    if not path.is_file():
        raise BadInput(f"{path}: no such file; vrgs.py capture makes a room")
    data = _Entry(read_json(path, SIZE_MAX), f"{path}")
    if data.text("format") != FORMAT:
        raise BadInput(f"{path}: not a {FORMAT} file")
    version = data.value("version")
    if version != VERSION or isinstance(version, bool):
        raise BadInput(f"{path}: version {str(version)[:20]} of the format, this program reads {VERSION}")
    objects = []
    for k, item in enumerate(data.items("objects", OBJECTS_MAX)):
        entry = _Entry(item, f"{path}: object {k}")
        rotation = entry.numbers("rotation", 4)
        if abs(np.linalg.norm(rotation) - 1.0) > UNIT_TOLERANCE:
            raise BadInput(f"{entry.where}: its rotation is no unit quaternion")
        fixed = entry.numbers("fixed_below", None) if entry.has("fixed_below") else None
        objects.append(
            RoomObject(entry.text("name"), entry.file("asset"), entry.numbers("position", 3), rotation, fixed)
        )
        entry.end()
    if len({o.name for o in objects}) < len(objects):
        raise BadInput(f"{path}: two objects have the same name")
    room = RoomManifest(
        data.file("background"),
        tuple(objects),
        data.numbers("eye", 3),
        data.numbers("target", 3),
        data.numbers("fov_y", None),
        data.numbers("floor", None),
        data.numbers("metres_per_unit", None),
        _similarity(data.value("room_from_capture"), f"{path}: room_from_capture"),
        tuple(parse_camera(f"{path}: camera {k}", item) for k, item in enumerate(data.items("cameras", 100_000))),
    )
    data.end()
    if not 0.05 < room.fov_y < 3.0 or not room.metres_per_unit > 0.0:
        raise BadInput(f"{path}: fov_y or metres_per_unit is out of range")
    if np.linalg.norm(np.subtract(room.eye, room.target)) < 1e-6:
        raise BadInput(f"{path}: the eye is where it looks to")
    for asset in (room.background, *(o.asset for o in room.objects)):
        if not (path.parent / asset).is_file():
            raise BadInput(f"{path}: {asset} is missing")
    return room


def _similarity(value, where: str) -> np.ndarray:
    """A rotation, a factor and a translation (4, 4). Raises BadInput."""
    try:
        m = np.array(value, np.float64)
    except (TypeError, ValueError, OverflowError):
        m = np.zeros(1)
    if m.shape != (4, 4) or not (np.abs(m) < MAGNITUDE_MAX).all() or not np.array_equal(m[3], [0, 0, 0, 1]):
        raise BadInput(f"{where} is not a finite 4x4 matrix")
    factor = np.cbrt(np.linalg.det(m[:3, :3]))
    if not factor > 0 or np.abs(m[:3, :3] @ m[:3, :3].T - factor**2 * np.eye(3)).max() > 1e-3 * factor**2:
        raise BadInput(f"{where} is no rotation, factor and translation")
    return m


class _Entry:
    """An object of the manifest that must have the keys that are asked for, and no others. Raises BadInput."""

    def __init__(self, data, where: str):
        if not isinstance(data, dict):
            raise BadInput(f"{where}: is no JSON object")
        self._left, self.where = dict(data), where

    def has(self, key: str) -> bool:
        return key in self._left

    def value(self, key: str):
        if key not in self._left:
            raise BadInput(f"{self.where}: {key} is missing")
        return self._left.pop(key)

    def text(self, key: str) -> str:
        value = self.value(key)
        if not isinstance(value, str) or not 0 < len(value) <= 100 or not value.isprintable():
            raise BadInput(f"{self.where}: {key} is not a short text")
        return value

    def file(self, key: str) -> str:
        name = self.text(key)
        if not FILE_NAME.fullmatch(name):
            raise BadInput(f"{self.where}: {key} is not the name of an .h5 file in this folder or its objects/")
        return name

    def numbers(self, key: str, count: int | None):
        """A tuple of `count` numbers, or one number for None."""
        value = self.value(key)
        items = value if count is not None and isinstance(value, list) else [value]
        if len(items) != (count or 1) or not all(
            isinstance(x, (int, float)) and not isinstance(x, bool) for x in items
        ):
            raise BadInput(f"{self.where}: {key} is not {'a number' if count is None else f'{count} numbers'}")
        if not all(abs(x) < MAGNITUDE_MAX for x in items):  # NaN compares false
            raise BadInput(f"{self.where}: {key} is not finite")
        return float(items[0]) if count is None else tuple(map(float, items))

    def items(self, key: str, most: int) -> list:
        value = self.value(key)
        if not isinstance(value, list) or len(value) > most:
            raise BadInput(f"{self.where}: {key} is not a list of at most {most}")
        return value

    def end(self) -> None:
        if self._left:
            raise BadInput(f"{self.where}: {str(next(iter(self._left)))[:40]!r} is unknown")
