"""Build the modelled assets from code, as shipped or at the paper's sizes, or a modelled capture: python -m studio

python -m studio ring_red
python -m studio --detail paper ring_toss
python -m studio --capture toys/          photographs, poses, masks, depths, what is behind each toy, its other sides
python -m studio --films clips/           films of toys whose material is known, for `vrgs.py fit`
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable
from pathlib import Path

from assets.file_access import make_folder
from assets.library import SHIPPED_FOLDER, paper_folder
from core.errors import BadInput
from core.program import check_package
from core.runtime import start_taichi

AXES = ("+x", "-x", "+y", "-y", "+z", "-z")
DEFAULTS = {"views": 40, "size": (480, 360), "seed": 0, "up": "+y", "scale": 1.0}  # of a capture


def main(words: list[str] | None = None) -> int:
    """Run one command line; returns the exit status: 0 done, 2 bad input."""
    try:
        run(parser().parse_args(words))
    except BadInput as e:
        print(f"studio: {e}", file=sys.stderr)
        return 2
    return 0


def parser() -> argparse.ArgumentParser:
    """The command line."""
    made = argparse.ArgumentParser(
        prog="python -m studio", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    text = "names of assets, with --detail paper of demos (default: all)"
    made.add_argument("names", nargs="*", metavar="NAME", help=text)
    text = "default: the shipped assets' folder, with --detail paper one in the user's cache"
    made.add_argument("--out", type=Path, metavar="DIR", help=text)
    text = "paper: each demo's own set, with as many Gaussians and vertices as the paper's; rough: quickly, to look at"
    made.add_argument("--detail", choices=("shipped", "paper", "rough"), default="shipped", help=text)
    made.add_argument("--force", action="store_true", help="--detail paper: rebuild what is there already")
    made.add_argument("--arch", choices=("cuda", "cpu"), help="where kernels run")
    text = "film moving toys, by names of clips, into this folder, with cameras, marks and truth"
    made.add_argument("--films", type=Path, metavar="FOLDER", help=text)
    capture = made.add_argument_group("a capture whose truth is known")
    text = "photograph toys on a table, modelled and ray-cast, into this new folder, with masks, depths and truth.json"
    capture.add_argument("--capture", type=Path, metavar="FOLDER", help=text)
    capture.add_argument("--cut-out", action="store_true", help="toys on transparent ground, as a Blender dataset")
    capture.add_argument("--views", type=int, metavar="N", help="photographs (default 40)")
    capture.add_argument("--size", type=picture_size, metavar="WxH", help="of a photograph [px] (default 480x360)")
    capture.add_argument("--seed", type=int, metavar="S", help="of the toys' places and the cameras (default 0)")
    capture.add_argument("--up", choices=AXES, help="axis of the capture's world (default +y; write --up=-y)")
    capture.add_argument("--scale", type=float, metavar="F", help="units of the capture's world in a metre (default 1)")
    return made


def picture_size(text: str) -> tuple[int, int]:
    """WIDTHxHEIGHT [px]."""
    width, _, height = text.partition("x")
    if not (width.isdecimal() and height.isdecimal() and int(width) >= 16 and int(height) >= 16):
        raise argparse.ArgumentTypeError(f"{text!r} is not WIDTHxHEIGHT, each 16 or more")
    return int(width), int(height)


def run(args: argparse.Namespace) -> None:
    """Build the assets `args.names` (all, if there are none) into `args.out`, a capture, or films. Raises BadInput."""
    if args.films is not None:
        film_toys(args)
        return
    check_package("studio", "open3d", "studio/requirements.txt")
    if args.capture is not None:
        build_capture(args)
        return
    for name in (name for name in DEFAULTS if getattr(args, name) is not None):
        raise BadInput(f"--{name} belongs to --capture")
    if args.cut_out:
        raise BadInput("--cut-out belongs to --capture")
    if args.force and args.detail != "paper":
        raise BadInput("--force belongs to --detail paper; the others always build")
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
    from prepare.train.capture_files import VIEWS_MIN
    from studio.procedural_capture import CaptureOptions, write_procedural_capture

    if args.names:
        raise BadInput(f"{args.names[0]}: --capture builds no assets")
    chosen = {
        name: getattr(args, name) if getattr(args, name) is not None else value for name, value in DEFAULTS.items()
    }
    if chosen["views"] < VIEWS_MIN:
        raise BadInput(f"--views {chosen['views']}: a capture has at least {VIEWS_MIN}")
    if chosen["seed"] < 0 or not 0 < chosen["scale"] < 1e9:
        raise BadInput("--seed is 0 or more, --scale more than 0")
    write_procedural_capture(args.capture, CaptureOptions(**chosen, cut_out=args.cut_out), clock())
    print(f"{args.capture}: {chosen['views']} photographs of {chosen['size'][0]}x{chosen['size'][1]}")


def film_toys(args: argparse.Namespace) -> None:
    """Film the clips `args.names` (all, if there are none) into `args.films`. Raises BadInput."""
    from studio.filmed_toys import CLIPS, film_toy

    start_taichi(args.arch)
    report = clock()
    for name in args.names or CLIPS:
        film_toy(name, args.films, report)


def build_paper(names: list[str], out: Path | None, arch: str | None, *, force: bool = False) -> None:
    """Build the assets of demos at the paper's sizes into out/DEMO (default: in the user's cache). Raises BadInput."""
    from scenes.paper_demos import paper_demos
    from studio.paper_assets import build_demo

    demos = paper_demos(names)
    start_taichi(arch)
    report = clock()
    for k, demo in enumerate(demos):
        report(f"demo {k + 1} of {len(demos)}: {demo.name}")
        build_demo(demo, paper_folder(demo.name) if out is None else out / demo.name, report, force=force)


def clock() -> Callable[[str], None]:
    """A function that prints a line with the time since now."""
    start = time.perf_counter()
    return lambda line: print(f"[{time.perf_counter() - start:6.1f} s] {line}", flush=True)


if __name__ == "__main__":
    sys.exit(main())
