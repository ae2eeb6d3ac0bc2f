"""The clip that an asset's material was fitted to, and how the body sets off in it: the group `clip` of an asset."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import h5py
import numpy as np

from assets.camera_file import parse_camera
from assets.hdf5 import Hdf5Reader, write_dataset, write_text
from assets.images import decode_image, read_image_header
from core.camera import Camera
from core.errors import BadInput
from core.rotation import pose_matrix
from core.typed import to_json

SIDE_MAX, PICTURES_MAX = 256, 120  # [px] of a picture, and how many there are
SECONDS_MAX, AWAY_MAX, SPEED_MAX = 10.0, 100.0, 100.0  # [s], [m] from the origin, [m/s]
QUALITY = 65  # of the pictures as JPEG: some 2 kB for one of 144 x 144 px


@dataclass(frozen=True, eq=False)
class FittedClip:
    """Pictures of a moving body, and its motion when they begin, in a world with +y up.

    pictures    (F, H, W, 3) uint8, at `times` (F,) [s] from 0 on
    camera      that takes them
    held        vertices of the cage that stand still, (H,)
    positions   of the cage's vertices at the first time [m], (V, 3);   velocities  [m/s], (V, 3)
    planes      (P, 4): normal n and offset d [m] of what is solid: the body stays in n x >= d
    """

    pictures: np.ndarray
    times: np.ndarray
    camera: Camera
    held: np.ndarray
    positions: np.ndarray
    velocities: np.ndarray
    planes: np.ndarray

    def in_front(self, rest: np.ndarray) -> FittedClip:
        """The clip in a world in which its camera looks towards -z and the body's middle is that of `rest` (V, 3)."""
        ahead = self.camera.world_to_camera[2, :3]
        turn = np.arctan2(ahead[0], -ahead[2])
        R = np.array([[np.cos(turn), 0.0, np.sin(turn)], [0.0, 1.0, 0.0], [-np.sin(turn), 0.0, np.cos(turn)]])
        pose = pose_matrix(rest.mean(0) - R @ self.positions.mean(0), R)
        normals = self.planes[:, :3] @ R.T
        return replace(
            self,
            camera=replace(self.camera, world_to_camera=self.camera.world_to_camera @ np.linalg.inv(pose)),
            positions=self.positions @ R.T + pose[:3, 3],
            velocities=self.velocities @ R.T,
            planes=np.column_stack([normals, self.planes[:, 3] + normals @ pose[:3, 3]]),
        )

    @property
    def period(self) -> float:
        """Time [s] after which it begins again: that of its last picture, and one picture more."""
        return float(self.times[-1] * len(self.times) / (len(self.times) - 1))

    def check(self, vertices: int, where: str) -> None:
        """Raise BadInput, naming `where`, unless it can be played beside a cage of this many vertices."""
        count, height, width, *_ = self.pictures.shape
        if not (2 <= count <= PICTURES_MAX and 0 < max(height, width) <= SIDE_MAX):
            raise BadInput(f"{where}: its clip has {count} pictures of {width} x {height} px")
        if (self.camera.width, self.camera.height) != (width, height):
            raise BadInput(f"{where}: the pictures of its clip are not of the size of their camera's")
        t = self.times
        if t.shape != (count,) or t[0] != 0.0 or not ((np.diff(t) > 0).all() and t[-1] <= SECONDS_MAX):
            raise BadInput(f"{where}: the times of its clip do not ascend from 0 to at most {SECONDS_MAX:g} s")
        for name, values, most in (("positions", self.positions, AWAY_MAX), ("velocities", self.velocities, SPEED_MAX)):
            if values.shape != (vertices, 3) or not (np.abs(values) <= most).all():  # NaN compares false
                raise BadInput(f"{where}: the {name} of its clip are not those of {vertices} vertices, or out of range")
        if self.held.size and not (self.held.min() >= 0 and self.held.max() < vertices):
            raise BadInput(f"{where}: its clip holds a vertex outside 0..{vertices - 1}")
        lengths = np.linalg.norm(self.planes[:, :3], axis=1)
        if not ((np.abs(lengths - 1) < 1e-3).all() and (np.abs(self.planes[:, 3]) <= AWAY_MAX).all()):
            raise BadInput(f"{where}: a plane of its clip has no unit normal, or is out of range")


def write_clip(file: h5py.File, clip: FittedClip) -> None:
    """Write the group `clip`; the pictures as one JPEG in which each stands under the one before."""
    import cv2  # only where a clip is written

    _, code = cv2.imencode(".jpg", np.concatenate(clip.pictures)[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, QUALITY])
    write_dataset(file, "clip/film", code.ravel(), np.uint8)
    write_dataset(file, "clip/held", clip.held, np.int32)
    write_dataset(file, "clip/times", clip.times, np.float64)
    write_dataset(file, "clip/planes", clip.planes, np.float64)
    for name in ("positions", "velocities"):
        write_dataset(file, f"clip/{name}", getattr(clip, name), np.float32)
    write_text(file["clip"], "camera", to_json(clip.camera))


def read_clip_group(file: Hdf5Reader) -> FittedClip:
    """The group `clip` of an open asset file, not checked against the cage. Raises BadInput."""
    camera = parse_camera(f"{file.path}: the camera of its clip", file.json("clip", "camera", Any))
    times = file.floats("clip/times", (None,), np.float64)
    code = file.indices("clip/film", (None,), np.uint8).tobytes()
    header, size = read_image_header(code), (camera.width, camera.height * len(times))
    if len(times) > PICTURES_MAX or max(camera.width, camera.height) > SIDE_MAX:
        raise file.error(f"its clip has {len(times)} pictures of {camera.width} x {camera.height} px")
    if header is None or header.format != "jpeg" or (header.width, header.height) != size:
        raise file.error(f"the film of its clip is no JPEG of {size[0]} x {size[1]} px")
    film = decode_image(code)
    if film is None or film.shape[1::-1] != size:
        raise file.error("the film of its clip is damaged")
    return FittedClip(
        film.reshape(len(times), camera.height, camera.width, 3),
        times,
        camera,
        file.indices("clip/held", (None,)),
        file.floats("clip/positions", (None, 3)),
        file.floats("clip/velocities", (None, 3)),
        file.floats("clip/planes", (None, 4), np.float64),
    )
