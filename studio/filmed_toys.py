"""Films of modelled toys whose material is known, as a telephone would take them: the truth of `vrgs.py fit`.

What moves them differs from what fits them: each tet of the cage is cut in eight, twice, and the integrator is XPBD
with its own, shorter substeps. Pictures are blurred by lens and shutter, their rows are read one after the other, and
they are noisy and compressed.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from assets.asset import Asset
from assets.camera_file import write_cameras
from assets.file_access import make_folder
from assets.library import find_asset
from core.camera import Camera, look_at, perspective
from core.errors import BadInput
from core.material import Material
from display.drawn_body import DrawnBody
from display.headless.video import Video
from prepare.fit.linear_elasticity import subdivided
from prepare.segment.marks import Marks, ViewMarks, write_marks
from sim.rollouts import Candidate, Rollouts
from studio.stroke_marks import stroke_within

CUTS = 2  # of the cage: its slowest modes are then 1 to 4% slower than after one, and stay so to 1 or 2%
SHUTTER, READOUT = 1 / 120, 0.012  # [s] that a row of a picture takes, and from the first row to the last
MOMENTS = 7  # of a picture that are drawn, evenly spaced: a row mixes those of its own time
LENS_BLUR, NOISE = 0.6, 2.0 / 255  # [px], and of a channel 0..1


@dataclass(frozen=True)
class FilmedToy:
    """A clip: a shipped asset, what it is made of, and how it moves.

    held     share of its height, from the top, that stands still, from the bottom if negative; 0: it is free
    push     [m/s] in x, y, z of the free end at the start, or of all of a free body;   spin  [rad/s] of a free body
    bend     [m] by which a free body is bent at the start
    tilt     [degrees] of the board that it slides down, 0 of the floor; None: there is none
    drop     [m] over that from which it falls;   lean  [degrees] to the side
    turn     [degrees] about the vertical;   before  [s] that have passed when the film begins
    shake    [px] by which the hand that holds the camera turns it to each side
    yield_strain  beyond which it stays bent; None: it springs back
    """

    asset: str
    young: float
    damping: float
    friction: float = 0.5
    held: float = 0.0
    push: tuple[float, float, float] = (0.0, 0.0, 0.0)
    spin: tuple[float, float, float] = (0.0, 0.0, 0.0)
    bend: float = 0.0
    tilt: float | None = None
    drop: float = 0.0
    lean: float = 0.0
    turn: float = 0.0
    before: float = 0.0
    seconds: float = 1.0
    fps: float = 30.0
    shake: float = 0.0
    yield_strain: float | None = None


CLIPS = {
    "rabbit_hung": FilmedToy("rabbit", 5e3, 3.0, held=0.25, push=(0.5, 0.0, 0.25), turn=25.0),
    "rabbit_by_hand": FilmedToy("rabbit", 5e3, 3.0, held=0.25, push=(0.5, 0.0, 0.25), turn=25.0, shake=6.0),
    "toy_rabbit_hung": FilmedToy("toy_rabbit", 4e3, 2.0, held=0.4, push=(1.0, 0.0, 0.4), turn=20.0, seconds=1.2),
    "cat_hung": FilmedToy("toy_cat", 1.5e4, 6.0, held=0.2, push=(1.6, 0.0, 0.6), turn=-20.0),
    "cat_of_clay": FilmedToy("toy_cat", 4e4, 4.0, held=0.2, push=(2.5, 0.0, 0.75), turn=-20.0, yield_strain=0.05),
    "teddy_hung": FilmedToy("toy_teddy", 8e3, 4.0, held=0.3, push=(0.9, 0.0, 0.3), turn=15.0),
    "penguin_hung": FilmedToy("toy_penguin", 3e4, 3.0, held=0.25, push=(1.8, 0.0, 0.5), turn=-35.0),
    "whale_hung": FilmedToy("toy_whale", 1e3, 2.0, held=0.3, push=(0.2, 0.0, 0.1), turn=60.0, seconds=1.5),
    "star_hung": FilmedToy("toy_star", 1e5, 4.0, held=0.25, push=(2.5, 0.0, 0.6), fps=60.0, seconds=0.8),
    "duck_hung": FilmedToy("toy_duck", 3e5, 8.0, held=0.3, push=(3.0, 0.0, 1.0), turn=40.0, fps=120.0, seconds=0.5),
    "dinosaur_hung": FilmedToy("toy_dinosaur", 1e6, 10.0, held=0.25, push=(4.0, 0, 1.0), turn=70, fps=240, seconds=0.3),
    "jelly_hung": FilmedToy("jelly_bear", 1.2e4, 5.0, held=0.25, push=(0.6, 0.0, 0.2), turn=10.0),
    "ladybird_pressed": FilmedToy("toy_ladybird", 4e3, 3.0, held=-0.2, push=(0.3, -0.7, 0.0), turn=20.0),
    "octopus_pressed": FilmedToy("toy_octopus", 2e4, 5.0, held=-0.2, push=(0.8, -1.2, 0.2), turn=10.0),
    "frog_pressed": FilmedToy(
        "toy_frog", 2e4, 2.0, held=-0.25, push=(3.0, -2.0, 0.5), turn=-15.0, fps=60.0, seconds=0.7
    ),
    "parcel_sliding": FilmedToy("box_parcel", 4e4, 20.0, friction=0.25, tilt=25.0, seconds=0.8),
    "parcel_slower": FilmedToy("box_parcel", 1e5, 10.0, friction=0.4, tilt=30.0, seconds=0.9),
    "crate_sliding": FilmedToy("box_crate", 1e6, 10.0, friction=0.1, tilt=12.0, seconds=0.8),
    "tin_sliding": FilmedToy("box_tin", 1e6, 10.0, friction=0.55, tilt=38.0, seconds=0.8),
    "cat_dropped": FilmedToy("toy_cat", 1.5e4, 6.0, tilt=0.0, drop=0.1, lean=10.0, seconds=0.7),
    "jelly_dropped": FilmedToy("jelly_bear", 1.2e4, 5.0, tilt=0.0, drop=0.05, lean=10.0, seconds=0.6),
    "teddy_dropped": FilmedToy("toy_teddy", 3e4, 4.0, tilt=0.0, drop=0.1, lean=-12.0, turn=20.0, seconds=0.7),
    "cat_thrown": FilmedToy("toy_cat", 1.5e4, 6.0, push=(0.6, 1.5, 0), spin=(0, 0, -1.5), bend=0.015, seconds=0.5),
}


def film_toy(name: str, folder: Path, report: Callable[[str], None], *, size=(480, 360), seed=0) -> None:
    """Write NAME.mp4, its camera, strokes in two of its pictures, and the truth into a folder. Taichi must be running.

    Raises BadInput.
    """
    if name not in CLIPS:
        raise BadInput(f"{name}: no such clip; there are {', '.join(CLIPS)}")
    make_folder(folder)
    clip = CLIPS[name]
    asset = Asset.load(find_asset(clip.asset))
    body = replace(asset.material, young=clip.young, damping=clip.damping, friction=clip.friction)
    body = replace(body, kinetic_friction=None, yield_strain=clip.yield_strain)
    count, rng = round(clip.seconds * clip.fps), np.random.default_rng(seed)
    moments, shares = exposures(size[1], 1 / clip.fps)
    times = (np.arange(count)[:, None] / clip.fps + moments - moments[0]).ravel()
    moving, held, planes = motion_of(clip, asset, body, times)
    report(f"{name}: moved")
    camera = camera_for(moving, size)
    background = backdrop(camera, rng)
    drawn = DrawnBody(asset, *size)
    video = Video(folder / f"{name}.mp4", *size, fps=clip.fps, frames=count)
    alphas = []
    for k in range(count):
        picture, alpha = np.zeros((size[1], size[0], 3)), np.zeros(size[::-1])
        for share, j in zip(shares, range(k * MOMENTS, (k + 1) * MOMENTS), strict=True):
            turned, behind = shaken(camera, background, clip.shake, times[j])
            drawn.move(moving[j])
            rgb, a, _ = drawn.picture(turned)
            picture += share[:, None, None] * (rgb + (1 - a[..., None]) * behind)
            alpha += share[:, None] * a
        picture = cv2.GaussianBlur(picture, (0, 0), LENS_BLUR) + NOISE * rng.normal(size=picture.shape)
        video.write((picture.clip(0, 1) * 255 + 0.5).astype(np.uint8))
        alphas.append(alpha > 0.5)
    video.close()
    drawn.destroy()
    write_cameras(folder / f"{name}.camera.json", [camera])
    write_marks(folder / f"{name}.marks.json", marks_on(alphas, held, camera))
    truth = {"clip": asdict(clip), "density": body.density, "planes": planes.tolist(), "start": moving[0].tolist()}
    (folder / f"{name}.truth.json").write_text(json.dumps(truth), encoding="utf-8")
    report(f"{name}: filmed, {count} pictures")


def exposures(rows: int, period: float) -> tuple[np.ndarray, np.ndarray]:
    """Moments (M,) [s] about a picture's time, of which one is taken each period [s], and each row's shares (M, rows)
    of what is seen in them; between two moments it fades."""
    shutter, readout = min(SHUTTER, 0.4 * period), min(READOUT, 0.5 * period)
    moments = 0.5 * (shutter + readout) * np.linspace(-1, 1, MOMENTS)
    begin = readout * (np.arange(rows) / (rows - 1) - 0.5) - shutter / 2
    lit = begin[:, None] + shutter * (np.arange(64) + 0.5) / 64
    near = (lit - moments[0]) / (moments[1] - moments[0])
    return moments, np.stack([(1 - np.abs(near - m)).clip(0).mean(1) for m in range(MOMENTS)])


def motion_of(clip: FilmedToy, asset: Asset, material: Material, times: np.ndarray):
    """Places of the asset's cage (F, V, 3) [m] at the times [s], those that are held (H, 3), and the planes (P, 4)."""
    x, tets = asset.cage.vertices, asset.cage.tets
    for _ in range(CUTS):
        x, tets, _ = subdivided(x, tets)
    bottom, height = x[:, 1].min(), np.ptp(x[:, 1])
    away = (bottom + height - x[:, 1] if clip.held > 0 else x[:, 1] - bottom) / height  # from the end that is held
    held = np.flatnonzero(away <= abs(clip.held)) if clip.held else np.zeros(0, np.int64)
    planes = np.zeros((0, 4))
    c, s = np.cos(np.radians(clip.turn)), np.sin(np.radians(clip.turn))
    turn = np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])
    start = x @ turn.T
    if clip.tilt is not None:
        start = start @ Rotation.from_euler("z", -clip.tilt - clip.lean, degrees=True).as_matrix().T
        a = np.radians(clip.tilt)
        planes = np.array([[np.sin(a), np.cos(a), 0.0, 0.0]])
        start += (clip.drop - (start @ planes[0, :3]).min()) * planes[0, :3]
    v = np.tile(np.asarray(clip.push, float), (len(x), 1))
    if clip.held:
        v *= away[:, None] ** 1.5
    v += np.cross(clip.spin, start - start.mean(0))
    start += clip.bend * np.cos(2 * np.pi * (x[:, 1:2] - bottom) / height) * [1.0, 0.0, 0.0]
    rollouts = Rollouts(x, tets, held, 1, planes=planes, integrator="xpbd")
    own = len(asset.cage.vertices)
    found = rollouts.run([Candidate(material, start, v)], np.r_[0.0, times + clip.before], lambda q: q[:, :own])
    rollouts.destroy()
    return found[1:, 0], start[held], planes


