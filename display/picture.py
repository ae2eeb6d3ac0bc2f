"""The finished picture: its pixels on the host, a picture file, the surface that it shows."""

from __future__ import annotations

import re
from collections.abc import Container
from dataclasses import replace
from datetime import datetime
from pathlib import Path

import numpy as np

from assets.file_access import PICTURES, atomic_write, check_writable, unused_name
from core.camera import Camera
from core.errors import BadInput

SURFACE_SIDE = 16  # [px] of the part of the picture that is drawn for its depth: a tile
OPAQUE = 0.5  # of a pixel; fainter ones show no surface


def pixels_of(picture) -> np.ndarray:
    """Pixels (H, W, 4) uint8 RGBA of a finished picture, a ti.ndarray u32 (H, W).

    On the CPU this is a view of the picture itself, valid until the next one is drawn (a copy through
    Taichi takes 4 ms at 960x540, more than the rest of showing it); from a GPU it is a copy.
    """
    from core.fields import view_of

    return np.asarray(view_of(picture))


def surface_point(splats, camera: Camera, u: float, v: float) -> np.ndarray | None:
    """The point (3,) [m] of splats (render/splats.py) that is seen at a pixel; None: nothing opaque is there."""
    from render.renderer import Renderer

    if not (0 <= u < camera.width and 0 <= v < camera.height):
        return None
    left, top = int(u) - SURFACE_SIDE // 2, int(v) - SURFACE_SIDE // 2
    near = replace(camera, width=SURFACE_SIDE, height=SURFACE_SIDE, cx=camera.cx - left, cy=camera.cy - top)
    renderer = Renderer(splats, SURFACE_SIDE, SURFACE_SIDE, outputs="float", sort="z")
    renderer.render([near])
    middle = (0, SURFACE_SIDE // 2, SURFACE_SIDE // 2)
    depth, alpha = renderer.depth.to_numpy()[middle], renderer.alpha.to_numpy()[middle]
    renderer.destroy()
    if alpha < OPAQUE:
        return None
    origin, direction = camera.ray(u, v)
    return origin + direction * float(depth / alpha) / float(direction @ camera.world_to_camera[2, :3])


def side_by_side(pixels: np.ndarray, views: int) -> np.ndarray:
    """Views that lie one below the other (views * H, W, 4), one beside the other (H, views * W, 4)."""
    return np.concatenate(np.split(pixels, views), axis=1) if views > 1 else pixels


def save_picture(path: str | Path, pixels: np.ndarray) -> None:
    """Write RGBA or RGB pixels (H, W, 3|4) uint8 as an opaque picture of the kind that the suffix says.

    Raises BadInput.
    """
    import cv2

    path = Path(path)
    if path.suffix.lower() not in PICTURES:
        raise BadInput(f"{path}: a picture's name ends in {', '.join(PICTURES[:-1])} or {PICTURES[-1]}")
    ok, data = cv2.imencode(path.suffix.lower(), np.ascontiguousarray(pixels[..., 2::-1]))
    if not ok:
        raise BadInput(f"{path}: cannot encode a picture of {pixels.shape[1]}x{pixels.shape[0]} pixels")
    with atomic_write(path) as beside:
        beside.write_bytes(data.tobytes())


def fit(picture: tuple[int, int], frame: tuple[int, int]) -> tuple[int, int, int, int]:
    """Largest (left, top, width, height) in a frame of (width, height) with the picture's aspect, centred."""
    scale = min(frame[0] / picture[0], frame[1] / picture[1])
    width, height = round(picture[0] * scale), round(picture[1] * scale)
    return (frame[0] - width) // 2, (frame[1] - height) // 2, width, height


def output_path(scene: str, ending: str, taken: Container[Path] = ()) -> Path:
    """Path of a new file, SCENE_TIME followed by `ending` (".png", "_camera.json").

    It is in the current folder, or, if that is not writable, in the user's folder of pictures, or home. Neither a file
    that exists nor one of those `taken` has this name. Raises BadInput if neither folder is writable.
    """
    stem = re.sub(r"[^\w.-]+", "_", Path(scene).stem) or "scene"
    name = f"{stem}_{datetime.now().strftime('%Y-%m-%d_%H-%M-%S')}{ending}"
    pictures, error = Path.home() / "Pictures", None
    for folder in (Path.cwd(), pictures if pictures.is_dir() else Path.home()):
        path = unused_name(folder / name, taken)
        try:
            check_writable(path)
            return path
        except BadInput as e:
            error = error or e
    raise error
