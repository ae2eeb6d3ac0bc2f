"""CAM.json, the camera file of the command line: read and written."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from assets.file_access import atomic_write, read_json
from assets.gaussians import MAGNITUDE_MAX
from core.camera import Camera
from core.errors import BadInput

SIZE_MAX = 64 << 20  # [bytes]: some 100,000 cameras
SIDE_MAX = 16384  # [px] a larger picture is a mistake in the file
FOCAL_RANGE = (1e-3, 1e9)  # [px] also bounds the principal point: products still fit float32


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
    items = [camera_entry(c) for c in cameras]
    with atomic_write(path) as beside:
        beside.write_text(json.dumps(items if len(items) != 1 else items[0], indent=1) + "\n", encoding="utf-8")


def camera_entry(c: Camera) -> dict:
    """A camera as an object of a JSON file."""
    sides = {"width": c.width, "height": c.height, "fx": c.fx, "fy": c.fy, "cx": c.cx, "cy": c.cy}
    return sides | {"world_to_camera": np.asarray(c.world_to_camera, np.float64).tolist()}


def parse_camera(where: str, item) -> Camera:
    """The camera of an object of a JSON file. Raises BadInput, naming `where`."""
    if not isinstance(item, dict):
        raise BadInput(f"{where}: expected an object")
    names = ("width", "height", "fx", "fy", "cx", "cy", "world_to_camera")
    missing = [n for n in names if n not in item]
    if missing:
        raise BadInput(f"{where}: missing {missing[0]!r}")
    try:
        matrix = np.array(item["world_to_camera"], np.float64)
    except (TypeError, ValueError, OverflowError):
        matrix = np.full(1, np.nan)
    if matrix.shape != (4, 4) or not np.isfinite(matrix).all():
        raise BadInput(f"{where}: world_to_camera must be 4x4 and finite")
    rotation = matrix[:3, :3]
    unit = np.abs(rotation).max() < 2  # products of greater ones may overflow
    if not unit or np.abs(rotation @ rotation.T - np.eye(3)).max() > 1e-3 or np.linalg.det(rotation) < 0:
        raise BadInput(f"{where}: the rotation in world_to_camera is not orthonormal")
    if np.abs(matrix[3] - [0.0, 0.0, 0.0, 1.0]).max() > 1e-6:
        raise BadInput(f"{where}: the last row of world_to_camera is not 0 0 0 1 (is it transposed?)")
    if np.abs(matrix[:3, 3]).max() > MAGNITUDE_MAX:
        raise BadInput(f"{where}: the translation in world_to_camera is beyond {MAGNITUDE_MAX:g}")
    sides = [_number(where, item, name, 1, SIDE_MAX) for name in ("width", "height")]
    if any(side != int(side) for side in sides):
        raise BadInput(f"{where}: width and height must be whole")
    intrinsics = [_number(where, item, name, *FOCAL_RANGE) for name in ("fx", "fy")]
    intrinsics += [_number(where, item, name, -FOCAL_RANGE[1], FOCAL_RANGE[1]) for name in ("cx", "cy")]
    return Camera(int(sides[0]), int(sides[1]), *intrinsics, matrix)


def _number(where: str, item: dict, name: str, low: float, high: float) -> float:
    """A number of the file within [low, high]. Raises BadInput."""
    value = item[name]
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise BadInput(f"{where}: {name} is not a number")
    if not low <= value <= high:  # NaN compares false
        raise BadInput(f"{where}: {name} must be {low:g} to {high:g}")
    return float(value)
