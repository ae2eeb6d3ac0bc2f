"""`vrgs.py segment`: marks of objects in some photographs become masks of all, or take them out of a splat."""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

import numpy as np

from assets.file_access import atomic_write, check_writable
from commands.conditions import Condition
from commands.options import add_arch, positive
from core.errors import BadInput
from core.runtime import start_taichi

HELP = "find marked objects in all photographs of a capture, or take them out of a splat"
EXAMPLES = (
    "segment toys/ --marks marks.json --splats toys.ply --out toys/masks",
    "segment bear/ --marks marks.json --out masks/ --overlay masks.html    by the capture's sparse points",
    "segment toys/ --marks marks.json --splats toys.ply --out m/ --model sam_like.onnx",
    "segment room.ply --out parts/    mark in a window; a splat an object, and the rest",
    "segment room.ply --marks marks.json --out parts/",
)
CONDITIONS = (
    Condition(
        ("--arch",),
        lambda args: args.splats or is_splats(args.capture),
        "belongs to --splats; nothing else needs a device",
    ),
    Condition(
        ("--splats", "--model", "--reduce", "--overlay", "--compare"),
        lambda args: not is_splats(args.capture),
        "is for a capture, not for a splat",
    ),
)
WINDOW_SIZE = (1200, 680)  # in screen coordinates
LINE_SECONDS = 2.0  # between two progress lines; on a terminal a tenth


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    text = "folder with transforms.json or a COLMAP model, or a transforms.json; or a splat file in any format"
    parser.add_argument("capture", type=Path, metavar="CAPTURE|SPLATS", help=text)
    text = "strokes and boxes in one or more pictures (docs/your_own.md), about two strokes per object. By default a "
    text += "window opens to draw them; they are saved in CAPTURE/marks.json, for a splat in FOLDER/marks.json"
    parser.add_argument("--marks", type=Path, metavar="MARKS.json", help=text)
    text = (
        "output: a mask for each photograph; for a splat, one splat per object, background.ply, and scene.ply with ids"
    )
    parser.add_argument("--out", type=Path, required=True, metavar="FOLDER", help=text)
    text = "splat trained on the capture (vrgs.py train), whose depth carries the marks (default: the sparse points)"
    parser.add_argument("--splats", type=Path, metavar="SPLATS", help=text)
    text = "network of yours that refines the borders instead of GrabCut (docs/your_own.md)"
    parser.add_argument("--model", type=Path, metavar="FILE.onnx", help=text)
    text = "work on photographs whose width and height are divided by N"
    parser.add_argument("--reduce", type=positive(int), default=1, metavar="N", help=text)
    text = "write all photographs with the masks drawn over them: .png or .html"
    parser.add_argument("--overlay", type=Path, metavar="SHEET", help=text)
    text = "folder of true masks: print the overlap with them (intersection over union, IoU)"
    parser.add_argument("--compare", type=Path, metavar="MASKS", help=text)
    add_arch(parser)


def is_splats(path: Path) -> bool:
    """True for the name of a splat file or mesh, which holds no photographs."""
    from assets.splat_files import MESHES, READERS

    suffix = path.suffix.lower()
    return suffix in (*READERS, *MESHES) and (suffix != ".json" or path.name.lower() == "meta.json")


def run(args: argparse.Namespace) -> None:
    """Segment what `args.capture` names. Raises BadInput."""
    if is_splats(args.capture):
        from commands.splat_objects import take_objects

        take_objects(args)
    else:
        segment_capture(args)


