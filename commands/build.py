"""`vrgs.py build`: rebuild the shipped assets from code."""

from __future__ import annotations

import argparse
import time
from pathlib import Path

from assets.library import SHIPPED_FOLDER
from core.errors import BadInput
from core.runtime import start_taichi

HELP = "rebuild the shipped assets from code"
EXAMPLES = ("build ring_red",)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    parser.add_argument("names", nargs="*", metavar="NAME", help="names of assets (default: all)")
    parser.add_argument("--out", type=Path, default=None, metavar="DIR", help="default: the shipped assets' folder")
    parser.add_argument(
        "--detail", choices=("shipped", "rough"), default="shipped", help="rough: quickly, to look at (needs --out)"
    )


def run(args: argparse.Namespace) -> None:
    """Build the assets `args.names` (all, if there are none) into `args.out`. Raises BadInput."""
    from studio.catalogue import MODELS, build_model
    from studio.detail import ROUGH, SHIPPED

    names = list(args.names or MODELS)
    for name in names:
        if name not in MODELS:
            raise BadInput(f"{name}: no such model; there are {', '.join(MODELS)}")
    if args.detail != "shipped" and args.out is None:
        raise BadInput(f"--detail {args.detail} needs --out: it would replace the shipped assets")
    detail = {"shipped": SHIPPED, "rough": ROUGH}[args.detail]
    start_taichi(args.arch)
    out = Path(args.out or SHIPPED_FOLDER)
    start = time.perf_counter()

    def report(line: str) -> None:
        print(f"[{time.perf_counter() - start:5.1f} s] {line}", flush=True)

    out.mkdir(parents=True, exist_ok=True)
    for name in names:
        asset = build_model(name, detail, report)
        path = out / f"{name}.h5"
        asset.save(path, quantised=True)
        report(f"{path}: {len(asset.gaussians):,} Gaussians, {path.stat().st_size / 1e6:.2f} MB")
