"""Stiffness sweep: a body is dropped on a floor with one Young's modulus after another, measured and drawn.

The paper finds materials in this way: by how far the body deforms with each modulus (VR-GS, Sec. 5).
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np

from assets.asset import Asset
from assets.gaussians import Gaussians
from core.camera import Camera, look_at, perspective
from core.material import Material
from core.rotation import best_fit_rotation
from core.spherical_harmonics import C0
from core.vocabulary import Body, Light, Plane
from display.panel import pascals
from display.picture import pixels_of
from display.protocol import Frame
from scenes.scene import Scene

STEP = 1 / 120  # [s] between two measurements: a stiff body touches the floor for some milliseconds only
DROP_TIME_MAX = 4.0  # [s]
REST_SPEED = 0.02  # [m/s], root mean square over the vertices
REST_TIME = 0.25  # [s] below REST_SPEED
FLOOR_BACKGROUND = (0.93, 0.92, 0.90)
FLOOR_COLOUR, LINE_COLOUR = (0.80, 0.78, 0.75), (0.66, 0.64, 0.62)
FLOOR_CELLS = 160  # Gaussians along each side of the floor
LINE_SPACING = 10  # Gaussians
FLOOR_SIZE = 8.0  # sides of the floor, in sizes of the body
FOV = 0.55  # [rad]
CAMERA_ELEVATION, AZIMUTH = 0.33, 0.35  # [rad] of the camera above the floor, and from +z to +x
PANEL = 300  # [px]
GAP, MARGIN, HEAD, FOOT = 6, 18, 104, 30  # [px]
PAPER, INK, FAINT, ACCENT = (250, 249, 247), (40, 38, 36), (120, 116, 112), (200, 70, 40)
FRAMING = 0.9  # what the picture shows to each side, of the body's half diagonal


@dataclass(frozen=True)
class Drop:
    """Result of one drop. Heights are relative to that of the undeformed body in the same orientation."""

    young: float  # [Pa]
    compression: float  # the greatest loss of height
    rebound: float  # [m] by which its lowest point rises afterwards
    settled: float  # final height
    at_rest: bool  # at the end
    substeps: int  # of a frame of 1/60 s
    dt: float  # [s]
    path: str
    finite: bool
    pictures: list[np.ndarray]  # at the greatest compression and at the end

    def row(self) -> dict:
        """The fields without the pictures."""
        return {key: value for key, value in vars(self).items() if key != "pictures"}


def drop_each(path: Path, cage: np.ndarray, material: Material, youngs: list[float], height: float) -> Iterator[Drop]:
    """Drop the asset with each Young's modulus [Pa] from `height` [m]; yields a Drop each."""
    from display.world import World

    with tempfile.TemporaryDirectory() as folder:
        scene = drop_scene(path, cage, replace(material, young=youngs[0]), height, Path(folder))
        world = World(scene, width=PANEL, height=PANEL)
    for young in youngs:
        for body in range(len(world.bodies())):  # the pieces of the asset
            world.device.solver.set_material(body, replace(material, young=young))
        world.device.solver.reset()
        yield _drop(world, cage.astype(np.float64), young)


def _drop(world, cage: np.ndarray, young: float) -> Drop:
    """One drop, until the body rests."""
    solver = world.device.solver
    crushed, least, rebound, quiet, time = solver.snapshot(), np.inf, 0.0, 0.0, 0.0
    while time < DROP_TIME_MAX and quiet < REST_TIME:
        solver.step(STEP)
        time += STEP
        now = solver.snapshot()
        x = now["x"].astype(np.float64)
        if not np.isfinite(x).all():
            break
        relative = np.ptp(x[:, 1]) / undeformed_height(cage, x)
        touched = least < np.inf
        if x[:, 1].min() < 1e-3 * np.ptp(cage, axis=0).max() or touched:
            if relative < least:
                least, crushed, rebound = relative, now, 0.0
            rebound = max(rebound, x[:, 1].min())
            speed = np.sqrt((now["v"] ** 2).sum(1).mean())
            quiet = quiet + STEP if speed < REST_SPEED else 0.0
    stats = solver.stats
    pictures = [np.full((PANEL, PANEL, 3), 255, np.uint8)] * 2
    if stats["finite"]:
        pictures = [_picture(world, cage, q) for q in (crushed, now)]
    return Drop(
        young=young,
        compression=float(1 - least),
        rebound=float(rebound),
        settled=float(relative),
        at_rest=quiet >= REST_TIME,
        substeps=round(1 / 60 / stats["dt"]),
        dt=stats["dt"],
        path=stats["integrator"],
        finite=stats["finite"] and stats["recovered"] == 0,
        pictures=pictures,
    )


def undeformed_height(rest: np.ndarray, x: np.ndarray) -> float:
    """Height [m] of the undeformed body in the best-fit rotation of the deformed one."""
    rotation = best_fit_rotation((x - x.mean(0)).T @ (rest - rest.mean(0)))
    return float(np.ptp((rest @ rotation.T)[:, 1]))


def _picture(world, cage: np.ndarray, snapshot: dict) -> np.ndarray:
    """Picture (H, W, 3) uint8 of a moment, with the undeformed height beside the body."""
    world.device.solver.restore(snapshot)
    x = snapshot["x"].astype(np.float64)
    camera = framing(x.mean(0), np.ptp(cage, axis=0))
    world.step(Frame(0.0, 0.0, [camera]))
    picture = pixels_of(world.picture)[..., :3].copy()
    mark_height(picture, camera, x, undeformed_height(cage, x))
    return picture


