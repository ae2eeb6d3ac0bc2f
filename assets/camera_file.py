"""CAM.json, the camera file of the command line: read and written."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from assets.file_access import read_json, write_json
from assets.gaussians import MAGNITUDE_MAX
from core.camera import Camera
from core.errors import BadInput
from core.typed import field_types, from_plain

SIZE_MAX = 64 << 20  # [bytes]: some 100,000 cameras


def read_cameras(path: str | Path) -> list[Camera]:
    """Cameras of a CAM.json: one object or a list of them. Raises BadInput."""
    path = Path(path)
    data = read_json(path, SIZE_MAX)
    items = data if isinstance(data, list) else [data]
    if not items:
        raise BadInput(f"{path}: holds no camera")
    cameras = [parse_camera(f"{path}: camera {i}", item) for i, item in enumerate(items)]
    if len({(c.width, c.height) for c in cameras}) > 1:
        raise BadInput(f"{path}: the cameras differ in size")
    return cameras


def write_cameras(path: str | Path, cameras: list[Camera]) -> None:
    """Write a CAM.json: an object, or a list of several. Raises BadInput."""
    write_json(path, cameras if len(cameras) != 1 else cameras[0])


def parse_camera(where: str, item) -> Camera:
    """The camera of an object of a JSON file, which may have other keys, too. Raises BadInput, naming `where`."""
    if isinstance(item, dict):
        item = {key: value for key, value in item.items() if key in field_types(Camera)}
    camera = from_plain(Camera, item, where)
    matrix = camera.world_to_camera
    rotation = matrix[:3, :3]
    unit = np.abs(rotation).max() < 2  # products of greater ones may overflow
    if not unit or np.abs(rotation @ rotation.T - np.eye(3)).max() > 1e-3 or np.linalg.det(rotation) < 0:
        raise BadInput(f"{where}: the rotation in world_to_camera is not orthonormal")
    if np.abs(matrix[3] - [0.0, 0.0, 0.0, 1.0]).max() > 1e-6:
        raise BadInput(f"{where}: the last row of world_to_camera is not 0 0 0 1 (is it transposed?)")
    if np.abs(matrix[:3, 3]).max() > MAGNITUDE_MAX:
        raise BadInput(f"{where}: the translation in world_to_camera is beyond {MAGNITUDE_MAX:g}")
    return camera
