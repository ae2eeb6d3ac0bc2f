"""A speckled block that is held at one end and let go, as linear elasticity moves it, and a small film of it."""

from dataclasses import replace

import cv2
import numpy as np

from assets.asset import Asset, Cage
from assets.camera_file import write_cameras
from core.camera import Camera, look_at, perspective
from core.material import Material
from core.tetmesh import boundary_surface, box_mesh
from display.drawn_body import DrawnBody
from display.headless.video import Video
from prepare.cage.embedding_hosts import embed
from prepare.fit.linear_elasticity import ElasticShape
from prepare.segment.marks import Marks, ViewMarks, write_marks
from tests.support.samples import discs

SIZE = np.array([0.2, 0.06, 0.05])
TRUE = Material(6e4, 0.3, 200.0, damping=3.0)
FPS, FRAMES, PIXELS = 60, 42, (160, 120)
TIMES = np.arange(FRAMES) / FPS  # [s]
NAMES = ("clip.mp4", "camera.json", "marks.json")


def speckled_block(material: Material) -> Asset:
    """The block, whose faces have smooth colours that are nowhere alike."""
    x, tets, _ = box_mesh(SIZE, (8, 2, 2))
    rng = np.random.default_rng(0)
    faces = [rng.uniform(0, 1, (700, 3)) for _ in range(6)]
    for k, points in enumerate(faces):
        points[:, k // 2] = 0.02 + 0.96 * (k % 2)
    points = np.concatenate(faces)
    waves, phases = rng.normal(size=(3, 4, 3)) * 100.0, rng.uniform(0, 6, (3, 4))  # [1/m]
    colours = 0.5 + 0.12 * np.sin(np.einsum("nj,ckj->nck", points * SIZE, waves) + phases).sum(2)
    gaussians = discs(points * SIZE, 0.0025, colours)
    embedding = embed(gaussians.means, gaussians.quats, np.exp(gaussians.log_scales), x, tets)
    cage = Cage(x.astype(np.float32), tets.astype(np.int32), boundary_surface(tets))
    return Asset(gaussians, cage, embedding, material=material)


def let_go(asset: Asset, times: np.ndarray, material: Material = TRUE) -> np.ndarray:
    """Places of the cage (F, V, 3) [m]: at rest at first, held at x = 0, and pulled by gravity from then on."""
    x = asset.cage.vertices.astype(np.float64)
    shape = ElasticShape(x, asset.cage.tets, np.flatnonzero(x[:, 0] < 1e-6), material.poisson, 8)
    moved = np.tile(x, (len(times), 1, 1))
    for mode, stiffness in zip(shape.modes, shape.stiffness, strict=True):
        w2 = stiffness * material.young / material.density
        sag = -9.81 * (shape.mass @ mode[:, 1]) / (shape.mass @ (mode**2).sum(1)) / w2
        c, w = material.damping, np.sqrt(w2 - material.damping**2 / 4)  # as solvers that take no inner friction
        q = sag * (1 - np.exp(-c / 2 * times) * (np.cos(w * times) + c / 2 / w * np.sin(w * times)))
        moved += q[:, None, None] * mode
    return moved


def camera_of() -> Camera:
    middle = SIZE / 2 - [0, 0.02, 0]
    return perspective(*PIXELS, np.radians(32), look_at(middle + [-0.06, 0.12, 0.36], middle))


def pixel_map(camera: Camera, turns: np.ndarray) -> np.ndarray:
    """Homographies (..., 3, 3) of pixels, from the middle of the first, that turns (..., 3, 3) of a camera make."""
    lens = np.array([[camera.fx, 0, camera.cx - 0.5], [0, camera.fy, camera.cy - 0.5], [0, 0, 1]])
    return lens @ turns @ np.linalg.inv(lens)


def filmed(asset: Asset, moving: np.ndarray, camera: Camera, seed: int = 0, turns: np.ndarray | None = None):
    """Pictures (F, H, W, 3) uint8 of the block over a mottled wall, with noise. Taichi must be running.

    turns  (F, 3, 3) of the camera's frame in each picture; None: it stands still
    """
    rng, drawn = np.random.default_rng(seed), DrawnBody(asset, camera.width, camera.height)
    coarse = rng.normal(size=(camera.height // 12, camera.width // 12, 1)).astype(np.float32)
    wall = 120 + 12 * cv2.resize(coarse, (camera.width, camera.height), interpolation=cv2.INTER_CUBIC)
    wall = np.repeat(wall[..., None], 3, 2)
    pictures = []
    for x, turn in zip(moving, np.tile(np.eye(3), (len(moving), 1, 1)) if turns is None else turns, strict=True):
        drawn.move(x)
        noise, frame = 1.5 * rng.normal(size=wall.shape), np.eye(4)
        frame[:3, :3] = turn
        behind = cv2.warpPerspective(wall, pixel_map(camera, turn), PIXELS, borderMode=cv2.BORDER_REFLECT)
        seen = drawn.over(behind, replace(camera, world_to_camera=frame @ camera.world_to_camera))
        pictures.append((seen + noise).clip(0, 255).astype(np.uint8))
    drawn.destroy()
    return np.stack(pictures)


def marks_of(camera: Camera, moving: np.ndarray, pictures=(0, FRAMES // 2)) -> Marks:
    """A stroke along the block and a box around it in some pictures, and a box around its held end in the first."""
    marks = Marks({"block": {}})
    for k in pictures:
        u, v, _ = camera.projected(moving[k])
        line = np.stack(camera.projected(moving[k][np.abs(moving[0] - SIZE / 2)[:, 1:].max(1) < 1e-6])[:2], 1)
        box = np.array([u.min() - 3, v.min() - 3, u.max() + 3, v.max() + 3])
        marks.objects["block"][f"frame_{k:04d}"] = ViewMarks([line[2:-1]], boxes=[box])
    u, v, _ = camera.projected(moving[0][moving[0][:, 0] < 1e-6])
    held = np.array([u.min() - 3, v.min() - 3, u.max() + 3, v.max() + 3])
    marks.objects["held"] = {"frame_0000": ViewMarks(boxes=[held])}
    return marks


def write_film(folder, asset: Asset, moving: np.ndarray, camera: Camera, marked=(0, FRAMES // 2)) -> None:
    """The film, its camera and the marks, by NAMES, in a folder."""
    video = Video(folder / NAMES[0], *PIXELS, fps=FPS)
    for picture in filmed(asset, moving, camera):
        video.write(picture)
    video.close()
    write_cameras(folder / NAMES[1], [camera])
    write_marks(folder / NAMES[2], marks_of(camera, moving, marked))


def stiffer(asset: Asset, factor: float) -> Asset:
    return replace(asset, material=replace(TRUE, young=factor * TRUE.young, damping=8.0))
