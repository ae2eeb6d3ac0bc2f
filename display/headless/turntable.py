"""`vrgs.py render --turntable`: a film of one turn around a splat."""

from __future__ import annotations

import contextlib
from time import perf_counter

import numpy as np

from core.runtime import start_taichi
from display.headless.headless import Progress
from display.headless.video import Video
from display.picture import pixels_of
from display.viewer import BACKDROP, camera_around, upright

FPS = 30.0  # [1/s]


def run(args) -> None:
    """Film `args.splats` from all sides into `args.out`, an MP4 of `args.frames` pictures. Raises BadInput."""
    width, height = args.size
    video = Video(args.out, width, height, fps=FPS, frames=args.frames)
    with contextlib.ExitStack() as at_end:
        at_end.callback(video.discard)
        start = perf_counter()
        gaussians, up = upright(args.splats, args.up)
        start_taichi(args.arch)
        from render.renderer import Renderer
        from render.splats import Splats

        how = {"antialias": args.antialias, "sort": args.sort, "background": BACKDROP}
        renderer = Renderer(Splats(gaussians), width, height, **how)
        progress = Progress(args.frames)
        for k in range(args.frames):
            camera = camera_around(
                gaussians, width, height, 2 * np.pi * k / args.frames, above=np.radians(args.elevation)
            )
            renderer.render([camera])
            video.write(pixels_of(renderer.picture))
            progress.show(k + 1)
        progress.end()
        video.close()
    seconds = perf_counter() - start
    size = f"{width}x{height}"
    print(f"{args.out}: {args.frames} pictures {size} of {len(gaussians)} Gaussians, {up}, {seconds:.1f} s")
