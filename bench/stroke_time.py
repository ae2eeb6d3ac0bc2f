"""Seconds that strokes take in a large splat: `vrgs.py segment SPLATS` on a synthetic scene, without its window.

    python -m bench.stroke_time --gaussians 2000000 --thing 200000

A bumpy ball stands on a floor of its own density of Gaussians, among others that are not marked. Each row is a step of
a user: seconds of the clock and of the processor until the new selection is drawn, and its intersection over union with
the ball.
"""

from __future__ import annotations

import argparse
import time

import numpy as np

from assets.gaussians import Gaussians
from bench.synthetic_room import turns_to
from core.camera import Camera, look_at, perspective
from core.runtime import start_taichi
from core.spherical_harmonics import C0
from prepare.segment.live_selection import LiveSelection
from prepare.segment.marks import Marks, ViewMarks
from prepare.segment.splat_marks import SplatMarks

RADIUS = 0.15  # [m] of the ball
BUMPS = 0.02  # [m] amplitude of its surface
OTHERS = np.array([[0.42, 0.0, 0.1], [-0.36, 0.0, -0.3], [0.05, 0.0, -0.55]])  # [m] feet of the other balls

PICTURE = (960, 540)  # [px], as in the window
STROKES = (  # points [m] on ball and floor
    ("inside", [[0.02, 0.29, 0.06], [0.06, 0.22, 0.13]]),
    ("outside", [[0.0, 0.0, 0.24], [0.2, 0.0, 0.15], [0.24, 0.0, 0.0]]),
    ("inside", [[-0.07, 0.1, 0.13], [0.06, 0.06, 0.12]]),
    ("outside", [[-0.24, 0.0, 0.0], [-0.2, 0.0, 0.14]]),
)


def scene(count: int, thing: int, seed: int = 3) -> tuple[Gaussians, np.ndarray]:
    """`count` Gaussians, and which of them (N,) bool are the `thing` of the ball. At random in memory, as trained."""
    rng = np.random.default_rng(seed)
    size = RADIUS * np.sqrt(4 * np.pi / thing)  # [m] between Gaussians
    floor = count - thing * (1 + len(OTHERS))
    half = 0.5 * size * np.sqrt(floor)
    points = np.zeros((floor, 3))
    points[:, [0, 2]] = rng.uniform(-half, half, (floor, 2))
    parts, normals = [points], [np.tile([0.0, 1.0, 0.0], (floor, 1))]
    for foot in (np.zeros(3), *OTHERS):
        way = rng.normal(size=(thing, 3))
        way /= np.linalg.norm(way, axis=1, keepdims=True)
        bumpy = RADIUS + BUMPS * np.sin(7 * way + 1).prod(1)
        parts.append(foot + [0, RADIUS, 0] + bumpy[:, None] * way)
        normals.append(way)
    points, normals = np.concatenate(parts), np.concatenate(normals)
    points += 0.15 * size * rng.normal(size=points.shape)
    log_scales = np.log(size) + rng.normal(0, 0.3, (count, 3)) + [0, 0, -2]
    quats = turns_to(normals + rng.normal(0, 0.1, points.shape), rng.uniform(0, np.pi, count))
    wood = 0.45 + 0.1 * np.sin(40 * points[:, :1] + 3 * np.sin(9 * points[:, 2:])) + [0.1, 0.0, -0.12]
    red = 0.35 + 0.05 * np.sin(30 * points[:, 1:2]) + [0.25, -0.1, -0.1]
    colour = np.where(np.arange(count)[:, None] < floor, wood, red) + rng.normal(0, 0.04, (count, 3))
    own = (np.arange(count) >= floor) & (np.arange(count) < floor + thing)
    order = rng.permutation(count)
    g = Gaussians.of(points, quats, log_scales, rng.normal(3.0, 1.5, count), ((colour - 0.5) / C0)[:, None])
    return g.select(order), own[order]


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--gaussians", type=int, default=2_000_000)
    parser.add_argument("--thing", type=int, default=200_000)
    args = parser.parse_args()
    start_taichi("cpu")
    steps(*scene(args.gaussians, args.thing))


def steps(g: Gaussians, own: np.ndarray) -> None:
    """Print a row for each step of a user."""
    clock = time.perf_counter(), time.process_time()
    camera = perspective(*PICTURE, 0.8, look_at((0.25, 0.55, 0.75), (0.0, 0.12, 0.0)))
    selection, marks = LiveSelection(g), ViewMarks()
    selection.picture(camera)
    row("open", clock)

    def select(name: str, rings: int = 0) -> None:
        clock = time.perf_counter(), time.process_time()
        selection.select(SplatMarks({"view": camera}, Marks({"ball": {"view": marks}}), {"ball": rings}), {"ball": 1})
        selection.picture(camera)
        found = selection.ids == 1
        row(name, clock, f"  IoU {(found & own).sum() / (found | own).sum():.3f}")

    for kind, points in STROKES:
        getattr(marks, kind).append(projected(camera, points))
        select(f"stroke {kind}")
    last = marks.outside.pop()
    select("undo")
    marks.outside.append(last)
    select("redo")
    for name, rings in (("grow", 1), ("grow", 2), ("shrink", 1), ("shrink", 0)):
        select(name, rings)
    selection.destroy()


def row(name: str, clock: tuple[float, float], more: str = "") -> None:
    """Print the seconds since `clock`, (wall, processor)."""
    wall, cpu = time.perf_counter() - clock[0], time.process_time() - clock[1]
    print(f"{name:<24} {wall:6.2f} s {cpu:6.2f} s CPU{more}", flush=True)


def projected(camera: Camera, points) -> np.ndarray:
    """Pixels (M, 2) of points (N, 3), and of nine between each two, as a mouse draws them."""
    knots = np.linspace(0, len(points) - 1, 10 * (len(points) - 1) + 1)
    p = np.stack([np.interp(knots, range(len(points)), axis) for axis in np.array(points).T], axis=1)
    p = p @ camera.world_to_camera[:3, :3].T + camera.world_to_camera[:3, 3]
    return np.stack([camera.fx * p[:, 0] / p[:, 2] + camera.cx, camera.fy * p[:, 1] / p[:, 2] + camera.cy], axis=1)


if __name__ == "__main__":
    main()
