"""`vrgs.py render`: draw a splat file from given cameras, or film a turn around it."""

from __future__ import annotations

import contextlib
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from assets.camera_file import read_cameras
from assets.file_access import atomic_write
from assets.splat_files import read_gaussians
from commands.options import (
    SPLATS,
    Arch,
    Axis,
    Condition,
    Count,
    Elevation,
    OneOf,
    Options,
    Size,
    Sort,
    arch_option,
    argument,
    option,
    sort_option,
    switch,
)
from core.camera import Camera
from core.errors import BadInput
from core.runtime import start_taichi

DEFAULT_SORT = "z"  # as other renderers draw
TURNTABLE_FPS = 30.0  # [1/s]
WHERE = OneOf()


@dataclass(kw_only=True)
class RenderOptions(Options):
    """Options of `render`."""

    EXAMPLES = ("render cat.ply --camera cam.json --out cat.png", "render cat.ply --turntable --out cat.mp4")
    CONDITIONS = (
        Condition(
            ("--up", "--size", "--frames", "--elevation"),
            lambda o: o.turntable,
            "belongs to --turntable; a camera file says all of this itself",
        ),
    )

    splats: Path = argument("SPLATS", f"{SPLATS} or .h5")
    camera: Path | None = option("CAM.json", "one camera or a list", one_of=WHERE)
    turntable: bool = switch("film one turn around it", one_of=WHERE)
    out: Path = option("OUT.png|OUT.npz|OUT.mp4", "file to write", required=True)
    up: Axis | None = option(None, "turntable: the file's up axis (default: guessed)")
    size: Size = option("WxH", "turntable: picture size (default 960x540)", (960, 540))
    frames: Count = option("N", "turntable: number of pictures (default 180)", 180)
    elevation: Elevation = option("DEG", "turntable: elevation of the camera (default 15)", 15.0)
    sort: Sort | None = sort_option(DEFAULT_SORT)
    antialias: bool = switch("opacity compensation of Mip-Splatting")
    arch: Arch | None = arch_option()


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
    sort = options.sort or gaussians.sort or DEFAULT_SORT
    start = time.perf_counter()
    if out.suffix.lower() == ".npz":
        images = draw_float(gaussians, cameras, antialias=options.antialias, sort=sort)
        with atomic_write(out) as beside, open(beside, "wb") as file:
            np.savez_compressed(file, **images)
    else:
        for path, picture in zip(
            picture_names(out, len(cameras)), draw_rgba8(gaussians, cameras, options.antialias, sort), strict=True
        ):
            _write_png(path, picture)
    pixels = f"{cameras[0].width}x{cameras[0].height}"
    count = "1 picture" if len(cameras) == 1 else f"{len(cameras)} pictures"
    print(f"{out}: {count} {pixels} of {len(gaussians)} Gaussians, {time.perf_counter() - start:.1f} s")


def picture_names(out: Path, count: int) -> list[Path]:
    """The file names of `count` pictures."""
    return [out] if count == 1 else [out.with_name(f"{out.stem}_{i:03d}{out.suffix}") for i in range(count)]


def draw_float(gaussians, cameras: list[Camera], *, antialias: bool = False, sort: str = "z") -> dict[str, np.ndarray]:
    """rgb (V, H, W, 3), alpha (V, H, W), depth [m] (V, H, W), float32."""
    renderer = _renderer(gaussians, cameras[0], antialias, "float", sort)
    images = {"rgb": [], "alpha": [], "depth": []}
    for camera in cameras:
        renderer.render([camera])
        for name, stack in images.items():
            stack.append(getattr(renderer, name).to_numpy()[0])
    return {name: np.stack(stack) for name, stack in images.items()}


def draw_rgba8(gaussians, cameras: list[Camera], antialias: bool = False, sort: str = "z"):
    """One (H, W, 4) uint8 RGBA picture per camera."""
    renderer = _renderer(gaussians, cameras[0], antialias, "rgba8", sort)
    for camera in cameras:
        renderer.render([camera])
        yield renderer.pixels()[0]


def _renderer(gaussians, camera: Camera, antialias: bool, outputs: str, sort: str):
    from render.renderer import Renderer
    from render.splats import Splats

    return Renderer(Splats(gaussians), camera.width, camera.height, antialias=antialias, outputs=outputs, sort=sort)


def _write_png(path: Path, rgba: np.ndarray) -> None:
    import cv2

    ok, data = cv2.imencode(".png", cv2.cvtColor(rgba, cv2.COLOR_RGBA2BGR))
    if not ok:
        raise BadInput(f"{path}: the picture could not be encoded")
    with atomic_write(path) as beside:
        beside.write_bytes(data.tobytes())


def film_turntable(options: RenderOptions) -> None:
    """Film one turn around the splats: an MP4 of --frames pictures. Raises BadInput."""
    from display.headless.headless import Progress
    from display.headless.video import Video
    from display.picture import pixels_of
    from display.viewed_file import BACKGROUND, ViewedFile, camera_around
    from render.renderer import Renderer
    from render.splats import Splats

    width, height = options.size
    video = Video(options.out, width, height, fps=TURNTABLE_FPS, frames=options.frames)
    with contextlib.ExitStack() as at_end:
        at_end.callback(video.discard)
        start = time.perf_counter()
        file = ViewedFile.read(options.splats, options.up)
        gaussians = file.gaussians
        sort = options.sort or gaussians.sort or DEFAULT_SORT
        renderer = Renderer(
            Splats(gaussians), width, height, antialias=options.antialias, sort=sort, background=BACKGROUND
        )
        progress = Progress(options.frames)
        for k in range(options.frames):
            yaw = 2 * np.pi * k / options.frames
            renderer.render([camera_around(gaussians, width, height, yaw, elevation=np.radians(options.elevation))])
            video.write(pixels_of(renderer.picture))
            progress.show(k + 1)
        progress.end()
        video.close()
    seconds, count = time.perf_counter() - start, len(gaussians)
    print(
        f"{options.out}: {options.frames} pictures {width}x{height} of {count} Gaussians, {file.note}, {seconds:.1f} s"
    )
