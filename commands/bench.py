"""`vrgs.py bench`: measure speed."""

from __future__ import annotations

import argparse
import importlib
from pathlib import Path

from assets.library import SHIPPED_FOLDER
from commands.options import add_arch, positive, size
from core.runtime import start_taichi

HELP = "measure speed"
EXAMPLES = ("bench sim --json sim.json",)
SUBJECTS = {
    "sim": ("bench.sim_speed", "the solver, 400 substeps a frame"),
    "scene": ("bench.scene_speed", "the solver, real bodies dropped, thrown, squeezed, piled up"),
    "render": ("bench.render_speed", "a headset's picture, both eyes"),
    "frame": ("bench.frame_time", "a headset's whole frame, ring toss"),
    "scaling": ("bench.scaling", "a picture's time against Gaussians and against pixels"),
    "popping": ("bench.popping", "flicker when the head turns, by sort mode"),
    "embedding": ("bench.embedding_ablation", "finding host tets, deforming Gaussians, one level against two"),
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    text = "; ".join(f"{name}: {what}" for name, (_, what) in SUBJECTS.items())
    parser.add_argument("subject", choices=tuple(SUBJECTS), help=text)
    text = "popping: splats to draw (default: the dining room); embedding: a body"
    parser.add_argument("--splats", type=Path, default=SHIPPED_FOLDER / "dining_room.h5", metavar="SPLATS", help=text)
    text = "embedding: number of Gaussians (default 1000000)"
    parser.add_argument("--count", type=positive(int), default=1_000_000, metavar="N", help=text)
    parser.add_argument("--out", type=Path, metavar="OUT.png", help="embedding: a strip of pictures")
    text = "numbers of vertices; sim: some of 1.7k 9.3k 24k 46k (default: all); scene: any (default: 10k 20k 46k)"
    parser.add_argument("--sizes", nargs="+", metavar="N", help=text)
    text = "scene: splats, prepared bodies (.h5), or ball, mug, ring, bunny, capsule (default: these five)"
    parser.add_argument("--asset", nargs="+", metavar="FILE", help=text)
    text = "scene: (default: plush rubber wood)"
    parser.add_argument("--materials", nargs="+", default=["plush", "rubber", "wood"], metavar="NAME", help=text)
    acts = ("drop", "throw", "squeeze", "stack")
    parser.add_argument("--acts", nargs="+", choices=acts, default=list(acts), help="scene: (default: all)")
    parser.add_argument("--frames", type=positive(int), metavar="N", help="scene: a row (default 1000, quick 240)")
    parser.add_argument("--quick", action="store_true", help="scene: drop, throw and squeeze in one row; 2 s a row")
    text = "scene: folder of bodies that were made for it (default: in the user's cache)"
    parser.add_argument("--bodies", type=Path, metavar="DIR", help=text)
    rooms = ("0.305M", "1.313M", "2.526M")
    text = "render: rooms (default: all)"
    parser.add_argument("--gaussians", nargs="+", choices=rooms, default=list(rooms), help=text)
    text = "render: picture of an eye (default 1800x1920)"
    parser.add_argument("--size", type=size, default=(1800, 1920), metavar="WxH", help=text)
    parser.add_argument("--rounds", type=positive(int), default=12, metavar="N", help="frames measured (default 12)")
    parser.add_argument("--json", type=Path, metavar="OUT.json", help="write the rows")
    parser.add_argument("--plot", type=Path, metavar="OUT.svg", help="scaling: draw the curves")
    text = "scaling: read rows that --json wrote instead of measuring"
    parser.add_argument("--from", dest="earlier", type=Path, nargs="+", metavar="ROWS.json", default=[], help=text)
    add_arch(parser)


def run(args: argparse.Namespace) -> int | None:
    """Measure the subject."""
    if not args.earlier:
        start_taichi(args.arch)
    return importlib.import_module(SUBJECTS[args.subject][0]).run(args)
