"""CAM.json, the camera file of the command line: read and written."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from assets.file_access import read_json, write_json
from assets.gaussians import MAGNITUDE_MAX
from core.camera import Camera
from core.errors import BadInput
from core.typed import Range, Shape, field_types, from_plain

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


@dataclass(frozen=True)
class TrainedCamera:
    """An entry of a trainer's cameras.json, camera-to-world."""

    position: Annotated[np.ndarray, Shape(3), Range(-MAGNITUDE_MAX, MAGNITUDE_MAX)]
    rotation: Annotated[np.ndarray, Shape(3, 3), Range(-1.01, 1.01)]


def cameras_of_splat(splats: Path) -> Path | None:
    """The cameras.json of the training of a splat file: beside it, or over its point_cloud/iteration_N/."""
    own = splats.resolve().parent
    folders = (own, *own.parents[1:2]) if own.parent.name == "point_cloud" else (own,)
    return next((f / "cameras.json" for f in folders if (f / "cameras.json").is_file()), None)


def read_poses(path: Path) -> np.ndarray:
    """World-to-camera matrices (V, 4, 4) of a trainer's cameras.json, V > 0. Raises BadInput."""
    items = from_plain(list[dict[str, Any]], read_json(path, SIZE_MAX), str(path))
    keys = field_types(TrainedCamera)
    cameras = [from_plain(TrainedCamera, {k: v for k, v in i.items() if k in keys}, str(path)) for i in items]
    if not cameras:
        raise BadInput(f"{path}: holds no camera")
    poses = np.tile(np.eye(4), (len(cameras), 1, 1))
    for pose, c in zip(poses, cameras, strict=True):
        if np.abs(c.rotation @ c.rotation.T - np.eye(3)).max() > 1e-3:
            raise BadInput(f"{path}: the rotation of a camera is not orthonormal")
        pose[:3, :3], pose[:3, 3] = c.rotation.T, -c.rotation.T @ c.position
    return poses


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