def floor(size: float) -> Gaussians:
    """Flat Gaussians at y = 0 under a body of `size` [m], with lines, that fade to the backdrop."""
    step = FLOOR_SIZE * size / FLOOR_CELLS
    i, k = (a.ravel() for a in np.meshgrid(np.arange(FLOOR_CELLS), np.arange(FLOOR_CELLS), indexing="ij"))
    x, z = ((a - (FLOOR_CELLS - 1) / 2) * step for a in (i, k))
    lined = (i % LINE_SPACING == 0) | (k % LINE_SPACING == 0)
    colour = np.where(lined[:, None], LINE_COLOUR, FLOOR_COLOUR)
    far = np.clip(np.hypot(x, z) / (0.45 * FLOOR_SIZE * size), 0, 1)[:, None] ** 2
    colour = (1 - far) * colour + far * np.array(FLOOR_BACKGROUND)
    n = len(x)
    thin = 1e-3 * size
    return Gaussians.of(
        np.stack([x, np.full(n, -thin), z], 1),
        np.tile([1.0, 0.0, 0.0, 0.0], (n, 1)),
        np.log(np.tile([0.55 * step, thin, 0.55 * step], (n, 1))),
        np.full(n, 5.0),
        ((colour - 0.5) / C0)[:, None],
    )


def drop_scene(asset: Path, cage: np.ndarray, material: Material, drop: float, folder: Path) -> Scene:
    """The body `drop` [m] above the floor. Its vertices at rest are `cage` (V, 3); `folder` takes the floor's file."""
    low, high = cage.min(0), cage.max(0)
    size = float(np.linalg.norm(high - low))
    file = folder / "floor.h5"
    Asset(floor(size)).save(file)
    centre = (low + high) / 2
    place = (-centre[0], drop - low[1], -centre[2])
    return Scene(
        bodies=[Body(str(file)), Body(str(asset), material, position=tuple(map(float, place)))],
        colliders=[Plane((0, 0, 0), (0, 1, 0), friction=material.friction)],
        light=Light(position=(-1.2 * size, 3.0 * size, 1.6 * size), softness=0.02 * size),
        background=FLOOR_BACKGROUND,
        eye=(0.0, size, 2 * size),
        target=(0.0, 0.0, 0.0),
        fov_y=FOV,
    )


def framing(centre: np.ndarray, extent: np.ndarray) -> Camera:
    """A camera that shows a body of `extent` (3,) [m] standing on the floor around `centre` (x and z count)."""
    half = FRAMING * float(np.linalg.norm(extent)) / 2
    target = np.array([centre[0], 0.45 * extent[1], centre[2]])
    flat = np.cos(CAMERA_ELEVATION)
    direction = np.array([flat * np.sin(AZIMUTH), np.sin(CAMERA_ELEVATION), flat * np.cos(AZIMUTH)])
    return perspective(PANEL, PANEL, FOV, look_at(target + half / np.tan(FOV / 2) * direction, target))


def strip(name: str, drops: list[Drop], height: float) -> np.ndarray:
    """Picture (H, W, 3) uint8 of all drops of a body from `height` [m]."""
    width = 2 * MARGIN + len(drops) * PANEL + (len(drops) - 1) * GAP
    page = np.full((HEAD + 2 * (PANEL + FOOT) + MARGIN, max(width, 2 * PANEL), 3), PAPER, np.uint8)
    write(page, f"{name}, dropped from {height:.2f} m", (MARGIN, 34), 22, weight=600)
    write(page, "dashed: the undeformed height", (MARGIN, 54), 15, ACCENT)
    rows = ("greatest compression", "at rest")
    for column, d in enumerate(drops):
        left = MARGIN + column * (PANEL + GAP)
        write(page, f"E = {pascals(d.young)}", (left, HEAD - 12), 20, weight=600)
        numbers = (f"{d.compression:.0%}", f"{d.settled:.0%} of its height")
        for k, (picture, row, number) in enumerate(zip(d.pictures, rows, numbers, strict=True)):
            top = HEAD + k * (PANEL + FOOT)
            page[top : top + PANEL, left : left + PANEL] = picture
            row = row if k == 0 or d.at_rest else "still moving"
            write(page, f"{row}: {number}", (left, top + PANEL + 20), 15, FAINT)
    return page


def mark_height(picture: np.ndarray, camera: Camera, x: np.ndarray, height: float) -> None:
    """Draw a dashed line at the undeformed height: `height` [m] above the lowest point."""
    reach = 2.0 * np.ptp(x, axis=0).max()
    middle = np.array([x[:, 0].mean(), x[:, 1].min() + height, x[:, 2].mean()])
    u, v, _ = camera.projected(middle + np.linspace(-reach, reach, 82)[:, None] * camera.world_to_camera[0, :3])
    for a, b in np.column_stack([u, v]).reshape(-1, 2, 2):
        cv2.line(picture, *(tuple(np.round(16 * q).astype(int).tolist()) for q in (a, b)), ACCENT, 1, cv2.LINE_AA, 4)


def write(page: np.ndarray, text: str, place: tuple[int, int], size: int, colour=INK, weight: int = 400) -> None:
    """Write a text on a picture, from its lower left corner on."""
    cv2.putText(page, text, place, colour, cv2.FontFace("sans"), size, weight)
