"""`vrgs.py build`: build the modelled assets from code, as shipped or at the paper's sizes, or a modelled capture."""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from pathlib import Path

from assets.file_access import make_folder
from assets.library import SHIPPED_FOLDER, paper_folder
from commands.conditions import Condition
from commands.options import AXES, add_arch, positive, size
from core.errors import BadInput
from core.open3d_package import check_open3d
from core.runtime import start_taichi

HELP = "build the modelled assets from code, or a capture whose truth is known"
EXAMPLES = (
    "build ring_red",
    "build --detail paper ring_toss",
    "build --capture toys/                                     photographs, poses, masks, depths, what is behind",
    "build --capture toys/ --views 12 --size 240x180 --up=+z --scale 3.5",
)
CONDITIONS = (
    Condition(("--force",), lambda args: args.detail == "paper", "belongs to --detail paper; the others always build"),
    Condition(("--views", "--size", "--seed", "--up", "--scale"), lambda args: args.capture, "belongs to --capture"),
    Condition(("--detail", "--out", "--arch"), lambda args: not args.capture, "is for assets, not for --capture"),
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    text = "names of assets, with --detail paper of demos (default: all)"
    parser.add_argument("names", nargs="*", metavar="NAME", help=text)
    text = "default: the shipped assets' folder, with --detail paper one in the user's cache"
    parser.add_argument("--out", type=Path, metavar="DIR", help=text)
    text = "paper: each demo's own set, with as many Gaussians and vertices as the paper's; rough: quickly, to look at"
    parser.add_argument("--detail", choices=("shipped", "paper", "rough"), default="shipped", help=text)
    parser.add_argument("--force", action="store_true", help="--detail paper: rebuild what is there already")
    text = "photograph toys on a table, modelled and ray-cast, into this new folder, with masks, depths and truth.json"
    parser.add_argument("--capture", type=Path, metavar="FOLDER", help=text)
    parser.add_argument("--views", type=positive(int), default=40, metavar="N", help="photographs (default 40)")
    text = "of a photograph [px] (default 480x360)"
    parser.add_argument("--size", type=size, default=(480, 360), metavar="WxH", help=text)
    text = "of the toys' places and the cameras (default 0)"
    parser.add_argument("--seed", type=int, default=0, metavar="S", help=text)
    parser.add_argument("--up", choices=AXES, default="+y", help="axis of the capture's world (default +y)")
    text = "units of the capture's world in a metre (default 1)"
    parser.add_argument("--scale", type=positive(float), default=1.0, metavar="F", help=text)
    add_arch(parser)


def run(args: argparse.Namespace) -> None:
    """Build the assets `args.names` (all, if there are none) into `args.out`, or a capture. Raises BadInput."""
    check_open3d("build")
    if args.capture is not None:
        build_capture(args)
        return
    if args.detail == "paper":
        build_paper(args.names, args.out, args.arch, force=args.force)
        return
    from studio.catalogue import MODELS, build_model
    from studio.detail import ROUGH, SHIPPED

    names = list(args.names or MODELS)
    for name in names:
        if name not in MODELS:
            raise BadInput(f"{name}: no such model; there are {', '.join(MODELS)}")
    if args.detail != "shipped" and args.out is None:
        raise BadInput(f"--detail {args.detail} needs --out: it would replace the shipped assets")
    detail = {"shipped": SHIPPED, "rough": ROUGH}[args.detail]
    out = Path(args.out or SHIPPED_FOLDER)
    make_folder(out)
    start_taichi(args.arch)
    report = clock()
    for name in names:
        asset = build_model(name, detail, report)
        path = out / f"{name}.h5"
        asset.save(path, quantised=True)
        report(f"{path}: {len(asset.gaussians):,} Gaussians, {path.stat().st_size / 1e6:.2f} MB")


def build_capture(args: argparse.Namespace) -> None:
    """Photograph the modelled toys into `args.capture`. Raises BadInput."""
    from prepare.train.capture import VIEWS_MIN
    from studio.procedural_capture import CaptureOptions, write_procedural_capture

    if args.names:
        raise BadInput(f"{args.names[0]}: --capture builds no assets")
    if args.views < VIEWS_MIN:
        raise BadInput(f"--views {args.views}: a capture has at least {VIEWS_MIN}")
    if args.seed < 0:
        raise BadInput("--seed is 0 or more")
    options = CaptureOptions(args.views, args.size, args.seed, args.up, args.scale)
    write_procedural_capture(args.capture, options, clock())
    print(f"{args.capture}: {args.views} photographs of {args.size[0]}x{args.size[1]}")


def build_paper(names: list[str], out: Path | None, arch: str | None, *, force: bool = False) -> None:
    """Build the assets of demos at the paper's sizes into out/DEMO (default: in the user's cache). Raises BadInput."""
    from commands.paper_assets import build_demo
    from scenes import registry
    from scenes.paper_demos import paper_demos

    demos = paper_demos(names, there=registry.names())
    start_taichi(arch)
    report = clock()
    for k, demo in enumerate(demos):
        report(f"demo {k + 1} of {len(demos)}: {demo.name}")
        build_demo(demo, paper_folder(demo.name) if out is None else out / demo.name, report, force=force)


def clock() -> Callable[[str], None]:
    """A function that prints a line with the time since now."""
    start = time.perf_counter()
    return lambda line: print(f"[{time.perf_counter() - start:6.1f} s] {line}", flush=True)
