"""`vrgs.py build`: rebuild the shipped assets from code."""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import numpy as np

from assets.library import SHIPPED_FOLDER
from core.errors import BadInput
from core.runtime import start_taichi

NAMES = ("dining_room", "bottle", "ring_red", "ring_blue", "ring_yellow", "dancer")
SEED = 7


HELP = "rebuild the shipped assets from code"
EXAMPLES = ("build ring_red",)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    parser.add_argument("names", nargs="*", metavar="NAME", help="names of assets (default: all)")
    parser.add_argument("--out", type=Path, default=SHIPPED_FOLDER, metavar="DIR")


def run(args: argparse.Namespace) -> None:
    """Build the assets `args.names` (all, if there are none) into `args.out`. Raises BadInput."""
    names = list(args.names or NAMES)
    for name in names:
        if name not in NAMES:
            raise BadInput(f"{name}: no such model; there are {', '.join(NAMES)}")
    start_taichi(args.arch)
    out = Path(args.out or SHIPPED_FOLDER)
    start = time.perf_counter()

    def report(line: str) -> None:
        print(f"[{time.perf_counter() - start:5.1f} s] {line}", flush=True)

    out.mkdir(parents=True, exist_ok=True)
    for name, asset in build(names, report):
        path = out / f"{name}.h5"
        asset.save(path)
        report(f"{path}: {len(asset.gaussians):,} Gaussians, {path.stat().st_size / 1e6:.2f} MB")


def build(names: list[str], report=print):
    """Yield (name, asset) for each name. Each asset has its own random numbers, so that the order does not matter."""
    from studio.dining_room.bottle import bottle
    from studio.dining_room.room_model import dining_room, lit_room
    from studio.ring import ring

    room = None
    for name in names:
        rng = np.random.default_rng([SEED, NAMES.index(name)])
        if name.startswith("ring"):
            yield name, ring(name, rng)
            continue
        if name == "dancer":
            from studio.dancer import dancer

            yield name, dancer(rng)
            continue
        if room is None:
            room = lit_room(np.random.default_rng(SEED), report)
        yield name, dining_room(room, rng, report) if name == "dining_room" else bottle(room.light, rng)
