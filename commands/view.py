"""`vrgs.py view`: look at splat files in a window."""

from __future__ import annotations

import itertools
import sys
from dataclasses import dataclass, replace
from pathlib import Path

from assets.file_access import check_writable
from assets.splat_files import kind_to_write
from commands.options import (
    BACKGROUND_NAMES,
    SPLATS,
    Arch,
    Axis,
    Colour,
    Condition,
    Count,
    Options,
    PictureName,
    Size,
    Sort,
    arch_option,
    argument,
    option,
    sort_option,
)
from core.errors import BadInput
from core.runtime import start_taichi

SIZE = (960, 540)  # [px] of a picture, and from which a window's first view is chosen


@dataclass(kw_only=True)
class ViewOptions(Options):
    """Options of `view`."""

    EXAMPLES = ("view cat.ply", "view before.ply after.ply", "view room.ply --background white --out part.ply")
    CONDITIONS = (
        Condition(("--frames",), lambda o: o.snapshot is None, "belongs to a window: --snapshot needs one"),
        Condition(("--out",), lambda o: o.snapshot is None, "is what a crop in the window is written to"),
    )

    files: list[Path] = argument("FILE", f"{SPLATS} or .h5; with several, Tab shows the next from the same view")
    up: Axis | None = option(None, "the files' up axis (default: guessed)")
    size: Size | None = option("WxH", "picture size (default 960x540, of a window: the last one's)")
    background: Colour = option("COLOUR", "grey, black, white, or as #rrggbb (default grey)", BACKGROUND_NAMES["grey"])
    snapshot: PictureName | None = option("OUT.png", "no window: write one picture")
    out: Path | None = option(
        "OUT.ply",
        "file for what a crop leaves (O): .ply, .compressed.ply, .spz or .splat (default: a new .ply each time)",
    )
    sort: Sort | None = sort_option("radial")
    frames: Count | None = option("N", "stop after N frames")
    arch: Arch | None = arch_option()


def view(options: ViewOptions) -> None:
    """Show the files in a window, or write the snapshot. Raises BadInput."""
    from display.viewed_file import ViewedFile, scene_around
    from display.viewer import Viewer
    from display.window.gl_window import has_display

    if options.snapshot is not None and len(options.files) > 1:
        raise BadInput("--snapshot draws one file: name one")
    if options.snapshot is None and not has_display():
        raise BadInput("no display to open a window on: --snapshot OUT.png writes a picture, `vrgs.py render` a film")
    if options.out is not None:
        kind_to_write(options.out)
        check_writable(options.out)
    files = [ViewedFile.read(path, options.up) for path in options.files]
    width, height = options.size or SIZE
    scene = replace(scene_around(files[0].gaussians, width / height), background=options.background)
    for file in files:
        g = file.gaussians
        print(f"{file.path}: {len(g)} Gaussians, SH degree {g.sh_degree}, {file.note}", file=sys.stderr)
    name = options.files[0].name if len(files) == 1 else f"{len(files)} files"
    if options.snapshot is not None:
        from display.headless.headless import Headless

        display = Headless(scene, width=width, height=height, frames=1, snapshot=options.snapshot)
    else:
        from display.preferences import Preferences
        from display.window.window import Window

        width, height = options.size or (None, None)
        display = Window(
            scene,
            title=name,
            width=width,
            height=height,
            preferences=Preferences.of_user(),
            name=options.files[0].name,
        )
    from display.keep.keeper import Keeper

    with display, Keeper(str(options.files[0])) as keeper:
        start_taichi(options.arch)
        width, height = display.size
        viewer = Viewer(files, scene, width=width, height=height, sort=options.sort, out=options.out)
        for frame in itertools.islice(display.frames(viewer), options.frames):
            viewer.step(frame)
            display.present(viewer)
            keeper.after(frame, viewer)
