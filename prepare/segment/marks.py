"""Marks of objects in photographs or in pictures of a splat: strokes inside and outside, and boxes around them.

A file of marks on a splat also holds the cameras of its pictures:
{"views": {"view_1": camera, ...}, "objects": {"bear": {"view_1": {"inside": [...], ...}}}, "grow": {"bear": 1}}
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

import cv2
import numpy as np

from assets.camera_file import parse_camera
from assets.file_access import read_json, write_json
from core.camera import Camera
from core.errors import BadInput
from core.typed import Range, Shape, from_plain, to_plain
from prepare.segment.mask_files import JSON_MAX, OBJECTS_MAX, check_name

FORM = '{"objects": {"NAME": {"PHOTOGRAPH.jpg": {"inside": [[[x, y], ...], ...], "outside": [...], "boxes": [...]}}}}'
POINTS_MAX = 100_000  # in all strokes on an object in a view
Clicks = list[tuple[float, float] | None]  # (x, y) [px] of numbered points in a photograph, None: not seen there
Stroke, Box = Annotated[np.ndarray, Shape(None, 2)], Annotated[np.ndarray, Shape(4)]
VIEWS_MAX = 1000
Rings = dict[str, Annotated[int, Range(-50, 50)]]  # of neighbours, by the object's name
FILE_MAX = 16 * JSON_MAX


@dataclass
class ViewMarks:
    """Marks of an object in one photograph, in its pixels, x to the right and y down from the upper left corner.

    inside, outside  strokes: polylines (P, 2); one point is a click
    boxes            around the object, (4,) each: x0, y0, x1, y1
    """

    inside: list[Stroke] = field(default_factory=list)
    outside: list[Stroke] = field(default_factory=list)
    boxes: list[Box] = field(default_factory=list)

    @property
    def points(self) -> np.ndarray:
        """All points of all marks, (N, 2)."""
        parts = [*self.inside, *self.outside, *(b.reshape(2, 2) for b in self.boxes)]
        return np.concatenate(parts) if parts else np.zeros((0, 2))


@dataclass
class Marks:
    """Marks by the object's name, then by the photograph's file name.

    points  by the photograph's file name: the nth of each is the same point of the place
    """

    objects: dict[str, dict[str, ViewMarks]] = field(default_factory=dict)
    points: dict[str, Clicks] = field(default_factory=dict)

    @property
    def views(self) -> list[str]:
        """Names of the photographs with marks, sorted."""
        return sorted({view for views in self.objects.values() for view in views})

    def in_view(self, view: str) -> dict[str, ViewMarks]:
        """The marks of each object in a photograph."""
        return {name: views[view] for name, views in self.objects.items() if view in views}


def read_marks(path: str | Path, sizes: Mapping[str, tuple[int, int]]) -> Marks:
    """The marks in a JSON file. `sizes` holds (width, height) [px] of each photograph by its file's name.

    Raises BadInput for an unknown photograph, for marks outside of it, and for an object without marks inside.
    """
    path = Path(path)
    return marks_of(read_json(path, FILE_MAX), sizes, str(path))


def read_points(path: str | Path) -> dict[str, Clicks]:
    """The numbered points in a file of marks, of the photographs that have some. Raises BadInput."""
    data = from_plain(dict[str, Any], read_json(path, FILE_MAX), str(path))
    points = from_plain(dict[str, Clicks], data.get("points", {}), f"{path}: points")
    return {view: row for view, row in points.items() if any(row)}


def marks_of(data, sizes: Mapping[str, tuple[int, int]], where: str) -> Marks:
    """The marks of parsed JSON, as `read_marks`; `where` is named in errors."""
    objects = data.get("objects") if isinstance(data, dict) else None
    if not isinstance(objects, dict):
        raise BadInput(f"{where}: no marks; the form is {FORM}")
    if not 0 < len(objects) <= OBJECTS_MAX:
        raise BadInput(f"{where}: {len(objects)} objects are marked, not 1 to {OBJECTS_MAX}")
    marks = from_plain(Marks, {"objects": objects, "points": data.get("points", {})}, where)
    for name, views in marks.objects.items():
        check_name(name, where)
        for view, entry in views.items():
            if view not in sizes:
                known = ", ".join(sorted(sizes)[:3]) + (f" and {len(sizes) - 3} more" if len(sizes) > 3 else "")
                raise BadInput(f"{where}: {name!r} in {view}: no such photograph; there are {known}")
            check_view(entry, sizes[view], f"{where}: {name!r} in {view}")
        if not any(m.inside or m.boxes for m in views.values()):
            raise BadInput(f"{where}: {name!r} has no stroke inside of it and no box around it")
    return marks


def check_view(marks: ViewMarks, size: tuple[int, int], where: str) -> None:
    """Raise BadInput for boxes without area, and for marks outside of a photograph of this size [px]."""
    for x0, y0, x1, y1 in marks.boxes:
        if x1 - x0 < 1 or y1 - y0 < 1:
            box = f"[{x0:g}, {y0:g}, {x1:g}, {y1:g}]"
            raise BadInput(f"{where}: the box {box} has no area; its form is [left, top, right, bottom]")
    points = marks.points
    if not 0 < len(points) <= POINTS_MAX:
        raise BadInput(f"{where}: {len(points)} points, not 1 to {POINTS_MAX}")
    out = ((points < 0) | (points > size)).any(axis=1)
    if out.any():
        x, y = points[out][0]
        raise BadInput(f"{where}: ({x:g}, {y:g}) is outside of the photograph, {size[0]}x{size[1]}")


def write_marks(path: str | Path, marks: Marks) -> None:
    """Write marks as JSON. Raises BadInput."""
    points = {view: [p and [round(x, 1) for x in p] for p in row] for view, row in marks.points.items()}
    write_json(path, {"objects": marks_json(marks)} | ({"points": points} if points else {}))


def marks_json(marks: Marks) -> dict:
    """The value of "objects" in a file of marks; pixels are rounded to a tenth."""

    def rounded(parts: list[np.ndarray]) -> list:
        return [np.round(p, 1).tolist() for p in parts]

    def kinds(m: ViewMarks) -> dict:
        return {k: rounded(v) for k, v in vars(m).items() if v}

    return {name: {view: kinds(m) for view, m in views.items()} for name, views in marks.objects.items()}


def drawn_strokes(strokes: list[np.ndarray], shape: tuple[int, int], width: int = 3) -> np.ndarray:
    """Mask (H, W) bool of the pixels under strokes of `width` [px]."""
    mask = np.zeros(shape, np.uint8)
    for stroke in strokes:
        points = np.round((np.asarray(stroke, np.float64) - 0.5) * 16).astype(np.int32)  # 4 bits of fraction
        if len(points) == 1:
            points = np.repeat(points, 2, axis=0)
        cv2.polylines(mask, [points], False, 1, width, cv2.LINE_8, 4)
    return mask > 0


def drawn_boxes(boxes: list[np.ndarray], shape: tuple[int, int]) -> np.ndarray:
    """Mask (H, W) bool of the pixels whose centres lie in one of the boxes."""
    mask = np.zeros(shape, bool)
    for box in boxes:
        x0, y0, x1, y1 = np.round(box).astype(int)
        mask[max(y0, 0) : max(y1, y0 + 1), max(x0, 0) : max(x1, x0 + 1)] = True
    return mask


@dataclass
class SplatMarks:
    """Marks on pictures of a splat.

    cameras  of the pictures by name, in the frame of the splat's file
    grow     rings of neighbours by which an object's selection is grown, or shrunk if negative, by its name
    """

    cameras: dict[str, Camera] = field(default_factory=dict)
    marks: Marks = field(default_factory=Marks)
    grow: dict[str, int] = field(default_factory=dict)


def read_splat_marks(path: str | Path) -> SplatMarks:
    """The marks and cameras in a JSON file. Raises BadInput."""
    path = Path(path)
    data = read_json(path, FILE_MAX)
    views = data.get("views") if isinstance(data, dict) else None
    if not isinstance(views, dict) or not 0 < len(views) <= VIEWS_MAX:
        raise BadInput(f'{path}: no "views"; marks on a splat need the cameras of its pictures: {{"view_1": camera}}')
    cameras = {name: parse_camera(f"{path}: {name}", item) for name, item in views.items()}
    marks = marks_of(data, {name: (c.width, c.height) for name, c in cameras.items()}, str(path))
    grow = from_plain(Rings, data.get("grow", {}), f"{path}: grow")
    if strange := set(grow) - set(marks.objects):
        raise BadInput(f'{path}: "grow" names {min(strange)!r:.60}, which is not marked')
    return SplatMarks(cameras, marks, grow)


def write_splat_marks(path: str | Path, marks: SplatMarks) -> None:
    """Write marks and cameras as JSON. Raises BadInput."""
    cameras = {name: to_plain(camera) for name, camera in marks.cameras.items()}
    grow = {name: rings for name, rings in marks.grow.items() if rings}
    write_json(path, {"views": cameras, "objects": marks_json(marks.marks), "grow": grow})
