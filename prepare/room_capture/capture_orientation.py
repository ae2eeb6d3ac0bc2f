"""Frame of a captured place: +y up, its floor at y = 0, in metres, its front towards +z."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from assets.gaussians import OPAQUE, Gaussians
from assets.orientation import support_plane, turned_about_up, up_of_cameras
from core.errors import BadInput
from core.measured_length import scale_between
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

    rotation      (3, 3);   scale [m per unit];   shift [m], (3,): the floor is at y = 0, what is looked at over (0, 0)
    up            in the capture's frame, (3,), and its error, a standard deviation [rad]
    up_from       "cameras", or "support plane" if one agrees with them
    scale_from    "measured", "eye height" or "viewing distance"; the last two are guesses
    scale_spread  factor by which a guess may be too large or too small (two times of three); 1.0: measured
    front_from    which photographs were taken from the front: "most photographs" or "first photograph"
    floor_seen    a floor was found; else y = 0 is the lowest surface
    """

    rotation: np.ndarray
    scale: float
    shift: np.ndarray
    up: np.ndarray
    error: float
    up_from: str
    scale_from: str
    scale_spread: float
    front_from: str
    floor_seen: bool

    def points(self, x: np.ndarray) -> np.ndarray:
        """Points (..., 3) of the capture in the world [m]."""
        return self.scale * (x @ self.rotation.T) + self.shift

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
        known = {
            "measured": "measured",
            "eye height": f"guessed: cameras about {EYE_HEIGHT} m over the floor",
            "viewing distance": f"guessed: cameras about {VIEW_DISTANCE} m from what they show, no floor was seen",
        }[self.scale_from]
        may = f"; may be {self.scale_spread:g} times too large or too small" if self.scale_spread > 1.0 else ""
        plane = ", and the plane that things stand on" if self.up_from == "support plane" else ""
        return [
            f"up: from the cameras{plane}, to about {np.degrees(self.error):.1f} degrees",
            f"scale: {self.scale:.4g} m per unit, {known}{may}",
            f"front: the side of the {self.front_from}",
        ]


def capture_orientation(
    capture: Capture,
    gaussians: Gaussians | None,
    *,
    measured: tuple[np.ndarray, np.ndarray] | None = None,
    length: float | None = None,
) -> CaptureOrientation:
    """Up axis, scale and front of a capture.

    gaussians  trained from the capture, in its frame; None: cameras alone
    measured   two points (3,) of the capture's frame that are `length` [m] apart; else the scale is guessed
    Raises BadInput for a length or points that give no scale.
    """
    poses = np.array([v.world_to_camera for v in capture.views])
    places = np.array([v.position for v in capture.views])
    up, error = up_of_cameras(poses)
    target = capture.looked_at()
    plane, near = None, None if gaussians is None else near_gaussians(gaussians, places, target)
    if near is not None:
        plane = support_plane(near, places, up, error)
    if plane is not None:
        up, error = plane[0], PLANE_ERROR
    upright = rotation_between(up, (0.0, 1.0, 0.0))
    turn, front_from = _front(poses, upright)
    rotation = turn @ upright
    if measured is not None or length is not None:
        scale, scale_from, spread = measured_scale(measured, length), "measured", 1.0
    elif plane is not None:
        scale, scale_from, spread = EYE_HEIGHT / (np.median(places @ up) - plane[1]), "eye height", EYE_SPREAD
    else:
        away = float(np.median(np.linalg.norm(places - target, axis=1)))
        scale, scale_from, spread = VIEW_DISTANCE / max(away, 1e-9), "viewing distance", VIEW_SPREAD
    if plane is not None:
        floor = plane[1]
    else:  # the lowest surface, below which there is hardly anything
        floor = float(np.percentile(near.means @ up, 1.0)) if near is not None and len(near) else float(target @ up)
    shift = -scale * (rotation @ target)
    shift[1] = -scale * floor
    up_from = "cameras" if plane is None else "support plane"
    seen = plane is not None
    return CaptureOrientation(
        rotation, float(scale), shift, up, float(error), up_from, scale_from, spread, front_from, seen
    )


def measured_scale(measured, length: float | None) -> float:
    """Metres per unit of two points (3,) that are `length` [m] apart. Raises BadInput."""
    if measured is None or length is None:
        raise BadInput("a scale needs two points and the length between them in metres")
    return scale_between(*measured, length)


def near_gaussians(gaussians: Gaussians, places: np.ndarray, target: np.ndarray) -> Gaussians:
    """The opaque Gaussians near what the cameras at `places` (V, 3) look at and where they stand: no background."""
    middle = 0.5 * (target + places.mean(0))
    reach = REACH * np.linalg.norm(places - middle, axis=1).max()
    return gaussians.select((gaussians.opacities > OPAQUE) & (np.linalg.norm(gaussians.means - middle, axis=1) < reach))


def _front(poses: np.ndarray, upright: np.ndarray) -> tuple[np.ndarray, str]:
    """Rotation (3, 3) about +y after which the cameras look along -z on average; if they look everywhere, the first."""
    ahead = poses[:, 2, :3] @ upright.T
    ahead = ahead[:, [0, 2]]
    mean = ahead.sum(0) / max(np.linalg.norm(ahead, axis=1).sum(), 1e-12)
    most = np.linalg.norm(mean) > FRONT_MIN
    x, z = mean if most else ahead[0]
    turn = np.arctan2(-x, -z)  # of -ahead, which points to the viewer
    return turned_about_up(-turn), "most photographs" if most else "first photograph"
