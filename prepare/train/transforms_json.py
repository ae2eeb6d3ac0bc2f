"""transforms.json of instant-ngp and nerfstudio: cameras to the world with OpenGL's axes."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from assets.file_access import read_json
from assets.gaussians import MAGNITUDE_MAX
from core.errors import BadInput
from prepare.train.capture import Capture, View, rigid
from prepare.train.lens import Lens
from prepare.train.photographs import image_size
from prepare.train.point_files import read_points

OPENGL_TO_OPENCV = np.diag([1.0, -1.0, -1.0, 1.0])
FILE_MAX = 64 << 20  # [bytes]
DISTORTION = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
FISHEYE = ("k1", "k2", "k3", "k4")
MODELS = ("OPENCV", "PINHOLE", "SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV_FISHEYE")


def read_transforms(path: Path) -> Capture:
    """The capture of a transforms.json. Raises BadInput."""
    data = read_json(path, FILE_MAX)
    frames = data.get("frames") if isinstance(data, dict) else None
    if not isinstance(frames, list) or not all(isinstance(f, dict) for f in frames):
        raise BadInput(f"{path}: has no list of frames")
    views = [_view(path, {**data, **frame}, frame) for frame in frames]
    points, colors = np.zeros((0, 3)), np.zeros((0, 3), np.uint8)
    name = data.get("ply_file_path")
    found = _inside(path, name) if isinstance(name, str) else path.parent / "sparse_pc.ply"
    if isinstance(name, str) or found.is_file():
        points, colors = read_points(found)
    return Capture(path.parent, views, points, colors)


def _view(path: Path, values: dict, frame: dict) -> View:
    """A frame, with the file's values where it has none of its own."""
    name = frame.get("file_path")
    if not isinstance(name, str) or not name:
        raise BadInput(f"{path}: a frame has no file_path")
    image = _inside(path, name)
    if not image.suffix:  # as of Blender's datasets
        image = image.with_suffix(".png")
    mask = values.get("mask_path")
    where = f"{path}: {name}"
    world_from_camera = rigid(frame.get("transform_matrix"), where) @ OPENGL_TO_OPENCV
    lens = _lens(where, values, image)
    lens.check(where)
    return View(image, lens, np.linalg.inv(world_from_camera), _inside(path, mask) if isinstance(mask, str) else None)


def _inside(path: Path, name: str) -> Path:
    """A file beside the transforms.json. Raises BadInput for one that lies elsewhere."""
    if "\0" in name or Path(name).is_absolute() or ".." in Path(name).parts:
        raise BadInput(f"{path}: {name!r} is not inside of the capture's folder")
    return path.parent / name


def _lens(where: str, values: dict, image: Path) -> Lens:
    def number(name: str, default: float | None = None) -> float | None:
        value = values.get(name, default)
        if value is not None and (isinstance(value, bool) or not isinstance(value, (int, float))):
            raise BadInput(f"{where}: {name} is not a number")
        if isinstance(value, int) and abs(value) > MAGNITUDE_MAX:
            raise BadInput(f"{where}: {name} is too large")
        return value

    width, height = number("w"), number("h")
    if width is None or height is None:
        width, height = image_size(image)
    fx = number("fl_x")
    if fx is None:
        angle = number("camera_angle_x")
        if angle is None or not 0.0 < angle < math.pi:
            raise BadInput(f"{where}: has neither a focal length (fl_x) nor an angle of view (camera_angle_x)")
        fx = 0.5 * width / math.tan(0.5 * angle)
    model = values.get("camera_model", "OPENCV")
    if model not in MODELS:
        raise BadInput(f"{where}: camera_model {model!r} is not known; undistort it to one of {', '.join(MODELS)}")
    fisheye = model == "OPENCV_FISHEYE" or values.get("is_fisheye") is True
    distortion = tuple(number(k, 0.0) for k in (FISHEYE if fisheye else DISTORTION))
    if any(isinstance(n, float) and not math.isfinite(n) for n in (width, height)):
        raise BadInput(f"{where}: the size is not finite")
    cx, cy = number("cx", 0.5 * width), number("cy", 0.5 * height)
    return Lens(int(width), int(height), fx, number("fl_y", fx), cx, cy, distortion, fisheye)
