"""A small capture with exact poses: pictures of known Gaussians, drawn by the float64 renderer."""

import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np

from assets.gaussians import Gaussians
from core.camera import Camera, look_at, perspective
from core.spherical_harmonics import C0
from prepare.train.capture_files import OPENGL_TO_OPENCV
from prepare.train.object_labels import label_colors, nearest_label
from prepare.train.photographs import Photograph
from tests.support import reference_render as reference
from tests.support.splat_encoders import ply_bytes

SIDE, VIEWS = 64, 12  # [px], number of photographs
COLOURS = ("red", "green", "blue")


def painted_gaussians(count: int = 60) -> Gaussians:
    """Coloured, opaque ellipsoids within half a metre of the origin."""
    rng = np.random.default_rng(3)
    means, quats = rng.uniform(-0.5, 0.5, (count, 3)), rng.normal(size=(count, 4))
    log_scales = np.log(rng.uniform(0.03, 0.14, (count, 3)))
    sh = (rng.uniform(0.05, 0.95, (count, 1, 3)) - 0.5) / C0
    return Gaussians.of(means, quats, log_scales, np.full(count, 3.0), sh)


def cameras() -> list[Camera]:
    """Cameras in two circles around the origin."""
    found = []
    for k in range(VIEWS):
        turn = 2 * np.pi * k / VIEWS
        eye = (1.9 * np.sin(turn), 0.5 if k % 2 else -0.4, 1.9 * np.cos(turn))
        found.append(perspective(SIDE, SIDE, 0.8, look_at(eye, (0, 0, 0))))
    return found


def photographs() -> list[Photograph]:
    """Pictures of the painted Gaussians on black, from all cameras."""
    g = painted_gaussians()
    pictures = [(reference.render(g, c, linear=True)[0].clip(0, 1) * 255).round().astype(np.uint8) for c in cameras()]
    return [Photograph(p, np.ones(p.shape[:2], bool), c) for p, c in zip(pictures, cameras(), strict=True)]


def write_capture(folder: Path) -> None:
    """Write them as a folder with transforms.json and points."""
    (folder / "images").mkdir(parents=True)
    frames = []
    for k, photograph in enumerate(photographs()):
        name = f"images/{k:02}.png"
        cv2.imwrite(str(folder / name), photograph.pixels[..., ::-1])
        matrix = np.linalg.inv(photograph.camera.world_to_camera) @ OPENGL_TO_OPENCV
        frames.append({"file_path": name, "transform_matrix": matrix.tolist()})
    c = cameras()[0]
    data = {"w": SIDE, "h": SIDE, "fl_x": c.fx, "fl_y": c.fy, "cx": c.cx, "cy": c.cy, "frames": frames}
    (folder / "transforms.json").write_text(json.dumps({**data, "ply_file_path": "sparse_pc.ply"}))
    points, colors = sparse_points()
    columns = dict(zip("xyz", points.T, strict=True)) | dict(zip(COLOURS, colors.T, strict=True))
    (folder / "sparse_pc.ply").write_bytes(ply_bytes(columns, dict.fromkeys(COLOURS, "uchar")))


def sparse_points(count: int = 150) -> tuple[np.ndarray, np.ndarray]:
    """Points near the Gaussians' centres, (count, 3), in their colours, (count, 3) uint8."""
    g, rng = painted_gaussians(), np.random.default_rng(4)
    chosen = rng.integers(0, len(g), count)
    colors = ((0.5 + C0 * g.sh[chosen, 0]).clip(0, 1) * 255).astype(np.uint8)
    return g.means[chosen] + rng.normal(0.0, 0.05, (count, 3)), colors


def painted_objects() -> np.ndarray:
    """Object of each painted Gaussian, (60,): 1 on one side, 2 on the other; there is nothing else."""
    return np.where(painted_gaussians().means[:, 0] > 0.0, 1, 2)


def masks() -> list[np.ndarray]:
    """Ids (H, W) uint8 of the objects that the photographs show."""
    g = painted_gaussians()
    labelled = replace(g, sh=(label_colors(2)[painted_objects()][:, None] - 0.5) / C0)
    return [nearest_label(reference.render(labelled, camera, linear=True)[0], 2) for camera in cameras()]
