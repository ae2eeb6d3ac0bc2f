"""Views of the place where an object stands: the background alone and the object alone, cut to its surroundings."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import cv2
import numpy as np
from scipy.ndimage import binary_dilation

from assets.gaussians import Gaussians, concatenate
from core.camera import Camera, directions_around, look_at, perspective
from prepare.blending_weights import BlendingWeights
from prepare.progress import Progress

REACH = 2.2  # radius of the surroundings that are processed, in radii of the object
SIDE = 400  # [px] longer side of a view at most
SIDE_MIN = 12  # [px] a view that shows less of the surroundings is not used
WIDE = 1.4  # [rad] off the optical axis; points farther out are outside any picture
SOLID = 0.5  # opacity from which a pixel shows a surface
TRACE = 0.05  # opacity of the object from which it tints a pixel

INSIDE = 1.5  # radii from the object's middle: Gaussians that may lie inside the object
OUTSIDE_SHARE = 0.1  # largest share of such a Gaussian's weight outside the silhouettes, into which it may spread
SILHOUETTE_MARGIN = 1  # [px] by which silhouettes are dilated
ROW = 1024  # positions sampled in a row; OpenCV's limit is 32767

AROUND = 60  # directions tried if there are no cameras
AROUND_SIDE, AROUND_SIDE_FULL = 96, 320  # [px] of a trial, and of a view that is kept
AROUND_MAX = 24  # views kept at most
AROUND_DISTANCE = 4.0  # radii of the object
FREE = 0.7  # share of an object's pixels that must be in front of the background


@dataclass(frozen=True)
class Surroundings:
    """The ball around an object: its middle [m] (3,) and the radius [m] of the object."""

    centre: np.ndarray
    radius: float

    @classmethod
    def of(cls, removed: Gaussians) -> Surroundings:
        """The ball around an object's Gaussians, except for the outermost ones."""
        low, high = np.percentile(removed.means.astype(np.float64), (2, 98), axis=0)
        centre = 0.5 * (low + high)
        distance = np.linalg.norm(removed.means - centre, axis=1)
        return cls(centre, max(float(np.percentile(distance, 97)), 1e-6))


@dataclass(frozen=True)
class HoleView:
    """Float32 pictures, of the size of `camera`, of the scene without the object and of the object alone.

    camera                      cut out of camera number `index` of those that were given
    color, alpha, depth         of the background: RGB premultiplied, opacity, and camera z [m]
    object_alpha, object_depth  of the object alone
    """

    index: int
    camera: Camera
    color: np.ndarray
    alpha: np.ndarray
    depth: np.ndarray
    object_alpha: np.ndarray
    object_depth: np.ndarray

    def in_front(self) -> np.ndarray:
        """Pixels (H, W) bool that the object covers."""
        return (self.object_alpha > SOLID) & ((self.alpha < SOLID) | (self.object_depth < self.depth))


@contextmanager
def drawing_of(*parts: Gaussians) -> Iterator[BlendingWeights]:
    """A drawing for one part of a splat after the other (`replace`), with room for all of them in pictures of SIDE: it
    is compiled once, which takes longer than all pictures."""
    whole = concatenate(parts)
    drawing = BlendingWeights(whole, [perspective(SIDE, SIDE, 1.0, np.eye(4))], capacity=len(whole))
    try:
        yield drawing
    finally:
        drawing.destroy()


def draw_views(
    drawing: BlendingWeights, background: Gaussians, removed: Gaussians, cameras: list[Camera], ball: Surroundings
) -> list[HoleView]:
    """The views of all cameras that look at the surroundings of the object."""
    cuts = [(k, cut) for k, c in enumerate(cameras) if (cut := cut_out_camera(c, ball)) is not None]
    if not cuts:
        return []
    within = 1.2 * REACH * ball.radius  # all that is processed, without its rim
    near = background.select(np.linalg.norm(background.means - ball.centre, axis=1) < within)
    things = [g for g in (background, removed, near) if len(g)]
    pictures = []
    for g in things:
        drawing.replace(g)
        pictures.append([drawing.picture(cut) for _, cut in cuts])
    found = []
    for (k, cut), ((color, depth, alpha), *others) in zip(cuts, zip(*pictures, strict=True), strict=True):
        _, object_depth, object_alpha = others[0]
        if len(near):  # where it is what shows: a few per cent of a far background behind it are metres of depth
            _, near_depth, near_alpha = others[1]
            depth = np.where(near_alpha > SOLID, near_depth, depth)
        found.append(HoleView(k, cut, color, alpha, depth, object_alpha, object_depth))
    return found