def segment_capture(args: argparse.Namespace) -> None:
    """Carry the marks to all views and write the masks. Raises BadInput."""
    from assets.splat_files import read_gaussians
    from prepare.segment.marks import read_marks
    from prepare.segment.mask_files import (
        check_masks_folder,
        overlap_of,
        photograph_size,
        read_masks,
        write_masks,
    )
    from prepare.segment.mask_propagation import grab_cut, propagate_marks
    from prepare.train.capture_files import read_capture
    from prepare.train.photographs import load_photograph

    check_masks_folder(args.out)
    if args.overlay is not None:
        if args.overlay.suffix.lower() not in (".png", ".html"):
            raise BadInput(f"{args.overlay}: the sheet's name must end in .png or .html")
        check_writable(args.overlay)
    capture = read_capture(args.capture)
    sizes = {v.name: photograph_size(v)[::-1] for v in capture.views}
    truth = None if args.compare is None else read_masks(args.compare, capture.views)
    cut = grab_cut
    if args.model is not None:
        from prepare.onnx_network import MaskNetwork

        cut = MaskNetwork(args.model)
    splats = None
    if args.splats is not None:
        splats = read_gaussians(args.splats)
        start_taichi(args.arch)
    elif not len(capture.points):
        raise BadInput(f"{args.capture}: has no sparse points; train on it first, then give the splat with --splats")
    marks = (
        marked_photographs(capture, sizes, capture.folder / "marks.json")
        if args.marks is None
        else read_marks(args.marks, sizes)
    )
    start, progress = time.perf_counter(), TimeLeft()
    photographs = []
    for k, view in enumerate(capture.views):
        photographs.append(load_photograph(view, args.reduce))
        progress("photographs", (k + 1) / len(capture.views))
    if splats is not None:
        progress("splats beside photographs", 0.0)  # compiles the renderer
        capture, photographs = in_world_of(splats, capture, photographs, args.splats)
    masks = propagate_marks(capture, photographs, marks, splats, progress, cut=cut)
    progress.end()
    write_masks(args.out, capture.views, masks)
    if args.overlay is not None:
        write_sheet(args.overlay, capture.views, masks)
        print(f"{args.overlay}: photographs with their masks")
    for name, overlap in overlap_of(masks, truth).items() if truth else ():
        print(f"{name}: IoU {overlap:.3f}")
    for name in masks.names:
        label = masks.names.index(name) + 1
        seen = sum(bool((ids == label).any()) for ids in masks.ids)
        print(f"{name}: in {seen} of {len(masks.ids)} photographs, {masks.pixels(name):,} pixels")
        if seen < 0.3 * len(masks.ids):
            print(f"{name}: found in few photographs; check with --overlay, mark it in one more", file=sys.stderr)
    print(f"{args.out}: {len(masks.ids)} masks, {time.perf_counter() - start:.0f} s")


def marked_photographs(capture, sizes: dict[str, tuple[int, int]], path: Path):
    """Marks drawn in a window, starting from those in the file `path` if it exists, and saved there.

    Raises BadInput without a display, Cancelled if the user leaves without saving.
    """
    from commands.marking import PhotographSubject, check_window, edit_of, marks_of_state
    from display.mark.mark_window import marked_in_window
    from prepare.segment.marks import Marks, read_marks, write_marks

    check_window()
    check_writable(path)
    before = read_marks(path, sizes) if path.is_file() else Marks()
    subject, edit = PhotographSubject(capture.views), edit_of(before, {})
    marks = marks_of_state(marked_in_window(subject, edit, f"Mark {capture.folder.name}", WINDOW_SIZE))
    write_marks(path, marks)
    print(f"{path}: marks saved", file=sys.stderr)
    return marks


def write_sheet(path: Path, views: list, masks) -> None:
    """Write the masks over their photographs: a picture (.png), or a page (.html). Raises BadInput."""
    import cv2

    from core.report import Section, html_page
    from prepare.segment.mask_files import contact_sheet, overlays

    tiles = overlays(views, masks)
    if path.suffix.lower() == ".html":
        section = Section("Photographs", "Each object in its colour.", tiles)
        data = html_page("Masks", f"{', '.join(masks.names)} in {len(views)} photographs.", [section]).encode()
    else:
        data = cv2.imencode(".png", contact_sheet(list(tiles.values()))[..., ::-1].copy())[1].tobytes()
    with atomic_write(path) as beside:
        beside.write_bytes(data)


class TimeLeft:
    """Prints the progress of a step and the time left."""

    def __init__(self) -> None:
        self._step, self._begin, self._told = None, 0.0, 0.0

    def __call__(self, step: str, done: float) -> None:
        now, terminal = time.perf_counter(), sys.stderr.isatty()
        if step != self._step:
            self.end()
            self._step, self._begin, self._told = step, now, now
        if now - self._told < LINE_SECONDS * (0.1 if terminal else 1.0):
            return
        self._told, passed = now, now - self._begin
        left = f", {passed * (1 - done) / done:.0f} s left" if done > 0 else ""
        text = f"{step} {done:.0%}{left}"
        print(f"\r{text:<60}" if terminal else text, end="" if terminal else "\n", file=sys.stderr, flush=True)

    def end(self) -> None:
        """Close the line of the last step."""
        if self._step is not None:
            text = f"{self._step}: {time.perf_counter() - self._begin:.1f} s"
            print(f"\r{text:<60}" if sys.stderr.isatty() else text, file=sys.stderr, flush=True)
        self._step = None


def in_world_of(splats, capture, photographs: list, path: Path):
    """Capture and photographs in the world of the splats: the capture's own, or upright as `train` makes it.

    Raises BadInput if the splats show in neither what was photographed.
    """
    from dataclasses import replace

    from commands.render import draw_float

    found = []
    for posed in (capture.upright(), capture):
        cameras = [
            replace(p.camera, world_to_camera=v.world_to_camera) for p, v in zip(photographs, posed.views, strict=True)
        ]
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
