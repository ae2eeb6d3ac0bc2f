"""Depths of all views of a capture: of a trained splat, drawn, or of sparse points, interpolated."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from assets.gaussians import Gaussians
from core.camera import Camera
from prepare.progress import Progress, no_progress

ALPHA_MIN = 0.6  # a pixel of lower opacity has no depth
HIDDEN_RATIO = 0.9  # a point is hidden by one beside it in the picture that is nearer than this fraction of its depth
CELL = 1.6  # spacings of the points in the picture within which one can hide another
GAP = 8.0  # spacings of the points beyond which a pixel has no depth
POINTS_MIN = 12  # visible in a picture; with fewer it has no depth


def depths_of_splats(gaussians: Gaussians, cameras: list[Camera], report: Progress = no_progress) -> list[np.ndarray]:
    """Depths along the axis (H, W) float32 of each view, 0 where there is nothing. Taichi must be running."""
    from render.renderer import Renderer
    from render.splats import Splats

    splats, renderers, depths = Splats(gaussians), {}, []
    for k, camera in enumerate(cameras):
        size = (camera.width, camera.height)
        if size not in renderers:
            renderers[size] = Renderer(splats, *size, outputs="float")
        renderer = renderers[size]
        renderer.render([camera])
        alpha, depth = renderer.alpha.to_numpy()[0], renderer.depth.to_numpy()[0]
        depths.append(np.where(alpha >= ALPHA_MIN, depth, 0.0).astype(np.float32))
        report("depths", (k + 1) / len(cameras))
    for renderer in renderers.values():
        renderer.destroy()
    splats.destroy()
    return depths


def depths_of_points(points: np.ndarray, cameras: list[Camera], report: Progress = no_progress) -> list[np.ndarray]:
    """As `depths_of_splats`, of points (P, 3) alone: that of the nearest visible one in the picture."""
    depths = []
    for k, camera in enumerate(cameras):
        x, y, z = seen_by(camera, points)
        there = (z > 0) & (x >= 0) & (x < camera.width) & (y >= 0) & (y < camera.height)
        at, z = np.column_stack([x, y])[there], z[there]
        depths.append(_interpolated(at, z, (camera.height, camera.width)))
        report("depths", (k + 1) / len(cameras))
    return depths


def seen_by(camera: Camera, points: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Pixel positions x, y (N,), and depths (N,) of points; those behind the camera have depths below 0."""
    local = points @ camera.world_to_camera[:3, :3].T + camera.world_to_camera[:3, 3]
    z = np.where(np.abs(local[:, 2]) < 1e-12, -1e-12, local[:, 2])
    return camera.fx * local[:, 0] / z + camera.cx, camera.fy * local[:, 1] / z + camera.cy, z


def points_at(camera: Camera, depth: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """World points (N, 3) at pixels (N,) whole x and y of a view with depths (H, W)."""
    z = depth[y, x].astype(np.float64)
    local = np.column_stack([(x + 0.5 - camera.cx) / camera.fx * z, (y + 0.5 - camera.cy) / camera.fy * z, z])
    return (local - camera.world_to_camera[:3, 3]) @ camera.world_to_camera[:3, :3]


def _interpolated(at: np.ndarray, z: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """Depths (H, W) float32 of points at (N, 2) [px], each hidden by nearer ones beside it."""
    if len(at) < POINTS_MIN:
        return np.zeros(shape, np.float32)
    tree = cKDTree(at)
    spacing = np.median(tree.query(at, k=min(4, len(at)))[0][:, -1])
    near = tree.query(at, k=min(8, len(at)), distance_upper_bound=CELL * spacing)[1]
    nearest = np.append(z, np.inf)[near].min(axis=1)
    visible = nearest > HIDDEN_RATIO * z
    y, x = np.mgrid[: shape[0], : shape[1]] + 0.5
    distance, index = cKDTree(at[visible]).query(np.column_stack([x.ravel(), y.ravel()]))
    return np.where(distance < GAP * spacing, z[visible][index], 0.0).reshape(shape).astype(np.float32)
