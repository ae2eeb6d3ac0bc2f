"""`vrgs.py bench train --orders`: Gaussians trained for one order of blending and played in another.

Training knows one order for the whole picture; `pixel` can be played, not trained for.
"""

from __future__ import annotations

import sys

import numpy as np

from assets.gaussians import Gaussians
from bench.popping import COMPARED_SIZE, SHARPER
from bench.popping import measure as measure_popping
from bench.training_speed import new_trainer
from core.camera import Camera
from prepare.train.train_options import TRAINED_SORTS, TrainOptions
from render import SORTS


def measure_orders(name: str, read: tuple, options: TrainOptions, *, size: tuple[int, int] = COMPARED_SIZE):
    """A row (dict) for each order of training and of play: quality of unseen photographs, and popping, see there."""
    from dataclasses import replace

    capture, learned, kept = read
    rows = []
    for trained in TRAINED_SORTS:
        trainer = new_trainer(capture, learned, replace(options, sort=trained))
        while trainer.done < options.steps:
            trainer.step()
            if trainer.done % 1000 == 0:
                print(
                    f"{name}, trained for {trained}: step {trainer.done}/{options.steps}", file=sys.stderr, flush=True
                )
        gaussians = trainer.gaussians()
        trainer.destroy()
        moved = measure_popping(gaussians, wide(kept[len(kept) // 2].camera, size), size=size)
        of = {row["sort"]: row for row in moved}
        for played in SORTS:
            row = {"bench": "train_orders", "capture": name, "trained": trained, "played": played}
            row |= {"steps": options.steps, "gaussians": len(gaussians), "psnr": played_psnr(gaussians, kept, played)}
            rows.append(row | {key: of[played][key] for key in ("popping", "change", "error", "ms")})
    return rows


def wide(camera: Camera, size: tuple[int, int]) -> Camera:
    """A camera of the fine pictures of bench popping, which shows the middle of what `camera` does."""
    width, height = SHARPER * size[0], SHARPER * size[1]
    zoom = max(width / camera.width, height / camera.height)
    return Camera(width, height, camera.fx * zoom, camera.fy * zoom, 0.5 * width, 0.5 * height, camera.world_to_camera)


def played_psnr(gaussians: Gaussians, photographs: list, sort: str) -> float:
    """Mean PSNR [dB] of photographs, over the pixels that count, drawn in an order."""
    from render.renderer import Renderer
    from render.splats import Splats

    splats, found, renderer = Splats(gaussians), [], None
    for pixels, mask, camera, _ in photographs:
        if renderer is None or (renderer.width, renderer.height) != (camera.width, camera.height):
            if renderer is not None:
                renderer.destroy()
            renderer = Renderer(splats, camera.width, camera.height, outputs="float", sort=sort)
        renderer.render([camera])
        drawn = renderer.rgb.to_numpy()[0].clip(0.0, 1.0)
        found.append(-10.0 * np.log10(max(1e-12, np.mean((drawn - pixels / 255.0)[mask] ** 2))))
    renderer.destroy()
    splats.destroy()
    return float(np.mean(found))


def print_orders(rows: list[dict]) -> None:
    """A table of the rows."""
    print(f"{'capture':10} {'trained':8} {'played':8} {'PSNR dB':>8} {'popping':>9} {'change':>9} {'ms':>8}")
    for row in rows:
        numbers = "{psnr:8.2f} {popping:9.5f} {change:9.5f} {ms:8.2f}".format(**row)
        print(f"{row['capture']:10} {row['trained']:8} {row['played']:8} {numbers}")
    sys.stdout.flush()
