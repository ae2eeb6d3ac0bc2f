"""`vrgs.py bench`, `check` and `figures`: speed, the physics table, and the paper's figures; bench/ measures."""

from __future__ import annotations

import importlib
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from assets.library import SHIPPED_FOLDER
from commands.options import (
    Arch,
    Condition,
    Count,
    Options,
    Size,
    arch_option,
    argument,
    option,
    switch,
)
from core.errors import BadInput
from core.runtime import start_taichi

SUBJECTS = {
    "sim": ("bench.sim_speed", "the solver, 400 substeps a frame"),
    "scene": ("bench.scene_speed", "the solver, real bodies dropped, thrown, squeezed, piled up"),
    "render": ("bench.render_speed", "a headset's picture, both eyes"),
    "frame": ("bench.frame_time", "a headset's whole frame, ring toss"),
    "demos": ("bench.demos", "the paper's nine demos, beside its figures"),
    "popping": ("bench.popping", "flicker when the head turns, by sort mode"),
    "train": ("bench.training_speed", "training on captures: quality, speed, memory, time by stage"),
}
NAMED = ("demos", "train")  # subjects that take names
TAKERS = {  # subjects that take an option, of those that not all take
    ("demos",): ("--detail",),
    ("popping",): ("--splats",),
    ("sim", "scene"): ("--sizes",),
    ("scene",): ("--asset", "--materials", "--acts", "--bodies"),
    ("scene", "demos"): ("--frames", "--quick"),
    ("train",): ("--steps", "--at", "--reduce", "--test-every", "--cap", "--seed", "--variants"),
    ("render",): ("--gaussians",),
    ("render", "demos"): ("--size",),
    ("sim", "render"): ("--rounds",),
}


@dataclass(kw_only=True)
class BenchOptions(Options):
    """Options of `bench`."""

    EXAMPLES = (
        "bench sim --json sim.json",
        "bench demos ring_toss --quick",
        "bench train fox/ bear/ --variants plain fast --json train.json",
    )
    CONDITIONS = tuple(
        Condition(flags, lambda o, takers=takers: o.subject in takers, f"belongs to bench {' and '.join(takers)}")
        for takers, flags in TAKERS.items()
    )

    subject: Literal["sim", "scene", "render", "frame", "demos", "popping", "train"] = argument(
        None, "; ".join(f"{name}: {what}" for name, (_, what) in SUBJECTS.items())
    )
    names: list[str] = argument("NAME", "demos: which (default: all that are there); train: captures", optional=True)
    detail: Literal["shipped", "paper"] = option(
        None, "demos: assets as shipped, or at the paper's sizes (python -m studio --detail paper)", "shipped"
    )
    splats: Path = option(
        "SPLATS", "popping: splats to draw (default: the dining room)", SHIPPED_FOLDER / "dining_room.h5"
    )
    sizes: list[str] | None = option(
        "N", "numbers of vertices; sim: some of 1.7k 9.3k 24k 46k (default: all); scene: any (default: 10k 20k 46k)"
    )
    asset: list[str] | None = option(
        "FILE",
        "scene: splats, prepared bodies (.h5), or ball, mug, ring, bunny, capsule (default: these five)",
    )
    materials: list[str] = option("NAME", "scene: (default: plush rubber wood)", ["plush", "rubber", "wood"])
    acts: list[Literal["drop", "throw", "squeeze", "stack"]] = option(
        None, "scene: (default: all)", ["drop", "throw", "squeeze", "stack"]
    )
    frames: Count | None = option("N", "scene, demos: a row (default 1000; quick 240, 30)")
    quick: bool = switch("scene: one row, 2 s; demos: few frames")
    bodies: Path | None = option("DIR", "scene: folder of bodies that were made for it (default: in the user's cache)")
    gaussians: list[Literal["0.305M", "1.313M", "2.526M"]] = option(
        None, "render: rooms (default: all)", ["0.305M", "1.313M", "2.526M"]
    )
    size: Size = option("WxH", "render, demos: picture of an eye (default 1800x1920)", (1800, 1920))
    rounds: Count = option("N", "frames measured (default 12)", 12)
    steps: Count | None = option("N", "train: steps (default 30000 on a GPU, 3000 on a CPU)")
    at: list[Count] = option("N", "train: steps after which it is tested as well (default 7000)", [7000])
    reduce: Count = option("N", "train: divide the photographs' sides by N", 1)
    test_every: Count = option("N", "train: keep every Nth photograph for the test (default 8)", 8)
    cap: Count | None = option("N", "train: most Gaussians (default as train's)")
    seed: int = option("S", "train: seed of all random numbers", 0)
    variants: list[str] = option(
        "V", "train: kinds of training, each `plain`, `fast` or like sparse=1,coarse=0.3 (default plain)", ["plain"]
    )
    json: Path | None = option("OUT.json", "write the rows")
    arch: Arch | None = arch_option()


@dataclass(kw_only=True)
class CheckOptions(Options):
    """Options of `check`."""

    EXAMPLES = ("check --quick --json table.json",)

    quick: bool = switch("minutes, not hours: fewer substeps, throws and seconds")
    json: Path | None = option("OUT.json", "write the table")
    arch: Arch | None = arch_option()


@dataclass(kw_only=True)
class FiguresOptions(Options):
    """Options of `figures`."""

    EXAMPLES = ("figures --out figures", "figures --out /tmp/figures --quick")

    out: Path = option(
        "DIR", "folder for figures.html, which holds all pictures, and figures.json, the numbers", required=True
    )
    capture: Path | None = option(
        "DIR",
        "the figure of inpainting: a capture with the truth behind its objects (python -m studio --capture DIR)",
    )
    quick: bool = switch("small pictures, one demo, one toy: two minutes")
    arch: Arch | None = arch_option()


def bench(options: BenchOptions) -> int | None:
    """Measure the subject. Raises BadInput."""
    if options.names and options.subject not in NAMED:
        raise BadInput(f"bench {options.subject} takes no names: {' '.join(options.names)}")
    start_taichi(options.arch)
    return importlib.import_module(SUBJECTS[options.subject][0]).run(options)


def check(options: CheckOptions) -> int:
    """Print the physics table; returns 1 if a row fails."""
    start_taichi(options.arch)
    from bench import check

    return check.run(options)


def figures(options: FiguresOptions) -> None:
    """Make the page of figures. Raises BadInput."""
    if options.out.exists() and not options.out.is_dir():
        raise BadInput(f"{options.out}: is a file, not a folder")
    if options.capture is not None and not options.capture.is_dir():
        raise BadInput(f"{options.capture}: no such folder")
    start_taichi(options.arch)
    from bench.paper_figures import run

    run(options)
