"""`vrgs.py bench popping`: flicker of a picture when the head turns, and cost, for each sort order.

A head turns by one degree about its eye, in small steps. The scene is fixed in direction, so
pictures are drawn SHARPER times as fine, resampled to the directions of the first one, and each is compared with its
predecessor. Their mean absolute difference is the change: popping, the slow change of projecting splats to a plane, and
detail finer than the pixels. A reference whose pixels sort (almost) all splats changes by the last two alone. Popping
is the mean absolute difference between the change of a sort order and that of the reference.
"""

from __future__ import annotations

import warnings
from dataclasses import replace
from statistics import median
from time import perf_counter

import numpy as np

from core.camera import Camera
from display.timing import write_stats
from display.viewed_file import ViewedFile, camera_around
from render import SORTS

DEGREES, STEPS, SHARPER = 1.0, 20, 3
COMPARED_SIZE = (480, 360)  # [px] of the pictures that are compared
CUT_MARGIN = 0.1  # of a side, left out: the rotation reveals what was not seen
REFERENCE_BUFFER = 64  # splats that its pixels sort; more changed the dining room by less than 1e-4 of 255


def run(args) -> None:
    """Run the command: measure every sort order, print a table, write --json."""
    gaussians = ViewedFile.read(args.splats, None).gaussians
    camera = camera_around(gaussians, SHARPER * COMPARED_SIZE[0], SHARPER * COMPARED_SIZE[1], 0.4)
    rows = measure(gaussians, camera)
    print("differences in 1/255")
    print(f"{'sort':10} {'popping':>9} {'change':>9} {'worst step':>11} {'error':>9} {'ms':>8}")
    for row in rows:
        numbers = "{popping:9.5f} {change:9.5f} {worst:11.5f} {error:9.5f} {ms:8.2f}".format(**row)
        print(f"{row['sort']:10} {numbers}", flush=True)
    if args.json:
        write_stats(args.json, rows)


def turned(camera: Camera, degrees: float) -> Camera:
    """The camera, rotated sideways about its own centre."""
    a = np.radians(degrees)
    turn = np.eye(4)
    turn[0, [0, 2]], turn[2, [0, 2]] = (np.cos(a), np.sin(a)), (-np.sin(a), np.cos(a))
    return replace(camera, world_to_camera=turn @ camera.world_to_camera)


def measure(gaussians, camera: Camera, *, size: tuple[int, int] = COMPARED_SIZE, buffer_size: int = REFERENCE_BUFFER):
    """One row (dict) per sort order, the reference first, whose pixels sort `buffer_size` splats.

    All differences in 1/255, means over pixels, channels and steps: popping, beyond the reference's change; change,
    from step to step; worst, that of the worst step; error, against the reference. ms: the median time of a picture.
    All draw one step before the next, so that other load on the machine affects them alike.
    """
    import taichi as ti

    from render.renderer import Renderer
    from render.splats import Splats

    orders = {"reference": {"sort": "pixel", "buffer_size": buffer_size}, **{sort: {"sort": sort} for sort in SORTS}}
    splats = Splats(gaussians)
    renderers = [
        Renderer(splats, camera.width, camera.height, outputs="float", **options) for options in orders.values()
    ]
    times, changes, popping, errors, before = [], [], [], [], None
    for k in range(STEPS + 1):
        now = turned(camera, DEGREES * k / STEPS)
        pictures = []
        for renderer in renderers:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", SyntaxWarning)  # of a buffer that takes long to compile
                begin = perf_counter()
                renderer.render([now])
                ti.sync()
            times.append(perf_counter() - begin)
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
            "bench": "popping",
            "sort": name,
            "popping": float(np.mean(popping, axis=0)[i]),
            "change": float(np.mean(changes, axis=0)[i]),
            "worst": float(np.max(changes, axis=0)[i]),
            "error": float(np.mean(errors, axis=0)[i]),
            "ms": 1e3 * median(times[i :: len(orders)][2:]),
            "arch": str(ti.cfg.arch).removeprefix("Arch."),
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
