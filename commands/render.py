"""`vrgs.py render`: draw a splat file from given cameras into PNG or NPZ files."""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import numpy as np

from assets.camera_file import read_cameras
from assets.file_access import atomic_write
from assets.splat_files import read_gaussians
from core.camera import Camera
from core.errors import BadInput


def run(args: argparse.Namespace) -> None:
    """Draw `args.splats` through `args.camera` into `args.out`: .png, 8 bits on black, or .npz, float32.

    Several cameras give OUT_000.png, OUT_001.png, ... or one NPZ with rgb (V, H, W, 3), alpha and
    depth [m] (V, H, W), unclamped and without a background. Raises BadInput.
    """
    if args.camera is None:
        raise BadInput("from where? --camera CAM.json, or --turntable for a film from all sides")
    out = Path(args.out)
    if out.suffix.lower() not in (".png", ".npz"):
        raise BadInput(f"{out}: the picture's name must end in .png or .npz")
    if not out.parent.is_dir():
        raise BadInput(f"{out}: the folder {out.parent} does not exist")
    cameras = read_cameras(args.camera)
    gaussians = read_gaussians(args.splats)
    start = time.perf_counter()
    if out.suffix.lower() == ".npz":
        images = draw_float(gaussians, cameras, antialias=args.antialias, sort=args.sort)
        with atomic_write(out) as beside, open(beside, "wb") as file:
            np.savez_compressed(file, **images)
    else:
        for path, picture in zip(
            names(out, len(cameras)), draw_rgba8(gaussians, cameras, args.antialias, args.sort), strict=True
        ):
            _write_png(path, picture)
    size = f"{cameras[0].width}x{cameras[0].height}"
    count = "1 picture" if len(cameras) == 1 else f"{len(cameras)} pictures"
    print(f"{out}: {count} {size} of {len(gaussians)} Gaussians, {time.perf_counter() - start:.1f} s")


def names(out: Path, count: int) -> list[Path]:
    """Where each of `count` pictures goes."""
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
