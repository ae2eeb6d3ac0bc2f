"""Thinned splats: every so many-th Gaussian, widened to cover what those between covered, stands for them."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from assets.gaussians import Gaussians
from prepare.segment.gaussian_graph import log_widths, nearest_as_wide


@dataclass(frozen=True)
class Thinned:
    """`some` (M,) of N Gaussians, these as `gaussians`, and the one that stands for each: `cell` (N,), in 0..M-1."""

    some: np.ndarray
    gaussians: Gaussians
    cell: np.ndarray


def thinned(gaussians: Gaussians, most: int) -> Thinned:
    """At most so many of the Gaussians, evenly spread; the given ones lie in Morton order.

    For each of these stands the nearest of those that is about as wide or wider.
    """
    step = -(-len(gaussians) // most)
    points = gaussians.means.astype(np.float64)
    some = np.arange(step // 2, len(points), step, dtype=np.int32)
    width = log_widths(gaussians)
    place = np.empty(len(points), np.int32)
    place[some] = np.arange(len(some))
    cell = place[nearest_as_wide(points, width, some, 1)[0][:, 0]]
    return Thinned(some, widened(gaussians.select(some), step), cell)


def widened(gaussians: Gaussians, factor: float) -> Gaussians:
    """The Gaussians with so many times their area: their two larger scales grow, and the surface gets no thicker."""
    scales = gaussians.log_scales.copy()
    scales += np.float32(0.5 * np.log(factor)) * (scales > scales.min(axis=1, keepdims=True))
    return replace(gaussians, log_scales=scales)
