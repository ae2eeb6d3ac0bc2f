"""`vrgs.py inpaint`: take objects out of a splat, and close the holes that they leave."""

from __future__ import annotations

import argparse
import json
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from assets.file_access import atomic_write, check_writable
from commands.conditions import Condition
from commands.options import SPLATS, add_arch, positive
from core.errors import BadInput
from core.runtime import start_taichi

HELP = "remove an object from a splat, and fill the hole that it leaves"
EXAMPLES = (
    "inpaint room.ply --remove bear --capture room/ --out empty.ply",
    "inpaint room.ply --remove 1 2 --out empty.ply             without photographs",
    "inpaint background.ply --objects bear.ply --out empty.ply --report empty.json",
    "inpaint room.ply --remove bear --capture room/ --lama lama.onnx --out empty.ply",
)
CONDITIONS = (
    Condition(("--truth",), lambda args: args.capture and args.report, "belongs to --capture and --report"),
    Condition(("--reduce",), lambda args: args.capture and args.truth, "belongs to --truth"),
)
FIGURES = 4  # views in the report


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    text = f"{SPLATS} or .h5; for --remove a .ply or .h5 that knows its objects"
    parser.add_argument("scene", type=Path, metavar="SCENE", help=text)
    which = parser.add_mutually_exclusive_group(required=True)
    text = "names or ids of the objects to remove from SCENE"
    which.add_argument("--remove", nargs="+", metavar="OBJECT", help=text)
    text = "splats of objects that SCENE no longer contains, as `train --split` writes them"
    which.add_argument("--objects", nargs="+", type=Path, metavar="FILE", help=text)
    parser.add_argument("--out", type=Path, required=True, metavar="OUT", help="OUT.ply, .spz, .splat, .compressed.ply")
    text = (
        "the capture that SCENE was trained on: what no photograph shows is filled; default: what is empty under OBJECT"
    )
    parser.add_argument("--capture", type=Path, metavar="CAPTURE", help=text)
    text = (
        "LaMa network with inputs image (1, 3, 512, 512) and mask (1, 1, 512, 512) in 0..1 (default: patch synthesis)"
    )
    parser.add_argument("--lama", type=Path, metavar="FILE.onnx", help=text)
    text = "leave the object's shadow; default: its surroundings get back the light that it took"
    parser.add_argument("--keep-shadow", action="store_true", help=text)
    parser.add_argument(
        "--steps", type=positive(int), metavar="N", help="training steps of the new Gaussians (default 200)"
    )
    text = "write the results as JSON, and a page and a picture (before, after) beside it"
    parser.add_argument("--report", type=Path, metavar="R.json", help=text)
    text = "photographs without the object, named as in the capture, for the PSNR in the report"
    parser.add_argument("--truth", type=Path, metavar="FOLDER", help=text)
    parser.add_argument(
        "--reduce", type=positive(int), default=1, metavar="N", help="divide width and height of the truth by N"
    )
    add_arch(parser)


def run(args: argparse.Namespace) -> None:
    """Remove, inpaint and write. Raises BadInput."""
    from assets.gaussians import concatenate
    from assets.splat_files import kind_to_write, read_gaussians, write_gaussians
    from prepare.inpaint.inpaint_pipeline import (
        STAGES,
        STEPS,
        close_hole,
        find_hole,
        order_of,
        paint_hole,
        take_shadow,
        without_support,
    )
    from prepare.inpaint.picture_inpainting import paint_from_patches
    from prepare.onnx_network import LamaNetwork
    from prepare.progress import progress_on

    kind_to_write(args.out)
    for file in filter(None, (args.out, args.report)):
        check_writable(file)
    painter = LamaNetwork(args.lama) if args.lama else paint_from_patches
    cameras, truths = _cameras(args)
    background, objects = _parts(args, read_gaussians)
    start_taichi(args.arch)
    begin, reports = time.perf_counter(), []
    options = {"antialias": False, "sort": order_of(background)}
    for k, (name, removed) in enumerate(objects.items()):
        others = [g for other, g in objects.items() if other != name]
        standing = list(objects.values())[k + 1 :]  # the shadows of those before went with them
        progress = progress_on(sys.stderr, STAGES)
        told = options | {"progress": progress}
        try:
            more = concatenate(others) if others else None
            background, removed = without_support(background, removed, cameras, others=more, progress=progress)
            hole = find_hole(background, removed, cameras, name=name, others=more, **told)
            if not args.keep_shadow:
                hole = take_shadow(hole, concatenate(standing) if standing else None, **told)
            textures = paint_hole(hole, painter, progress)
            after = close_hole(hole, textures, steps=args.steps or STEPS, **told)
        finally:
            progress.close()
        patch = len(after) - len(hole.background)
        line = f"{name}: {len(removed)} Gaussians removed"
        line += f", {patch} added over {hole.area:.3g} m^2 that no camera saw" if patch else "; no hole was left"
        print(line)
        if args.report:
            reports.append(_measured(name, removed, hole, textures, background, after, truths, options))
        background = after
    write_gaussians(args.out, background)
    seconds = time.perf_counter() - begin
    print(f"{args.out}: {len(background)} Gaussians, {seconds:.0f} s")
    if args.report:
        _report(args.report, reports, {"gaussians": len(background), "seconds": seconds, "scene": str(args.scene)})


