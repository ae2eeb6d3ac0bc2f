"""The report of a training: numbers as JSON, and a page with pictures."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from assets.file_access import atomic_write

TEST_PICTURES = 4  # of the page


def write_report(path: Path, numbers: dict, trainer, test: list, qualities: list, objects=None) -> None:
    """Write the numbers, and a page with held-out photographs beside their renderings.

    objects  (colours of the masks (K, 3) uint8, ids of the Gaussians): also shows masks beside the Gaussians' objects
    """
    from core.report import Section, Table, html_page

    said = _perceptual(numbers, trainer, test)
    with atomic_write(path) as beside:
        beside.write_text(json.dumps(numbers, indent=1) + "\n", encoding="utf-8")
    sections = []
    for k in np.linspace(0, len(test) - 1, min(TEST_PICTURES, len(test))).round().astype(int):
        q, drawn = qualities[k], trainer.picture(test[k].camera)
        pictures = {"photograph": test[k].pixels, "drawn": drawn}
        if objects is not None and test[k].objects is not None:
            colors = np.concatenate([np.zeros((1, 3), np.uint8), objects[0]])
            pictures["mask"] = np.where(test[k].mask[..., None], colors[test[k].objects], 0).astype(np.uint8)
            pictures["objects of the Gaussians"] = colors[trainer.seen_objects(test[k].camera, objects[1])]
        sections.append(Section(f"Unseen view {k + 1}", f"PSNR {q.psnr:.2f} dB, SSIM {q.ssim:.3f}", pictures))
    rows = [(str(c["step"]), f"{c['loss']:.4f}", f"{c['psnr']:.2f}", str(c["gaussians"])) for c in numbers["curve"]]
    rows = rows[:: max(1, len(rows) // 40)]
    table = Table(("step", "loss", "PSNR [dB]", "Gaussians"), rows)
    sections.append(Section("Training", "Means over the photographs since the row before.", table=table))
    if "objects" in numbers:
        rows = [
            (name, str(n["gaussians"]), f"{n['iou']:.3f}" if "iou" in n else "-")
            for name, n in numbers["objects"].items()
        ]
        table = Table(("object", "Gaussians", "IoU"), rows)
        text = "Intersection over union of masks and what the Gaussians show, over all held-out photographs."
        sections.append(Section("Objects", text, table=table))
    text = f"{numbers['gaussians']} Gaussians from {numbers['views']} photographs. {said}"
    page = html_page("Training", text, sections)
    with atomic_write(path.with_suffix(".html")) as beside:
        beside.write_text(page, encoding="utf-8")


def _perceptual(numbers: dict, trainer, test: list) -> str:
    """Add the mean LPIPS of the held-out photographs to the numbers; returns a sentence about it."""
    from prepare.train.image_loss import SIDE_MIN, lpips_distance

    if not test:
        return ""
    if min(min(p.mask.shape) for p in test) < SIDE_MIN:
        return f"No LPIPS of photographs with sides below {SIDE_MIN} pixels."
    distance, why_not = lpips_distance()
    if distance is None:
        return f"{why_not}."
    found = []
    for photograph in test:
        drawn = np.where(photograph.mask[..., None], trainer.picture(photograph.camera), photograph.pixels)
        found.append(distance(drawn, photograph.pixels))
    numbers["test"]["lpips"] = float(np.mean(found))
    return f"LPIPS of held-out photographs: {numbers['test']['lpips']:.3f}."
