"""`vrgs.py bench train`: quality, speed and memory of a training, and where the time of its steps goes."""

from __future__ import annotations

import sys
from pathlib import Path

STAGE_STEPS = 100  # that are timed stage by stage, with the device waited for after each


def read_training_capture(path: Path, reduce: int, test_every: int) -> tuple:
    """The upright capture, its photographs to learn from, and those kept for the test. Raises BadInput."""
    from prepare.train.capture import read_capture
    from prepare.train.photographs import kept_for_test, load_photographs

    capture = read_capture(path).upright()
    photographs = load_photographs(capture.views, reduce)
    return capture, *kept_for_test(photographs, test_every)


def print_rows(rows: list[dict]) -> None:
    """A table of the rows, and the stages of those that have them."""
    head = f"{'capture':10} {'step':>6} {'PSNR dB':>8} {'SSIM':>6} {'Gaussians':>10} {'s':>7} {'steps/s':>8} {'MiB':>7}"
    print(head)
    for row in rows:
        memory = "-" if row["device_mb"] is None else f"{row['device_mb']:.0f}"
        figures = f"{row['psnr']:8.2f} {row['ssim']:6.3f} {row['gaussians']:10,} {row['seconds']:7.1f}"
        print(f"{row['capture']:10} {row['step']:6} {figures} {row['steps_per_second']:8.1f} {memory:>7}")
    for row in rows:
        if "stages_ms" in row:
            total = sum(row["stages_ms"].values())
            parts = ", ".join(f"{name} {ms:.3f}" for name, ms in row["stages_ms"].items())
            print(f"{row['capture']}: a step after {row['step']}: {total:.3f} ms = {parts}")
    sys.stdout.flush()