def _cameras(args: argparse.Namespace) -> tuple[list | None, list]:
    """Cameras of the capture, None without one, and the photographs of the truth, none without it. Raises BadInput."""
    from prepare.train.capture_files import read_capture
    from prepare.train.photographs import load_photograph

    if args.capture is None:
        return None, []
    capture = read_capture(args.capture).upright()  # as `train` turns it
    truths = []
    if args.truth:
        if not args.truth.is_dir():
            raise BadInput(f"{args.truth}: no such folder")
        for view in capture.views:
            image = next((p for p in sorted(args.truth.glob(f"{view.image.stem}.*")) if p.is_file()), None)
            if image is None:
                raise BadInput(f"{args.truth}: holds no picture {view.image.stem}")
            truths.append(load_photograph(replace(view, image=image, mask=None), args.reduce))
    return [t.camera for t in truths] or [v.camera() for v in capture.views], truths


def _parts(args: argparse.Namespace, read) -> tuple:
    """The background, and the objects by name. Raises BadInput."""
    scene = read(args.scene)
    if args.objects:
        names = [path.stem for path in args.objects]
        if len(set(names)) < len(names):
            raise BadInput(f"--objects: two files are named {max(names, key=names.count)}")
        return scene, {name: read(path) for name, path in zip(names, args.objects, strict=True)}
    ids = {name: object_number(scene, name, args.scene) for name in args.remove}
    return scene.select(~np.isin(scene.object_id, list(ids.values()))), {
        name: scene.select(scene.object_id == number) for name, number in ids.items()
    }


def object_number(scene, name: str, path: Path) -> int:
    """The id of an object by its name or number. Raises BadInput."""
    there = sorted(set(scene.object_id.tolist()) - {0})
    names = {k: scene.objects[k - 1] if k <= len(scene.objects) else str(k) for k in there}
    for k, known in names.items():
        if name in (known, str(k)):
            return k
    if not there:
        raise BadInput(f"{path}: holds no objects; use train --masks or segment first, or give --objects")
    raise BadInput(f"{path}: holds no object {name}, only {', '.join(names.values())}")


def _measured(name, removed, hole, textures, before, after, truths, options) -> dict:
    """Numbers of an object's hole, and under "pictures" a picture for the report."""
    from prepare.inpaint.hole_patch import compare, uncovered_psnr

    views = compare(hole.views, textures, before, after, truths, **options)
    views = [v for v in views if v.covered.any()]
    numbers = {"object": name, "removed": len(removed), "new": len(after) - len(hole.background)}
    numbers |= {"unseen": hole.dropped, "area": hole.area, "views": len(views)}
    numbers["surfaces"] = [{"normal": t.surface.axes[2].tolist(), "area": t.area} for t in textures]
    if truths:
        numbers["psnr"] = uncovered_psnr(views)
    best = sorted(views, key=lambda v: -int(v.hole.sum() or v.covered.sum()))
    rows = []
    for v in best[:: max(1, len(best) // FIGURES)][:FIGURES]:
        columns = [v.before, v.after] if v.truth is None else [v.truth, v.before, v.after]
        rows.append((np.concatenate(columns, axis=1) * 255).round().astype(np.uint8))
    numbers["pictures"] = rows
    return numbers


def _report(path: Path, objects: list[dict], whole: dict) -> None:
    """Write the numbers, a page and a picture."""
    import cv2

    from core.report import Section, Table, html_page

    sections, sheet = [], []
    for numbers in objects:
        pictures = numbers.pop("pictures")
        columns = "truth, before, after" if "psnr" in numbers else "before, after"
        shown = {f"view {k + 1}: {columns}": p for k, p in enumerate(pictures)}
        rows = [("area of the hole [m^2]", f"{numbers['area']:.4g}"), ("new Gaussians", str(numbers["new"]))]
        for where, psnr in numbers.get("psnr", {}).items():
            rows += [(f"PSNR, pixels of the {where}, {when} [dB]", f"{value:.2f}") for when, value in psnr.items()]
        sections.append(Section(numbers["object"], columns, shown, Table(("", ""), rows)))
        sheet += pictures
    text = f"{whole['gaussians']} Gaussians, {whole['seconds']:.0f} s"
    if sheet:
        width = max(p.shape[1] for p in sheet)
        sheet = [np.pad(p, ((0, 4), (0, width - p.shape[1]), (0, 0)), constant_values=255) for p in sheet]
        data = cv2.imencode(".png", np.concatenate(sheet)[..., ::-1])[1].tobytes()
        with atomic_write(path.with_suffix(".png")) as beside:
            beside.write_bytes(data)
    with atomic_write(path.with_suffix(".html")) as beside:
        beside.write_text(html_page("Inpainting", text, sections), encoding="utf-8")
    with atomic_write(path) as beside:
        beside.write_text(json.dumps(whole | {"objects": objects}, indent=1) + "\n", encoding="utf-8")
