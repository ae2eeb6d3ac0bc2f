"""Flicker of a picture when the head turns, for each sort order.

A head turns by one degree about its eye, in small steps. The scene is fixed in direction, so pictures are drawn SHARPER
times as fine, resampled to the directions of the first one, and each is compared with its predecessor. Their mean
absolute difference is the change: popping, the slow change of projecting splats to a plane, and detail finer than the
pixels. A reference whose pixels sort (almost) all splats changes by the last two alone. Popping is the mean absolute
difference between the change of a sort order and that of the reference.
"""

import warnings
from dataclasses import replace

import numpy as np

from core.camera import Camera
from render import SORTS

DEGREES, STEPS, SHARPER = 1.0, 20, 3
COMPARED_SIZE = (480, 360)  # [px] of the pictures that are compared
CUT_MARGIN = 0.1  # of a side, left out: the rotation reveals what was not seen
REFERENCE_BUFFER = 64  # splats that its pixels sort; more changed the dining room by less than 1e-4 of 255


def turned(camera: Camera, degrees: float) -> Camera:
    """The camera, rotated sideways about its own centre."""
    a = np.radians(degrees)
    turn = np.eye(4)
    turn[0, [0, 2]], turn[2, [0, 2]] = (np.cos(a), np.sin(a)), (-np.sin(a), np.cos(a))
    return replace(camera, world_to_camera=turn @ camera.world_to_camera)


def measure(gaussians, camera: Camera, *, size: tuple[int, int] = COMPARED_SIZE, buffer_size: int = REFERENCE_BUFFER):
    """One row (dict) per sort order, the reference first, whose pixels sort `buffer_size` splats.

    All differences in 1/255, means over pixels, channels and steps: popping, beyond the reference's change; change,
    from step to step; worst, that of the worst step; error, against the reference.
    All draw one step before the next, so that other load on the machine affects them alike.
    """

    from render.renderer import Renderer
    from render.splats import Splats

    orders = {"reference": {"sort": "pixel", "buffer_size": buffer_size}, **{sort: {"sort": sort} for sort in SORTS}}
    splats = Splats(gaussians)
    renderers = [
        Renderer(splats, camera.width, camera.height, outputs="float", **options) for options in orders.values()
    ]
    changes, popping, errors, before = [], [], [], None
    for k in range(STEPS + 1):
        now = turned(camera, DEGREES * k / STEPS)
        pictures = []
        for renderer in renderers:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", SyntaxWarning)  # of a buffer that takes long to compile
                renderer.render([now])
            pictures.append(255 * compared(renderer.rgb.to_numpy()[0], camera, now, size))
        pictures = np.stack(pictures)
        if before is not None:
            step = pictures - before
            changes.append(np.abs(step).mean(axis=(1, 2, 3)))
            popping.append(np.abs(step - step[0]).mean(axis=(1, 2, 3)))
            errors.append(np.abs(pictures - pictures[0]).mean(axis=(1, 2, 3)))
        before = pictures
    for renderer in renderers:
        renderer.destroy()
    return [
        {
            "sort": name,
            "popping": float(np.mean(popping, axis=0)[i]),
            "change": float(np.mean(changes, axis=0)[i]),
            "error": float(np.mean(errors, axis=0)[i]),
        }
        for i, name in enumerate(orders)
    ]


def compared(picture: np.ndarray, camera: Camera, now: Camera, size: tuple[int, int]) -> np.ndarray:
    """A picture of `now`, resampled to the directions of `camera`, at `size` and without its margin."""
    import cv2

    K = np.array([[camera.fx, 0, camera.cx - 0.5], [0, camera.fy, camera.cy - 0.5], [0, 0, 1]])
    back = camera.world_to_camera[:3, :3] @ now.world_to_camera[:3, :3].T  # from its rays to the first one's
    H = K @ back.T @ np.linalg.inv(K)
    flat = cv2.WARP_INVERSE_MAP | cv2.INTER_LINEAR
    picture = cv2.GaussianBlur(picture, (0, 0), SHARPER / 2)  # makes the resampling insensitive to subpixel positions
    picture = cv2.warpPerspective(picture, H, (camera.width, camera.height), flags=flat)
    left, top = (round(CUT_MARGIN * side) for side in size)
    return cv2.resize(picture, size, interpolation=cv2.INTER_AREA)[top:-top, left:-left]
