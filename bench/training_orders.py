"""`vrgs.py bench train --orders`: Gaussians trained for one order of blending and played in another."""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import replace
from time import perf_counter

import numpy as np

from assets.gaussians import Gaussians
from bench.popping import COMPARED_SIZE, SHARPER
from bench.popping import measure as measure_popping
from bench.training_speed import new_trainer
from core.camera import Camera
from prepare.train.train_options import TrainOptions
from render import SORTS

LINE_SECONDS = 10.0  # between two progress lines
PSNR_SLACK = 0.1  # [dB] that a steadier order may cost
TIME_SLACK = 1.5  # times the fastest order's picture: more, and a headset's frame is missed


def measure_orders(
    name: str,
    read: tuple,
    options: TrainOptions,
    rows: list[dict],
    *,
    keep: Callable[[list[dict]], None] = lambda rows: None,
    size: tuple[int, int] = COMPARED_SIZE,
) -> None:
    """Add to `rows` a row for each order of training and of play: quality of unseen photographs, and popping.

    What `rows` already has for this capture, so many steps and at most so many Gaussians is not measured again. `keep`
    is given the rows after each order that was trained.
    """
    capture, learned, kept = read
    about = {
        "bench": "train --orders",
        "capture": name,
        "steps": options.steps,
        "cap": options.cap,
        "views": len(learned),
    }
    for trained in SORTS:
        known = {**about, "trained": trained}
        if any(all(row.get(key) == value for key, value in known.items()) for row in rows):
            print(f"{name}, trained for {trained}: known from an earlier run", file=sys.stderr, flush=True)
            continue
        gaussians, seconds = _trained(
            f"{name}, trained for {trained}", capture, learned, replace(options, sort=trained)
        )
        moved = {
            row["sort"]: row for row in measure_popping(gaussians, wide(kept[len(kept) // 2].camera, size), size=size)
        }
        for played in SORTS:
            row = {**known, "played": played, "gaussians": len(gaussians), "seconds": seconds}
            row["psnr"] = played_psnr(gaussians, kept, played)
            rows.append(row | {key: moved[played][key] for key in ("popping", "change", "error", "ms", "arch")})
        keep(rows)


def _trained(what: str, capture, photographs: list, options: TrainOptions) -> tuple[Gaussians, float]:
    """Gaussians after all steps, and the time [s] from the second step on; progress on stderr."""
    import taichi as ti

    trainer = new_trainer(capture, photographs, options)
    trainer.step()  # compiles
    ti.sync()
    begin = told = perf_counter()
    while trainer.done < options.steps:
        trainer.step()
        if trainer.done % 10 == 0 and perf_counter() - told >= LINE_SECONDS:
            ti.sync()
            told = perf_counter()
            rate = (trainer.done - 1) / (told - begin)
            text = (
                f"{what}: step {trainer.done}/{options.steps}, {trainer.population.count} Gaussians, {rate:.1f} steps/s"
            )
            print(f"{text}, {(options.steps - trainer.done) / rate:.0f} s left", file=sys.stderr, flush=True)
    ti.sync()
    seconds = perf_counter() - begin
    gaussians = trainer.gaussians()
    trainer.destroy()
    print(f"{what}: {len(gaussians)} Gaussians in {seconds:.0f} s", file=sys.stderr, flush=True)
    return gaussians, seconds


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


def is_row(row: dict) -> bool:
    """True for a row with all entries of a table."""
    numbers = [row.get(name) for name in ("steps", "gaussians", "seconds", "psnr", "popping", "change", "ms")]
    named = isinstance(row.get("capture"), str) and row.get("trained") in SORTS and row.get("played") in SORTS
    return named and all(type(n) in (int, float) for n in numbers)


def print_orders(rows: list[dict]) -> None:
    """A table of the rows, and the defaults that follow from those of all captures together."""
    head = (
        f"{'capture':10} {'steps':>6} {'trained':8} {'played':8} {'PSNR dB':>8} {'popping':>9} {'change':>9} {'ms':>8}"
    )
    print(f"{head} {'Gaussians':>10} {'train s':>8}")
    for row in rows:
        numbers = "{psnr:8.2f} {popping:9.5f} {change:9.5f} {ms:8.2f} {gaussians:10,} {seconds:8.1f}".format(**row)
        print(f"{row['capture']:10} {row['steps']:6} {row['trained']:8} {row['played']:8} {numbers}")
    if {row["trained"] for row in rows} == set(SORTS):
        print("popping and change in 1/255")
        order, reason = default_order(rows)
        print(f"train for, and play what does not say its order by: {order} ({reason})")
        print(f"files from elsewhere (z): {foreign_costs(rows)}")
    sys.stdout.flush()


def default_order(rows: list[dict]) -> tuple[str, str]:
    """The order that should be trained for and played where nothing is known, and why.

    Of those that are nearly as fast as the fastest, TIME_SLACK, that is the steadiest one that is nearly as good as the
    best, PSNR_SLACK; each trained for and played, means over the captures.
    """
    own = {sort: [row for row in rows if row["trained"] == row["played"] == sort] for sort in SORTS}
    mean = {sort: {key: np.mean([r[key] for r in own[sort]]) for key in ("psnr", "popping", "ms")} for sort in SORTS}
    fastest = min(m["ms"] for m in mean.values())
    fast = [sort for sort in SORTS if mean[sort]["ms"] <= TIME_SLACK * fastest]
    best = max(mean[sort]["psnr"] for sort in fast)
    good = [sort for sort in fast if mean[sort]["psnr"] >= best - PSNR_SLACK]
    chosen = min(good, key=lambda sort: mean[sort]["popping"])
    about = "{psnr:.2f} dB, popping {popping:.5f}, {ms:.2f} ms".format(**mean[chosen])
    within = f"within {TIME_SLACK:g} times the fastest's time and {PSNR_SLACK:g} dB of the best: {', '.join(good)}"
    return chosen, f"{about}; the steadiest of those {within}"


def foreign_costs(rows: list[dict]) -> str:
    """Costs of playing Gaussians that were trained for z in another order, means over the captures."""
    psnr = {sort: np.mean([r["psnr"] for r in rows if r["trained"] == "z" and r["played"] == sort]) for sort in SORTS}
    parts = [f"{sort} {psnr[sort] - psnr['z']:+.2f} dB" for sort in SORTS if sort != "z"]
    best = max(psnr, key=psnr.get)
    return f"played by {best} they are best; beside z: {', '.join(parts)}"
