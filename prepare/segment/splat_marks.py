"""Marks of a user on pictures of a splat: as those on photographs, with the cameras of the pictures in the same file.

{"views": {"view_1": camera, ...}, "objects": {"bear": {"view_1": {"inside": [...], ...}}}, "grow": {"bear": 1}}
"""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from pathlib import Path

from assets.camera_file import parse_camera
from assets.file_access import atomic_write, read_json
from core.camera import Camera
from core.errors import BadInput
from core.typed import to_plain
from prepare.segment.marks import Marks, marks_json, marks_of
from prepare.segment.mask_files import JSON_MAX

VIEWS_MAX = 1000
GROW_MAX = 50  # rings of neighbours
SIZE_MAX = 16 * JSON_MAX


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
    data = read_json(path, SIZE_MAX)
    views = data.get("views") if isinstance(data, dict) else None
    if not isinstance(views, dict) or not 0 < len(views) <= VIEWS_MAX:
        raise BadInput(f'{path}: no "views"; marks on a splat need the cameras of its pictures: {{"view_1": camera}}')
    cameras = {name: parse_camera(f"{path}: {name}", item) for name, item in views.items()}
    marks = marks_of(data, {name: (c.width, c.height) for name, c in cameras.items()}, str(path))
    grow = data.get("grow", {})
    if not isinstance(grow, dict):
        raise BadInput(f'{path}: "grow" is not an object')
    for name, rings in grow.items():
        if name not in marks.objects:
            raise BadInput(f'{path}: "grow" names {name!r:.60}, which is not marked')
        if isinstance(rings, bool) or not isinstance(rings, int) or abs(rings) > GROW_MAX:
            raise BadInput(f'{path}: "grow" of {name!r}: {rings!r:.60} is no whole number of at most {GROW_MAX}')
    return SplatMarks(cameras, marks, grow)


def write_splat_marks(path: str | Path, marks: SplatMarks) -> None:
    """Write marks and cameras as JSON. Raises BadInput."""
    data = {
        "views": {name: to_plain(camera) for name, camera in marks.cameras.items()},
        "objects": marks_json(marks.marks),
        "grow": {name: rings for name, rings in marks.grow.items() if rings},
    }
    with atomic_write(path) as beside:
        beside.write_text(json.dumps(data, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
