"""A capture: photographs, the lenses and cameras that took them, and sparse points of the scene."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path

import cv2
import numpy as np

from assets.orientation import up_of_cameras
from core.camera import Camera
from core.errors import BadInput
from core.rotation import rotation_between

SIDE_MAX = 16384  # [px]
ASPECT_TOLERANCE = 0.01  # between an image and its camera: sizes of reduced copies are rounded
GAP = 0.5 * np.pi  # [rad] between neighbouring cameras around what they look at; with a wider one they are on one side
ASIDE = np.pi / 6  # [rad] that cameras which look away from each other are taken to go round what lies ahead
EXTENT_MARGIN = 1.1  # factor on the distance of the farthest camera from their centre, as in 3DGS


@dataclass(frozen=True)
class Lens:
    """Image size and intrinsics [px], pixel centres at +0.5, and OpenCV's distortion.

    distortion  k1, k2, p1, p2, k3, ... as OpenCV orders them; with `fisheye` k1 to k4 of its fisheye model
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    distortion: tuple[float, ...] = ()
    fisheye: bool = False

    def check(self, where: str) -> None:
        """Raise BadInput, naming `where`, unless the numbers describe a possible lens."""
        numbers = (self.fx, self.fy, self.cx, self.cy, *self.distortion)
        if not np.isfinite(numbers).all() or not (0 < self.width <= SIDE_MAX and 0 < self.height <= SIDE_MAX):
            raise BadInput(f"{where}: the camera's size or intrinsics are no finite positive numbers")
        if not all(1e-2 * side < f < 1e4 * side for f, side in ((self.fx, self.width), (self.fy, self.height))):
            raise BadInput(
                f"{where}: a focal length of {self.fx:g} x {self.fy:g} pixels does not fit {self.width}x{self.height}"
            )
        if not all(abs(c) < 1e4 * side for c, side in ((self.cx, self.width), (self.cy, self.height))):
            raise BadInput(f"{where}: the centre ({self.cx:g}, {self.cy:g}) is too far from the picture")

    @property
    def distorts(self) -> bool:
        """True if there is any distortion."""
        return self.fisheye or any(k != 0.0 for k in self.distortion)

    def resized(self, width: int, height: int, where: str) -> Lens:
        """The same lens for an image of another size. Raises BadInput, naming `where`, if its aspect ratio differs."""
        sx, sy = width / self.width, height / self.height
        if abs(sx / sy - 1.0) > ASPECT_TOLERANCE:
            raise BadInput(f"{where}: the image is {width}x{height}, its camera {self.width}x{self.height}")
        return replace(
            self, width=width, height=height, fx=self.fx * sx, fy=self.fy * sy, cx=self.cx * sx, cy=self.cy * sy
        )

    def matrix(self) -> np.ndarray:
        """Intrinsics (3, 3) as OpenCV wants them."""
        return camera_matrix(self.fx, self.fy, self.cx, self.cy)

    def pinhole(self) -> tuple[float, float, float, float]:
        """fx, fy, cx, cy of the undistorted image: those of the lens, but a fisheye's, which keeps its middle half."""
        if not self.fisheye:
            return self.fx, self.fy, self.cx, self.cy
        size = (self.width, self.height)
        k = cv2.fisheye.estimateNewCameraMatrixForUndistortRectify(
            self.matrix(), self._coefficients(), size, np.eye(3), balance=0.0
        )
        return float(k[0, 0]), float(k[1, 1]), float(k[0, 2]) + 0.5, float(k[1, 2]) + 0.5

    def undistort(self, pixels: np.ndarray, mask: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Pixels (H, W, 3) and mask (H, W) bool as a pinhole camera sees them.

        Pixels that the photograph does not cover are outside the mask: trained as black they would cost much quality.
        """
        if not self.distorts:
            return pixels, mask
        along, down = self._photographed_places()
        out = cv2.remap(pixels, along, down, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
        # a pixel counts if all that it is interpolated from was photographed
        whole = cv2.remap(mask.astype(np.float32), along, down, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT)
        return out, whole > 0.999

    def undistort_labels(self, labels: np.ndarray) -> np.ndarray:
        """Labels (H, W) uint8 of the photograph's pixels as a pinhole camera sees them; 0 outside the photograph."""
        if not self.distorts:
            return labels
        return cv2.remap(labels, *self._photographed_places(), cv2.INTER_NEAREST, borderMode=cv2.BORDER_CONSTANT)

    def distort_labels(self, labels: np.ndarray) -> np.ndarray:
        """Labels (H, W) uint8 of the pinhole camera's pixels as the lens sees them; 0 outside the pinhole image."""
        if not self.distorts:
            return labels
        down, along = np.mgrid[: self.height, : self.width]
        places = self.undistort_points(np.stack([along, down], -1).reshape(-1, 2) + 0.5) - 0.5
        places = np.where(np.isfinite(places), places, -2.0).clip(-2.0, SIDE_MAX + 2.0).astype(np.float32)
        places = places.reshape(self.height, self.width, 2)
        return cv2.remap(labels, places, None, cv2.INTER_NEAREST, borderMode=cv2.BORDER_CONSTANT)

    def undistort_points(self, points: np.ndarray) -> np.ndarray:
        """Places (N, 2) [px] in the pinhole camera's image of places in the photograph."""
        if not self.distorts:
            return points
        undistort = cv2.fisheye.undistortPoints if self.fisheye else cv2.undistortPoints
        places = np.ascontiguousarray(points, np.float64).reshape(-1, 1, 2) - 0.5
        new = camera_matrix(*self.pinhole())
        return undistort(places, self.matrix(), self._coefficients(), R=np.eye(3), P=new).reshape(-1, 2) + 0.5

    def _photographed_places(self) -> tuple[np.ndarray, np.ndarray]:
        """Places in the photograph of the pinhole camera's pixels, along and down, (H, W) float32 each."""
        new = camera_matrix(*self.pinhole())
        size, k = (self.width, self.height), self._coefficients()
        rectify = cv2.fisheye.initUndistortRectifyMap if self.fisheye else cv2.initUndistortRectifyMap
        along, down = rectify(self.matrix(), k, np.eye(3), new, size, cv2.CV_32FC1)
        return along, down

    def _coefficients(self) -> np.ndarray:
        count = 4 if self.fisheye else 8
        return np.array([*self.distortion, *[0.0] * count][:count], np.float64)


def camera_matrix(fx: float, fy: float, cx: float, cy: float) -> np.ndarray:
    """Matrix (3, 3) of intrinsics [px] with pixel centres at whole numbers; cx, cy: with those at +0.5."""
    return np.array([[fx, 0.0, cx - 0.5], [0.0, fy, cy - 0.5], [0.0, 0.0, 1.0]])


@dataclass(frozen=True)
class View:
    """A photograph: its file, its lens, and `world_to_camera` (4, 4), +z forward and +y down.

    cut_out  there is nothing where it is transparent; else what is there is not known
    border   [px] along the photograph's edges that do not count
    """

    image: Path
    lens: Lens
    world_to_camera: np.ndarray
    mask: Path | None = None
    cut_out: bool = False
    border: int = 0

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
    """Views in the order of their names, and points (P, 3) float64 with colours (P, 3) uint8, P may be 0.

    test  views that the capture itself holds out, as Blender's datasets do
    """

    folder: Path
    views: list[View]
    points: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))
    colors: np.ndarray = field(default_factory=lambda: np.zeros((0, 3), np.uint8))
    test: list[View] = field(default_factory=list)

    def cameras(self) -> list[Camera]:
        """The camera of each view."""
        return [view.camera() for view in self.views]

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
        """The world's vertical as the cameras saw it, (3,) unit (assets/orientation.py)."""
        return up_of_cameras(np.array([v.world_to_camera for v in self.views]))[0]

    def upright(self) -> Capture:
        """The same capture in a world whose +y is `up`."""
        turn = np.eye(4)
        turn[:3, :3] = rotation_between(self.up, (0.0, 1.0, 0.0))
        views, test = (
            [replace(v, world_to_camera=v.world_to_camera @ turn.T) for v in part] for part in (self.views, self.test)
        )
        return replace(self, views=views, test=test, points=self.points @ turn[:3, :3].T)

    def photographer(self) -> tuple[float, ...]:
        """A camera amid the others, what is looked at, and how far the cameras go round that, as `Gaussians.view` (7,).

        The point lies ahead of the camera where the cameras look away from each other. The capture is `upright`.
        """
        target, places = self.looked_at(), np.array([v.position for v in self.views])
        x, y, z = (places - target).T
        away = np.maximum(np.linalg.norm(places - target, axis=1), 1e-9)
        turn, rise = np.arctan2(x, z), np.arcsin(y / away)
        order = np.sort(turn)
        gaps = np.diff(order, append=order[0] + 2 * np.pi)
        widest = int(np.argmax(gaps))
        around, beside = np.pi, 0.0 * turn
        if gaps[widest] > GAP:
            around = np.pi - 0.5 * gaps[widest]
            beside = np.abs(np.angle(np.exp(1j * (turn - order[widest] - 0.5 * gaps[widest] - np.pi))))
        k = int(np.argmin(beside + np.abs(rise - np.median(rise)) + np.abs(np.log(away / np.median(away)))))
        ahead = self.views[k].world_to_camera[2, :3]
        if (target - places[k]) @ ahead < 0.5 * away[k]:
            target, around = places[k] + self.extent * ahead, ASIDE
        return (*map(float, places[k]), *map(float, target), float(around))

    def looked_at(self) -> np.ndarray:
        """The point nearest to the axes of all cameras, (3,); the middle of the cameras where those are parallel."""
        ahead = np.array([v.world_to_camera[2, :3] for v in self.views])
        across = np.eye(3) - ahead[:, :, None] * ahead[:, None, :]
        places = np.array([v.position for v in self.views])
        matrix, right = across.sum(axis=0), np.einsum("nij,nj->i", across, places)
        return np.linalg.solve(matrix, right) if np.linalg.cond(matrix) < 1e6 else self.middle
