"""`vrgs.py bench popping`: how much a picture flickers when the head turns, for each way to sort, and what it costs.

A head turns by one degree about its eye, in small steps. What lies in a direction stays there, so pictures are drawn
SHARPER times as fine, brought to the directions of the first one, and each compared with the one before: the mean
absolute difference is popping, and what projecting splats to a plane changes slowly.
"""

from __future__ import annotations

from dataclasses import replace
from statistics import median
from time import perf_counter

import numpy as np

from assets.camera import Camera
from display.stats import write_stats
from display.viewing import camera_around, upright

DEGREES, STEPS, SHARPER = 1.0, 20, 3
SIZE = (480, 360)  # [px] of the pictures that are compared
EDGE = 0.1  # of a side that is left out: the turn brings in what was not seen


def run(args) -> None:
    """The command: measure every way to sort, print a table, write --json."""
    gaussians, _ = upright(args.splats, None)
    camera = camera_around(gaussians, SHARPER * SIZE[0], SHARPER * SIZE[1], 0.4)
    rows = []
    print(f"{'sort':8} {'mean /255':>12} {'worst step':>12} {'ms':>8}", flush=True)
    for sort in ("z", "radial"):
        row = measure(gaussians, camera, sort)
        rows.append(row)
        print(f"{sort:8} {row['mean']:12.5f} {row['worst']:12.5f} {row['ms']:8.2f}", flush=True)
    if args.json:
        write_stats(args.json, rows)


def turned(camera: Camera, degrees: float) -> Camera:
    """The camera after a turn to the side about its own centre."""
    a = np.radians(degrees)
    turn = np.eye(4)
    turn[0, [0, 2]], turn[2, [0, 2]] = (np.cos(a), np.sin(a)), (-np.sin(a), np.cos(a))
    return replace(camera, world_to_camera=turn @ camera.world_to_camera)


def measure(gaussians, camera: Camera, sort: str) -> dict:
    """Mean and worst difference [1/255] of two steps' pictures, and the median time of a picture [ms]."""
    import cv2
    import taichi as ti

    from render.renderer import Renderer
    from render.splats import Splats

    renderer = Renderer(Splats(gaussians), camera.width, camera.height, outputs="float", sort=sort)
    K = np.array([[camera.fx, 0, camera.cx - 0.5], [0, camera.fy, camera.cy - 0.5], [0, 0, 1]])
    left, top = (round(EDGE * side) for side in SIZE)
    differences, times, before = [], [], None
    for k in range(STEPS + 1):
        now = turned(camera, DEGREES * k / STEPS)
        begin = perf_counter()
        renderer.render([now])
        ti.sync()
        times.append(perf_counter() - begin)
        back = camera.world_to_camera[:3, :3] @ now.world_to_camera[:3, :3].T  # from its rays to the first one's
        flat = cv2.WARP_INVERSE_MAP | cv2.INTER_LINEAR
        H = K @ back.T @ np.linalg.inv(K)
        picture = cv2.warpPerspective(renderer.rgb.to_numpy()[0], H, (camera.width, camera.height), flags=flat)
        picture = cv2.resize(picture, SIZE, interpolation=cv2.INTER_AREA)[top:-top, left:-left]
        if before is not None:
            differences.append(255 * float(np.abs(picture - before).mean()))
        before = picture
    renderer.destroy()
    return {
        "bench": "popping",
        "sort": sort,
        "mean": float(np.mean(differences)),
        "worst": max(differences),
        "ms": 1e3 * median(times[2:]),
        "arch": str(ti.cfg.arch).removeprefix("Arch."),
    }
