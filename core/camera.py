"""Pinhole cameras; in the camera's frame +z points forward and +y down (COLMAP)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Camera:
    """Size and intrinsics [px], and the rigid transform `world_to_camera` (4, 4) of points [m]."""

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    world_to_camera: np.ndarray

    @property
    def position(self) -> np.ndarray:
        """Centre of the camera in the world [m], (3,)."""
        r, t = self.world_to_camera[:3, :3], self.world_to_camera[:3, 3]
        return -r.T @ t

    def ray(self, u: float, v: float) -> tuple[np.ndarray, np.ndarray]:
        """Origin and unit direction in the world of the ray through pixel position (u, v)."""
        d = np.array([(u - self.cx) / self.fx, (v - self.cy) / self.fy, 1.0])
        d = self.world_to_camera[:3, :3].T @ d
        return self.position, d / np.linalg.norm(d)


def look_at(eye, target, up=(0.0, 1.0, 0.0)) -> np.ndarray:
    """`world_to_camera` (4, 4) of a camera at `eye` that looks at `target`."""
    eye, target, up = (np.asarray(a, np.float64) for a in (eye, target, up))
    forward = (target - eye) / np.linalg.norm(target - eye)
    right = np.cross(forward, up)
    if np.linalg.norm(right) < 1e-6:  # looking straight up or down
        right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    m = np.eye(4)
    m[:3, :3] = [right, np.cross(forward, right), forward]
    m[:3, 3] = -m[:3, :3] @ eye
    return m


def perspective(width: int, height: int, fov_y: float, world_to_camera: np.ndarray) -> Camera:
    """Camera with a vertical field of view `fov_y` [rad] and the principal point in the middle."""
    f = 0.5 * height / np.tan(0.5 * fov_y)
    return Camera(width, height, f, f, 0.5 * width, 0.5 * height, np.asarray(world_to_camera, np.float64))


def view_depth(camera: Camera, point: np.ndarray) -> float:
    """Distance [m] of a point along the camera's axis."""
    return float(camera.world_to_camera[2, :3] @ point + camera.world_to_camera[2, 3])


def project(camera: Camera, point: np.ndarray) -> tuple[float, float] | None:
    """Picture pixels of a point in the world, None behind the camera."""
    x, y, z = camera.world_to_camera[:3, :3] @ point + camera.world_to_camera[:3, 3]
    return (camera.cx + camera.fx * x / z, camera.cy + camera.fy * y / z) if z > 1e-6 else None


def fitted(camera: Camera, width: int, height: int) -> Camera:
    """The same view in a picture of another size [px], with the same vertical field of view."""
    s = height / camera.height
    cx, cy = width / 2 + s * (camera.cx - camera.width / 2), s * camera.cy
    return Camera(width, height, camera.fx * s, camera.fy * s, cx, cy, camera.world_to_camera)
