"""`vrgs.py bench train`: quality, speed and memory of a training, and where the time of its steps goes.

Options of the training that no user needs are tried here: a variant is a list like `sparse=1,coarse=0.3` of fields of
TrainOptions, or `fast`, the recipe of `train --fast`. bench/peers/gsplat_training.py prints the same rows for gsplat.
"""

from __future__ import annotations

import ctypes
import sys
from collections.abc import Iterator
from ctypes.util import find_library
from dataclasses import fields, replace
from pathlib import Path
from time import perf_counter

import numpy as np
import taichi as ti

from core.errors import BadInput
from core.runtime import running_arch
from display.timing import peak_memory_mb
from prepare.train.train_options import CAPS, FAST_STEPS, STEPS, TrainOptions, fast

STAGE_STEPS = 100  # that are timed stage by stage, with the device waited for after each


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
    """Train on each capture in each variant; prints a table and yields a row for each time of testing."""
    if not names:
        raise BadInput("bench train: name captures, folders as `train` takes them")
    options = [(text, variant_of(text, steps, cap, seed)) for text in variants]
    rows = []
    for name in names:
        read = read_training_capture(Path(name), reduce, test_every)
        if not read[2]:
            raise BadInput("bench train compares with photographs that are kept for the test: --test-every 8")
        for text, how in options:
            rows += (measured := measure(Path(name).name, text, read, how, at))
            print_rows(rows)
            yield from measured


def variant_of(text: str, steps: int | None = None, cap: int | None = None, seed: int = 0) -> TrainOptions:
    """Options of a variant: `plain`, `fast`, and fields with values, separated by commas. Raises BadInput.

    steps, cap, seed  where the variant does not say; None: as suits the device
    """
    words, kinds = text.split(","), {f.name: type(f.default) for f in fields(TrainOptions)}
    steps = steps or (FAST_STEPS if "fast" in words else STEPS)[running_arch()]
    options = TrainOptions(steps=steps, cap=cap or CAPS[running_arch()], seed=seed)
    for word in words:
        name, given, value = word.partition("=")
        if word == "fast":
            options = fast(options)
        elif given and name in kinds:
            try:
                number = value if kinds[name] is str else kinds[name](float(value))
            except ValueError as e:
                raise BadInput(f"--variants: {word}: not a number") from e
            options = replace(options, **{name: number})
        elif word != "plain":
            raise BadInput(f"--variants: {word!r} is none of plain, fast, or NAME=VALUE of {', '.join(kinds)}")
    return options


def read_training_capture(path: Path, reduce: int, test_every: int) -> tuple:
    """The upright capture, its photographs to learn from, and those kept for the test. Raises BadInput."""
    from prepare.train.capture_files import read_capture
    from prepare.train.photographs import kept_for_test, load_photographs

    capture = read_capture(path).upright()
    photographs = load_photographs(capture.views, reduce)
    return capture, *kept_for_test(photographs, test_every)


def new_trainer(capture, photographs: list, options: TrainOptions):
    """A trainer at its start, from the capture's points as `train` begins."""
    from prepare.train.seeds import first_count, seeds, with_background
    from prepare.train.trainer import Trainer

    count = first_count(capture, options.cap)
    rng = np.random.default_rng(options.seed)
    start = seeds(with_background(capture, photographs, rng), degree=options.degree, count=count, rng=rng)
    return Trainer(photographs, start, capture.extent, options)


def measure(name: str, variant: str, read: tuple, options: TrainOptions, test_at) -> list[dict]:
    """Train; a row (dict) for each step of `test_at` and the last, with the time of training alone.

    The first step compiles the kernels and is timed by itself.
    """
    capture, learned, kept = read
    trainer = new_trainer(capture, learned, options)
    refining = _time_refinement(trainer)
    begin = perf_counter()
    trainer.step()
    ti.sync()
    first, seconds, rows = perf_counter() - begin, 0.0, []
    while trainer.done < options.steps:
        end = min([at for at in test_at if at > trainer.done], default=options.steps)
        begin = perf_counter()
        while trainer.done < min(end, options.steps):
            trainer.step()
            if trainer.done % 1000 == 0:
                ti.sync()
                rate = (trainer.done - 1) / (seconds + perf_counter() - begin)
                text = f"{name}, {variant}: step {trainer.done}/{options.steps}, {rate:.1f} steps/s"
                print(f"{text}, {trainer.population.count} Gaussians", file=sys.stderr, flush=True)
        ti.sync()
        seconds += perf_counter() - begin
        qualities = [trainer.quality(p) for p in kept]
        row = {"bench": "train", "program": "vrgs", "capture": name, "variant": variant, "step": trainer.done}
        row |= {"psnr": np.mean([q.psnr for q in qualities]), "ssim": np.mean([q.ssim for q in qualities])}
        row["psnr_of_each"] = [round(float(q.psnr), 2) for q in qualities]
        row |= {"gaussians": trainer.population.count, "seconds": seconds, "first_step_seconds": first}
        row |= {"steps_per_second": (trainer.done - 1) / seconds, "refining_seconds": refining["seconds"]}
        row |= {"device_mb": device_memory(), "process_mb": peak_memory_mb(), "views": len(learned)}
        row |= {"test_views": len(kept), "sort": options.sort, "arch": str(ti.cfg.arch).removeprefix("Arch.")}
        rows.append(row)
        text = f"{name}, {variant}, {trainer.done} steps: {row['psnr']:.2f} dB, SSIM {row['ssim']:.3f}"
        print(f"{text}, {row['gaussians']} Gaussians, {seconds:.1f} s", file=sys.stderr)
        print(f"  each held-out photograph: {listed(row['psnr_of_each'])} dB", file=sys.stderr, flush=True)
    rows[-1]["stages_ms"] = stages(trainer, min(STAGE_STEPS, options.steps))
    trainer.destroy()
    return rows


