"""Captures in files: transforms.json (nerfstudio, instant-ngp, Blender), COLMAP models, Polycam, Record3D, points."""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from os.path import isfile
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from assets.camera_file import parse_camera
from assets.file_access import read_json
from assets.formats.ply import read_vertices
from assets.gaussians import MAGNITUDE_MAX
from core.errors import BadInput
from core.rotation import matrices_from_quaternions
from core.typed import Range, Shape, from_plain
from prepare.train.capture import Capture, Lens, View
from prepare.train.photographs import image_size

VIEWS_MIN = 3  # two views always agree on some depth of a point; a third one checks it
ORTHONORMAL_TOLERANCE = 1e-2  # of rotations in files, which are rounded; they are made exact
SPREAD_MIN = 1e-6  # spread of the cameras relative to their distance from the origin; below it they stand in one place
OPENGL_TO_OPENCV = np.diag([1.0, -1.0, -1.0, 1.0])
FILE_MAX = 64 << 20  # [bytes]
DISTORTION = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
FISHEYE = ("k1", "k2", "k3", "k4")
TRANSFORMS_MODELS = ("OPENCV", "PINHOLE", "SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV_FISHEYE")
GREY = 128
TRANSFORMS = ("transforms.json", "transforms_train.json")
TRANSFORMS_TEST = "transforms_test.json"  # beside the latter; transforms_val.json is for neither
FOLDERS = ("sparse/0", "colmap/sparse/0", "sparse", ".")  # of a capture, in which models lie
IMAGE_FOLDERS = ("images", ".")
SUFFIXES = (".png", ".jpg", ".jpeg")  # tried where a name has none
KEYFRAMES = "keyframes"  # folder of Polycam's raw data; in it (cameras, photographs), the corrected ones first
POLYCAM = (("corrected_cameras", "corrected_images"), ("cameras", "images"))
POLYCAM_BORDER = 15  # [px] of corrected photographs, which may be black (nerfstudio's converter crops as much)
RECORD3D = (("metadata.json", "rgb"), ("metadata", "rgbd"))  # exported as EXR + JPG; an unzipped .r3d
RECORD3D_VIEWS = 300  # most that are taken of a recording, which has 30 or 60 a second
SIDE_MISSING = 1000  # [px] of images that are not there, until `checked` has counted them
NAME_MAX = 4096  # [bytes]
# COLMAP's model number: name, focal lengths (1 or 2), coefficients of OpenCV's in the order of the file, fisheye
COLMAP_MODELS = {
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


def read_capture(path: str | Path) -> Capture:
    """The capture in a folder, or of a transforms.json: nerfstudio, instant-ngp, Blender, COLMAP, Polycam, Record3D.

    Raises BadInput, which names the fault and a remedy.
    """
    path = Path(path)
    if path.is_file():
        if path.suffix.lower() != ".json":
            raise BadInput(
                f"{path}: a capture is a folder with transforms.json or a COLMAP model, or a transforms.json"
            )
        return checked(read_transforms(path))
    if not path.is_dir():
        raise BadInput(f"{path}: no such folder")
    read = reader_of(path)
    if read is None:
        raise BadInput(
            f"{path}: holds no photographs, neither in images/, and no transforms.json or COLMAP model (sparse/0)"
        )
    return checked(read())


def reader_of(folder: Path) -> Callable[[], Capture] | None:
    """The function that reads the views with poses that a folder holds, None if it holds none."""
    for name in TRANSFORMS:  # of Blender's datasets the views to learn from
        if (folder / name).is_file():
            return partial(read_transforms, folder / name)
    if (model := find_colmap_model(folder)) is not None:
        return partial(read_colmap, model, folder)
    keyframes = folder if folder.name == KEYFRAMES else folder / KEYFRAMES
    for cameras, images in POLYCAM:
        if next((keyframes / cameras).glob("*.json"), None):
            return partial(read_polycam, keyframes / cameras, images)
    for name, images in RECORD3D:
        if (folder / name).is_file() and (folder / images).is_dir():
            return partial(read_record3d, folder / name, images)
    return None


def checked(capture: Capture) -> Capture:
    """The capture, its views sorted by name. Raises BadInput if no training is possible with it."""
    views = sorted(capture.views, key=lambda v: str(v.image))
    named = [*views, *capture.test]
    missing = [view.image for view in named if not isfile(view.image)]  # False for a name too long, too
    if missing:
        raise BadInput(f"{missing[0]}: no such image ({len(missing)} of {len(named)} are missing)")
    if len(views) < VIEWS_MIN:
        raise BadInput(
            f"{capture.folder}: {len(views)} views; take at least {VIEWS_MIN}, better 30, around what you want"
        )
    places = np.array([v.position for v in views])
    reach = np.linalg.norm(places - places.mean(axis=0), axis=1).max()
    if reach <= SPREAD_MIN * max(1.0, np.abs(places).max()):
        raise BadInput(f"{capture.folder}: all cameras stand in one place; depth shows only from several places")
    for view in named:
        size = image_size(view.image)
        view.lens.resized(*size, str(view.image))
        if view.mask is not None and (found := image_size(view.mask)) != size:
            raise BadInput(f"{view.mask}: the mask is {found[0]}x{found[1]}, its image {size[0]}x{size[1]}")
    finite = (np.abs(capture.points) < MAGNITUDE_MAX).all(axis=1)  # NaN compares false
    capture = replace(capture, views=views, points=capture.points[finite], colors=capture.colors[finite])
    blind = sum(not _sees_any(view, capture.points) for view in views)
    if len(capture.points) and blind > len(views) / 2:
        text = "the poses are of another set, or their axes point elsewhere"
        raise BadInput(f"{capture.folder}: {blind} of {len(views)} cameras see none of the points: {text}")
    return capture


def _sees_any(view: View, points: np.ndarray) -> bool:
    """True if a point lies in the picture."""
    lens, (x, y, z) = view.lens, view.camera().projected(points)
    return bool(((z > 0.0) & (x >= 0.0) & (x < lens.width) & (y >= 0.0) & (y < lens.height)).any())


def rigid(matrix, where: str) -> np.ndarray:
    """A 4x4 or 3x4 matrix of a file as an exact rigid transform (4, 4). Raises BadInput, naming `where`."""
    try:
        m = np.array(matrix, np.float64)
    except (TypeError, ValueError, OverflowError):
        m = np.full((1, 1), np.nan)
    if m.shape not in ((4, 4), (3, 4)) or not (np.abs(m) < MAGNITUDE_MAX).all():  # NaN compares false
        raise BadInput(f"{where}: the pose is not a finite 4x4 matrix")
    u, s, vt = np.linalg.svd(m[:3, :3])
    if np.abs(s - 1.0).max() > ORTHONORMAL_TOLERANCE or np.linalg.det(u @ vt) < 0:
        raise BadInput(
            f"{where}: the pose is no rotation and translation (it scales by {s.min():.3g} to {s.max():.3g})"
        )
    out = np.eye(4)
    out[:3, :3], out[:3, 3] = u @ vt, m[:3, 3]
    return out


def read_transforms(path: Path) -> Capture:
    """The capture of a transforms.json. Raises BadInput."""
    data = read_json(path, FILE_MAX)
    frames = data.get("frames") if isinstance(data, dict) else None
    if not isinstance(frames, list) or not all(isinstance(f, dict) for f in frames):
        raise BadInput(f"{path}: has no list of frames")
    views, test = [_view(path, {**data, **frame}, frame) for frame in frames], []
    points, colors = np.zeros((0, 3)), np.zeros((0, 3), np.uint8)
    name = data.get("ply_file_path")
    found = _inside(path, path.parent, name) if isinstance(name, str) else path.parent / "sparse_pc.ply"
    if isinstance(name, str) or found.is_file():
        points, colors = read_points(found)
    else:  # with points it was made of photographs, in which transparency hides what is not to be matched
        views = [replace(view, cut_out=True) for view in views]
    held_out = path.with_name(TRANSFORMS_TEST)
    if path.name == TRANSFORMS[1] and held_out.is_file():
        test = read_transforms(held_out).views
    return Capture(path.parent, views, points, colors, test)


def _view(path: Path, values: dict, frame: dict) -> View:
    """A frame, with the file's values where it has none of its own."""
    name = frame.get("file_path")
    if not isinstance(name, str) or not name:
        raise BadInput(f"{path}: a frame has no file_path")
    image = _inside(path, path.parent, name)
    if not image.suffix:  # as of Blender's datasets
        named = [image.with_suffix(suffix) for suffix in SUFFIXES]
        image = next((p for p in named if isfile(p)), named[0])
    mask = values.get("mask_path")
    mask = _inside(path, path.parent, mask) if isinstance(mask, str) else None
    where = f"{path}: {name}"
    world_from_camera = rigid(frame.get("transform_matrix"), where) @ OPENGL_TO_OPENCV
    lens = _frame_lens(where, values, image)
    lens.check(where)
    return View(image, lens, np.linalg.inv(world_from_camera), mask)


def _inside(where: Path, folder: Path, name: str) -> Path:
    """A file in the folder. Raises BadInput, naming `where`, for one that lies elsewhere."""
    if "\0" in name or Path(name).is_absolute() or ".." in Path(name).parts:
        raise BadInput(f"{where}: {name!r} is not inside of the capture's folder")
    return folder / name


def read_polycam(cameras: Path, images: str) -> Capture:
    """The capture of Polycam's raw data: a JSON file a photograph, and beside that folder the one of the photographs.

    t_00 ... t_23 are the rows of world_from_camera, of ARKit: +y up, +y up and +z back in the camera. Raises BadInput.
    """
    views, border = [], POLYCAM_BORDER if images.startswith("corrected") else 0
    for file in sorted(cameras.glob("*.json")):
        data = from_plain(dict[str, Any], read_json(file, FILE_MAX), str(file))
        pose = [[data.get(f"t_{row}{column}") for column in range(4)] for row in range(3)]
        names = {"w": "width", "h": "height", "fl_x": "fx", "fl_y": "fy", "cx": "cx", "cy": "cy"}
        values = {name: data.get(theirs) for name, theirs in names.items()}
        frame = {"file_path": f"{images}/{file.stem}", "transform_matrix": pose}
        views.append(replace(_view(cameras, values, frame), border=border))
    return Capture(cameras.parent, views)


def read_record3d(metadata: Path, images: str) -> Capture:
    """The capture of a recording: photographs 0, 1, ... in `images`, of which at most RECORD3D_VIEWS are taken.

    poses are (qx, qy, qz, qw, x, y, z) of world_from_camera, of ARKit; K is a matrix by columns,
    perFrameIntrinsicCoeffs (fx, fy, cx, cy) of each photograph. Raises BadInput.
    """
    data = from_plain(dict[str, Any], read_json(metadata, FILE_MAX), str(metadata))
    bound = Range(-MAGNITUDE_MAX, MAGNITUDE_MAX)
    poses = from_plain(Annotated[np.ndarray, Shape(None, 7), bound], data.get("poses"), f"{metadata}: poses")
    if data.get("perFrameIntrinsicCoeffs"):
        kind = Annotated[np.ndarray, Shape(len(poses), 4), bound]
        lenses = from_plain(kind, data["perFrameIntrinsicCoeffs"], f"{metadata}: perFrameIntrinsicCoeffs")
    else:
        k = from_plain(Annotated[np.ndarray, Shape(9), bound], data.get("K"), f"{metadata}: K")
        lenses = np.tile(k[[0, 4, 6, 7]], (len(poses), 1))
    views, size = [], {"w": data.get("w"), "h": data.get("h")}
    for i in range(0, len(poses), max(1, -(-len(poses) // RECORD3D_VIEWS))):
        pose = _pose(poses[i, [3, 0, 1, 2]], poses[i, 4:])
        frame = {"file_path": f"{images}/{i}", "transform_matrix": pose.tolist()}
        views.append(
            _view(metadata, size | dict(zip(("fl_x", "fl_y", "cx", "cy"), lenses[i].tolist(), strict=True)), frame)
        )
    return Capture(metadata.parent, views)


def _number(where: str, values: dict, name: str, default: float | None = None) -> float | None:
    value = values.get(name)
    if value is None:
        return default
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise BadInput(f"{where}: {name} is not a number")
    if isinstance(value, int) and abs(value) > MAGNITUDE_MAX:
        raise BadInput(f"{where}: {name} is too large")
    return value


def _distortion(where: str, values: dict) -> tuple[tuple[float, ...], bool]:
    """`distortion` and `fisheye` of a Lens. Raises BadInput."""
    model = values.get("camera_model", "OPENCV")
    if model not in TRANSFORMS_MODELS:
        raise BadInput(
            f"{where}: camera_model {model!r} is not known; undistort it to one of {', '.join(TRANSFORMS_MODELS)}"
        )
    fisheye = model == "OPENCV_FISHEYE" or values.get("is_fisheye") is True
    return tuple(_number(where, values, k, 0.0) for k in (FISHEYE if fisheye else DISTORTION)), fisheye


def _frame_lens(where: str, values: dict, image: Path) -> Lens:
    number = partial(_number, where, values)
    width, height = number("w"), number("h")
    if width is None or height is None:
        width, height = image_size(image) if isfile(image) else (SIDE_MISSING, SIDE_MISSING)
    fx, fy = number("fl_x"), number("fl_y")
    if fx is None:
        angle, high = number("camera_angle_x"), number("camera_angle_y")
        if angle is None or not 0.0 < angle < math.pi:
            raise BadInput(f"{where}: has neither a focal length (fl_x) nor an angle of view (camera_angle_x)")
        fx = 0.5 * width / math.tan(0.5 * angle)
        if fy is None and high is not None and 0.0 < high < math.pi:
            fy = 0.5 * height / math.tan(0.5 * high)
    bent = _distortion(where, values)
    if any(isinstance(n, float) and not math.isfinite(n) for n in (width, height)):
        raise BadInput(f"{where}: the size is not finite")
    cx, cy = number("cx", 0.5 * width), number("cy", 0.5 * height)
    return Lens(int(width), int(height), fx, fx if fy is None else fy, cx, cy, *bent)


def read_camera_views(path: Path, images: Sequence[Path]) -> list[View]:
    """Views of images, or videos, through the cameras of a CAM.json, one for each: in it a camera may have distortion
    in the words of transforms.json, and another size than the next. Raises BadInput."""
    data = read_json(path, FILE_MAX)
    items, views = data if isinstance(data, list) else [data], []
    if len(items) != len(images):
        raise BadInput(f"{path}: holds {len(items)} cameras, for {len(images)} videos")
    for k, (item, image) in enumerate(zip(items, images, strict=True)):
        c = parse_camera(f"{path}: camera {k}", item)
        lens = Lens(c.width, c.height, c.fx, c.fy, c.cx, c.cy, *_distortion(f"{path}: camera {k}", item))
        lens.check(f"{path}: camera {k}")
        views.append(View(image, lens, c.world_to_camera))
    return views


def read_points(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Points (P, 3) float64 and colours (P, 3) uint8, grey where the file has none. Raises BadInput."""
    rows = read_vertices(path)
    known = rows.dtype.names
    if not {"x", "y", "z"} <= set(known):
        raise BadInput(f"{path}: holds no points")
    points = np.stack([rows[name] for name in ("x", "y", "z")], axis=1).astype(np.float64)
    if not {"red", "green", "blue"} <= set(known):
        return points, np.full(points.shape, GREY, np.uint8)
    colors = np.stack([rows[name] for name in ("red", "green", "blue")], axis=1)
    return points, np.nan_to_num(colors).clip(0, 255).astype(np.uint8)


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
    pictures = next((folder / name for name in IMAGE_FOLDERS if images and isfile(folder / name / images[0][2])), None)
    views = []
    for pose, camera, name in images:
        if camera not in lenses:
            raise BadInput(f"{model}: image {name} has a camera {camera} that is not there")
        image = _inside(model, pictures or folder / "images", name)
        views.append(View(image, lenses[camera], rigid(pose, f"{model}: {name}")))
    return Capture(folder, views, points, colors)


def _colmap_model(model: Path, number: int, kind: int | str) -> tuple[str, int, tuple[str, ...], bool]:
    """The entry of COLMAP_MODELS for a model's number or name. Raises BadInput."""
    found = next((m for k, m in COLMAP_MODELS.items() if kind in (k, m[0])), None)
    if found is None:
        raise BadInput(f"{model}: camera {number} has the model {kind}, which is not known; undistort it with COLMAP")
    return found


def _colmap_lens(
    model: Path, number: int, kind: int | str, width: int, height: int, values: list[float]
) -> tuple[int, Lens]:
    name, focal, coefficients, fisheye = _colmap_model(model, number, kind)
    if len(values) != focal + 2 + len(coefficients):
        raise BadInput(f"{model}: camera {number} ({name}) has {len(values)} parameters")
    fx, fy = values[0], values[focal - 1]
    cx, cy = values[focal : focal + 2]
    given = dict(zip(coefficients, values[focal + 2 :], strict=True))
    distortion = tuple(given.get(k, 0.0) for k in (FISHEYE if fisheye else DISTORTION))
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
            yield _colmap_lens(model, int(number), kind, int(width), int(height), [float(v) for v in values])


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
        _, focal, coefficients, _ = _colmap_model(model, number, kind)
        values = list(file.take(f"{focal + 2 + len(coefficients)}d"))
        yield _colmap_lens(model, number, kind, width, height, values)


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
