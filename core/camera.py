"""Pinhole cameras; in the camera's frame +z points forward and +y down (COLMAP)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from core.typed import Range, Shape

Side = Annotated[int, Range(1, 16_384)]  # [px] of a file; a larger picture is a mistake in it
Focal = Annotated[float, Range(1e-3, 1e9)]  # [px]: products still fit float32
Centre = Annotated[float, Range(-1e9, 1e9)]  # [px]


@dataclass(frozen=True)
class Camera:
    """Size and intrinsics [px], and the rigid transform `world_to_camera` (4, 4) of points [m]."""

    width: Side
    height: Side
    fx: Focal
    fy: Focal
    cx: Centre
    cy: Centre
    world_to_camera: Annotated[np.ndarray, Shape(4, 4)]

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

    def resized(self, width: int, height: int) -> Camera:
        """The same view in a picture of another size [px], stretched to it."""
        sx, sy = width / self.width, height / self.height
        return Camera(width, height, self.fx * sx, self.fy * sy, self.cx * sx, self.cy * sy, self.world_to_camera)

    def projected(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Picture positions x, y (...) [px] of points (..., 3), and their depths (...) along the axis [m]; positions
        mean nothing where the depth is not positive."""
        local = points @ self.world_to_camera[:3, :3].T + self.world_to_camera[:3, 3]
        z = local[..., 2]
        ahead = np.where(z > 1e-9, z, 1.0)
        return self.fx * local[..., 0] / ahead + self.cx, self.fy * local[..., 1] / ahead + self.cy, z

    def slopes(self, points: np.ndarray) -> np.ndarray:
        """Derivatives (N, 2, 3) [px/m] of the picture positions of points (N, 3) ahead of the camera."""
        x, y, z = (points @ self.world_to_camera[:3, :3].T + self.world_to_camera[:3, 3]).T
        zero = np.zeros_like(z)
        rows = [[self.fx / z, zero, -self.fx * x / z**2], [zero, self.fy / z, -self.fy * y / z**2]]
        return np.moveaxis(np.array(rows), 2, 0) @ self.world_to_camera[:3, :3]

    def points_at(self, depth: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Points (N, 3) in the world at the middles of the pixels (N,) x and y of a picture with depths (H, W) [m]."""
        z = depth[y, x].astype(np.float64)
        local = np.column_stack([(x + 0.5 - self.cx) / self.fx * z, (y + 0.5 - self.cy) / self.fy * z, z])
        return (local - self.world_to_camera[:3, 3]) @ self.world_to_camera[:3, :3]


def look_at(eye, target) -> np.ndarray:
    """`world_to_camera` (4, 4) of a camera at `eye` that looks at `target`, +y up."""
    ex, ey, ez = (float(c) for c in eye)  # in plain numbers: NumPy takes ten times as long for so few
    forward = _unit([float(t) - e for t, e in zip(target, (ex, ey, ez), strict=True)])
    right = _cross(forward, [0.0, 1.0, 0.0])
    if math.hypot(*right) < 1e-6:  # looking straight up or down
        right = _cross(forward, [0.0, 0.0, 1.0])
    right = _unit(right)
    rows = [right, _cross(forward, right), forward]
    return np.array([*([x, y, z, -(x * ex + y * ey + z * ez)] for x, y, z in rows), [0.0, 0.0, 0.0, 1.0]])


def directions_around(count: int) -> np.ndarray:
    """Unit directions (count, 3) evenly over the sphere, from +y to -y: a Fibonacci spiral."""
    k = np.arange(count) + 0.5
    height, turn = 1.0 - 2.0 * k / count, np.pi * (1 + 5**0.5) * k
    level = np.sqrt(1.0 - height**2)
    return np.stack([level * np.cos(turn), height, level * np.sin(turn)], axis=1)


def _unit(v: list[float]) -> list[float]:
    length = math.hypot(*v) or 1.0
    return [c / length for c in v]


def _cross(a: list[float], b: list[float]) -> list[float]:
    return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]


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


def fitted(camera: Camera, width: int, height: int, *, stretch: float = 1.0) -> Camera:
    """The same view in a picture of another size [px], with the same vertical field of view.

    stretch  fx / fy of that picture, which is shown in another shape; 1: its pixels are square
    """
    s = height / camera.height
    fx, fy = camera.fy * s * stretch, camera.fy * s
    cx, cy = width / 2 + fx / camera.fx * (camera.cx - camera.width / 2), s * camera.cy
    return Camera(width, height, fx, fy, cx, cy, camera.world_to_camera)
