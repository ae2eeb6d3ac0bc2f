"""The command line's options: all commands and what they take."""

from __future__ import annotations

import argparse
import importlib
from pathlib import Path

from assets.library import SHIPPED_FOLDER
from commands.argument_types import elevation, positive, share, size
from core.runtime import start_taichi
from render import MOVING_SORT, SORTS

SPLATS = ".ply, .splat, .ksplat, .spz, .sog, meta.json"
AXES = ("+x", "-x", "+y", "-y", "+z", "-z")
BENCHES = {
    "sim": "bench.sim_speed",
    "render": "bench.render_speed",
    "frame": "bench.frame_time",
    "scaling": "bench.scaling",
    "popping": "bench.popping",
    "embedding": "bench.embedding_ablation",
}
EXAMPLES = """examples:
  python vrgs.py                                        play the ring toss in a window
  python vrgs.py --scene sandbox --body cat.ply         drop your own splat on the table
  python vrgs.py --scene ring_toss --headless --record toss.mp4 --stats toss.json
  python vrgs.py --xr --record-input play.h5            play in a headset, and keep what you do
  python vrgs.py --replay play.h5                       see it again; with --headless --record play.mp4: film it
  python vrgs.py scenes                                 list the demos
  python vrgs.py view cat.ply                           look at a splat from all sides
  python vrgs.py render cat.ply --turntable --out cat.mp4
  python vrgs.py render cat.ply --camera cam.json --out cat.png
  python vrgs.py prepare cat.ply --out cat.h5 --vertices 2000
  python vrgs.py convert cat.sog cat.compressed.ply     between splat formats, and what was lost
  python vrgs.py --scene sandbox --stage room.ply --body cat.ply
  python vrgs.py tune cat.h5                            how stiff should it be?
  python vrgs.py check --quick
"""


def command(module: str, *, taichi: bool = False):
    """A command that lives in `module.run`, which may return an exit status; imported only when it is used."""

    def run(args) -> int | None:
        if taichi:
            start_taichi(args.arch)
        return importlib.import_module(module).run(args)

    return run


def bench(args) -> None:
    """Measure what was asked for."""
    command(BENCHES[args.subject], taichi=not args.earlier)(args)


def prepare(args) -> None:
    """Make a body of a splat, or a static environment."""
    command("commands.prepare", taichi=True)(args)


def render(args) -> None:
    """Draw pictures, or film."""
    command("display.headless.turntable" if args.turntable else "commands.render", taichi=True)(args)


def list_scenes(args) -> None:
    """Print each scene's name and what it is."""
    from scenes import registry

    for name in registry.names():
        print(f"{name:14} {registry.summary(name)}")


def add_preparation(p: argparse.ArgumentParser, what: str = "") -> None:
    """The options of making a splat simulatable."""
    suppress = {} if what else {"default": argparse.SUPPRESS}  # those of a command must not undo those before it
    p.add_argument("--up", choices=AXES, help=f"{what}the file's up axis (default: guessed)", **suppress)
    metres = f"{what}largest extent in metres (default: guessed)"
    p.add_argument("--scale", type=positive(float), metavar="M", help=metres, **suppress)
    vertices = f"{what}cage vertices (default 2000)"
    p.add_argument("--vertices", type=positive(int), metavar="N", help=vertices, **(suppress or {"default": 2000}))
    cells = f"{what}of the cage: smaller where it is thin or curved, or all alike (default adaptive)"
    p.add_argument("--cells", choices=("adaptive", "uniform"), help=cells, **(suppress or {"default": "adaptive"}))
    apart = f"{what}pieces that lie apart each get a cage and become bodies of their own (default: the largest alone)"
    p.add_argument("--pieces", action="store_true", help=apart, **suppress)


