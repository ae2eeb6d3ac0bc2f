"""COLMAP models, text and binary: cameras, images (world to camera, OpenCV's axes) and points."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from core.errors import BadInput
from core.rotation import matrices_from_quaternions
from prepare.train.capture import Capture, View, rigid
from prepare.train.lens import Lens

FOLDERS = ("sparse/0", "colmap/sparse/0", "sparse", ".")  # of a capture, in which models lie
IMAGE_FOLDERS = ("images", ".")
NAME_MAX = 4096  # [bytes]
# COLMAP's model number: name, focal lengths (1 or 2), coefficients of OpenCV's in the order of the file, fisheye
MODELS = {
    0: ("SIMPLE_PINHOLE", 1, (), False),
    1: ("PINHOLE", 2, (), False),
    2: ("SIMPLE_RADIAL", 1, ("k1",), False),
    3: ("RADIAL", 1, ("k1", "k2"), False),
    4: ("OPENCV", 2, ("k1", "k2", "p1", "p2"), False),
    5: ("OPENCV_FISHEYE", 2, ("k1", "k2", "k3", "k4"), True),
    6: ("FULL_OPENCV", 2, ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"), False),
    8: ("SIMPLE_RADIAL_FISHEYE", 1, ("k1",), True),
    9: ("RADIAL_FISHEYE", 1, ("k1", "k2"), True),
}
OPENCV_ORDER = {False: ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"), True: ("k1", "k2", "k3", "k4")}


def find_colmap_model(folder: Path) -> Path | None:
    """The folder of the first model of a capture, or None."""
    for name in FOLDERS:
        if any((folder / name / f"cameras{suffix}").is_file() for suffix in (".bin", ".txt")):
            return folder / name
    return None


def read_colmap(model: Path, folder: Path) -> Capture:
    """The capture of a model and of the images in `folder`. Raises BadInput."""
    binary = (model / "cameras.bin").is_file()
    try:
        lenses = dict(_binary_cameras(model) if binary else _text_cameras(model))
        images = list(_binary_images(model) if binary else _text_images(model))
        points, colors = _binary_points(model) if binary else _text_points(model)
    except OSError as e:
        raise BadInput(f"{model}: {e.filename} cannot be read ({e.strerror})") from e
    except (struct.error, ValueError, IndexError, OverflowError, UnicodeDecodeError) as e:
        raise BadInput(f"{model}: a file of this COLMAP model is cut off or damaged ({str(e)[:100]})") from e
    pictures = next(
        (folder / name for name in IMAGE_FOLDERS if images and (folder / name / images[0][2]).is_file()), None
    )
    views = []
    for pose, camera, name in images:
        if camera not in lenses:
            raise BadInput(f"{model}: image {name} has a camera {camera} that is not there")
        if Path(name).is_absolute() or ".." in Path(name).parts or "\0" in name:
            raise BadInput(f"{model}: {name!r} is not inside of the capture's folder")
        views.append(View((pictures or folder / "images") / name, lenses[camera], rigid(pose, f"{model}: {name}")))
    return Capture(folder, views, points, colors)


def _lens(model: Path, number: int, kind: int | str, width: int, height: int, values: list[float]) -> tuple[int, Lens]:
    known = {**MODELS, **{m[0]: m for m in MODELS.values()}}
    if kind not in known:
        raise BadInput(f"{model}: camera {number} has the model {kind}, which is not known; undistort it with COLMAP")
    name, focal, coefficients, fisheye = known[kind]
    if len(values) != focal + 2 + len(coefficients):
        raise BadInput(f"{model}: camera {number} ({name}) has {len(values)} parameters")
    fx, fy = values[0], values[focal - 1]
    cx, cy = values[focal : focal + 2]
    given = dict(zip(coefficients, values[focal + 2 :], strict=True))
    distortion = tuple(given.get(k, 0.0) for k in OPENCV_ORDER[fisheye])
    lens = Lens(width, height, fx, fy, cx, cy, distortion if coefficients else (), fisheye)
    lens.check(f"{model}: camera {number}")
    return number, lens


def _pose(quaternion, translation) -> np.ndarray:
    pose = np.eye(4)
    q = np.asarray(quaternion, np.float64)
    with np.errstate(over="ignore"):
        length = np.linalg.norm(q)
    pose[:3, :3] = matrices_from_quaternions((q / length)[None])[0] if 0 < length < np.inf else np.nan
    pose[:3, 3] = translation
    return pose


# text


def _lines(path: Path) -> Iterator[str]:
    with open(path, encoding="utf-8") as file:
        for line in file:
            if not line.startswith("#"):
                yield line.rstrip("\n")


def _text_cameras(model: Path) -> Iterator[tuple[int, Lens]]:
    for line in _lines(model / "cameras.txt"):
        if words := line.split():
            number, kind, width, height, *values = words
            yield _lens(model, int(number), kind, int(width), int(height), [float(v) for v in values])


def _text_images(model: Path) -> Iterator[tuple[np.ndarray, int, str]]:
    lines = _lines(model / "images.txt")
    for line in lines:
        if words := line.split(maxsplit=9):
            numbers = [float(w) for w in words[1:8]]
            yield _pose(numbers[:4], numbers[4:]), int(words[8]), words[9].strip()
            next(lines, None)  # the points that it saw, which may be an empty line


def _text_points(model: Path) -> tuple[np.ndarray, np.ndarray]:
    path = model / "points3D.txt"
    rows = [line.split()[1:7] for line in _lines(path) if line.strip()] if path.is_file() else []
    values = np.array(rows, np.float64).reshape(-1, 6)
    return values[:, :3].copy(), np.nan_to_num(values[:, 3:]).clip(0, 255).astype(np.uint8)


# binary, little-endian


class _Bytes:
    """A file that is read from the front. Raises struct.error where it ends too early."""

    def __init__(self, path: Path):
        self.data, self.at = path.read_bytes(), 0

    def take(self, form: str) -> tuple:
        values = struct.unpack_from("<" + form, self.data, self.at)
        self.at += struct.calcsize("<" + form)
        return values

    def skip(self, count: int, size: int) -> None:
        if count > (len(self.data) - self.at) // size:
            raise ValueError(f"{count} records announced")
        self.at += count * size

    def name(self) -> str:
        end = self.data.index(b"\0", self.at, self.at + NAME_MAX)
        text = self.data[self.at : end].decode("utf-8")
        self.at = end + 1
        return text


def _binary_cameras(model: Path) -> Iterator[tuple[int, Lens]]:
    file = _Bytes(model / "cameras.bin")
    for _ in range(file.take("Q")[0]):
        number, kind, width, height = file.take("IiQQ")
        if kind not in MODELS:
            raise BadInput(
                f"{model}: camera {number} has the model {kind}, which is not known; undistort it with COLMAP"
            )
        values = list(file.take(f"{MODELS[kind][1] + 2 + len(MODELS[kind][2])}d"))
        yield _lens(model, number, kind, width, height, values)


def _binary_images(model: Path) -> Iterator[tuple[np.ndarray, int, str]]:
    file = _Bytes(model / "images.bin")
    for _ in range(file.take("Q")[0]):
        _, *pose, camera = file.take("I7dI")
        name = file.name()
        file.skip(file.take("Q")[0], 24)  # x, y, and the point's number
        yield _pose(pose[:4], pose[4:]), camera, name


def _binary_points(model: Path) -> tuple[np.ndarray, np.ndarray]:
    path = model / "points3D.bin"
    if not path.is_file():
        return np.zeros((0, 3)), np.zeros((0, 3), np.uint8)
    file, points, colors = _Bytes(path), [], []
    for _ in range(file.take("Q")[0]):
        _, x, y, z, red, green, blue, _ = file.take("Q3d3Bd")
        points.append((x, y, z))
        colors.append((red, green, blue))
        file.skip(file.take("Q")[0], 8)
    return np.array(points).reshape(-1, 3), np.array(colors, np.uint8).reshape(-1, 3)
