"""Poses: OpenXR's (x, y, z, w quaternions, -z forward) and the world's; cameras of eyes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from core.camera import Camera
from core.rotation import matrices_from_quaternions, quaternions_from_matrices

ARM, STEP = 0.6, 0.25  # [m] that a hand reaches over a table; to go ahead at most: a table may stand there
VIEW_TO_CAMERA = np.diag([1.0, -1.0, -1.0, 1.0])  # OpenXR looks along -z with y up, cameras along +z with y down


def matrix_of(pose) -> np.ndarray:
    """(4, 4) float64 that maps points of a space located at an XrPosef to the base space."""
    q, p = pose.orientation, pose.position
    m = np.eye(4)
    m[:3, :3] = matrices_from_quaternions(np.array([[q.w, q.x, q.y, q.z]], np.float64))[0]
    m[:3, 3] = p.x, p.y, p.z
    return m


def eye_camera(width: int, height: int, fov, eye_to_world: np.ndarray) -> Camera:
    """Camera of an eye with an XrFovf [rad]: left and down are negative, and the axis need not be in the middle."""
    left, right, up, down = (np.tan(a) for a in (fov.angle_left, fov.angle_right, fov.angle_up, fov.angle_down))
    fx, fy = width / (right - left), height / (up - down)
    world_to_camera = VIEW_TO_CAMERA @ np.linalg.inv(eye_to_world)
    return Camera(width, height, float(fx), float(fy), float(-left * fx), float(up * fy), world_to_camera)


@dataclass
class Standpoint:
    """Where the play space stands in the world: its origin [m] on the floor, turned by `yaw` [rad] about +y."""

    x: float = 0.0
    y: float = 0.0
    z: float = 0.0
    yaw: float = 0.0

    @classmethod
    def before(cls, eye, target) -> Standpoint:
        """Under `eye`, so that forward (-z) looks to `target`; the world's floor is at y = 0."""
        d = np.subtract(target, eye)
        return cls(float(eye[0]), 0.0, float(eye[2]), float(np.arctan2(-d[0], -d[2])))

    @classmethod
    def of(cls, scene) -> Standpoint:
        """Where a scene's player begins: at its eye, or a step ahead if nothing that can be held were in reach."""
        place = cls.before(scene.eye, scene.target)
        away = [np.hypot(b.position[0] - place.x, b.position[2] - place.z) for b in scene.bodies if b.material]
        step = float(np.clip(min(away, default=ARM) - ARM, 0.0, STEP))
        place.x, place.z = place.x - step * float(np.sin(place.yaw)), place.z - step * float(np.cos(place.yaw))
        return place

    @property
    def matrix(self) -> np.ndarray:
        """(4, 4) float64, stage to world."""
        c, s = np.cos(self.yaw), np.sin(self.yaw)
        m = np.eye(4)
        m[:3, :3] = [[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]]
        m[:3, 3] = self.x, self.y, self.z
        return m

    def turn(self, angle: float, about: np.ndarray) -> None:
        """Turn the player [rad] on the spot: `about` is where the head is in the world."""
        c, s = np.cos(angle), np.sin(angle)
        dx, dz = self.x - about[0], self.z - about[2]
        self.x, self.z = float(about[0] + c * dx + s * dz), float(about[2] - s * dx + c * dz)
        self.yaw += angle

    def go(self, to: np.ndarray, head: np.ndarray) -> None:
        """Move so that the head [world] comes to stand over `to` [world]."""
        self.x += float(to[0] - head[0])
        self.z += float(to[2] - head[2])


def position_rotation(m: np.ndarray) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Position and wxyz quaternion of a (4, 4) rigid matrix, as `Hand` takes them."""
    return tuple(m[:3, 3].tolist()), tuple(quaternions_from_matrices(m[:3, :3]).tolist())
