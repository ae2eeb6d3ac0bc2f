"""`vrgs.py view`: look at a splat file in a window."""

from __future__ import annotations

import argparse
import itertools
import sys
from pathlib import Path

from commands.conditions import Condition
from commands.options import AXES, SPLATS, add_arch, add_sort, picture_name, positive, size
from core.errors import BadInput
from core.runtime import start_taichi
from render import MOVING_SORT

HELP = "look at a splat file in a window"
EXAMPLES = ("view cat.ply",)
SIZE = (960, 540)  # [px] of a picture, and from which a window's first view is chosen
CONDITIONS = (
    Condition(("--frames",), lambda args: args.snapshot is None, "belongs to a window: --snapshot needs one"),
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    parser.add_argument("file", type=Path, metavar="FILE", help=f"{SPLATS} or .h5")
    parser.add_argument("--up", choices=AXES, help="the file's up axis (default: guessed)")
    text = "picture size (default 960x540, of a window: the last one's)"
    parser.add_argument("--size", type=size, metavar="WxH", help=text)
    parser.add_argument("--snapshot", type=picture_name, metavar="OUT.png", help="no window: write one picture")
    add_sort(parser, MOVING_SORT)
    parser.add_argument("--frames", type=positive(int), metavar="N", help="stop after N frames")
    add_arch(parser)


def run(args: argparse.Namespace) -> None:
    """Show `args.file` in a window, or write `args.snapshot`. Raises BadInput."""
    from display.viewer import Viewer, scene_around, upright
    from display.window.gl_window import has_display

    if args.snapshot is None and not has_display():
        raise BadInput("no display to open a window on: --snapshot OUT.png writes a picture, `vrgs.py render` a film")
    gaussians, up = upright(args.file, args.up)
    width, height = args.size or SIZE
    scene = scene_around(gaussians, width / height)
    print(f"{args.file}: {len(gaussians)} Gaussians, SH degree {gaussians.sh_degree}, {up}", file=sys.stderr)
    if args.snapshot is not None:
        from display.headless.headless import Headless

        display = Headless(scene, width=width, height=height, frames=1, snapshot=args.snapshot)
    else:
        from display.preferences import Preferences
        from display.window.window import Window

        width, height = args.size or (None, None)
        name = Path(args.file).name
        kept = {"preferences": Preferences.of_user(), "name": name}
        display = Window(scene, title=name, width=width, height=height, **kept)
    from display.keep.keeper import Keeper

    with display, Keeper(str(args.file)) as keeper:
        start_taichi(args.arch)
        viewer = Viewer(gaussians, scene, width=display.size[0], height=display.size[1], sort=args.sort)
        for frame in itertools.islice(display.frames(viewer), args.frames):
            viewer.step(frame)
            display.present(viewer)
            keeper.after(frame, viewer)
