"""The figure of `vrgs.py figures` on inpainting: objects of a modelled capture, before and after, beside the truth.

`python -m studio --capture` makes the capture; a splat is trained with its masks, and each object is
taken out by itself.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np

from core.errors import BadInput
from core.report import Section, Table
from prepare.inpaint import inpaint_pipeline as pipeline
from prepare.inpaint.hole_patch import compare, cut_out, uncovered_psnr
from prepare.segment.object_ids import identified, masks_of
from prepare.train.capture_files import read_capture
from prepare.train.photographs import load_photograph, load_photographs
from prepare.train.seeds import first_gaussians
from prepare.train.train_options import CAPS, TrainOptions
from prepare.train.trainer import Trainer

TITLE = "Inpainting"
WIDTH = 1100  # [px] of a picture on the page, at least
STEPS, QUICK_STEPS = 1500, 400  # of training


def inpainting_section(folder: Path | None, results: dict, report: Callable[[str], None], *, quick: bool) -> Section:
    """The section of the capture in a folder, or without one a note on how to make one; quick: of one object."""
    text = (
        "Toys on a table, photographed by ray casting, so that it is known what stands behind each. A splat is trained "
        "with their masks; an object's Gaussians are taken out; where no photograph shows what was behind them, a "
        "patch of new Gaussians is made up, and all others stay as they are."
    )
    if folder is None:
        results["inpainting"] = None
        note = "Not made: it needs --capture, a capture whose truth is known (python -m studio --capture DIR)."
        return Section(TITLE, text, note=note)
    steps = QUICK_STEPS if quick else STEPS
    rows = _measured(folder, steps, report, objects=1 if quick else None)
    refused = "".join(f" Not closed: {row['refused']}." for row in rows.values() if "refused" in row)
    closed = {name: row for name, row in rows.items() if "refused" not in row}
    pictures = {f"{name}: photograph, taken out, inpainted, truth": row.pop("picture") for name, row in closed.items()}
    results["inpainting"] = {"steps": steps, "objects": rows}
    table = [
        (name, *(f"{row['psnr'][when]:.1f} dB" for when in ("before", "after")), f"{1e4 * row['area']:.0f} cm²")
        for name, row in closed.items()
    ]  # fmt: skip
    return Section(
        TITLE,
        text,
        pictures,
        Table(("object", "PSNR, taken out", "PSNR, inpainted", "seen by no camera"), table),
        f"{steps:,} steps of training. PSNR: against the scene without the object, over the pixels that it covered, in "
        "all views. The object's shadow is taken away with it." + refused,
    )


def _measured(folder: Path, steps: int, report: Callable[[str], None], objects: int | None) -> dict[str, dict]:
    """Numbers and the picture of each object, or of the first few. Raises BadInput."""
    if not (folder / "behind").is_dir():
        raise BadInput(f"{folder}: shows nothing without its objects (make it: python -m studio --capture {folder})")
    capture, photographs, gaussians = _trained(folder, steps, report)
    found = {}
    for number, name in enumerate(gaussians.objects[:objects], 1):
        report(f"without the {name}")
        own = gaussians.object_id == number
        cameras = [p.camera for p in photographs]
        parts = gaussians.select(~own), {name: gaussians.select(own)}
        try:
            before, objects = pipeline.without_supports(*parts, cameras)
            after, (hole,) = pipeline.inpaint(before, objects, cameras)
        except BadInput as e:  # a small capture's splat is rough
            report(str(e))
            found[name] = {"refused": str(e)}
            continue
        behind = [replace(v, image=folder / "behind" / name / v.image.name, mask=None) for v in capture.views]
        truths = [load_photograph(v) for v in behind]
        views = [v for v in compare(hole.views, hole.textures, before, after, truths) if v.covered.any()]
        found[name] = {
            "gaussians": int(own.sum()),
            "new": len(hole.patch),
            "area": hole.area,
            "psnr": uncovered_psnr(views)["object"],
            "picture": _strip(max(views, key=lambda v: int(v.hole.sum() or v.covered.sum())), photographs),
        }
    return found


def _trained(folder: Path, steps: int, report: Callable[[str], None]) -> tuple:
    """The capture, its photographs, and the Gaussians trained to them, with the ids of its objects."""
    capture, masks = masks_of(read_capture(folder).upright(), folder / "masks", report)
    photographs = load_photographs(capture.views, 1, masks.ids)
    options = TrainOptions(steps=steps, cap=CAPS["cpu"], degree=1)
    start = first_gaussians(capture, photographs, degree=options.degree, cap=options.cap, seed=options.seed)
    trainer = Trainer(photographs, start, capture.extent, options, masks.names)
    while trainer.done < steps:
        trainer.step()
        if trainer.done % max(steps // 4, 1) == 0:
            report(f"training, step {trainer.done} of {steps}, PSNR {trainer.recent_loss().psnr:.1f} dB")
    gaussians = identified(trainer)
    trainer.destroy()
    return capture, photographs, gaussians


def _strip(view, photographs) -> np.ndarray:
    """A view's photograph, and the pictures before, after and of the truth, side by side, (H, W, 3) uint8."""
    parts = [cut_out(photographs[view.view.index], view.view), view.before, view.after, view.truth]
    strip = np.concatenate(parts, axis=1)
    times = WIDTH / strip.shape[1]
    strip = cv2.resize(strip, None, fx=times, fy=times, interpolation=cv2.INTER_CUBIC) if times > 1 else strip
    return (strip.clip(0.0, 1.0) * 255).round().astype(np.uint8)
