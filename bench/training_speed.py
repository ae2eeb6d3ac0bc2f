"""`vrgs.py bench train`: quality, speed and memory of a training. bench/peers/gsplat_training.py: of gsplat's."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from time import perf_counter

import numpy as np
import taichi as ti

from core.errors import BadInput
from core.runtime import running_arch
from display.timing import peak_memory_mb
from prepare.train.capture_files import read_capture
from prepare.train.photographs import learned_and_tested
from prepare.train.seeds import first_gaussians
from prepare.train.train_options import CAPS, FAST_STEPS, STEPS, TrainOptions, fast
from prepare.train.trainer import Trainer


def run(
    *,
    names: list[str],
    variants: list[str],
    steps: int | None,
    at: list[int],
    cap: int | None,
    seed: int,
    reduce: int,
    test_every: int,
) -> Iterator[dict]:
    """Train on each capture, plainly or fast; prints a table and yields a row for each time of testing."""
    if not names:
        raise BadInput("bench train: name captures, folders as `train` takes them")
    arch, rows = running_arch(), []
    for name in names:
        read = read_training_capture(Path(name), reduce, test_every)
        for variant in variants:
            default_steps = (FAST_STEPS if variant == "fast" else STEPS)[arch]
            options = TrainOptions(steps=steps or default_steps, cap=cap or CAPS[arch], seed=seed)
            measured = measure(Path(name).name, variant, read, fast(options) if variant == "fast" else options, at)
            rows += measured
            print_rows(rows)
            yield from measured


def read_training_capture(path: Path, reduce: int, test_every: int) -> tuple:
    """The upright capture, its photographs to learn from, and those kept for the test. Raises BadInput."""
    capture = read_capture(path).upright()
    learned, kept = learned_and_tested(capture, reduce, test_every)
    if not kept:
        raise BadInput("bench train compares with photographs that are kept for the test: --test-every 8")
    return capture, learned, kept


def measure(name: str, variant: str, read: tuple, options: TrainOptions, test_at: list[int]) -> list[dict]:
    """Train; a row (dict) for each step of `test_at` and the last, with the time of training alone.

    The first step compiles the kernels and is timed by itself.
    """
    capture, learned, kept = read
    start = first_gaussians(capture, learned, degree=options.degree, cap=options.cap, seed=options.seed)
    trainer = Trainer(learned, start, capture.extent, options)
    begin = perf_counter()
    trainer.step()
    ti.sync()
    first, seconds, rows = perf_counter() - begin, 0.0, []
    while trainer.done < options.steps:
        end = min([at for at in (*test_at, options.steps) if trainer.done < at <= options.steps])
        begin = perf_counter()
        while trainer.done < end:
            trainer.step()
            if trainer.done % 1000 == 0:
                ti.sync()
                print(f"{name}, {variant}: step {trainer.done}/{options.steps}", file=sys.stderr, flush=True)
        ti.sync()
        seconds += perf_counter() - begin
        qualities = [trainer.quality(p) for p in kept]
        rows.append(
            {
                "bench": "train",
                "program": "vrgs",
                "capture": name,
                "variant": variant,
                "step": trainer.done,
                "psnr": np.mean([q.psnr for q in qualities]),
                "ssim": np.mean([q.ssim for q in qualities]),
                "psnr_of_each": [round(float(q.psnr), 2) for q in qualities],
                "gaussians": trainer.population.count,
                "seconds": seconds,
                "first_step_seconds": first,
                "steps_per_second": (trainer.done - 1) / seconds,
                "device_mb": device_memory(),
                "process_mb": peak_memory_mb(),
                "views": len(learned),
                "test_views": len(kept),
                "sort": options.sort,
                "arch": str(ti.cfg.arch).removeprefix("Arch."),
            }
        )
        print_test(f"{name}, {variant}", rows[-1])
    trainer.destroy()
    return rows


def print_test(about: str, row: dict) -> None:
    """Lines on a test, with the PSNR of each photograph: a mean may hide those that the others do not determine."""
    text = f"{about}, {row['step']} steps: {row['psnr']:.2f} dB, SSIM {row['ssim']:.3f}"
    print(f"{text}, {row['gaussians']} Gaussians, {row['seconds']:.1f} s", file=sys.stderr)
    each = " ".join(f"{psnr:.1f}" for psnr in row["psnr_of_each"])
    print(f"  each held-out photograph: {each} dB", file=sys.stderr, flush=True)


def print_rows(rows: list[dict]) -> None:
    """A table of the rows."""
    names = [f"{row['capture']:10} {row.get('variant', row['program'])}" for row in rows]
    width = max(map(len, names))
    head = f"{'step':>6} {'PSNR dB':>8} {'SSIM':>6} {'Gaussians':>10} {'s':>7} {'steps/s':>8} {'MiB':>7}"
    print(f"{'capture':{width}} {head}")
    for name, row in zip(names, rows, strict=True):
        memory = "-" if row["device_mb"] is None else f"{row['device_mb']:.0f}"
        figures = f"{row['psnr']:8.2f} {row['ssim']:6.3f} {row['gaussians']:10,} {row['seconds']:7.1f}"
        print(f"{name:{width}} {row['step']:6} {figures} {row['steps_per_second']:8.1f} {memory:>7}", flush=True)


def device_memory() -> float | None:
    """Memory in use on the first GPU by all processes [MiB], or None without NVIDIA's tool."""
    words = ["nvidia-smi", "--id=0", "--query-gpu=memory.used", "--format=csv,noheader,nounits"]
    try:
        return float(subprocess.run(words, capture_output=True, text=True, check=True).stdout)
    except (OSError, subprocess.CalledProcessError, ValueError):
        return None