def camera_for(moving: np.ndarray, size: tuple[int, int]) -> Camera:
    """A camera that keeps the whole motion (F, V, 3) in the picture, from the front and a little above."""
    low, high = moving.min((0, 1)), moving.max((0, 1))
    middle = (low + high) / 2
    away = 1.3 * max(high[1] - low[1], (high[0] - low[0]) * size[1] / size[0]) + (high[2] - low[2]) / 2
    eye = middle + away * np.array([0.12, 0.16, 1.0])
    return perspective(*size, np.radians(50), look_at(eye, middle))


def shaken(camera: Camera, behind: np.ndarray, shake: float, time: float) -> tuple[Camera, np.ndarray]:
    """The camera, turned by a hand at a time [s], by `shake` [px] to each side and as much about its axis; what it sees
    behind, of what it saw at the start."""
    angles = (np.sin(2 * np.pi * np.array([3.1, 2.3, 1.7]) * time + [0, 1, 2]) - np.sin([0, 1, 2])) * shake / camera.fx
    frame = np.eye(4)
    frame[:3, :3] = Rotation.from_rotvec(angles).as_matrix()
    lens = np.array([[camera.fx, 0, camera.cx - 0.5], [0, camera.fy, camera.cy - 0.5], [0, 0, 1]])
    move = lens @ frame[:3, :3] @ np.linalg.inv(lens)
    size, edge = (camera.width, camera.height), cv2.BORDER_REFLECT
    seen = cv2.warpPerspective(behind, move, size, borderMode=edge) if shake else behind
    return replace(camera, world_to_camera=frame @ camera.world_to_camera), seen