def listed(values: list[float]) -> str:
    """PSNR of each photograph in a line: a mean may hide one or two that the others do not determine."""
    return " ".join(f"{value:.1f}" for value in values)


def _time_refinement(trainer) -> dict[str, float]:
    """Sum up the time of births and deaths of a trainer from now on, in what is returned."""
    from prepare.train.densification import EVERY

    act, spent = trainer.strategy.after, {"seconds": 0.0}

    def after(step: int, steps: int, mean_rate: float) -> None:
        if step % EVERY:
            act(step, steps, mean_rate)
            return
        ti.sync()
        begin = perf_counter()
        act(step, steps, mean_rate)
        ti.sync()
        spent["seconds"] += perf_counter() - begin

    trainer.strategy.after = after
    return spent


def stages(trainer, count: int) -> dict[str, float]:
    """Milliseconds of a step by stage, means over `count` more steps without births, deaths and noise."""
    spent: dict[str, float] = {}
    from bench.training_stages import StagedStep

    step = StagedStep(trainer)
    for k in range(count + 1):  # the first one compiles
        times = step.run(k % len(trainer.views))
        for name, seconds in times.items() if k else ():
            spent[name] = spent.get(name, 0.0) + 1e3 * seconds / count
    ti.sync()
    return spent


def print_rows(rows: list[dict]) -> None:
    """A table of the rows, and the stages of those that have them."""
    width = max(len(row.get("variant", row["program"])) for row in rows)
    head = (
        f"{'capture':10} {'':{width}} {'step':>6} {'PSNR dB':>8} {'SSIM':>6} {'Gaussians':>10} {'s':>7} {'steps/s':>8}"
    )
    print(f"{head} {'MiB':>7}")
    for row in rows:
        memory = "-" if row["device_mb"] is None else f"{row['device_mb']:.0f}"
        figures = f"{row['psnr']:8.2f} {row['ssim']:6.3f} {row['gaussians']:10,} {row['seconds']:7.1f}"
        name = f"{row['capture']:10} {row.get('variant', row['program']):{width}}"
        print(f"{name} {row['step']:6} {figures} {row['steps_per_second']:8.1f} {memory:>7}")
    for row in rows:
        if "stages_ms" in row:
            parts = ", ".join(f"{name} {ms:.3f}" for name, ms in row["stages_ms"].items())
            refining = 1e3 * row["refining_seconds"] / row["step"]
            total = sum(row["stages_ms"].values()) + refining
            about = f"{row['capture']}, {row.get('variant', row['program'])}, after {row['step']} steps"
            print(f"{about}: a step {total:.3f} ms = {parts}, births and deaths {refining:.3f} (mean of all)")
    sys.stdout.flush()


class _Memory(ctypes.Structure):
    _fields_ = (("total", ctypes.c_ulonglong), ("free", ctypes.c_ulonglong), ("used", ctypes.c_ulonglong))


def device_memory() -> float | None:
    """Memory in use on the first GPU by all processes [MiB], or None without NVIDIA's management library."""
    try:
        nvml = ctypes.CDLL(find_library("nvidia-ml") or "libnvidia-ml.so.1")
    except OSError:
        return None
    device, memory = ctypes.c_void_p(), _Memory()
    if nvml.nvmlInit_v2() or nvml.nvmlDeviceGetHandleByIndex_v2(0, ctypes.byref(device)):
        return None
    failed = nvml.nvmlDeviceGetMemoryInfo(device, ctypes.byref(memory))
    return None if failed else memory.used / 2**20
