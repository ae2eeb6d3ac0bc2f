"""`vrgs.py inpaint`: take objects out of a splat, and close the holes that they leave."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from assets.file_access import atomic_write, check_writable, write_json
from assets.gaussians import Gaussians
from assets.splat_files import kind_to_write, read_gaussians, write_gaussians
from commands import options as cli
from core.errors import BadInput
from core.report import Section, Table, html_page
from core.runtime import start_taichi
from display.picture import save_picture
from prepare.progress import StepProgress
from prepare.train.capture_files import read_capture
from prepare.train.photographs import load_photograph

FIGURES = 4  # views in the report
WHICH = cli.OneOf(required=True)


@dataclass(kw_only=True)
class InpaintOptions(cli.Options):
    EXAMPLES = (
        "inpaint room.ply --remove bear --capture room/ --out empty.ply",
        "inpaint room.ply --remove 1 2 --out empty.ply             without photographs",
        "inpaint background.ply --objects bear.ply --out empty.ply --report empty.json",
        "inpaint room.ply --remove bear --capture room/ --lama lama.onnx --out empty.ply",
    )
    CONDITIONS = (
        cli.Condition(("--truth",), lambda o: o.capture and o.report, "belongs to --capture and --report"),
        cli.Condition(("--reduce",), lambda o: o.capture and o.truth, "belongs to --truth"),
    )

    scene: Path = cli.argument("SCENE", f"{cli.SPLATS} or .h5; for --remove a .ply or .h5 that knows its objects")
    remove: list[str] | None = cli.option("OBJECT", "names or ids of the objects to remove from SCENE", one_of=WHICH)
    objects: list[Path] | None = cli.option(
        "FILE", "splats of objects that SCENE no longer contains, as `train --split` writes them", one_of=WHICH
    )
    out: Path = cli.option("OUT", "OUT.ply, .spz, .splat, .compressed.ply", cli.REQUIRED)
    capture: Path | None = cli.option(
        "CAPTURE", "what SCENE was trained on: fill what no photograph shows (default: what is empty under OBJECT)"
    )
    lama: Path | None = cli.option(
        "FILE.onnx", "LaMa network, image (1, 3, 512, 512) and mask (1, 1, 512, 512) in 0..1 (default: patch synthesis)"
    )
    keep_shadow: bool = cli.switch("keep the object's shadow (default: the surroundings are relit)")
    steps: cli.Count | None = cli.option("N", "training steps of the new Gaussians (default 200)")
    report: Path | None = cli.option("R.json", "write the results as JSON, as a page, and as a picture (before, after)")
    truth: Path | None = cli.option("FOLDER", "--report: photographs without the object, named as in the capture")
    reduce: cli.Count = cli.reduce_option("the photographs of --truth")
    arch: cli.Arch | None = cli.arch_option()


def inpaint(options: InpaintOptions) -> None:
    """Remove, inpaint and write. Raises BadInput."""
    from prepare.inpaint import inpaint_pipeline as pipeline
    from prepare.onnx_network import LamaNetwork

    kind_to_write(options.out)
    for file in filter(None, (options.out, options.report)):
        check_writable(file)
    painter = LamaNetwork(options.lama) if options.lama else None
    cameras, truths = _cameras(options)
    background, objects = _parts(options)
    start_taichi(options.arch)
    begin, progress = time.perf_counter(), StepProgress(pipeline.STAGES)
    try:
        background, objects = pipeline.without_supports(background, objects, cameras, lambda *_: progress)
        after, holes = pipeline.inpaint(
            background,
            objects,
            cameras,
            shadows=not options.keep_shadow,
            painter=painter,
            steps=options.steps or pipeline.STEPS,
            progress=lambda *_: progress,
        )
    finally:
        progress.close()
    for hole in holes:
        line, patch = f"{hole.name}: {len(hole.removed)} Gaussians removed", len(hole.patch)
        line += f", {patch} added over {hole.area:.3g} m^2 that no camera saw" if patch else "; no hole was left"
        print(line)
    reports = [_measured(hole, background, after, truths) for hole in holes if options.report]
    write_gaussians(options.out, after)
    seconds = time.perf_counter() - begin
    print(f"{options.out}: {len(after)} Gaussians, {seconds:.0f} s")
    if options.report:
        whole = {"gaussians": len(after), "seconds": seconds, "scene": str(options.scene)}
        _report(options.report, reports, whole)


def _cameras(options: InpaintOptions) -> tuple[list | None, list]:
    """Cameras of the capture, None without one, and the photographs of the truth, none without it. Raises BadInput."""
    if options.capture is None:
        return None, []
    capture = read_capture(options.capture).upright()  # as `train` turns it
    truths = []
    if options.truth:
        if not options.truth.is_dir():
            raise BadInput(f"{options.truth}: no such folder")
        for view in capture.views:
            image = next((p for p in sorted(options.truth.glob(f"{view.image.stem}.*")) if p.is_file()), None)
            if image is None:
                raise BadInput(f"{options.truth}: holds no picture {view.image.stem}")
            truths.append(load_photograph(replace(view, image=image, mask=None), options.reduce))
    return [t.camera for t in truths] or capture.cameras(), truths


def _parts(options: InpaintOptions) -> tuple[Gaussians, dict[str, Gaussians]]:
    """The background, and the objects by name. Raises BadInput."""
    scene = read_gaussians(options.scene)
    if options.objects:
        names = [path.stem for path in options.objects]
        if len(set(names)) < len(names):
            raise BadInput(f"--objects: two files are named {max(names, key=names.count)}")
        return scene, {name: read_gaussians(path) for name, path in zip(names, options.objects, strict=True)}
    there = np.unique(scene.object_id[scene.object_id > 0]).tolist()
    names = {k: scene.objects[k - 1] if k <= len(scene.objects) else str(k) for k in there}
    if not there:
        raise BadInput(f"{options.scene}: holds no objects; use train --masks or segment first, or give --objects")
    ids = {name: next((k for k in there if name in (names[k], str(k))), None) for name in options.remove}
    for name, number in ids.items():
        if number is None:
            raise BadInput(f"{options.scene}: holds no object {name}, only {', '.join(names.values())}")
    rest = scene.select(~np.isin(scene.object_id, list(ids.values())))
    return rest, {name: scene.select(scene.object_id == number) for name, number in ids.items()}


def _measured(hole, before, after, truths) -> dict:
    """Numbers of an object's hole, and under "pictures" a picture for the report."""
    from prepare.inpaint.hole_patch import compare, uncovered_psnr

    views = compare(hole.views, hole.textures, before, after, truths)
    views = [v for v in views if v.covered.any()]
    numbers = {"object": hole.name, "removed": len(hole.removed), "new": len(hole.patch)}
    numbers |= {"unseen": hole.dropped, "area": hole.area, "views": len(views)}
    numbers["surfaces"] = [{"normal": t.surface.axes[2].tolist(), "area": t.area} for t in hole.textures]
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
        save_picture(path.with_suffix(".png"), np.concatenate(sheet))
    with atomic_write(path.with_suffix(".html")) as beside:
        beside.write_text(html_page("Inpainting", text, sections), encoding="utf-8")
    write_json(path, whole | {"objects": objects})
