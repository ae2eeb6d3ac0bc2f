"""Pictures of meshes and points without a GPU: painter's algorithm, flat shading, 2x supersampling."""

from __future__ import annotations

import cv2
import numpy as np

from core.camera import Camera

PAPER = (250, 249, 247)
LIGHT = np.array([-0.5, -0.65, -0.6]) / np.linalg.norm(
    [-0.5, -0.65, -0.6]
)  # direction towards the lamp, in the camera's frame
AMBIENT = 0.35
SUPERSAMPLING = 2
SHIFT = 4  # fractional bits of a pixel: OpenCV's fixed point


class Canvas:
    """Picture seen by `camera`; each call draws over the last, far to near."""

    def __init__(self, camera: Camera, background=PAPER) -> None:
        self.camera = camera
        self.page = np.full((SUPERSAMPLING * camera.height, SUPERSAMPLING * camera.width, 3), background, np.uint8)

    def project(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Positions [px of the supersampled page] (N, 2) and depths [m] (N,) of points (N, 3) [m]."""
        c, w = self.camera, self.camera.world_to_camera
        p = np.asarray(points, np.float64) @ w[:3, :3].T + w[:3, 3]
        z = np.maximum(p[:, 2:], 1e-9)
        return SUPERSAMPLING * (p[:, :2] / z * [c.fx, c.fy] + [c.cx, c.cy]), p[:, 2]

    def polygons(self, vertices: np.ndarray, faces: np.ndarray, colours: np.ndarray, *, lines=None, flat=False) -> None:
        """Draw flat faces (F, 3 or 4) of vertices (V, 3) [m], counter-clockwise from outside; colours (F, 3) 0..255.

        lines  colour of their edges, or None; flat: without shading. Back faces are culled.
        """
        x = np.asarray(vertices, np.float64)
        place, depth = self.project(x)
        normal = np.cross(x[faces[:, 1]] - x[faces[:, 0]], x[faces[:, 2]] - x[faces[:, 0]])
        normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-300)
        middle = x[faces].mean(1)
        towards = np.einsum("ni,ni->n", normal, self.camera.position - middle) > 0
        lit = 0.5 + 0.5 * normal @ (self.camera.world_to_camera[:3, :3].T @ LIGHT)  # wrapped diffuse: no face is black
        shade = np.ones(len(faces)) if flat else AMBIENT + (1 - AMBIENT) * lit
        order = np.argsort(-depth[faces].mean(1), kind="stable")
        order = order[towards[order]]
        fixed = np.round(place * (1 << SHIFT)).clip(-(1 << 24), 1 << 24).astype(np.int32)[faces]
        colour = (np.asarray(colours, np.float64) * shade[:, None]).clip(0, 255)
        for f in order:
            paint = tuple(colour[f].tolist())
            cv2.fillConvexPoly(self.page, fixed[f], paint, cv2.LINE_8, SHIFT)
            cv2.polylines(self.page, [fixed[f]], True, paint if lines is None else lines, 1, cv2.LINE_AA, SHIFT)

    def dots(self, points: np.ndarray, colours: np.ndarray, radius: float = 1.5) -> None:
        """Draw discs of `radius` [px] at points (N, 3) [m], colours (N, 3)."""
        place, depth = self.project(points)
        fixed = np.round(place * (1 << SHIFT)).clip(-(1 << 24), 1 << 24).astype(np.int64)
        size = round(SUPERSAMPLING * radius * (1 << SHIFT))
        for i in np.argsort(-depth, kind="stable"):
            cv2.circle(self.page, tuple(fixed[i].tolist()), size, tuple(colours[i].tolist()), -1, cv2.LINE_AA, SHIFT)

    def picture(self) -> np.ndarray:
        """The finished picture, (H, W, 3) uint8."""
        return cv2.resize(self.page, (self.camera.width, self.camera.height), interpolation=cv2.INTER_AREA)


def png_of(picture: np.ndarray) -> bytes:
    """PNG file of a picture (H, W, 3) uint8, RGB."""
    return cv2.imencode(".png", np.ascontiguousarray(picture[..., ::-1]), [cv2.IMWRITE_PNG_COMPRESSION, 9])[1].tobytes()


CUBE = np.array(  # corners of a cell's six faces, counter-clockwise from outside; face 2 a + s looks along s of axis a
    [
        [[0, 0, 0], [0, 0, 1], [0, 1, 1], [0, 1, 0]],
        [[1, 0, 0], [1, 1, 0], [1, 1, 1], [1, 0, 1]],
        [[0, 0, 0], [1, 0, 0], [1, 0, 1], [0, 0, 1]],
        [[0, 1, 0], [0, 1, 1], [1, 1, 1], [1, 1, 0]],
        [[0, 0, 0], [0, 1, 0], [1, 1, 0], [1, 0, 0]],
        [[0, 0, 1], [1, 0, 1], [1, 1, 1], [0, 1, 1]],
    ]
)


def cubes(cells: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Faces between set and unset cells (X, Y, Z) bool: corners (V, 3) [cells], faces (F, 4), cell of each (F, 3)."""
    padded = np.pad(cells, 1)
    corners, owner = [], []
    for axis in range(3):
        for side, step in ((0, -1), (1, 1)):
            free = ~np.roll(padded, -step, axis)[1:-1, 1:-1, 1:-1]
            at = np.argwhere(cells & free)
            corners.append(at[:, None] + CUBE[2 * axis + side])
            owner.append(at)
    corners, owner = np.concatenate(corners).reshape(-1, 3), np.concatenate(owner)
    return corners.astype(np.float64), np.arange(len(corners)).reshape(-1, 4), owner
