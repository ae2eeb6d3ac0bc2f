"""`vrgs.py view`: look at splat files in a window."""

from __future__ import annotations

import argparse
import itertools
import sys
from dataclasses import replace
from pathlib import Path

from assets.file_access import check_writable
from assets.splat_files import kind_to_write
from commands.conditions import Condition
from commands.options import AXES, BACKGROUND_NAMES, SPLATS, add_arch, add_sort, colour, picture_name, positive, size
from core.errors import BadInput
from core.runtime import start_taichi
from render import MOVING_SORT

HELP = "look at splat files in a window"
EXAMPLES = ("view cat.ply", "view before.ply after.ply", "view room.ply --background white --out part.ply")
SIZE = (960, 540)  # [px] of a picture, and from which a window's first view is chosen
CONDITIONS = (
    Condition(("--frames",), lambda args: args.snapshot is None, "belongs to a window: --snapshot needs one"),
    Condition(("--out",), lambda args: args.snapshot is None, "is what a crop in the window is written to"),
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    text = f"{SPLATS} or .h5; with several, Tab shows the next from the same view"
    parser.add_argument("files", type=Path, nargs="+", metavar="FILE", help=text)
    parser.add_argument("--up", choices=AXES, help="the files' up axis (default: guessed)")
    text = "picture size (default 960x540, of a window: the last one's)"
    parser.add_argument("--size", type=size, metavar="WxH", help=text)
    text = "grey, black, white, or as #rrggbb (default grey)"
    parser.add_argument("--background", type=colour, default=BACKGROUND_NAMES["grey"], metavar="COLOUR", help=text)
    parser.add_argument("--snapshot", type=picture_name, metavar="OUT.png", help="no window: write one picture")
    text = "file for what a crop leaves (O): .ply, .compressed.ply, .spz or .splat (default: a new .ply each time)"
    parser.add_argument("--out", type=Path, metavar="OUT.ply", help=text)
    add_sort(parser, MOVING_SORT)
    parser.add_argument("--frames", type=positive(int), metavar="N", help="stop after N frames")
    add_arch(parser)


def run(args: argparse.Namespace) -> None:
    """Show `args.files` in a window, or write `args.snapshot`. Raises BadInput."""
    from display.viewed_file import ViewedFile, scene_around
    from display.viewer import Viewer
    from display.window.gl_window import has_display

    if args.snapshot is not None and len(args.files) > 1:
        raise BadInput("--snapshot draws one file: name one")
    if args.snapshot is None and not has_display():
        raise BadInput("no display to open a window on: --snapshot OUT.png writes a picture, `vrgs.py render` a film")
    if args.out is not None:
        kind_to_write(args.out)
        check_writable(args.out)
    files = [ViewedFile.read(path, args.up) for path in args.files]
    width, height = args.size or SIZE
    scene = replace(scene_around(files[0].gaussians, width / height), background=args.background)
    for file in files:
        g = file.gaussians
        print(f"{file.path}: {len(g)} Gaussians, SH degree {g.sh_degree}, {file.note}", file=sys.stderr)
    name = args.files[0].name if len(files) == 1 else f"{len(files)} files"
    if args.snapshot is not None:
        from display.headless.headless import Headless

        display = Headless(scene, width=width, height=height, frames=1, snapshot=args.snapshot)
    else:
        from display.preferences import Preferences
        from display.window.window import Window

        width, height = args.size or (None, None)
        kept = {"preferences": Preferences.of_user(), "name": args.files[0].name}
        display = Window(scene, title=name, width=width, height=height, **kept)
    from display.keep.keeper import Keeper

    with display, Keeper(str(args.files[0])) as keeper:
        start_taichi(args.arch)
        width, height = display.size
        viewer = Viewer(files, scene, width=width, height=height, sort=args.sort, out=args.out)
        for frame in itertools.islice(display.frames(viewer), args.frames):
            viewer.step(frame)
            display.present(viewer)
            keeper.after(frame, viewer)
