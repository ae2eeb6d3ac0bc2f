"""`vrgs.py segment`: marks of objects in some photographs become masks of all, or take them out of a splat."""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from assets.file_access import atomic_write, check_writable, locked_folder
from assets.splat_files import MESHES, READERS, read_gaussians
from commands import options as cli
from core.errors import BadInput
from core.report import Section, html_page
from core.runtime import start_taichi
from display.picture import save_picture
from prepare.progress import StepProgress
from prepare.segment.marks import Marks, SplatMarks, read_marks, read_splat_marks, write_marks, write_splat_marks
from prepare.segment.mask_files import check_masks_folder, contact_sheet, overlap_of, overlays, read_masks, write_masks
from prepare.train.capture_files import read_capture
from prepare.train.photographs import image_size, load_photograph

WINDOW_SIZE, SPLAT_WINDOW_SIZE = (1200, 680), (1200, 640)  # in screen coordinates
MARKS_FILE = "marks.json"  # in the capture's folder, of a splat in the output folder
STEPS = ("photographs", "splats", "depths", "surface", "masks", "votes")  # of `segment_capture`, for the progress


@dataclass(kw_only=True)
class SegmentOptions(cli.Options):
    EXAMPLES = (
        "segment toys/ --marks marks.json --splats toys.ply --out toys/masks",
        "segment bear/ --marks marks.json --out masks/ --overlay masks.html    by the capture's sparse points",
        "segment toys/ --marks marks.json --splats toys.ply --out m/ --model sam_like.onnx",
        "segment room.ply --out parts/    mark in a window; one splat per object, and the rest",
        "segment room.ply --marks marks.json --out parts/",
    )
    CONDITIONS = (
        cli.Condition(("--arch",), lambda o: o.splats or is_splats(o.capture), "belongs to --splats"),
        cli.Condition(
            ("--splats", "--model", "--reduce", "--overlay", "--compare"),
            lambda o: not is_splats(o.capture),
            "is for a capture, not for a splat",
        ),
    )

    capture: Path = cli.argument("CAPTURE|SPLATS", f"{cli.CAPTURES}; or a splat file in any format")
    marks: Path | None = cli.option(
        "MARKS.json",
        "strokes and boxes, about two strokes per object (docs/your_own.md); by default a window opens to draw them, "
        "and they are saved in CAPTURE/marks.json, or for a splat in FOLDER/marks.json",
    )
    out: Path = cli.option(
        "FOLDER", "a mask per photograph; or a splat per object, background.ply, and scene.ply with ids", cli.REQUIRED
    )
    splats: Path | None = cli.option("SPLATS", "splat trained on the capture: its depth carries the marks to all views")
    model: Path | None = cli.option("FILE.onnx", "network that refines borders, in place of GrabCut (docs/your_own.md)")
    reduce: cli.Count = cli.reduce_option("the photographs")
    overlay: Path | None = cli.option("SHEET", "write all photographs with the masks drawn over them: .png or .html")
    compare: Path | None = cli.option("MASKS", "folder of true masks: print the overlap (intersection over union, IoU)")
    arch: cli.Arch | None = cli.arch_option()


def is_splats(path: Path) -> bool:
    """True for the name of a splat file or mesh, which holds no photographs."""
    suffix = path.suffix.lower()
    return suffix in (*READERS, *MESHES) and (suffix != ".json" or path.name.lower() == "meta.json")


def segment(options: SegmentOptions) -> None:
    """Segment a capture or a splat. Raises BadInput."""
    if is_splats(options.capture):
        take_objects(options)
    else:
        segment_capture(options)


def segment_capture(options: SegmentOptions) -> None:
    """Carry the marks to all views and write the masks. Raises BadInput."""
    from prepare.segment.mask_propagation import grab_cut, propagate_marks

    check_masks_folder(options.out)
    if options.overlay is not None:
        if options.overlay.suffix.lower() not in (".png", ".html"):
            raise BadInput(f"{options.overlay}: the sheet's name must end in .png or .html")
        check_writable(options.overlay)
    capture = read_capture(options.capture)
    sizes = {v.name: image_size(v.image) for v in capture.views}
    truth = None if options.compare is None else read_masks(options.compare, capture.views)
    cut = grab_cut
    if options.model is not None:
        from prepare.onnx_network import MaskNetwork

        cut = MaskNetwork(options.model)
    splats = None
    if options.splats is not None:
        splats = read_gaussians(options.splats)
        start_taichi(options.arch)
    elif not len(capture.points):
        raise BadInput(f"{options.capture}: has no sparse points; train on it first, then give the splat with --splats")
    if options.marks is None:
        marks = marked_photographs(capture, sizes, capture.folder / MARKS_FILE)
    else:
        marks = read_marks(options.marks, sizes)
    start, progress = time.perf_counter(), StepProgress(STEPS)
    photographs = []
    try:
        for k, view in enumerate(capture.views):
            photographs.append(load_photograph(view, options.reduce))
            progress("photographs", (k + 1) / len(capture.views))
        if splats is not None:
            progress("splats", 0.0)  # compiles the renderer
            capture, photographs = in_world_of(splats, capture, photographs, options.splats)
        masks = propagate_marks(capture, photographs, marks, splats, progress, cut=cut)
    finally:
        progress.close()
    write_masks(options.out, capture.views, masks)
    if options.overlay is not None:
        write_sheet(options.overlay, capture.views, masks)
        print(f"{options.overlay}: photographs with their masks")
    for name, overlap in overlap_of(masks, truth).items() if truth else ():
        print(f"{name}: IoU {overlap:.3f}")
    for label, name in enumerate(masks.names, 1):
        seen = sum(bool((ids == label).any()) for ids in masks.ids)
        print(f"{name}: in {seen} of {len(masks.ids)} photographs, {masks.pixels(name):,} pixels")
        if seen < 0.3 * len(masks.ids):
            print(f"{name}: found in few photographs; check with --overlay, or mark it once more", file=sys.stderr)
    print(f"{options.out}: {len(masks.ids)} masks, {time.perf_counter() - start:.0f} s")


