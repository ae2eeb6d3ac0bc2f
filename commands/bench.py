"""`vrgs.py bench`: measure speed."""

from __future__ import annotations

import argparse
import importlib
from pathlib import Path

from assets.library import SHIPPED_FOLDER
from commands.conditions import Condition
from commands.options import add_arch, positive, size
from core.errors import BadInput
from core.runtime import start_taichi

HELP = "measure speed and quality"
EXAMPLES = (
    "bench sim --json sim.json",
    "bench demos ring_toss --quick",
    "bench train fox/ bear/ --variants plain fast --json train.json",
)
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
OPTION_SUBJECTS = {  # of those that not all take
    "--detail": ("demos",),
    "--splats": ("popping",),
    "--sizes": ("sim", "scene"),
    "--asset": ("scene",),
    "--materials": ("scene",),
    "--acts": ("scene",),
    "--bodies": ("scene",),
    "--frames": ("scene", "demos"),
    "--steps": ("train",),
    "--at": ("train",),
    "--reduce": ("train",),
    "--test-every": ("train",),
    "--cap": ("train",),
    "--seed": ("train",),
    "--variants": ("train",),
    "--quick": ("scene", "demos"),
    "--gaussians": ("render",),
    "--size": ("render", "demos"),
    "--rounds": ("sim", "render"),
}
CONDITIONS = (
    *(
        Condition(
            (flag,), lambda args, takers=takers: args.subject in takers, f"belongs to bench {' and '.join(takers)}"
        )
        for flag, takers in OPTION_SUBJECTS.items()
    ),
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    text = "; ".join(f"{name}: {what}" for name, (_, what) in SUBJECTS.items())
    parser.add_argument("subject", choices=tuple(SUBJECTS), help=text)
    text = "demos: which (default: all that are there); train: captures"
    parser.add_argument("names", nargs="*", metavar="NAME", help=text)
    text = "demos: assets as shipped, or at the paper's sizes (python -m studio --detail paper)"
    parser.add_argument("--detail", choices=("shipped", "paper"), default="shipped", help=text)
    text = "popping: splats to draw (default: the dining room)"
    parser.add_argument("--splats", type=Path, default=SHIPPED_FOLDER / "dining_room.h5", metavar="SPLATS", help=text)
    text = "numbers of vertices; sim: some of 1.7k 9.3k 24k 46k (default: all); scene: any (default: 10k 20k 46k)"
    parser.add_argument("--sizes", nargs="+", metavar="N", help=text)
    text = "scene: splats, prepared bodies (.h5), or ball, mug, ring, bunny, capsule (default: these five)"
    parser.add_argument("--asset", nargs="+", metavar="FILE", help=text)
    text = "scene: (default: plush rubber wood)"
    parser.add_argument("--materials", nargs="+", default=["plush", "rubber", "wood"], metavar="NAME", help=text)
    acts = ("drop", "throw", "squeeze", "stack")
    parser.add_argument("--acts", nargs="+", choices=acts, default=list(acts), help="scene: (default: all)")
    parser.add_argument(
        "--frames", type=positive(int), metavar="N", help="scene, demos: a row (default 1000; quick 240, 30)"
    )
    parser.add_argument("--quick", action="store_true", help="scene: one row, 2 s; demos: few frames")
    text = "scene: folder of bodies that were made for it (default: in the user's cache)"
    parser.add_argument("--bodies", type=Path, metavar="DIR", help=text)
    rooms = ("0.305M", "1.313M", "2.526M")
    text = "render: rooms (default: all)"
    parser.add_argument("--gaussians", nargs="+", choices=rooms, default=list(rooms), help=text)
    text = "render, demos: picture of an eye (default 1800x1920)"
    parser.add_argument("--size", type=size, default=(1800, 1920), metavar="WxH", help=text)
    parser.add_argument("--rounds", type=positive(int), default=12, metavar="N", help="frames measured (default 12)")
    text = "train: steps (default 30000 on a GPU, 3000 on a CPU)"
    parser.add_argument("--steps", type=positive(int), metavar="N", help=text)
    text = "train: steps after which it is tested as well (default 7000)"
    parser.add_argument("--at", type=positive(int), nargs="+", metavar="N", default=[7000], help=text)
    text = "train: divide the photographs' sides by N"
    parser.add_argument("--reduce", type=positive(int), default=1, metavar="N", help=text)
    text = "train: keep every Nth photograph for the test (default 8)"
    parser.add_argument("--test-every", type=positive(int), default=8, metavar="N", help=text)
    parser.add_argument("--cap", type=positive(int), metavar="N", help="train: most Gaussians (default as train's)")
    parser.add_argument("--seed", type=int, default=0, metavar="S", help="train: seed of all random numbers")
    text = "train: kinds of training, each `plain`, `fast` or like sparse=1,coarse=0.3 (default plain)"
    parser.add_argument("--variants", nargs="+", default=["plain"], metavar="V", help=text)
    parser.add_argument("--json", type=Path, metavar="OUT.json", help="write the rows")
    add_arch(parser)


def run(args: argparse.Namespace) -> int | None:
    """Measure the subject. Raises BadInput."""
    if args.names and args.subject not in NAMED:
        raise BadInput(f"bench {args.subject} takes no names: {' '.join(args.names)}")
    start_taichi(args.arch)
    return importlib.import_module(SUBJECTS[args.subject][0]).run(args)
