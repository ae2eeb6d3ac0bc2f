"""`vrgs.py bench render`: time of a headset's picture, both eyes, for synthetic rooms of several sizes.

Medians of synchronous calls of `Renderer.render`; the head turns slightly between them. For gsplat see
`bench/peers/gsplat_peer.py`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from statistics import median
from time import perf_counter

import numpy as np
import taichi as ti

from assets.gaussians import Gaussians
from core.camera import Camera, look_at
from core.morton import morton_order
from core.rotation import turns_to
from render.renderer import Renderer
from render.splats import Splats

ROOM_SIZE = (6.0, 3.0, 5.0)  # [m]
EYE_DISTANCE = 0.064  # [m]
SIGMA = 0.0085  # [m] median of the two long axes: about 6 tiles of 16 px a Gaussian in stereo, as in captured rooms
SIZES = {"0.305M": 305_000, "1.313M": 1_313_000, "2.526M": 2_526_000}  # the paper's fox, animal crossing and bear


def room(count: int) -> Gaussians:
    """`count` flat Gaussians of degree 3 on walls, boxes and balls, most of them opaque, along a Z-order curve."""
    rng = np.random.default_rng(1)
    points, normals = surfaces(count, rng)
    points += normals * rng.normal(0, 0.004, (count, 1))
    log_scales = np.log(SIGMA) + rng.normal(0, 0.6, (count, 3))
    log_scales[:, 2] -= rng.uniform(0.7, 3.0, count)
    tilted = normals + rng.normal(0, 0.15, (count, 3))
    quats = turns_to(tilted, rng.uniform(0, np.pi, count))
    opaque = rng.random(count) < 0.6
    logits = np.where(opaque, rng.normal(3.0, 1.5, count), rng.normal(-1.5, 1.2, count))
    sh = rng.normal(0, 0.06, (count, 16, 3)).astype(np.float32)
    # stripes and checks, so that a wrong picture shows
    pattern = np.sin(2.5 * points + [0.0, 2.1, 4.2]) * np.sign(np.sin(6 * points.sum(axis=1)))[:, None]
    sh[:, 0] = 1.2 * pattern + rng.normal(0, 0.25, (count, 3))
    order = morton_order(points)
    return Gaussians.of(*(np.asarray(a, np.float32)[order] for a in (points, quats, log_scales, logits, sh)))


def surfaces(count: int, rng) -> tuple[np.ndarray, np.ndarray]:
    """Points and unit normals, each (count, 3), uniform on all surfaces of the room."""
    solids = [("box", np.zeros(3), np.array(ROOM_SIZE), -1.0)]
    for _ in range(14):
        size = rng.uniform(0.2, 0.9, 3)
        solids.append(("box", rng.uniform(0, 1, 3) * (np.array(ROOM_SIZE) - size) * (1, 0.3, 1), size, 1.0))
    for _ in range(10):
        r = rng.uniform(0.1, 0.35)
        solids.append(("ball", rng.uniform(r, np.array(ROOM_SIZE) - r), np.full(3, r), 1.0))
    areas = [4 * np.pi * s[0] ** 2 if kind == "ball" else 2 * (s * np.roll(s, 1)).sum() for kind, _, s, _ in solids]
    which = rng.choice(len(solids), count, p=np.array(areas) / sum(areas))
    points, normals = np.empty((count, 3)), np.zeros((count, 3))
    for k, (kind, at, size, side) in enumerate(solids):
        own = np.flatnonzero(which == k)
        if kind == "ball":
            n = rng.normal(size=(len(own), 3))
            n /= np.linalg.norm(n, axis=1, keepdims=True)
            points[own], normals[own] = at + size * n, n
        else:
            points[own], n = box_surface(rng, len(own), at, size)
            normals[own] = side * n
    return points, normals


def box_surface(rng, count: int, low: np.ndarray, size: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Points uniform on a box with lowest corner `low`, and outward unit normals, each (count, 3)."""
    faces = size.prod() / size
    axis = rng.choice(3, count, p=faces / faces.sum())
    high_side = rng.integers(0, 2, count)
    u, normals = rng.random((count, 3)), np.zeros((count, 3))
    u[np.arange(count), axis] = high_side
    normals[np.arange(count), axis] = 2 * high_side - 1
    return low + u * size, normals


def eyes(width: int = 1800, height: int = 1920, *, turn: float = 0.0) -> list[Camera]:
    """Left and right camera of a viewer 1.6 m tall near a corner, EYE_DISTANCE apart; `turn` [rad] to the side."""
    eye = np.array([0.9, 1.6, 0.9])
    view = look_at(eye, eye + [np.cos(0.6 + turn), -0.15, np.sin(0.6 + turn)])
    return two_eyes(view, width, height, 0.5 * width)  # 90 degrees wide, like a headset


def two_eyes(between: np.ndarray, width: int, height: int, focal: float) -> list[Camera]:
    """Left and right camera, EYE_DISTANCE apart, that look the same way as a view (4, 4) between them."""
    cameras = []
    for side in (0.5, -0.5):
        view = between.copy()
        view[0, 3] += side * EYE_DISTANCE
        cameras.append(Camera(width, height, focal, focal, 0.5 * width, 0.5 * height, view))
    return cameras


TURN = 0.002  # [rad] between two frames: 10 degrees a second at 90 Hz
WARM_PICTURES = 5  # uncounted frames: they compile and determine the capacity


def run(*, gaussians: list[str], size: tuple[int, int], rounds: int) -> Iterator[dict]:
    """Measure every room; prints and yields its row."""
    print(f"{'Gaussians':>10} {'pairs':>11} {'median ms':>10} {'worst ms':>10}", flush=True)
    for name in gaussians:
        row = measure(SIZES[name], *size, rounds=rounds)
        print(f"{name:>10} {row['pairs']:11,} {row['median_ms']:10.3f} {row['worst_ms']:10.3f}", flush=True)
        yield row


def measure(count: int, width: int, height: int, *, rounds: int) -> dict:
    """One row: a room of `count` Gaussians, SH of degree 3, two eyes of width x height [px]."""
    renderer = Renderer(Splats(room(count)), width, height, views=2, still=count)
    took = times(lambda cameras: renderer.render(cameras), ti.sync, width, height, rounds)
    pairs = renderer.rasterizer.pairs
    renderer.destroy()
    return {
        "bench": "render",
        "gaussians": count,
        "width": width,
        "height": height,
        "views": 2,
        "pairs": pairs,
        "median_ms": 1e3 * median(took),
        "worst_ms": 1e3 * max(took),
        "arch": str(ti.cfg.arch).removeprefix("Arch."),
    }


def times(
    draw: Callable[[list[Camera]], object],
    wait: Callable[[], object],
    width: int,
    height: int,
    rounds: int,
) -> list[float]:
    """Wall times [s] of `rounds` pictures of a slowly turning head."""
    result = []
    for k in range(WARM_PICTURES + rounds):
        cameras = eyes(width, height, turn=TURN * k)
        wait()
        begin = perf_counter()
        draw(cameras)
        wait()
        result.append(perf_counter() - begin)
    return result[WARM_PICTURES:]
