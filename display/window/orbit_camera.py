"""The desktop camera: orbits a target, or walks and looks about."""

from __future__ import annotations

import numpy as np

from core.camera import Camera, look_at, perspective

MAX_PITCH = np.radians(88.0)  # [rad]; nearer to the vertical the horizon would flip
MIN_DISTANCE, MAX_DISTANCE = 0.05, 200.0  # [m] from eye to target
ZOOM_STEP = 0.9  # factor on the distance of one notch of the wheel


class OrbitCamera:
    """An eye and the target it looks at [m], upright (+y), with a vertical field of view [rad].

    Pictures that are higher than wide see that angle from side to side: a telephone held upright shows the scene too.
    """

    def __init__(self, eye, target, fov_y: float):
        self._home = (np.array(eye, np.float64), np.array(target, np.float64))
        self.fov_y = fov_y
        self.reset()

    def reset(self) -> None:
        """Back to where the scene begins."""
        self.eye, self.target = (point.copy() for point in self._home)

    @property
    def distance(self) -> float:
        """From eye to target [m]."""
        return float(np.linalg.norm(self.eye - self.target))

    def camera(self, width: int, height: int) -> Camera:
        """The camera for a picture of this size [px]."""
        steepness = np.tan(0.5 * self.fov_y) * max(1.0, height / width)
        return perspective(width, height, float(2.0 * np.arctan(steepness)), look_at(self.eye, self.target))

    def turn(self, yaw: float, pitch: float, lowest: float | None = None) -> None:
        """Orbit the target: angles [rad], positive to the right of the target and upwards.

        The eye goes no lower than `lowest` [m], or than it is already.
        """
        offset = self.eye - self.target
        if lowest is not None:
            height = min(lowest - self.target[1], offset[1])
            least, now = np.arcsin(np.clip(np.array([height, offset[1]]) / self.distance, -1.0, 1.0))
            pitch = max(pitch, least - now)
        self.eye = self.target + turn_vector(offset, yaw, pitch)

    def look(self, yaw: float, pitch: float) -> None:
        """Turn the head: angles [rad], positive to the left and upwards."""
        self.target = self.eye + turn_vector(self.target - self.eye, yaw, pitch)

    def move(self, right: float, up: float, forward: float) -> None:
        """Move eye and target along the camera's own axes [m]."""
        axes = look_at(self.eye, self.target)[:3, :3]  # rows: right, down, forward
        step = right * axes[0] - up * axes[1] + forward * axes[2]
        self.eye, self.target = self.eye + step, self.target + step

    def zoom(self, notches: float) -> None:
        """Approach the target (positive) or back off, by a fraction of the distance a notch."""
        offset = self.eye - self.target
        length = np.clip(self.distance * ZOOM_STEP**notches, MIN_DISTANCE, MAX_DISTANCE)
        self.eye = self.target + offset * (length / self.distance)


def turn_vector(offset: np.ndarray, yaw: float, pitch: float) -> np.ndarray:
    """Turn a vector by `yaw` about +y and lift it by `pitch`, up to MAX_PITCH."""
    length = np.linalg.norm(offset)
    yaw += np.arctan2(offset[0], offset[2])
    pitch = np.clip(pitch + np.arcsin(np.clip(offset[1] / length, -1.0, 1.0)), -MAX_PITCH, MAX_PITCH)
    return length * np.array([np.sin(yaw) * np.cos(pitch), np.sin(pitch), np.cos(yaw) * np.cos(pitch)])
