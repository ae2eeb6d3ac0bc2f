"""`vrgs.py bench demos`: the paper's table of its nine demos, measured here and printed beside the paper's figures.

Each demo is played by its scene's scripted player in steps of 1/90 s, one a frame, in two eyes of 1800x1920, with the
player's hands drawn and their finger contact, but no OpenGL: a frame ends when the device has finished the picture. A
game that is over begins again. Times of the stages are medians of a second play, in which each stage waits for the
device; that takes longer than a frame as it runs.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator

import numpy as np
import taichi as ti

from assets.library import search_first
from bench.frame_time import RATE, StereoPlay
from scenes import registry
from scenes.paper_demos import PaperDemo, paper_demos, use_paper_assets

FIRST_SECOND = round(RATE)  # frames that do not count for the worst: bodies come to rest, buffers grow
FRAMES, QUICK_FRAMES = 1000, 30
STAGE_FRAMES = 300  # of the second play
STAGES = ("hands", "simulate", "embed", "shadow", "render")


def run(*, names: list[str], detail: str, frames: int | None, quick: bool, size: tuple[int, int]) -> Iterator[dict]:
    """Measure each demo; prints and yields its row. Raises BadInput."""
    demos = paper_demos(names)
    make_ready = use_paper_assets if detail == "paper" else lambda demo: search_first(None)
    for demo in demos:
        make_ready(demo)  # whatever is missing is said before any is measured
    frames = frames or (QUICK_FRAMES if quick else FRAMES)
    print(heading(), flush=True)
    for demo in demos:
        make_ready(demo)
        play = StereoPlay(registry.load(demo.scene, **demo.options), size)
        row = measure(demo, play, frames, first=0 if quick else FIRST_SECOND)
        play.close()
        print(line(row), flush=True)
        if not row["finite"]:
            print(f"vrgs: bench demos: not finite: {row['demo']}", file=sys.stderr)
        yield row | {"detail": detail}


def measure(demo: PaperDemo, play: StereoPlay, frames: int, first: int) -> dict:
    """Counts and times [ms] of a demo: `frames` frames after `first` ones, which do not count."""
    play.start(exact=False)
    play.play(first + frames, ti.sync)
    took, photon = np.array(play.frame_ms[first:]), play.photon_ms[first:]
    counts = play.world.stats()
    play.start(exact=True)
    play.play(min(frames, STAGE_FRAMES), ti.sync)
    stages = play.world.timings.as_dict()
    return {
        "bench": "demos",
        "demo": demo.name,
        "gaussians": counts["gaussians"] - play.hand_gaussians,
        **{name: counts[name] for name in ("vertices", "tets", "integrator", "iterations", "substeps")},
        "finite": counts["finite"],
        "size": list(play.size),
        "frames": frames,
        "stages": {name: stages[name]["median_ms"] for name in STAGES if name in stages},
        "median_ms": float(np.median(took)),
        "p99_ms": float(np.percentile(took, 99)),
        "worst_ms": float(took.max()),
        "photon_ms": float(np.median(photon)),
        "fps": float(1e3 / took.mean()),
        "paper": {name: getattr(demo, name) for name in ("gaussians", "vertices", "iterations", "fps")},
        "arch": str(ti.cfg.arch).removeprefix("Arch."),
    }


def heading() -> str:
    """Two lines over the table; in brackets: the paper's."""
    counts = f"{'Gaussians':>19} {'vertices':>15} {'tets':>7} {'iterations':>10} {'substeps':>8}"
    return (
        "in brackets: the paper's, on an RTX 4090; milliseconds, medians\n"
        f"{'demo':17} {counts}" + "".join(f" {s:>8}" for s in STAGES) + f" {'frame':>7} {'worst':>7} {'fps':>12}"
    )


def line(row: dict) -> str:
    """A row of the table."""
    paper = row["paper"]
    counts = (
        f"{row['gaussians'] / 1e6:.3f}M ({paper['gaussians'] / 1e6:.3f}M) "
        f"{row['vertices']:>7,} {'({:,})'.format(paper['vertices']):>8} {row['tets']:>7,} "
        f"{row['iterations']:>5} {'({})'.format(paper['iterations']):>4} {row['substeps']:>8}"
    )
    stages = "".join(f" {row['stages'].get(s, 0.0):>8.2f}" for s in STAGES)
    fps = f"{row['fps']:.1f} ({paper['fps']})"
    return f"{row['demo']:17} {counts:>19}{stages} {row['median_ms']:>7.2f} {row['worst_ms']:>7.2f} {fps:>12}"
