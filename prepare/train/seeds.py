"""The first Gaussians of a training: at the sparse points of the capture and behind what shows none, or where cameras
look."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.spatial import cKDTree

from assets.gaussians import SH_COUNTS, Gaussians
from core.spherical_harmonics import C0
from prepare.train.capture import Capture
from prepare.train.densification import logit
from prepare.train.photographs import OPAQUE, Photograph

OPACITY = 0.1
NEIGHBOURS = 3
RANDOM_COUNT = 100_000  # at most without sparse points, as in gsplat
TRIES = 20  # pixels for each Gaussian without sparse points, of which most look past a cut-out object elsewhere
MOST = 0.5  # of the cameras that see a place: they look at it
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
    if _has_points(capture):
        capture = with_background(capture, photographs, rng)
    else:
        capture = where_cameras_look(capture, photographs, rng, count)
    return seeds(capture, degree=degree, count=count, rng=rng)


def first_count(capture: Capture, cap: int) -> int:
    """Limit of initial Gaussians for a budget: all of it, or without points a quarter, which leaves room for growth."""
    return cap if _has_points(capture) else max(1, min(RANDOM_COUNT, cap // 4))


def _has_points(capture: Capture) -> bool:
    return len(capture.points) >= 2 * NEIGHBOURS


def where_cameras_look(
    capture: Capture, photographs: Sequence[Photograph], rng: np.random.Generator, count: int
) -> Capture:
    """The capture with `count` points in the colours of random pixels, on their rays.

    Half of them lie in the ball around what the cameras look at that they see whole, half on the spheres of
    `with_background`. Of cut-out photographs all lie in the ball, and none where any of them is transparent; where most
    cameras do not look at one place, all on the spheres.
    """
    target, cut_out = capture.looked_at(), any(p.alpha is not None for p in photographs)
    seen = [_inside(p.camera.projected(target[None]), p)[0] for p in photographs]
    in_ball = 0.0 if np.mean(seen) < MOST else 1.0 if cut_out else 0.5
    points, colors = [], []
    for p in photographs:
        c, n = p.camera, -(-count * (TRIES if cut_out else 1) // len(photographs))
        rows, columns = np.nonzero(p.mask if p.alpha is None else p.mask & (p.alpha > OPAQUE))
        if len(rows) == 0:
            continue
        chosen = rng.integers(0, len(rows), n)
        rows, columns = rows[chosen], columns[chosen]
        rays, away = _rays(p, rows, columns), np.linalg.norm(target - c.position)
        reach = min(1.0, 0.5 * c.width / c.fx, 0.5 * c.height / c.fy)
        way = away * (1.0 + reach * rng.uniform(-1.0, 1.0, n))
        far = _ways_to_spheres(capture, p, rays, rng)
        way = np.where(rng.uniform(size=n) < in_ball, way, far)
        points.append(c.position + way[:, None] * rays)
        colors.append(p.pixels[rows, columns])
    points, colors = np.concatenate(points), np.concatenate(colors)
    for p in photographs if cut_out else ():
        projected = p.camera.projected(points)
        inside = _inside(projected, p)
        row, column = (np.where(inside, v, 0).astype(int) for v in projected[1::-1])
        empty = inside & p.mask[row, column] & (p.alpha is not None and p.alpha[row, column] <= OPAQUE)
        if (~empty).sum() >= 2 * NEIGHBOURS:
            points, colors = points[~empty], colors[~empty]
    return replace(capture, points=points, colors=colors)


def _inside(projected: tuple, p: Photograph) -> np.ndarray:
    """Mask (N,) of the places x, y, z that lie in a photograph."""
    x, y, z = projected
    height, width = p.mask.shape
    return (z > 0.0) & (x >= 0.0) & (x < width) & (y >= 0.0) & (y < height)


def _rays(p: Photograph, rows: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """Directions (N, 3), unit, of pixels."""
    c = p.camera
    rays = np.stack([(columns + 0.5 - c.cx) / c.fx, (rows + 0.5 - c.cy) / c.fy, np.ones(len(rows))], axis=1)
    rays = rays @ c.world_to_camera[:3, :3]
    return rays / np.linalg.norm(rays, axis=1, keepdims=True)


def _ways_to_spheres(capture: Capture, p: Photograph, rays: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Lengths (N,) of rays from a camera to spheres around all, whose inverse radii are uniform up to FARTHEST."""
    eye = p.camera.position - capture.middle
    radius = capture.extent / rng.uniform(1.0 / FARTHEST, 1.0, len(rays))
    ahead = rays @ eye
    return -ahead + np.sqrt(ahead**2 - eye @ eye + radius**2)


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
        rays = _rays(p, rows, columns)
        points.append(p.camera.position + _ways_to_spheres(capture, p, rays, rng)[:, None] * rays)
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
    """At most `count` isotropic Gaussians, as wide as the distance to their neighbours (Kerbl 2023)."""
    points, colors = capture.points, capture.colors
    if len(points) > count:
        chosen = np.sort(rng.choice(len(points), count, replace=False))
        points, colors = points[chosen], colors[chosen]
    distances = cKDTree(points).query(points, k=NEIGHBOURS + 1)[0][:, 1:]
    scale = np.sqrt(np.maximum((distances**2).mean(axis=1), (1e-6 * capture.extent) ** 2))
    n = len(points)
    sh = np.zeros((n, SH_COUNTS[degree], 3))
    sh[:, 0] = (colors / 255.0 - 0.5) / C0
    quats = np.tile([1.0, 0.0, 0.0, 0.0], (n, 1))
    return Gaussians.of(points, quats, np.repeat(np.log(scale)[:, None], 3, axis=1), np.full(n, logit(OPACITY)), sh)
