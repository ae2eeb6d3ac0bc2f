"""Seeds of an object in a splat: Gaussians that the user's marks put certainly inside or outside of it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from assets.gaussians import Gaussians
from core.camera import Camera
from prepare.segment.marks import ViewMarks, drawn_boxes, drawn_strokes

STROKE_WIDTH = 0.008  # fraction of a picture's height: a thin felt pen
SEED_SHARE = 0.8  # fraction of a stroke's weight that its seeds carry; the rest shines through or spills in
BOX_MIDDLE = 1 / 3  # fraction of a box's sides: this middle part is taken for the object if there is no stroke
CLEARLY = 2.0  # a Gaussian under strokes of both sides is a seed of one if its weight there is this many times larger


@dataclass(frozen=True)
class ViewSeeds:
    """Seeds by the marks of one view: indices of those inside and outside, and what no box holds, (N,) bool."""

    inside: np.ndarray
    outside: np.ndarray
    barred: np.ndarray | None


class Seeds:
    """Seeds (N,) bool of an object: `inside`, `outside`, and `barred`, which no box around it holds."""

    def __init__(self, count: int, views: Iterable[ViewSeeds]):
        self.inside, self.outside, self.barred = (np.zeros(count, bool) for _ in range(3))
        for view in views:
            self.inside[view.inside] = self.outside[view.outside] = True
            if view.barred is not None:
                self.barred |= view.barred
        self.inside &= ~self.outside


def seeds_of(gaussians: Gaussians, weights, cameras: Mapping[str, Camera], marks: Mapping[str, ViewMarks]) -> Seeds:
    """Seeds of an object by its marks in all views; `weights` are BlendingWeights of the Gaussians."""
    return Seeds(len(gaussians), [view_seeds(gaussians, weights, cameras[name], mark) for name, mark in marks.items()])


def view_seeds(gaussians: Gaussians, weights, camera: Camera, marks: ViewMarks) -> ViewSeeds:
    """Seeds of an object by its marks in a view."""
    under = stroke_weights(weights, camera, marks)
    inside, outside = (strongest(w) for w in under)
    return ViewSeeds(
        inside[under[0][inside] > CLEARLY * under[1][inside]],
        outside[under[1][outside] > CLEARLY * under[0][outside]],
        ~in_boxes(gaussians, camera, marks.boxes) if marks.boxes else None,
    )


def stroke_weights(weights, camera: Camera, marks: ViewMarks) -> tuple[np.ndarray, np.ndarray]:
    """Weights (N,) [px] of each Gaussian under what is inside and outside; a box without strokes counts as one."""
    shape = (camera.height, camera.width)
    width = max(3, round(STROKE_WIDTH * camera.height))
    inside, outside = (drawn_strokes(strokes, shape, width) for strokes in (marks.inside, marks.outside))
    if marks.boxes and not marks.inside:
        middles = [np.tile(0.5 * (b[:2] + b[2:]), 2) for b in marks.boxes]
        half = [0.5 * BOX_MIDDLE * (b[2:] - b[:2]) for b in marks.boxes]
        inside |= drawn_boxes([m + np.concatenate([-h, h]) for m, h in zip(middles, half, strict=True)], shape)
    return tuple(weights.sums(camera, [inside, outside]).T)


def strongest(weights: np.ndarray) -> np.ndarray:
    """Indices of the Gaussians of the largest weights (N,) that make up SEED_SHARE of their sum."""
    some = np.flatnonzero(weights)
    order = some[np.argsort(-weights[some])]
    total = np.cumsum(weights[order], dtype=np.float64)
    return order[: int(np.searchsorted(total, SEED_SHARE * total[-1])) + 1] if len(order) else order


def in_boxes(gaussians: Gaussians, camera: Camera, boxes: list[np.ndarray]) -> np.ndarray:
    """Gaussians (N,) bool whose centre projects into a box of the picture."""
    p = gaussians.means.astype(np.float64) @ camera.world_to_camera[:3, :3].T + camera.world_to_camera[:3, 3]
    z = np.maximum(p[:, 2], 1e-9)
    x, y = camera.fx * p[:, 0] / z + camera.cx, camera.fy * p[:, 1] / z + camera.cy
    within = [(x >= b[0]) & (x <= b[2]) & (y >= b[1]) & (y <= b[3]) for b in boxes]
    return np.any(within, axis=0) & (p[:, 2] > 0)
