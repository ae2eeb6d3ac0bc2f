"""Likely cameras of a splat that came without its photographs.

Training makes many small, opaque Gaussians where cameras looked, keeps free what they looked through, and leaves fog
and floaters where none did. So a picture from where a camera stood is sharp, and shows much of the detail. On three
trained captures (a fox's head on a wall, a stone bear, a doll) the best view was within 5 degrees of a real camera.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from assets.gaussians import Gaussians
from core.camera import Camera, look_at, perspective
from core.errors import BadInput
from prepare.blending_weights import BlendingWeights
from prepare.environment.clear_view import FOG_WIDTH
from prepare.progress import Progress, no_progress

OPAQUE = 0.3  # fainter Gaussians are haze
WIDTH, HEIGHT, FOV_Y = 96, 72, 0.9  # [px], [rad] of the pictures that are compared
# From what is looked at, in median distances of the Gaussians: around a subject (2.1 to 2.6 on four captures), or
# within a room.
DISTANCES = (2.3, 0.6)
AZIMUTHS = 12
ELEVATIONS = (-20.0, 5.0, 30.0, 55.0)  # [degrees]
FINER = 0.5  # of the step between views, for those around the best one
LIKELY = 0.4  # of the best view's score; below, no camera stood there
MIDDLE_STEPS = 50  # of the iteration for the geometric median


class NothingSeen(BadInput):
    """A splat of which nothing is seen sharply from anywhere."""


@dataclass(frozen=True)
class Outlook:
    """Views that are sharp and show much, best first, all of the point `target` (3,), with their scores (V,)."""

    cameras: list[Camera]
    scores: np.ndarray
    target: np.ndarray

    @property
    def places(self) -> np.ndarray:
        """Centres of the cameras, (V, 3)."""
        return np.array([c.position for c in self.cameras])


def likely_cameras(gaussians: Gaussians, *, progress: Progress = no_progress) -> Outlook:
    """Cameras that may have photographed a splat, +y up, of which the best is where a player sees most.

    Taichi must be running. Raises NothingSeen.
    """
    views = ScoredViews(gaussians)
    target = geometric_median(gaussians)
    away = np.linalg.norm(gaussians.means[gaussians.opacities > OPAQUE] - target, axis=1)
    unit = float(np.median(away))
    azimuths = 360.0 / AZIMUTHS * np.arange(AZIMUTHS)
    tried = [(d, a, e) for d in DISTANCES for a in azimuths for e in ELEVATIONS]
    scores = []

    def score(d: float, a: float, e: float) -> float:
        progress("views", len(scores) / (len(tried) + 8))
        return views.score(eye_at(target, d * unit, a, e), target)

    for view in tried:
        scores.append(score(*view))
    if not max(scores) > 0.0:
        views.destroy()
        raise NothingSeen("nothing of it is seen sharply from anywhere")
    d, a, e = tried[int(np.argmax(scores))]
    step = FINER * np.array([azimuths[1], ELEVATIONS[1] - ELEVATIONS[0]])
    for u, v in [(u, v) for u in (-1, 0, 1) for v in (-1, 0, 1) if u or v]:
        tried.append((d, a + u * step[0], e + v * step[1]))
        scores.append(score(*tried[-1]))
    same = [k for k in np.argsort(scores)[::-1] if tried[k][0] == d and scores[k] >= LIKELY * max(scores)]
    eyes = [eye_at(target, tried[k][0] * unit, *tried[k][1:]) for k in same]
    views.destroy()
    cameras = [perspective(WIDTH, HEIGHT, FOV_Y, look_at(eye, target)) for eye in eyes]
    return Outlook(cameras, np.array(scores)[same], target)


def geometric_median(gaussians: Gaussians) -> np.ndarray:
    """The point (3,) with the least mean distance to the opaque Gaussians (Weiszfeld's iteration): what most cameras
    looked at, as a backdrop has few Gaussians and weighs no more for being far away."""
    x = gaussians.means[gaussians.opacities > OPAQUE].astype(np.float64)
    found = np.median(x, axis=0)
    for _ in range(MIDDLE_STEPS):
        away = np.linalg.norm(x - found, axis=1)
        found = np.average(x, axis=0, weights=1.0 / np.maximum(away, 1e-3 * away.max()))
    return found


def eye_at(target: np.ndarray, distance: float, azimuth: float, elevation: float) -> np.ndarray:
    """The point (3,) at a distance from the target; azimuth about +y from +z, and elevation [degrees]."""
    a, e = np.radians([azimuth, elevation])
    return target + distance * np.array([np.sin(a) * np.cos(e), np.sin(e), np.cos(a) * np.cos(e)])


class ScoredViews:
    """Draws Gaussians and scores the pictures: the share that is sharp, times that of the detail that is seen."""

    def __init__(self, gaussians: Gaussians):
        s = np.sort(np.exp(gaussians.log_scales.astype(np.float64)), axis=1)
        self._means, self._opacities = gaussians.means.astype(np.float64), gaussians.opacities
        self._width, self._radius = 2.0 * s[:, 1], np.sqrt(s[:, 1] * s[:, 2])
        opaque = self._opacities > OPAQUE
        self._detail = opaque & (self._radius < np.median(self._radius[opaque]))
        self._weights = BlendingWeights(gaussians, sort="radial")

    def destroy(self) -> None:
        """Free the device memory."""
        self._weights.destroy()

    def score(self, eye: np.ndarray, target: np.ndarray) -> float:
        """Score, 0 to 1, of the view from an eye (3,) of a target (3,)."""
        return float(np.prod(self.sharp_and_seen(eye, target)))

    def sharp_and_seen(self, eye: np.ndarray, target: np.ndarray) -> tuple[float, float]:
        """The share of the picture that is sharp, and that of the splat's detail which it shows."""
        camera = perspective(WIDTH, HEIGHT, FOV_Y, look_at(eye, target))
        weight = self._weights.sums(camera, [np.ones((HEIGHT, WIDTH))])[:, 0]
        away = np.maximum(np.linalg.norm(self._means - eye, axis=1), 1e-9)
        sharp = weight[self._width < FOG_WIDTH * away].sum() / (WIDTH * HEIGHT)
        own = self._detail
        # The weight that a Gaussian alone would have: its opacity's integral, of a part of a pixel at least.
        alone = 2.0 * np.pi * self._opacities[own] * (camera.fx * self._radius[own] / away[own]) ** 2
        seen = np.minimum(weight[own] / np.maximum(alone, 0.3), 1.0).mean()
        return float(sharp), float(seen)
