"""A corner of a room whose walls, floor and boxes have patterns, photographed by casting rays: exact, with any lens."""

import json
from pathlib import Path

import cv2
import numpy as np

from core.camera import Camera, look_at, perspective
from prepare.train.capture import Lens
from prepare.train.capture_files import OPENGL_TO_OPENCV

Quad = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]  # corner and two edges [m], (3,), and pattern (S, S, 3)
PATTERN = 512  # [px]


def quad(rng: np.random.Generator, corner, one, other) -> Quad:
    layers = [cv2.resize(rng.normal(size=(n, n, 3)), (PATTERN, PATTERN), interpolation=cv2.INTER_CUBIC)
              for n in (5, 20, 60)]  # fmt: skip
    return *(np.array(v, float) for v in (corner, one, other)), (128 + 28 * sum(layers)).clip(0, 255).astype(np.float32)


def box(rng: np.random.Generator, low, size) -> list[Quad]:
    """All sides of a box but the lower one."""
    x, y, z = np.diag(np.array(size, float))
    low = np.array(low, float)
    return [quad(rng, *q) for q in ((low, x, y), (low + z, x, y), (low, z, y), (low + x, z, y), (low + y, x, z))]


def corner_of_a_room(seed: int) -> list[Quad]:
    rng = np.random.default_rng(seed)
    corner, right, up, ahead = (-2, 0, -2), (4, 0, 0), (0, 2.4, 0), (0, 0, 4)
    walls = [quad(rng, corner, *edges) for edges in ((right, up), (ahead, up), (right, ahead))]
    return [*walls, *box(rng, (-0.6, 0, -1.2), (1.1, 0.7, 0.6))]


def photographed(quads: list[Quad], camera: Camera, distortion: tuple[float, ...] = ()) -> np.ndarray:
    """The picture (H, W, 3) uint8, of four rays a pixel, through a lens with OpenCV's coefficients."""
    wide = camera.resized(2 * camera.width, 2 * camera.height)
    lens = Lens(wide.width, wide.height, wide.fx, wide.fy, wide.cx, wide.cy, distortion)
    places = np.mgrid[: wide.width, : wide.height].reshape(2, -1).T + 0.5
    x, y = lens.undistort_points(places).T.reshape(2, wide.width, wide.height).swapaxes(1, 2)
    rays = np.stack([(x - wide.cx) / wide.fx, (y - wide.cy) / wide.fy, np.ones_like(x)], 2)
    rays = rays @ wide.world_to_camera[:3, :3]
    picture, nearest = np.full((*x.shape, 3), 90, np.float32), np.full(x.shape, np.inf)
    for corner, one, other, pattern in quads:
        normal = np.cross(one, other)
        away = normal @ (corner - camera.position) / (rays @ normal)
        at = camera.position + away[..., None] * rays - corner
        u, v = at @ one / (one @ one), at @ other / (other @ other)
        seen = (away > 0) & (away < nearest) & (u > 0) & (v > 0) & (u < 1) & (v < 1)
        nearest[seen] = away[seen]
        places = [np.where(seen, w * PATTERN - 0.5, 0).astype(np.float32) for w in (u, v)]
        picture[seen] = cv2.remap(pattern, *places, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)[seen]
    return cv2.resize(picture, (camera.width, camera.height), interpolation=cv2.INTER_AREA).round().astype(np.uint8)


def cameras(count: int = 9) -> list[Camera]:
    """Cameras in an arc before the corner, the first two in one place."""
    turns = np.linspace(-0.35, 1.3, count - 1)
    eyes = [(-0.3 + 2.6 * np.sin(a), 1.3 + 0.2 * np.cos(5 * a), -0.6 + 2.6 * np.cos(a)) for a in turns]
    return [perspective(400, 300, np.radians(58), look_at(e, (-0.4, 0.7, -0.9))) for e in (eyes[0], *eyes)]


def write_room(folder: Path, quads: list[Quad]) -> None:
    """Write its photographs as a folder with transforms.json."""
    (folder / "images").mkdir(parents=True)
    frames = []
    for k, camera in enumerate(cameras()):
        cv2.imwrite(str(folder / f"images/{k:02}.png"), photographed(quads, camera)[..., ::-1])
        matrix = np.linalg.inv(camera.world_to_camera) @ OPENGL_TO_OPENCV
        frames.append({"file_path": f"images/{k:02}.png", "transform_matrix": matrix.tolist()})
    c = cameras()[0]
    lens = {"w": c.width, "h": c.height, "fl_x": c.fx, "fl_y": c.fy, "cx": c.cx, "cy": c.cy}
    (folder / "transforms.json").write_text(json.dumps({**lens, "frames": frames}))
