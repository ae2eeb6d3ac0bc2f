"""Frame of a captured place: +y up, its floor at y = 0, in metres, its front towards +z."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from assets.gaussians import OPAQUE, Gaussians
from assets.orientation import support_plane, turned_about_up, up_of_cameras
from core.rotation import rotation_between
from prepare.train.capture import Capture

REACH = 2.5  # in distances of the cameras from what they look at; what is farther away is background
PLANE_ERROR = np.radians(0.5)  # of a plane's normal, fitted to thousands of Gaussians
EYE_HEIGHT, EYE_SPREAD = 1.5, 1.35  # [m] of a camera held by a standing person, and a factor for those who stoop
VIEW_DISTANCE, VIEW_SPREAD = 1.5, 2.5  # [m] to the subject if no floor was seen: a rough guess
FRONT_MIN = 0.35  # mean resultant length of the viewing directions; below it the cameras go all around


@dataclass(frozen=True)
class CaptureOrientation:
    """From a capture's frame to the world's: x_world = scale rotation x + shift.

    rotation    (3, 3);   scale [m per unit];   shift [m], (3,): the floor is at y = 0, what is looked at over (0, 0)
    up          in the capture's frame, (3,), and its error, a standard deviation [rad]
    measured    the scale was measured; else it is guessed
    front_from  which photographs were taken from the front: "most photographs" or "first photograph"
    floor_seen  a floor was found, which agrees with the cameras; else y = 0 is the lowest surface
    """

    rotation: np.ndarray
    scale: float
    shift: np.ndarray
    up: np.ndarray
    error: float
    measured: bool
    front_from: str
    floor_seen: bool

    def gaussians(self, g: Gaussians) -> Gaussians:
        """Gaussians of the capture in the world."""
        return g.transformed(self.rotation, self.shift, self.scale)

    def pose(self, world_to_camera: np.ndarray) -> np.ndarray:
        """The pose (4, 4) in the world of a camera with this one in the capture."""
        moved = np.eye(4)
        moved[:3, :3] = world_to_camera[:3, :3] @ self.rotation.T
        moved[:3, 3] = self.scale * world_to_camera[:3, 3] - moved[:3, :3] @ self.shift
        return moved

    def described(self) -> list[str]:
        """Lines for the user: what was found, from what, and how far it may be off."""
        plane, spread = "", VIEW_SPREAD
        guess = f"cameras about {VIEW_DISTANCE} m from what they show, as no floor was seen"
        if self.floor_seen:
            plane, spread = " and the plane that things stand on", EYE_SPREAD
            guess = f"cameras about {EYE_HEIGHT} m over the floor"
        guessed = f"guessed: {guess}; it may be {spread:g} times too large or too small"
        return [
            f"up: from the cameras{plane}, to about {np.degrees(self.error):.1f} degrees",
            f"scale: {self.scale:.4g} m per unit, {'measured' if self.measured else guessed}",
            f"front: the side of the {self.front_from}",
        ]


def capture_orientation(capture: Capture, gaussians: Gaussians, scale: float | None = None) -> CaptureOrientation:
    """Up axis, scale and front of a capture.

    gaussians  trained from the capture, in its frame
    scale      as measured [m per unit]; None: guessed
    """
    poses = np.array([v.world_to_camera for v in capture.views])
    places = np.array([v.position for v in capture.views])
    up, error = up_of_cameras(poses)
    target = capture.looked_at()
    middle = 0.5 * (target + places.mean(0))
    reach = REACH * np.linalg.norm(places - middle, axis=1).max()
    opaque = gaussians.opacities > OPAQUE
    near = gaussians.select(opaque & (np.linalg.norm(gaussians.means - middle, axis=1) < reach))  # no background
    plane = support_plane(near, places, up, error)
    if plane is not None:
        (up, floor), error = plane, PLANE_ERROR
        guess = EYE_HEIGHT / (np.median(places @ up) - floor)
    else:  # the floor is the lowest surface, below which there is hardly anything
        floor = float(np.percentile(near.means @ up, 1.0)) if len(near) else float(target @ up)
        guess = VIEW_DISTANCE / max(float(np.median(np.linalg.norm(places - target, axis=1))), 1e-9)
    upright = rotation_between(up, (0.0, 1.0, 0.0))
    turn, front_from = _front(poses, upright)
    rotation, measured = turn @ upright, scale is not None
    scale = float(scale if measured else guess)
    shift = -scale * (rotation @ target)
    shift[1] = -scale * floor
    return CaptureOrientation(rotation, scale, shift, up, float(error), measured, front_from, plane is not None)


def _front(poses: np.ndarray, upright: np.ndarray) -> tuple[np.ndarray, str]:
    """Rotation (3, 3) about +y after which the cameras look along -z on average; if they look everywhere, the first."""
    ahead = poses[:, 2, :3] @ upright.T
    ahead = ahead[:, [0, 2]]
    mean = ahead.sum(0) / max(np.linalg.norm(ahead, axis=1).sum(), 1e-12)
    most = np.linalg.norm(mean) > FRONT_MIN
    x, z = mean if most else ahead[0]
    turn = np.arctan2(-x, -z)  # of -ahead, which points to the viewer
    return turned_about_up(-turn), "most photographs" if most else "first photograph"