def marked_photographs(capture, sizes: dict[str, tuple[int, int]], path: Path, numbered: bool = False):
    """Marks drawn in a window, starting from those in the file `path` if it exists, and saved there.

    numbered  whether points of the place are marked, too
    Raises BadInput without a display, Cancelled if the user leaves without saving.
    """
    from commands.marking import PhotographSubject, check_window, edit_of, marks_of_state
    from display.mark.mark_window import marked_in_window

    check_window()
    check_writable(path)
    before = read_marks(path, sizes) if path.is_file() else Marks()
    subject, edit = PhotographSubject(capture.views, numbered), edit_of(before, {})
    marks = marks_of_state(marked_in_window(subject, edit, f"Mark {capture.folder.name}", WINDOW_SIZE))
    write_marks(path, marks)
    print(f"{path}: marks saved", file=sys.stderr)
    return marks


def write_sheet(path: Path, views: list, masks) -> None:
    """Write the masks over their photographs: a picture (.png), or a page (.html). Raises BadInput."""
    tiles = overlays(views, masks)
    if path.suffix.lower() == ".png":
        save_picture(path, contact_sheet(list(tiles.values())))
        return
    section = Section("Photographs", "Each object in its colour.", tiles)
    with atomic_write(path) as beside:
        text = f"{', '.join(masks.names)} in {len(views)} photographs."
        beside.write_text(html_page("Masks", text, [section]), encoding="utf-8")


def in_world_of(splats, capture, photographs: list, path: Path):
    """Capture and photographs in the world of the splats: the capture's own, or upright as `train` makes it.

    Raises BadInput if the splats show in neither what was photographed.
    """
    from commands.viewing import draw_float

    found = []
    for posed in (capture.upright(), capture):
        poses = [view.world_to_camera for view in posed.views]
        cameras = [replace(p.camera, world_to_camera=m) for p, m in zip(photographs, poses, strict=True)]
        errors = []
        for k in np.linspace(0, len(cameras) - 1, 3).round().astype(int):
            drawn = draw_float(splats, [cameras[k]], sort="radial")["rgb"][0].clip(0, 1)
            seen = photographs[k].pixels / 255.0
            errors.append(np.abs(drawn - seen).mean() / max(np.abs(seen - seen.mean((0, 1))).mean(), 1e-6))
        found.append((float(np.median(errors)), posed, cameras))
    error, posed, cameras = min(found, key=lambda f: f[0])
    if error > 0.7:  # of what a plain picture of the mean colour would be off; a fair training is off by 0.1 to 0.3
        raise BadInput(f"{path}: does not show what {capture.folder} photographed; was it trained on another capture?")
    return posed, [p._replace(camera=c) for p, c in zip(photographs, cameras, strict=True)]


def take_objects(options: SegmentOptions) -> None:
    """Write a splat per marked object to the folder --out. Raises BadInput."""
    from prepare.segment.splat_segmentation import output_files, overlay_of, segment_splat, write_segmented

    if options.out.exists() and not options.out.is_dir():
        raise BadInput(f"{options.out}: is a file; --out is a folder")
    with locked_folder(options.out):
        marks = marked_splats(options) if options.marks is None else read_splat_marks(options.marks)
        start = time.perf_counter()
        outputs = output_files(options.out, list(marks.marks.objects)).values()
        if options.capture.resolve() in [path.resolve() for path in outputs]:
            raise BadInput(f"{options.capture}: would be overwritten; choose another folder for --out")
        gaussians = read_gaussians(options.capture, show)
        start_taichi(options.arch)
        segmented = segment_splat(gaussians, marks, show)
        files = write_segmented(options.out, segmented)
        write_splat_marks(options.out / MARKS_FILE, marks)
        for view, picture in overlay_of(segmented, marks).items():
            save_picture(options.out / f"{view}.png", picture)
    written = ", ".join(path.name for path in files.values())
    print(f"{options.out}: {written}; {segmented.cut} Gaussians cut in two, {time.perf_counter() - start:.1f} s")


def marked_splats(options: SegmentOptions) -> SplatMarks:
    """Marks drawn in a window, starting from those in the output folder, where they are saved.

    Raises BadInput without a display, Cancelled if the user leaves without saving.
    """
    from commands.marking import SplatSubject, check_window, edit_of
    from display.mark.mark_window import marked_in_window

    check_window()
    path = options.out / MARKS_FILE
    before = read_splat_marks(path) if path.is_file() else SplatMarks()
    gaussians = read_gaussians(options.capture, show)
    start_taichi(options.arch)
    subject, edit = SplatSubject(gaussians, before), edit_of(before.marks, before.grow)
    state = marked_in_window(subject, edit, f"Mark {options.capture.name}", SPLAT_WINDOW_SIZE)
    marks = subject.marks(state)
    subject.close()
    write_splat_marks(path, marks)
    show(f"{path}: the marks")
    return marks


def show(line: str) -> None:
    """Print what has been done."""
    print(f"  {line}", file=sys.stderr, flush=True)
