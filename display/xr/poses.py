"""Poses between OpenXR, the play space and the world.

OpenXR's quaternions are (x, y, z, w), its views look along -z with y up; the world's quaternions are wxyz, its cameras
look along +z with y down. A pose is a (4, 4) matrix that maps points of a space to its base space.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from core.camera import Camera
from core.rotation import interpolate_quaternions, matrices_from_quaternions, pose_matrix, quaternions_from_matrices

ARM_LENGTH = 0.6  # [m] that a hand reaches over a table
MAX_STEP_AHEAD = 0.25  # [m] that a player begins nearer than the scene's eye: a table may stand there
VIEW_TO_CAMERA = np.diag([1.0, -1.0, -1.0, 1.0])


def rotation_facing(back: np.ndarray, up, side=None) -> np.ndarray:
    """Rotation (3, 3) whose z is the unit vector `back`, its y as near to `up` as can be.

    side  its x where `back` and `up` are parallel
    """
    x = np.cross(up, back)
    length = np.linalg.norm(x)
    x = x / length if length > 1e-3 else side
    return np.column_stack([x, np.cross(back, x), back])


def matrix_of(pose) -> np.ndarray:
    """(4, 4) float64 that maps points of a space located at an XrPosef to the base space."""
    q, p = pose.orientation, pose.position
    return pose_matrix((p.x, p.y, p.z), matrices_from_quaternions([q.w, q.x, q.y, q.z]))


def position_rotation(m: np.ndarray) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Position and wxyz quaternion of a (4, 4) rigid matrix, as `Hand` takes them."""
    return tuple(m[:3, 3].tolist()), tuple(quaternions_from_matrices(m[:3, :3]).tolist())


def eye_camera(width: int, height: int, fov, world_from_eye: np.ndarray) -> Camera:
    """Camera of an eye with an XrFovf [rad]: left and down are negative, and the axis need not be in the middle."""
    left, right, up, down = (np.tan(a) for a in (fov.angle_left, fov.angle_right, fov.angle_up, fov.angle_down))
    fx, fy = width / (right - left), height / (up - down)
    camera_from_world = VIEW_TO_CAMERA @ np.linalg.inv(world_from_eye)
    return Camera(width, height, float(fx), float(fy), float(-left * fx), float(up * fy), camera_from_world)


@dataclass
class PlaySpace:
    """Pose of the session's reference space in the world: its origin [m], turned by `yaw` [rad] about +y."""

    x: float = 0.0
    y: float = 0.0
    z: float = 0.0
    yaw: float = 0.0

    @classmethod
    def facing(cls, eye, target, floor: float = 0.0) -> PlaySpace:
        """Under `eye`, so that forward (-z) looks to `target`; the floor is at a height [m] of the world."""
        d = np.subtract(target, eye)
        return cls(float(eye[0]), floor, float(eye[2]), float(np.arctan2(-d[0], -d[2])))

    @classmethod
    def of(cls, scene) -> PlaySpace:
        """Start of a scene's player: at its eye, or a step ahead if no movable body were within an arm's length."""
        start = cls.facing(scene.eye, scene.target, scene.floor)
        distances = [np.hypot(b.position[0] - start.x, b.position[2] - start.z) for b in scene.bodies if b.material]
        step = float(np.clip(min(distances, default=ARM_LENGTH) - ARM_LENGTH, 0.0, MAX_STEP_AHEAD))
        return replace(start, x=start.x - step * float(np.sin(start.yaw)), z=start.z - step * float(np.cos(start.yaw)))

    @property
    def world_from_play(self) -> np.ndarray:
        """(4, 4) float64."""
        c, s = np.cos(self.yaw), np.sin(self.yaw)
        return pose_matrix((self.x, self.y, self.z), [[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])

    def turn(self, angle: float, about: np.ndarray) -> None:
        """Turn the player by `angle` [rad] in place: `about` is the head's position in the world."""
        c, s = np.cos(angle), np.sin(angle)
        dx, dz = self.x - about[0], self.z - about[2]
        self.x, self.z = float(about[0] + c * dx + s * dz), float(about[2] - s * dx + c * dz)
        self.yaw += angle

    def move(self, to: np.ndarray, head: np.ndarray) -> None:
        """Move so that the head [world] comes to stand over `to` [world]."""
        self.x += float(to[0] - head[0])
        self.z += float(to[2] - head[2])


def interpolate_pose(a: np.ndarray, b: np.ndarray, t: float) -> np.ndarray:
    """Pose (4, 4) between a (t = 0) and b (t = 1)."""
    rotation = interpolate_quaternions(*quaternions_from_matrices(np.array([a, b])[:, :3, :3]), t)
    return pose_matrix((1 - t) * a[:3, 3] + t * b[:3, 3], matrices_from_quaternions(rotation))