def parser(summary: str, play) -> argparse.ArgumentParser:
    """All commands and options; `play` is what runs without a command."""
    formatter = argparse.RawDescriptionHelpFormatter
    p = argparse.ArgumentParser(prog="vrgs.py", description=summary, epilog=EXAMPLES, formatter_class=formatter)
    p.set_defaults(run=play)
    arch = {"choices": ("cuda", "cpu"), "help": "where kernels run; unset: CUDA if there is one, else the CPU"}
    p.add_argument("--scene", default="ring_toss", metavar="NAME", help="demo to play (see: vrgs.py scenes)")
    how = p.add_mutually_exclusive_group()
    how.add_argument("--xr", action="store_true", help="play in a headset")
    how.add_argument("--headless", action="store_true", help="no window: the scene's scripted hand plays")
    p.add_argument("--arch", **arch)
    p.add_argument("--interaction", choices=("physics", "transform"), default="physics", help="what a grip does")
    p.add_argument("--embedding", choices=("two-level", "one-level"), default="two-level", help="how Gaussians follow")
    order = "in front is what is nearest by depth, by distance, or by distance along each pixel's ray"
    p.add_argument("--sort", choices=SORTS, default=MOVING_SORT, help=f"{order} (default {MOVING_SORT})")
    p.add_argument("--frames", type=positive(int), metavar="N", help="stop after N frames")
    p.add_argument("--size", type=size, default=(960, 540), metavar="WxH", help="picture size (default 960x540)")
    p.add_argument(
        "--render-scale", type=share, default=1.0, metavar="S", help="--xr: of the size that it asks for, a side"
    )
    p.add_argument("--stereo", action="store_true", help="headless: draw two eyes, 64 mm apart")
    p.add_argument("--record", type=Path, metavar="OUT.mp4", help="write a film")
    p.add_argument("--snapshot", type=Path, metavar="OUT.png", help="headless: write the last frame")
    p.add_argument("--stats", type=Path, metavar="OUT.json", help="write timings and counts")
    again = p.add_mutually_exclusive_group()
    again.add_argument("--record-input", type=Path, metavar="FILE.h5", help="write what you do, to be played again")
    again.add_argument("--replay", type=Path, metavar="FILE.h5", help="play again what was recorded; compare the end")
    p.add_argument("--seed", type=int, default=0, metavar="S", help="seed of all random numbers (default 0)")
    p.add_argument("--body", metavar="FILE", help="sandbox, just_dance: splat file or prepared asset to play with")
    p.add_argument("--stage", metavar="ROOM", help="sandbox: a room to play in, a splat or prepared with --static")
    p.add_argument("--material", metavar="NAME", help="sandbox: what the body is made of (see: vrgs.py materials)")
    add_preparation(p, "--body: ")
    commands = p.add_subparsers(metavar="COMMAND", title="commands (vrgs.py COMMAND --help)")

    def add(name: str, run, text: str, example: str) -> argparse.ArgumentParser:
        sub = commands.add_parser(
            name, help=text, description=text, epilog=f"example:\n  python vrgs.py {example}", formatter_class=formatter
        )
        sub.set_defaults(run=run)
        return sub

    add("scenes", list_scenes, "list the demos", "scenes")
    c = add("view", command("display.viewer"), "look at a splat file in a window", "view cat.ply")
    c.add_argument("file", type=Path, metavar="FILE", help=f"{SPLATS} or .h5")
    c.add_argument("--up", choices=AXES, help="the file's up axis (default: guessed)")
    c.add_argument("--size", type=size, default=(960, 540), metavar="WxH", help="of the window (default 960x540)")
    c.add_argument("--snapshot", type=Path, metavar="OUT.png", help="no window: write one picture")
    c.add_argument("--sort", choices=SORTS, default=argparse.SUPPRESS, help=f"{order} (default {MOVING_SORT})")
    c.add_argument("--frames", type=positive(int), metavar="N", help="stop after N frames")
    c.add_argument("--arch", default=argparse.SUPPRESS, **arch)
    c = add(
        "render",
        render,
        "draw a splat file, or film a turn around it",
        "render cat.ply --camera cam.json --out cat.png\n  python vrgs.py render cat.ply --turntable --out cat.mp4",
    )
    c.add_argument("splats", type=Path, metavar="SPLATS", help=f"{SPLATS} or .h5")
    where = c.add_mutually_exclusive_group()
    where.add_argument("--camera", type=Path, metavar="CAM.json", help="one camera or a list")
    where.add_argument("--turntable", action="store_true", help="film it from all sides")
    c.add_argument("--out", type=Path, required=True, metavar="OUT.png|OUT.npz|OUT.mp4")
    c.add_argument("--up", choices=AXES, help="turntable: the file's up axis (default: guessed)")
    c.add_argument("--size", type=size, default=(960, 540), metavar="WxH", help="turntable: (default 960x540)")
    c.add_argument("--frames", type=positive(int), default=180, metavar="N", help="turntable: pictures (default 180)")
    c.add_argument("--elevation", type=elevation, default=15.0, metavar="DEG", help="turntable: seen from (default 15)")
    c.add_argument("--sort", choices=SORTS, default="z", help=f"{order} (default z)")
    c.add_argument("--antialias", action="store_true", help="opacity compensation of Mip-Splatting")
    c.add_argument("--arch", default=argparse.SUPPRESS, **arch)  # else it would undo the one before COMMAND
    c = add(
        "prepare",
        prepare,
        "make a splat simulatable, or a room a stage",
        "prepare cat.ply --out cat.h5 --vertices 2000\n  python vrgs.py prepare room.ply --static --out room.h5",
    )
    c.add_argument("splats", type=Path, metavar="SPLATS", help=f"{SPLATS}, skinned .glb; --static: or .h5")
    c.add_argument("--out", type=Path, required=True, metavar="ASSET.h5")
    c.add_argument("--rig", type=Path, metavar="RIG.glb", help="a standing person takes over this rig's motion")
    c.add_argument("--landmarks", type=Path, metavar="L.json", help="where its joints are (default: guessed)")
    add_preparation(c)
    c.add_argument(
        "--material",
        metavar="NAME",
        default=argparse.SUPPRESS,
        help="foam, rubber, plush, jelly, wood or flesh (default plush, with a rig flesh)",
    )
    c.add_argument("--static", action="store_true", help="it is a room or a garden: a stage for the sandbox")
    c.add_argument(
        "--cell", type=positive(float), metavar="M", help="--static: of the distance grid (default: by size)"
    )
    c.add_argument("--cut", type=positive(int), nargs="+", metavar="ID", help="--static: objects to take out of it")
    c.add_argument("--force", action="store_true", help="overwrite OUT")
    meshers = "what makes the tetrahedra (default stuffing; tetgen as in the paper: see requirements-tetgen.txt)"
    c.add_argument("--mesher", choices=("stuffing", "tetgen"), default="stuffing", help=meshers)
    c.add_argument("--no-report", action="store_true", help="leave out ASSET.report.html and ASSET.report.json")
    c.add_argument("--arch", default=argparse.SUPPRESS, **arch)  # else it would undo the one before COMMAND
    c = add("convert", command("commands.convert"), "convert between splat formats", "convert cat.sog cat.spz")
    c.add_argument("input", type=Path, metavar="IN", help=f"{SPLATS} or .h5")
    c.add_argument("output", type=Path, metavar="OUT", help=".ply, .compressed.ply, .spz or .splat")
    c = add("bench", bench, "measure speed", "bench sim --json sim.json")
    what = "sim: the solver, 400 substeps a frame; render: a headset's picture, both eyes; "
    what += "frame: a headset's whole frame, ring toss; "
    what += "scaling: a picture's time against Gaussians and against pixels; "
    what += "popping: what flickers when the head turns, by ways to sort; "
    what += "embedding: finding hosts, carrying Gaussians, one level against two"
    c.add_argument("subject", choices=tuple(BENCHES), help=what)
    room = {"type": Path, "default": SHIPPED_FOLDER / "dining_room.h5", "metavar": "SPLATS"}
    c.add_argument("--splats", **room, help="popping: what is looked at (default: the dining room); embedding: a body")
    c.add_argument("--count", type=positive(int), default=1_000_000, metavar="N", help="embedding: (default 1000000)")
    c.add_argument("--out", type=Path, metavar="OUT.png", help="embedding: a strip of pictures")
    sizes = ("1.7k", "9.3k", "24k", "46k")
    c.add_argument("--sizes", nargs="+", choices=sizes, default=list(sizes), help="vertices (default: all)")
    rooms = ("0.305M", "1.313M", "2.526M")
    c.add_argument("--gaussians", nargs="+", choices=rooms, default=list(rooms), help="render: rooms (default: all)")
    c.add_argument("--size", type=size, default=(1800, 1920), metavar="WxH", help="render: an eye (default 1800x1920)")
    c.add_argument("--rounds", type=positive(int), default=12, metavar="N", help="frames measured (default 12)")
    c.add_argument("--json", type=Path, metavar="OUT.json", help="write the rows")
    c.add_argument("--plot", type=Path, metavar="OUT.svg", help="scaling: draw the curves")
    earlier = {"type": Path, "nargs": "+", "metavar": "ROWS.json", "default": []}
    c.add_argument("--from", dest="earlier", **earlier, help="scaling: of what --json wrote, instead of measuring")
    c.add_argument("--arch", default=argparse.SUPPRESS, **arch)
    c = add(
        "build",
        command("commands.build", taichi=True),
        "build the shipped assets anew from code",
        "build ring_red",
    )
    c.add_argument("names", nargs="*", metavar="NAME", help="which ones (default: all)")
    c.add_argument("--out", type=Path, default=SHIPPED_FOLDER, metavar="DIR")
    c = add(
        "tune",
        command("display.headless.stiffness_sweep", taichi=True),
        "drop a body with one stiffness after another: what each does, as a table and a strip of pictures",
        "tune cat.h5 --from 3e3 --to 3e5 --out cat_tune.png",
    )
    c.add_argument("asset", metavar="ASSET", help="a prepared asset, or a shipped one by name")
    young = {"type": positive(float), "metavar": "E"}
    c.add_argument("--young", nargs="+", **young, help="Young's moduli to try [Pa]")
    c.add_argument("--from", dest="lowest", default=1e3, **young, help="else: the lowest (default 1e3)")
    c.add_argument("--to", dest="highest", default=1e6, **young, help="the highest (default 1e6)")
    c.add_argument("--steps", type=positive(int), default=6, metavar="N", help="how many (default 6)")
    c.add_argument(
        "--material", metavar="NAME", help="density and so on (default: the asset's; see: vrgs.py materials)"
    )
    c.add_argument(
        "--height", type=positive(float), metavar="M", help="of the drop (default: half the body's, at least 0.1)"
    )
    c.add_argument("--out", type=Path, metavar="STRIP.png", help="(default: ASSET_tune.png)")
    c.add_argument("--json", type=Path, metavar="OUT.json", help="write the table")
    c.add_argument("--arch", default=argparse.SUPPRESS, **arch)
    add("materials", command("commands.materials"), "list the materials by name", "materials")
    c = add(
        "check",
        command("bench.check", taichi=True),
        "measure the physics against theory and finite elements",
        "check --quick --json table.json",
    )
    c.add_argument("--quick", action="store_true", help="minutes, not hours: fewer substeps, throws and seconds")
    c.add_argument("--json", type=Path, metavar="OUT.json", help="write the table")
    c.add_argument("--arch", default=argparse.SUPPRESS, **arch)
    return p
