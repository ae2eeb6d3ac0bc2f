"""Objects taken out of a splat file by marks on its pictures: the half of `vrgs.py segment` without photographs."""

from __future__ import annotations

import argparse
import sys
from time import perf_counter

from assets.file_access import make_folder
from assets.splat_files import read_gaussians
from core.errors import BadInput
from core.runtime import start_taichi

MARKS_FILE = "marks.json"  # in the output folder: a copy


def take_objects(args: argparse.Namespace) -> None:
    """Write a splat an object that `args.marks` mark in `args.capture`, to the folder `args.out`. Raises BadInput."""
    from display.picture import save_picture
    from prepare.segment.splat_marks import read_splat_marks, write_splat_marks
    from prepare.segment.splat_segmentation import output_files, overlay_of, segment_splat, write_segmented

    if args.out.exists() and not args.out.is_dir():
        raise BadInput(f"{args.out}: is a file; --out is a folder")
    start, marks = perf_counter(), read_splat_marks(args.marks)
    outputs = output_files(args.out, list(marks.marks.objects)).values()
    if args.capture.resolve() in [path.resolve() for path in outputs]:
        raise BadInput(f"{args.capture}: would be overwritten; choose another folder for --out")
    gaussians = read_gaussians(args.capture, progress)
    make_folder(args.out)
    start_taichi(args.arch)
    segmented = segment_splat(gaussians, marks, progress)
    files = write_segmented(args.out, segmented)
    write_splat_marks(args.out / MARKS_FILE, marks)
    for view, picture in overlay_of(segmented, marks).items():
        save_picture(args.out / f"{view}.png", picture)
    written = ", ".join(path.name for path in files.values())
    print(f"{args.out}: {written}; {segmented.cut} Gaussians cut in two, {perf_counter() - start:.1f} s")


def progress(line: str) -> None:
    """Show what has been done."""
    print(f"  {line}", file=sys.stderr, flush=True)
