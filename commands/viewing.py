"""`vrgs.py view` and `render`: splat files in a window, through given cameras, or as a film of one turn."""

from __future__ import annotations

import contextlib
import itertools
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from assets.camera_file import read_cameras
from assets.file_access import atomic_write, check_writable
from assets.splat_files import kind_to_write, read_gaussians
from commands import options as cli
from core.camera import Camera, look_at, perspective
from core.errors import BadInput
from core.runtime import start_taichi
from display.picture import pixels_of, save_picture

if TYPE_CHECKING:
    from render.renderer import Renderer

DEFAULT_SORT = "z"  # as other renderers draw
SIZE = (960, 540)  # [px] of a picture, and from which a window's first view is chosen
TURNTABLE_FPS = 30.0  # [1/s]
WHERE = cli.OneOf()


@dataclass(kw_only=True)
class RenderOptions(cli.Options):
    EXAMPLES = ("render cat.ply --camera cam.json --out cat.png", "render cat.ply --turntable --out cat.mp4")
    CONDITIONS = (
        cli.Condition(("--up", "--size", "--frames", "--elevation"), lambda o: o.turntable, "belongs to --turntable"),
    )

    splats: Path = cli.argument("SPLATS", f"{cli.SPLATS} or .h5")
    camera: Path | None = cli.option("CAM.json", "one camera or a list", one_of=WHERE)
    turntable: bool = cli.switch(
        "film one turn around it, or to and fro where it was photographed from one side", one_of=WHERE
    )
    out: Path = cli.option("OUT.png|OUT.npz|OUT.mp4", "file to write", cli.REQUIRED)
    up: cli.Axis | None = cli.option(None, "turntable: the file's up axis (default: guessed)")
    size: cli.Size = cli.option("WxH", "turntable: picture size (default 960x540)", SIZE)
    frames: cli.Count = cli.option("N", "turntable: number of pictures (default 180)", 180)
    elevation: cli.Elevation | None = cli.option(
        "DEG", "turntable: elevation of the camera (default 15; of what was trained that of the photographs)"
    )
    sort: cli.Sort | None = cli.sort_option(DEFAULT_SORT)
    antialias: bool = cli.switch("opacity compensation of Mip-Splatting (default: as the file was trained)")
    arch: cli.Arch | None = cli.arch_option()


def render(options: RenderOptions) -> None:
    """Draw the splats into --out. Raises BadInput."""
    start_taichi(options.arch)
    if options.turntable:
        film_turntable(options)
    else:
        draw_pictures(options)


def draw_pictures(options: RenderOptions) -> None:
    """Draw through --camera: .png, 8 bits on black, or .npz, float32.

    Several cameras give OUT_000.png, OUT_001.png, ... or one NPZ with rgb (V, H, W, 3), alpha and
    depth [m] (V, H, W), unclamped and without a background. Raises BadInput.
    """
    if options.camera is None:
        raise BadInput("no camera: use --camera CAM.json, or --turntable for a film of one turn")
    out = options.out
    if out.suffix.lower() not in (".png", ".npz"):
        raise BadInput(f"{out}: the picture's name must end in .png or .npz")
    if not out.parent.is_dir():
        raise BadInput(f"{out}: the folder {out.parent} does not exist")
    cameras = read_cameras(options.camera)
    gaussians = read_gaussians(options.splats)
    how = {
        "antialias": options.antialias or gaussians.antialias,
        "sort": options.sort or gaussians.sort or DEFAULT_SORT,
    }
    start = time.perf_counter()
    if out.suffix.lower() == ".npz":
        images = draw_float(gaussians, cameras, **how)
        with atomic_write(out) as beside, open(beside, "wb") as file:
            np.savez_compressed(file, **images)
    else:
        for k, picture in enumerate(draw_rgba8(gaussians, cameras, **how)):
            save_picture(out if len(cameras) == 1 else out.with_name(f"{out.stem}_{k:03d}{out.suffix}"), picture)
    pixels = f"{cameras[0].width}x{cameras[0].height}"
    count = "1 picture" if len(cameras) == 1 else f"{len(cameras)} pictures"
    print(f"{out}: {count} {pixels} of {len(gaussians)} Gaussians, {time.perf_counter() - start:.1f} s")


def draw_float(gaussians, cameras: list[Camera], *, antialias: bool = False, sort: str = "z") -> dict[str, np.ndarray]:
    """rgb (V, H, W, 3), alpha (V, H, W), depth [m] (V, H, W), float32."""
    images = {"rgb": [], "alpha": [], "depth": []}
    for renderer in _drawn(gaussians, cameras, "float", antialias, sort):
        for name, stack in images.items():
            stack.append(getattr(renderer, name).to_numpy()[0])
    return {name: np.stack(stack) for name, stack in images.items()}


def draw_rgba8(
    gaussians, cameras: list[Camera], *, antialias: bool = False, sort: str = "radial"
) -> Iterator[np.ndarray]:
    """One (H, W, 4) uint8 RGBA picture per camera, all of one size."""
    for renderer in _drawn(gaussians, cameras, "rgba8", antialias, sort):
        yield renderer.pixels()[0].copy()


