"""A capture: photographs, the cameras that took them, and sparse points of the scene."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from assets.gaussians import MAGNITUDE_MAX
from core.camera import Camera
from core.errors import BadInput
from core.rotation import rotation_between
from prepare.orientation.camera_up import up_of_cameras
from prepare.train.lens import Lens

VIEWS_MIN = 3  # two views always agree on some depth of a point; a third one checks it
ORTHONORMAL_TOLERANCE = 1e-2  # of rotations in files, which are rounded; they are made exact
SPREAD_MIN = 1e-6  # spread of the cameras relative to their distance from the origin; below it they stand in one place
EXTENT_MARGIN = 1.1  # factor on the distance of the farthest camera from their centre, as in 3DGS


@dataclass(frozen=True)
class View:
    """A photograph: its file, its lens, and `world_to_camera` (4, 4), +z forward and +y down."""

    image: Path
    lens: Lens
    world_to_camera: np.ndarray
    mask: Path | None = None

    @property
    def name(self) -> str:
        """The image's file name."""
        return self.image.name

    @property
    def position(self) -> np.ndarray:
        """Centre of the camera in the capture's units, (3,)."""
        return -self.world_to_camera[:3, :3].T @ self.world_to_camera[:3, 3]

    def camera(self) -> Camera:
        """The pinhole camera of the undistorted image."""
        lens = self.lens
        fx, fy, cx, cy = lens.pinhole()
        return Camera(lens.width, lens.height, fx, fy, cx, cy, self.world_to_camera)


@dataclass(frozen=True)
class Capture:
    """Views in the order of their names, and points (P, 3) float64 with colours (P, 3) uint8, P may be 0."""

    folder: Path
    views: list[View]
    points: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))
    colors: np.ndarray = field(default_factory=lambda: np.zeros((0, 3), np.uint8))

    @property
    def middle(self) -> np.ndarray:
        """Mean of the cameras' centres, (3,)."""
        return np.mean([v.position for v in self.views], axis=0)

    @property
    def extent(self) -> float:
        """Distance of the farthest camera from their mean position, with a margin: the unit of the learning rates."""
        return EXTENT_MARGIN * max(np.linalg.norm(v.position - self.middle) for v in self.views)

    @property
    def up(self) -> np.ndarray:
        """The world's vertical as the cameras saw it, (3,) unit (prepare/orientation/camera_up.py)."""
        return up_of_cameras(np.array([v.world_to_camera for v in self.views])).direction

    def upright(self) -> Capture:
        """The same capture in a world whose +y is `up`."""
        turn = np.eye(4)
        turn[:3, :3] = rotation_between(self.up, (0.0, 1.0, 0.0))
        views = [replace(v, world_to_camera=v.world_to_camera @ turn.T) for v in self.views]
        return replace(self, views=views, points=self.points @ turn[:3, :3].T)

    def looked_at(self) -> np.ndarray:
        """The point nearest to the axes of all cameras, (3,); the middle of the cameras where those are parallel."""
        ahead = np.array([v.world_to_camera[2, :3] for v in self.views])
        across = np.eye(3) - ahead[:, :, None] * ahead[:, None, :]
        places = np.array([v.position for v in self.views])
        matrix, right = across.sum(axis=0), np.einsum("nij,nj->i", across, places)
        return np.linalg.solve(matrix, right) if np.linalg.cond(matrix) < 1e6 else self.middle


def read_capture(path: str | Path) -> Capture:
    """The capture in a folder, or of a transforms.json: nerfstudio, instant-ngp or COLMAP (text or binary).

    Raises BadInput, which names the fault and a remedy.
    """
    from prepare.train.colmap_model import find_colmap_model, read_colmap
    from prepare.train.transforms_json import read_transforms

    path = Path(path)
    if path.is_file():
        if path.suffix.lower() != ".json":
            raise BadInput(
                f"{path}: a capture is a folder with transforms.json or a COLMAP model, or a transforms.json"
            )
        return checked(read_transforms(path))
    if not path.is_dir():
        raise BadInput(f"{path}: no such folder")
    if (path / "transforms.json").is_file():
        return checked(read_transforms(path / "transforms.json"))
    model = find_colmap_model(path)
    if model is None:
        raise BadInput(
            f"{path}: holds neither transforms.json nor a COLMAP model (cameras, images and points3D in sparse/0)"
        )
    return checked(read_colmap(model, path))


def checked(capture: Capture) -> Capture:
    """The capture, its views sorted by name. Raises BadInput if no training is possible with it."""
    views = sorted(capture.views, key=lambda v: str(v.image))
    for view in views:
        if not view.image.is_file():
            missing = sum(not v.image.is_file() for v in views)
            raise BadInput(f"{view.image}: no such image ({missing} of {len(views)} are missing)")
    if len(views) < VIEWS_MIN:
        raise BadInput(
            f"{capture.folder}: {len(views)} views; take at least {VIEWS_MIN}, better 30, around what you want"
        )
    places = np.array([v.position for v in views])
    reach = np.linalg.norm(places - places.mean(axis=0), axis=1).max()
    if reach <= SPREAD_MIN * max(1.0, np.abs(places).max()):
        raise BadInput(f"{capture.folder}: all cameras stand in one place; depth shows only from several places")
    finite = (np.abs(capture.points) < MAGNITUDE_MAX).all(axis=1)  # NaN compares false
    return Capture(capture.folder, views, capture.points[finite], capture.colors[finite])


def rigid(matrix, where: str) -> np.ndarray:
    """A 4x4 or 3x4 matrix of a file as an exact rigid transform (4, 4). Raises BadInput, naming `where`."""
    try:
        m = np.array(matrix, np.float64)
    except (TypeError, ValueError, OverflowError):
        m = np.full((1, 1), np.nan)
    if m.shape not in ((4, 4), (3, 4)) or not (np.abs(m) < MAGNITUDE_MAX).all():  # NaN compares false
        raise BadInput(f"{where}: the pose is not a finite 4x4 matrix")
    u, s, vt = np.linalg.svd(m[:3, :3])
    if np.abs(s - 1.0).max() > ORTHONORMAL_TOLERANCE or np.linalg.det(u @ vt) < 0:
        raise BadInput(
            f"{where}: the pose is no rotation and translation (it scales by {s.min():.3g} to {s.max():.3g})"
        )
    out = np.eye(4)
    out[:3, :3], out[:3, 3] = u @ vt, m[:3, 3]
    return out
