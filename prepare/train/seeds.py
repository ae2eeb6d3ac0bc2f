"""The first Gaussians of a training: one at each sparse point of the capture, or at random places."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from assets.gaussians import SH_COUNTS, Gaussians
from core.spherical_harmonics import C0
from prepare.train.capture import Capture
from prepare.train.densification import logit

OPACITY = 0.1
NEIGHBOURS = 3
RANDOM_COUNT = 100_000  # at most without sparse points, as in gsplat
RANDOM_REACH = 3.0  # extents around the cameras' mean position, without sparse points


def first_count(capture: Capture, cap: int) -> int:
    """Limit of initial Gaussians for a budget: all of it, or without points a quarter, which leaves room for growth."""
    return cap if _has_points(capture) else max(1, min(RANDOM_COUNT, cap // 4))


def _has_points(capture: Capture) -> bool:
    return len(capture.points) >= 2 * NEIGHBOURS


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