def within_object(
    drawing: BlendingWeights, background: Gaussians, views: list[HoleView], ball: Surroundings, progress: Progress
) -> np.ndarray:
    """Mask (N,) of Gaussians that appear almost only within an object's silhouettes: they lie inside it, unseen."""
    from prepare.room_capture.contributions import reduced

    drawing.replace(background)
    weights = np.zeros((len(background), 2))
    for k, view in enumerate(views):
        camera = reduced(view.camera)
        own = binary_dilation(view.object_alpha > SOLID, iterations=SILHOUETTE_MARGIN).astype(np.float32)
        own = cv2.resize(own, (camera.width, camera.height), interpolation=cv2.INTER_AREA)
        weights += drawing.sums(camera, [own, 1.0 - own])
        progress("hole", 0.5 * (k + 1) / len(views))
    near = np.linalg.norm(background.means - ball.centre, axis=1) < INSIDE * ball.radius
    return near & (weights[:, 1] < OUTSIDE_SHARE * weights.sum(axis=1))


def image_positions(camera: Camera, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Positions (..., 2) float32 of points (..., 3) for `sampled`, and their depths [m].

    Points behind the camera get positions far outside of the picture.
    """
    x, y, z = camera.projected(points)
    at, ahead = np.stack([x, y], axis=-1) - 0.5, z > 1e-9
    return np.where(ahead[..., None], at, -1e6).clip(-1e6, 1e6).astype(np.float32), z


def sampled(picture: np.ndarray, at: np.ndarray, *, linear: bool = False, outside: float = 0.0) -> np.ndarray:
    """Values (...) of a picture (H, W, ...) at positions (..., 2) [px], 0 at the middle of the first pixel.

    linear   interpolated, else those of the nearest pixel
    outside  value beyond the picture
    """
    values = picture.astype(np.uint8) if picture.dtype == bool else picture
    flat = at.astype(np.float32).reshape(-1, 2)
    rows = np.zeros((max(1, -(-len(flat) // ROW)), ROW, 2), np.float32)
    rows.reshape(-1, 2)[: len(flat)] = flat
    flag = cv2.INTER_LINEAR if linear else cv2.INTER_NEAREST
    found = cv2.remap(values, *np.moveaxis(rows, -1, 0), flag, borderMode=cv2.BORDER_CONSTANT, borderValue=outside)
    return found.reshape(-1, *picture.shape[2:])[: len(flat)].reshape(*at.shape[:-1], *picture.shape[2:])


def spread_indices(count: int, most: int) -> np.ndarray:
    """At most `most` indices, evenly spread over range(count)."""
    return np.unique(np.linspace(0, count - 1, min(count, most)).round().astype(int)) if count else np.zeros(0, int)


def cut_out_camera(camera: Camera, ball: Surroundings) -> Camera | None:
    """Crop a camera to the surroundings of an object, at most SIDE wide; None if it does not show them."""
    p = camera.world_to_camera[:3, :3] @ ball.centre + camera.world_to_camera[:3, 3]
    reach = REACH * ball.radius
    if p[2] < -reach:
        return None
    low, high = np.zeros(2), np.array([camera.width, camera.height], float)
    for k, (f, c) in enumerate(((camera.fx, camera.cx), (camera.fy, camera.cy))):
        distance = np.hypot(p[k], p[2])
        if distance > reach:  # else the camera stands within the ball
            middle, half = np.arctan2(p[k], p[2]), np.arcsin(reach / distance)
            if middle - half > -WIDE:
                low[k] = max(low[k], np.floor(c + f * np.tan(min(middle - half, WIDE))))
            if middle + half < WIDE:
                high[k] = min(high[k], np.ceil(c + f * np.tan(max(middle + half, -WIDE))))
    extent = high - low
    if (extent < SIDE_MIN).any():
        return None
    width, height = (max(SIDE_MIN, round(float(e * min(1.0, SIDE / extent.max())))) for e in extent)
    cx, cy = camera.cx - low[0], camera.cy - low[1]
    return Camera(*extent, camera.fx, camera.fy, cx, cy, camera.world_to_camera).resized(width, height)


def cameras_around(
    drawing: BlendingWeights, background: Gaussians, removed: Gaussians, ball: Surroundings
) -> list[Camera]:
    """Cameras on all sides with a free view of an object, for a splat without photographs."""
    eyes = ball.centre + AROUND_DISTANCE * ball.radius * directions_around(AROUND)
    fov = 2 * np.arcsin(min(0.9, REACH / AROUND_DISTANCE))
    poses = [look_at(eye, ball.centre) for eye in eyes]
    trials = [perspective(AROUND_SIDE, AROUND_SIDE, fov, pose) for pose in poses]
    pictures, free = [], []
    for g in (background, removed):
        drawing.replace(g)
        pictures.append([drawing.picture(trial) for trial in trials])
    for (_, depth, alpha), (_, object_depth, object_alpha) in zip(*pictures, strict=True):
        solid = object_alpha > SOLID
        clear = solid & ((alpha < SOLID) | (object_depth < depth))
        free.append(clear.sum() / max(1, solid.sum()))
    chosen = np.flatnonzero(np.array(free) > FREE)
    chosen = chosen[spread_indices(len(chosen), AROUND_MAX)]
    return [perspective(AROUND_SIDE_FULL, AROUND_SIDE_FULL, fov, poses[i]) for i in chosen]
