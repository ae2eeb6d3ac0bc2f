#!/usr/bin/env python
"""VR-GS: see a capture as Gaussians, hold it as an elastic body. The command line and the frame loop."""

from __future__ import annotations

import argparse
import contextlib
import itertools
import os
import sys
from pathlib import Path

from assets.errors import BadInput
from display.device import start_taichi

EXAMPLES = """examples:
  python vrgs.py                                        play the ring toss in a window
  python vrgs.py --scene sandbox --body cat.ply         drop your own splat on the table
  python vrgs.py --scene ring_toss --headless --record toss.mp4 --stats toss.json
  python vrgs.py scenes                                 list the demos
  python vrgs.py render cat.ply --camera cam.json --out cat.png
  python vrgs.py prepare cat.ply --out cat.h5 --vertices 2000
  python vrgs.py convert cat.ply cat.spz
"""


def main(argv: list[str] | None = None) -> int:
    """Run one command; returns the exit status: 0 done, 2 bad input, 130 interrupted."""
    argv = sys.argv[1:] if argv is None else argv
    for i in range(len(argv) - 2, -1, -1):  # argparse would take the -y of `--up -y` for an option
        if argv[i] == "--up" and argv[i + 1] in ("-x", "-y", "-z"):
            argv = [*argv[:i], f"--up={argv[i + 1]}", *argv[i + 2 :]]
    args = parser().parse_args(argv)
    try:
        args.run(args)
    except BadInput as e:
        print(f"vrgs: {' '.join(str(e).split())}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("vrgs: interrupted", file=sys.stderr)
        return 130
    except BrokenPipeError:  # `vrgs.py scenes | head`
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    return 0


def play(args) -> None:
    """Play a scene: in a window, or headless with its scripted hand."""
    from scenes import registry

    scene = registry.load(args.scene, body=prepared_body(args))
    with open_display(args, scene) as display, open_recorder(args, display) as recorder:
        start_taichi(args.arch, args.seed)
        from display.stats import run_stats, write_stats
        from display.world import World

        width, height = display.size
        views = 2 if args.stereo else 1
        how = {"interaction": args.interaction, "embedding": args.embedding}
        world = World(scene, width=width, height=height, views=views, **how)
        if args.headless:
            display.hands = world.scripted_hands
        frames = 0
        limit = None if args.headless else args.frames  # a headless display counts for itself
        for frame in itertools.islice(display.frames(), limit):
            world.step(frame)
            display.present(world)
            if recorder:
                recorder.add(world, frame.time)
            frames += 1
        if args.stats:
            write_stats(args.stats, run_stats(world, frames))
        if args.headless:
            print(f"{frames} frames, {world.timings.fps:.1f} a second; {world.message}", file=sys.stderr)


def open_display(args, scene):
    """The window, or without a display or with --headless the recorder of files."""
    if args.xr:
        raise BadInput("--xr: headsets are not supported yet; leave it out to play in a window")
    if args.stats:
        from display.video import claim

        claim(args.stats, args.stats.with_name(f".{args.stats.name}.part"))
    width, height = args.size
    if not args.headless:
        from display.surface import has_display

        if has_display():
            from display.window import Window

            return Window(scene, title=f"VR-GS: {args.scene}", width=width, height=height)
        args.headless = True
        args.record = args.record or Path(f"{args.scene}.mp4")
        args.snapshot = args.snapshot or Path(f"{args.scene}.png")
        print(f"no display: the scripted hand plays; writing {args.record} and {args.snapshot}", file=sys.stderr)
    from display.headless import Headless

    frames = args.frames or (round(60 * scene.game.duration) if scene.game else 300)
    views = 2 if args.stereo else 1
    out = {"record": args.record, "snapshot": args.snapshot}
    return Headless(scene, width=width, height=height, frames=frames, views=views, every=2, **out)


def open_recorder(args, display):
    """What films a window; a headless display films itself."""
    if args.headless or not args.record:
        return contextlib.nullcontext()
    from display.record import Recorder

    return contextlib.closing(Recorder(args.record, *display.size))


def prepared_body(args) -> str | None:
    """The asset of --body: as it is if it is one already, else prepared from the splat and cached."""
    if args.body is None:
        if args.up is not None or args.scale is not None:
            raise BadInput("--up and --scale belong to --body FILE")
        return None
    from assets.library import SHIPPED, cached_asset

    path = Path(args.body)
    if (SHIPPED / f"{args.body}.h5").is_file() or path.suffix.lower() == ".h5":
        return args.body
    if not path.is_file():
        raise BadInput(f"{path}: no such file")
    options = {"vertices": args.vertices, "scale": args.scale, "up": args.up, "version": 1}
    out = cached_asset(path, options)
    if not out.is_file():
        from prepare.command import prepare_file

        start_taichi(args.arch, args.seed)
        print(f"preparing {path.name} (once; kept as {out})", flush=True)
        out.parent.mkdir(parents=True, exist_ok=True)
        prepare_file(path, out, vertices=args.vertices, scale=args.scale, up=args.up)
    return str(out)


def command(module: str, *, taichi: bool = False):
    """A command that lives in `module.run`; imported only when it is used."""

    def run(args) -> None:
        import importlib

        if taichi:
            start_taichi(args.arch)
        importlib.import_module(module).run(args)

    return run


def list_scenes(args) -> None:
    """Print each scene's name and what it is."""
    from scenes import registry

    for name in registry.names():
        print(f"{name:14} {registry.summary(name)}")


def size(text: str) -> tuple[int, int]:
    """WIDTHxHEIGHT [px]."""
    width, _, height = text.lower().partition("x")
    if not (width.isdecimal() and height.isdecimal() and 16 <= int(width) <= 16384 and 16 <= int(height) <= 16384):
        raise argparse.ArgumentTypeError(f"{text!r} is not WIDTHxHEIGHT, each 16 to 16384")
    return int(width), int(height)


def positive(kind):
    """A number above zero."""

    def parse(text: str):
        try:
            value = kind(text)
        except ValueError:
            value = 0
        if not 0 < value < 1e9:
            raise argparse.ArgumentTypeError(f"{text!r} is not a positive number")
        return value

    return parse


def add_preparation(p: argparse.ArgumentParser, what: str = "") -> None:
    """The options of making a splat simulatable."""
    suppress = {} if what else {"default": argparse.SUPPRESS}  # those of a command must not undo those before it
    axes = ("+x", "-x", "+y", "-y", "+z", "-z")
    p.add_argument("--up", choices=axes, help=f"{what}the file's up axis (default: guessed)", **suppress)
    metres = f"{what}largest extent in metres (default: guessed)"
    p.add_argument("--scale", type=positive(float), metavar="M", help=metres, **suppress)
    vertices = f"{what}cage vertices (default 2000)"
    p.add_argument("--vertices", type=positive(int), metavar="N", help=vertices, **(suppress or {"default": 2000}))


def parser() -> argparse.ArgumentParser:
    """All commands and options."""
    formatter = argparse.RawDescriptionHelpFormatter
    p = argparse.ArgumentParser(prog="vrgs.py", description=__doc__, epilog=EXAMPLES, formatter_class=formatter)
    p.set_defaults(run=play)
    arch = {"choices": ("cuda", "cpu"), "help": "where kernels run; unset: CUDA if there is one, else the CPU"}
    p.add_argument("--scene", default="ring_toss", metavar="NAME", help="demo to play (see: vrgs.py scenes)")
    how = p.add_mutually_exclusive_group()
    how.add_argument("--xr", action="store_true", help="play in a headset")
    how.add_argument("--headless", action="store_true", help="no window: the scene's scripted hand plays")
    p.add_argument("--arch", **arch)
    p.add_argument("--interaction", choices=("physics", "transform"), default="physics", help="what a grip does")
    p.add_argument("--embedding", choices=("two-level", "one-level"), default="two-level", help="how Gaussians follow")
    p.add_argument("--frames", type=positive(int), metavar="N", help="stop after N frames")
    p.add_argument("--size", type=size, default=(960, 540), metavar="WxH", help="picture size (default 960x540)")
    p.add_argument("--stereo", action="store_true", help="headless: draw two eyes, 64 mm apart")
    p.add_argument("--record", type=Path, metavar="OUT.mp4", help="write a film")
    p.add_argument("--snapshot", type=Path, metavar="OUT.png", help="headless: write the last frame")
    p.add_argument("--stats", type=Path, metavar="OUT.json", help="write timings and counts")
    p.add_argument("--seed", type=int, default=0, metavar="S", help="seed of all random numbers (default 0)")
    p.add_argument("--body", metavar="FILE", help="sandbox: splat file or prepared asset to play with")
    add_preparation(p, "--body: ")
    commands = p.add_subparsers(metavar="COMMAND", title="commands (vrgs.py COMMAND --help)")

    def add(name: str, run, text: str, example: str) -> argparse.ArgumentParser:
        sub = commands.add_parser(
            name, help=text, description=text, epilog=f"example:\n  python vrgs.py {example}", formatter_class=formatter
        )
        sub.set_defaults(run=run)
        return sub

    add("scenes", list_scenes, "list the demos", "scenes")
    c = add(
        "render",
        command("render.command", taichi=True),
        "draw a splat file",
        "render cat.ply --camera cam.json --out cat.png",
    )
    c.add_argument("splats", type=Path, metavar="SPLATS", help=".ply, .splat, .spz or .h5")
    c.add_argument("--camera", type=Path, required=True, metavar="CAM.json", help="one camera or a list")
    c.add_argument("--out", type=Path, required=True, metavar="OUT.png|OUT.npz")
    c.add_argument("--antialias", action="store_true", help="opacity compensation of Mip-Splatting")
    c.add_argument("--arch", default=argparse.SUPPRESS, **arch)  # else it would undo the one before COMMAND
    c = add(
        "prepare",
        command("prepare.command", taichi=True),
        "make a splat simulatable",
        "prepare cat.ply --out cat.h5 --vertices 2000",
    )
    c.add_argument("splats", type=Path, metavar="SPLATS", help=".ply, .splat or .spz")
    c.add_argument("--out", type=Path, required=True, metavar="ASSET.h5")
    add_preparation(c)
    c.add_argument("--material", help="foam, rubber, plush, jelly or wood (default plush)")
    c.add_argument("--force", action="store_true", help="overwrite OUT")
    c.add_argument("--arch", default=argparse.SUPPRESS, **arch)  # else it would undo the one before COMMAND
    c = add("convert", command("assets.convert"), "convert between splat formats", "convert cat.ply cat.spz")
    c.add_argument("input", type=Path, metavar="IN", help=".ply, .splat, .spz or .h5")
    c.add_argument("output", type=Path, metavar="OUT", help=".ply or .spz")
    c = add("build", command("prepare.model.command"), "build the shipped assets anew from code", "build ring_red")
    c.add_argument("names", nargs="*", metavar="NAME", help="which ones (default: all)")
    c.add_argument("--out", type=Path, default=Path(__file__).resolve().parent / "assets" / "data", metavar="DIR")
    return p


if __name__ == "__main__":
    sys.exit(main())
