"""Photographs of `vrgs.py capture` with their poses, and marks or masks of their objects.

Objects are asked for first: poses and training take minutes, and marks are drawn on photographs, which need neither.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from commands.segment import marked_photographs
from commands.train import is_posed
from core.errors import BadInput
from prepare.room_capture.stages import Stages, file_key, source_digest
from prepare.segment.marks import Marks, read_marks
from prepare.segment.mask_files import photograph_size, read_masks
from prepare.segment.object_ids import masks_beside
from prepare.train.capture import Capture, Lens, View
from prepare.train.capture_files import checked, read_capture, read_colmap
from prepare.train.structure_from_motion import (
    find_poses,
    image_folder,
    load_pycolmap,
    photographs_in,
    sharpest_frames,
)

if TYPE_CHECKING:
    from commands.capture_room import CaptureOptions

MARKS = "marks.json"  # beside the photographs
Say = Callable[[str], None]


@dataclass(frozen=True)
class Photographed:
    """Photographs with poses, and what is known of their objects: marks in some, or a folder of masks, or neither.

    capture  in the frame of its files
    """

    capture: Capture
    marks: Marks | None
    masks: Path | None


def stages_before(capture: Path) -> tuple[str, ...]:
    """Names of the stages that find the poses of a capture; none if it has them."""
    if is_posed(capture):
        return ()
    return ("frames", "poses") if capture.is_file() else ("poses",)


def photographed(
    options: CaptureOptions, stages: Stages, say: Say, check: Callable[[list[View]], None]
) -> Photographed:
    """The capture that --capture names; `check` takes its photographs before poses are found. Raises BadInput."""
    if is_posed(options.capture):
        capture = read_capture(options.capture)
        check(capture.views)
        return Photographed(capture, *objects_of(options, capture, capture.folder / MARKS, say))
    load_pycolmap()
    folder, place, video = options.capture, options.capture / MARKS, options.capture.is_file()
    if video:
        key, source = file_key(options.capture), source_digest("prepare.train.structure_from_motion")
        folder = stages.run("frames", {"video": key}, lambda made: frames_of(options.capture, made, say), source)
        place = options.out / MARKS
    views = without_poses(image_folder(folder))
    check(views)
    marks, masks = objects_of(options, Capture(folder, views), place, say)
    capture = with_poses(folder, views, video, stages, say)
    if marks is not None:
        marks = marks_in(marks, [view.name for view in capture.views], say)
    return Photographed(capture, marks, masks)


def frames_of(video: Path, folder: Path, say: Say) -> None:
    """Write the sharpest frames of a video to images/ in a folder. Raises BadInput."""
    say(f"{sharpest_frames(video, folder / 'images')} sharp frames of {video}")


def without_poses(images: Path) -> list[View]:
    """Views of the photographs in a folder, with a lens and a pose that are none of theirs. Raises BadInput."""
    views = []
    for name in photographs_in(images):
        view = View(images / name, Lens(1, 1, 1.0, 1.0, 0.5, 0.5), np.eye(4))
        height, width = photograph_size(view)
        views.append(View(view.image, Lens(width, height, width, width, 0.5 * width, 0.5 * height), np.eye(4)))
    return views


def with_poses(folder: Path, views: list[View], video: bool, stages: Stages, say: Say) -> Capture:
    """The capture of photographs whose poses are found now, or were in an earlier run. Raises BadInput."""
    images, names = views[0].image.parent, [view.name for view in views]

    def make(into: Path) -> None:
        find_poses(images, into / "sparse", names=names, in_order=video, progress=say)

    inputs = {"photographs": [file_key(view.image) for view in views]}
    done = stages.run("poses", inputs, make, source_digest("prepare.train.structure_from_motion"))
    return checked(read_colmap(done / "sparse", folder))


def objects_of(options: CaptureOptions, capture: Capture, place: Path, say: Say) -> tuple[Marks | None, Path | None]:
    """Marks of objects, or the folder of their masks, checked against the photographs; neither for --no-objects.

    Without any the user is asked, and `place` receives the marks. Raises BadInput.
    """
    if options.no_objects:
        return None, None
    sizes = {view.name: photograph_size(view)[::-1] for view in capture.views}
    marks = options.marks or (place if options.masks is None and place.is_file() else None)
    if marks is not None:
        return read_marks(marks, sizes), None
    masks = options.masks or masks_beside(capture, say)
    if masks is not None:
        read_masks(masks, capture.views)
        return None, masks
    check_can_ask()
    return marked_photographs(capture, sizes, place), None


def marks_in(marks: Marks, names: list[str], say: Say) -> Marks:
    """The marks in photographs with these names, those whose poses were found. Raises BadInput if an object has none
    left."""
    kept = {}
    for name, views in marks.objects.items():
        lost = sorted(set(views) - set(names))
        kept[name] = {view: m for view, m in views.items() if view in names}
        where = f"{', '.join(lost[:3])}{' and others' if len(lost) > 3 else ''}, whose pose was not found"
        if not any(m.inside or m.boxes for m in kept[name].values()):
            raise BadInput(f"{name!r} is marked only in {where}; mark it in another photograph, as {names[0]}")
        if lost:
            say(f"{name}: not used are its marks in {where}")
    return Marks(kept)


def check_can_ask() -> None:
    """Raise BadInput where the user cannot be asked for marks in a window."""
    from display.window.gl_window import has_display

    if has_display():
        return
    raise BadInput(
        "no marked objects, and no display to mark them on: give --marks MARKS.json or --masks FOLDER, or --no-objects "
        "for only the room"
    )


def capture_key(capture: Capture) -> dict:
    """All that a training takes from a capture, as JSON: if any of it changes, it is made anew."""
    views = []
    for view in capture.views:
        files = [file_key(path) for path in (view.image, view.mask) if path is not None]
        views.append([files, asdict(view.lens), view.world_to_camera.tolist()])
    points = hashlib.sha256(capture.points.tobytes() + capture.colors.tobytes()).hexdigest()
    return {"views": views, "points": points}