def backdrop(camera: Camera, rng: np.random.Generator) -> np.ndarray:
    """A wall and a table in soft mottled colours, (H, W, 3) 0..1."""
    height, width = camera.height, camera.width
    picture = np.tile(np.array([0.70, 0.62, 0.50]), (height, width, 1))
    picture[int(0.78 * height) :] = [0.30, 0.34, 0.40]
    for scale, strength in ((90, 0.05), (24, 0.025), (6, 0.015)):
        shape = (height // scale + 2, width // scale + 2)
        coarse = rng.normal(size=(*shape, 1)) + 0.3 * rng.normal(size=(*shape, 3))
        picture += strength * cv2.resize(coarse, (width, height), interpolation=cv2.INTER_CUBIC)
    return picture.clip(0.02, 0.98)


def marks_on(alphas: list[np.ndarray], held: np.ndarray, camera: Camera) -> Marks:
    """A stroke on the toy and a box around it in the first picture and in one in the middle; a box of what is held."""
    marks, size = Marks({"toy": {}}), [camera.width, camera.height] * 2
    for k in (0, len(alphas) // 2):
        x, y, w, h = cv2.boundingRect(alphas[k].astype(np.uint8))
        box = np.array([x - 5, y - 5, x + w + 5, y + h + 5], float).clip(0, size)
        marks.objects["toy"][f"frame_{k:04d}"] = ViewMarks([stroke_within(alphas[k])], boxes=[box])
    if len(held):
        u, v, _ = camera.projected(held)
        box = np.array([u.min(), v.min(), u.max(), v.max()]) + [-1, -1, 1, 1]
        marks.objects["held"] = {"frame_0000": ViewMarks(boxes=[box.clip(0, size)])}
    return marks
