"""`vrgs.py bench render`: time of a headset's picture, both eyes, for rooms of several sizes.

Medians of synchronous calls of `Renderer.render`; the head turns slightly between them. For gsplat see
`bench/peers/gsplat_peer.py`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from statistics import median
from time import perf_counter

import taichi as ti

from bench.synthetic_room import SIZES, eyes, room
from core.camera import Camera
from render.renderer import Renderer
from render.splats import Splats

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
    renderer = Renderer(Splats(room(count)), width, height, views=2)
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
    *,
    warm: int = WARM_PICTURES,
    most: float = math.inf,
) -> list[float]:
    """Wall times [s] of `rounds` pictures of a slowly turning head; at least three, then no more after `most` [s]."""
    result = []
    for k in range(warm + rounds):
        cameras = eyes(width, height, turn=TURN * k)
        wait()
        begin = perf_counter()
        draw(cameras)
        wait()
        result.append(perf_counter() - begin)
        if len(result) >= warm + 3 and sum(result[warm:]) > most:
            break
    return result[warm:]