def _drawn(gaussians, cameras: list[Camera], outputs: str, antialias: bool, sort: str) -> Iterator[Renderer]:
    """The renderer after each camera's picture; its memory is freed at the end."""
    from render.renderer import Renderer
    from render.splats import Splats

    splats, first = Splats(gaussians), cameras[0]
    renderer = Renderer(splats, first.width, first.height, antialias=antialias, outputs=outputs, sort=sort)
    for camera in cameras:
        renderer.render([camera])
        yield renderer
    renderer.destroy()
    splats.destroy()


def film_turntable(options: RenderOptions) -> None:
    """Film one turn around the splats, or to and fro where they were photographed from one side: an MP4 of --frames
    pictures. Raises BadInput."""
    from display.headless.video import Video
    from display.timing import ProgressLine
    from display.viewed_file import BACKGROUND, ViewedFile, camera_around, film_yaws
    from render.renderer import Renderer
    from render.splats import Splats

    width, height = options.size
    video = Video(options.out, width, height, fps=TURNTABLE_FPS, frames=options.frames)
    with contextlib.ExitStack() as at_end:
        at_end.callback(video.close, keep=False)
        start = time.perf_counter()
        file = ViewedFile.read(options.splats, options.up)
        gaussians = file.gaussians
        renderer = Renderer(
            Splats(gaussians),
            width,
            height,
            antialias=options.antialias or gaussians.antialias,
            sort=options.sort or gaussians.sort or DEFAULT_SORT,
            background=BACKGROUND,
        )
        line = ProgressLine()
        elevation = None if options.elevation is None else np.radians(options.elevation)
        for k, yaw in enumerate(film_yaws(gaussians, options.frames)):
            renderer.render([camera_around(gaussians, width, height, yaw, elevation=elevation)])
            video.write(pixels_of(renderer.picture))
            line.show(f"frame {k + 1} of {options.frames}")
        line.end()
        video.close()
    what = f"{options.frames} pictures {width}x{height} of {len(gaussians)} Gaussians, {file.note}"
    print(f"{options.out}: {what}, {time.perf_counter() - start:.1f} s")


@dataclass(kw_only=True)
class ViewOptions(cli.Options):
    EXAMPLES = ("view cat.ply", "view before.ply after.ply", "view room.ply --background white --out part.ply")
    CONDITIONS = (
        cli.Condition(("--frames",), lambda o: o.snapshot is None, "belongs to a window: --snapshot needs one"),
        cli.Condition(("--out",), lambda o: o.snapshot is None, "is where a crop made in the window is written"),
    )

    files: list[Path] = cli.argument("FILE", f"{cli.SPLATS} or .h5; several: Tab shows the next from the same view")
    up: cli.Axis | None = cli.option(None, "the files' up axis (default: guessed)")
    size: cli.Size | None = cli.option("WxH", "picture size (default 960x540; a window: its last size)")
    background: cli.Colour = cli.option("COLOUR", "grey, black, white, or as #rrggbb (default grey)", cli.GREY)
    snapshot: cli.PictureName | None = cli.option("OUT.png", "no window: write one picture")
    out: Path | None = cli.option("OUT.ply", "what O writes a crop to: .ply, .compressed.ply, .spz or .splat")
    sort: cli.Sort | None = cli.sort_option("radial")
    frames: cli.Count | None = cli.option("N", "stop after N frames")
    arch: cli.Arch | None = cli.arch_option()


def view(options: ViewOptions) -> None:
    """Show the files in a window, or write the snapshot. Raises BadInput."""
    from display.picture import pixels_of, save_picture
    from display.viewed_file import ViewedFile, scene_around
    from display.viewer import Viewer
    from display.window.gl_window import has_display

    if options.snapshot is not None and len(options.files) > 1:
        raise BadInput("--snapshot draws a single file")
    if options.snapshot is None and not has_display():
        raise BadInput("no display to open a window on: use --snapshot OUT.png, or `vrgs.py render` for a film")
    if options.out is not None:
        kind_to_write(options.out)
        check_writable(options.out)
    files = [ViewedFile.read(path, options.up) for path in options.files]
    width, height = options.size or SIZE
    scene = replace(scene_around(files[0].gaussians, width / height), background=options.background)
    for file in files:
        g = file.gaussians
        print(f"{file.path}: {len(g)} Gaussians, SH degree {g.sh_degree}, {file.note}", file=sys.stderr)
    if options.snapshot is not None:
        check_writable(options.snapshot)
        start_taichi(options.arch)
        viewer = Viewer(files, scene, (width, height), sort=options.sort)
        viewer.draw([perspective(width, height, scene.fov_y, look_at(scene.eye, scene.target))])
        save_picture(options.snapshot, pixels_of(viewer.picture))
        return
    from display.keep.keeper import Keeper
    from display.preferences import Preferences
    from display.window.window import Window

    display = Window(
        scene,
        title=options.files[0].name if len(files) == 1 else f"{len(files)} files",
        size=options.size,
        preferences=Preferences.of_user(),
        name=options.files[0].name,
    )
    with display, Keeper(str(options.files[0])) as keeper:
        start_taichi(options.arch)
        viewer = Viewer(files, scene, display.size, sort=options.sort, out=options.out)
        for frame in itertools.islice(display.frames(viewer), options.frames):
            viewer.step(frame)
            display.present(viewer)
            keeper.after(frame, viewer)
