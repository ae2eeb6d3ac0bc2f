"""`vrgs.py segment` for a splat file: objects are cut out by marks on its renderings, without photographs."""

from __future__ import annotations

import argparse
import sys
from time import perf_counter
from typing import TYPE_CHECKING

from assets.file_access import locked_folder
from assets.splat_files import read_gaussians
from core.errors import BadInput
from core.runtime import start_taichi

if TYPE_CHECKING:
    from prepare.segment.splat_marks import SplatMarks

MARKS_FILE = "marks.json"  # in the output folder
WINDOW_SIZE = (1200, 640)  # in screen coordinates


def take_objects(args: argparse.Namespace) -> None:
    """Write a splat per object that `args.marks` mark in `args.capture` to the folder `args.out`. Raises BadInput."""
    if args.out.exists() and not args.out.is_dir():
        raise BadInput(f"{args.out}: is a file; --out is a folder")
    with locked_folder(args.out):
        _take_objects(args)


def _take_objects(args: argparse.Namespace) -> None:
    """As `take_objects`, in the locked folder."""
    from display.picture import save_picture
    from prepare.segment.splat_marks import read_splat_marks, write_splat_marks
    from prepare.segment.splat_segmentation import output_files, overlay_of, segment_splat, write_segmented

    if args.marks is None:
        marks = marked_splats(args)
    else:
        marks = read_splat_marks(args.marks)
    start = perf_counter()
    outputs = output_files(args.out, list(marks.marks.objects)).values()
    if args.capture.resolve() in [path.resolve() for path in outputs]:
        raise BadInput(f"{args.capture}: would be overwritten; choose another folder for --out")
    gaussians = read_gaussians(args.capture, progress)
    start_taichi(args.arch)
    segmented = segment_splat(gaussians, marks, progress)
    files = write_segmented(args.out, segmented)
    write_splat_marks(args.out / MARKS_FILE, marks)
    for view, picture in overlay_of(segmented, marks).items():
        save_picture(args.out / f"{view}.png", picture)
    written = ", ".join(path.name for path in files.values())
    print(f"{args.out}: {written}; {segmented.cut} Gaussians cut in two, {perf_counter() - start:.1f} s")


def marked_splats(args: argparse.Namespace) -> SplatMarks:
    """Marks drawn in a window, starting from those in the output folder, where they are saved.

    Raises BadInput without a display, Cancelled if the user leaves without saving.
    """
    from commands.marking import SplatSubject, check_window, edit_of
    from display.mark.mark_window import marked_in_window
    from prepare.segment.splat_marks import SplatMarks, read_splat_marks, write_splat_marks

    check_window()
    path = args.out / MARKS_FILE
    before = read_splat_marks(path) if path.is_file() else SplatMarks()
    gaussians = read_gaussians(args.capture, progress)
    start_taichi(args.arch)
    subject = SplatSubject(gaussians, before, None)
    state = marked_in_window(subject, edit_of(before.marks, before.grow), f"Mark {args.capture.name}", WINDOW_SIZE)
    marks = subject.marks(state)
    subject.close()
    write_splat_marks(path, marks)
    progress(f"{path}: the marks")
    return marks


def progress(line: str) -> None:
    """Show what has been done."""
    print(f"  {line}", file=sys.stderr, flush=True)
