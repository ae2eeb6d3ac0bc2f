"""The first Gaussians of a training: at the sparse points of the capture, behind what shows none, or at random."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.spatial import cKDTree

from assets.gaussians import SH_COUNTS, Gaussians
from core.spherical_harmonics import C0
from prepare.train.capture import Capture
from prepare.train.densification import logit
from prepare.train.photographs import Photograph

OPACITY = 0.1
NEIGHBOURS = 3
RANDOM_COUNT = 100_000  # at most without sparse points, as in gsplat
RANDOM_REACH = 3.0  # extents around the cameras' mean position, without sparse points
CELLS = 8  # across and down a photograph: points are added in those without sparse points
ADDED = 4  # points in a cell
FARTHEST = 20.0  # extents to the farthest of them
BLACK = 8  # of 255; pixels up to it look like that without a Gaussian


def first_gaussians(
    capture: Capture, photographs: Sequence[Photograph], *, degree: int, cap: int, seed: int
) -> Gaussians:
    """The Gaussians with which a training with a budget of `cap` begins."""
    rng = np.random.default_rng(seed)
    count = first_count(capture, cap)
    return seeds(with_background(capture, photographs, rng), degree=degree, count=count, rng=rng)


def first_count(capture: Capture, cap: int) -> int:
    """Limit of initial Gaussians for a budget: all of it, or without points a quarter, which leaves room for growth."""
    return cap if _has_points(capture) else max(1, min(RANDOM_COUNT, cap // 4))


def _has_points(capture: Capture) -> bool:
    return len(capture.points) >= 2 * NEIGHBOURS


def with_background(capture: Capture, photographs: Sequence[Photograph], rng: np.random.Generator) -> Capture:
    """Add points behind the cells of photographs in which no sparse point lies.

    If masks chose what was matched, sparse points lie on an object alone. A training would then make the background of
    Gaussians that split off the object, and hang in front of it in other views. The new points lie on rays through
    pixels that count, on spheres around all cameras whose inverse radii are uniform between those of the extent and of
    FARTHEST extents: the background of NeRF++ (Zhang 2020). Black pixels need none, nor does a capture without points.
    """
    if not _has_points(capture):
        return capture
    points, colors = [capture.points], [capture.colors]
    for p in photographs:
        rows, columns = _pixels_without_points(capture.points, p, rng)
        c, turn = p.camera, p.camera.world_to_camera[:3, :3]
        rays = np.stack([(columns + 0.5 - c.cx) / c.fx, (rows + 0.5 - c.cy) / c.fy, np.ones(len(rows))], axis=1) @ turn
        rays /= np.linalg.norm(rays, axis=1, keepdims=True)
        eye = c.position - capture.middle
        radius = capture.extent / rng.uniform(1.0 / FARTHEST, 1.0, len(rows))
        ahead = rays @ eye
        way = -ahead + np.sqrt(ahead**2 - eye @ eye + radius**2)
        points.append(c.position + way[:, None] * rays)
        colors.append(p.pixels[rows, columns])
    return replace(capture, points=np.concatenate(points), colors=np.concatenate(colors))


def _pixels_without_points(points: np.ndarray, p: Photograph, rng: np.random.Generator) -> tuple:
    """Rows and columns of random pixels in the cells without a point; only of those that count and are not black."""
    height, width = p.mask.shape
    x, y, z = p.camera.projected(points)
    x, y = x / width, y / height
    inside = (z > 0.0) & (x >= 0.0) & (x < 1.0) & (y >= 0.0) & (y < 1.0)
    empty = np.ones((CELLS, CELLS), bool)
    empty[(CELLS * y[inside]).astype(int), (CELLS * x[inside]).astype(int)] = False
    i, j = np.repeat(np.nonzero(empty), ADDED, axis=1)
    rows = ((i + rng.uniform(size=len(i))) / CELLS * height).astype(int)
    columns = ((j + rng.uniform(size=len(j))) / CELLS * width).astype(int)
    counts = p.mask[rows, columns] & (p.pixels[rows, columns].max(axis=1) > BLACK)
    return rows[counts], columns[counts]


def seeds(capture: Capture, *, degree: int, count: int, rng: np.random.Generator) -> Gaussians:
    """At most `count` isotropic Gaussians, as wide as the distance to their neighbours (Kerbl 2023).

    Without points they are placed at random around the cameras.
    """
    points, colors = capture.points, capture.colors
    if not _has_points(capture):
        points = capture.middle + capture.extent * rng.uniform(-RANDOM_REACH, RANDOM_REACH, (count, 3))
        colors = rng.integers(0, 256, (count, 3), dtype=np.uint8)
    elif len(points) > count:
        chosen = np.sort(rng.choice(len(points), count, replace=False))
        points, colors = points[chosen], colors[chosen]
    distances = cKDTree(points).query(points, k=NEIGHBOURS + 1)[0][:, 1:]
    scale = np.sqrt(np.maximum((distances**2).mean(axis=1), (1e-6 * capture.extent) ** 2))
    n = len(points)
    sh = np.zeros((n, SH_COUNTS[degree], 3))
    sh[:, 0] = (colors / 255.0 - 0.5) / C0
    quats = np.tile([1.0, 0.0, 0.0, 0.0], (n, 1))
    return Gaussians.of(points, quats, np.repeat(np.log(scale)[:, None], 3, axis=1), np.full(n, logit(OPACITY)), sh)
