"""A plain floor to drop one body on, and the camera that frames it: the stage of `vrgs.py tune`."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from assets.asset import Asset
from assets.gaussians import Gaussians
from core.camera import Camera, look_at, perspective
from core.material import Material
from core.spherical_harmonics import C0
from scenes.scene import Body, Light, Plane, Scene

BACKDROP = (0.93, 0.92, 0.90)
FLOOR, LINE = (0.80, 0.78, 0.75), (0.66, 0.64, 0.62)
CELLS = 160  # Gaussians along each side of the floor
LINE_EVERY = 10  # of them
FLOOR_SIZE = 8.0  # sides of the floor, in sizes of the body
FOV = 0.55  # [rad]
ELEVATION, AZIMUTH = 0.33, 0.35  # [rad] of the camera above the floor, and from +z to +x
ROOM = 0.9  # of the body's half diagonal, what the picture shows to each side


def floor(size: float) -> Gaussians:
    """Flat Gaussians at y = 0 under a body of `size` [m], with lines, that fade to the backdrop."""
    step = FLOOR_SIZE * size / CELLS
    i, k = (a.ravel() for a in np.meshgrid(np.arange(CELLS), np.arange(CELLS), indexing="ij"))
    x, z = ((a - (CELLS - 1) / 2) * step for a in (i, k))
    lined = (i % LINE_EVERY == 0) | (k % LINE_EVERY == 0)
    colour = np.where(lined[:, None], LINE, FLOOR)
    far = np.clip(np.hypot(x, z) / (0.45 * FLOOR_SIZE * size), 0, 1)[:, None] ** 2
    colour = (1 - far) * colour + far * np.array(BACKDROP)
    n = len(x)
    thin = 1e-3 * size
    return Gaussians.of(
        np.stack([x, np.full(n, -thin), z], 1),
        np.tile([1.0, 0.0, 0.0, 0.0], (n, 1)),
        np.log(np.tile([0.55 * step, thin, 0.55 * step], (n, 1))),
        np.full(n, 5.0),
        ((colour - 0.5) / C0)[:, None],
    )


def studio(asset: Path, cage: np.ndarray, material: Material, drop: float, folder: Path) -> Scene:
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
        background=BACKDROP,
        eye=(0.0, size, 2 * size),
        target=(0.0, 0.0, 0.0),
        fov_y=FOV,
    )


def framing(centre: np.ndarray, extent: np.ndarray, width: int, height: int) -> Camera:
    """A camera that shows a body of `extent` (3,) [m] standing on the floor around `centre` (x and z count)."""
    half = ROOM * float(np.linalg.norm(extent)) / 2
    target = np.array([centre[0], 0.45 * extent[1], centre[2]])
    flat = np.cos(ELEVATION)
    away = half / np.tan(FOV / 2) * np.array([flat * np.sin(AZIMUTH), np.sin(ELEVATION), flat * np.cos(AZIMUTH)])
    return perspective(width, height, FOV, look_at(target + away, target))
