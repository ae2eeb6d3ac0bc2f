"""Densification in training: adaptive density control, MCMC with a fixed budget, and the clearing of free space."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import comb

import numpy as np

from core.camera import Camera
from prepare.train.population import Population

START, STOP, EVERY = 500, 15_000, 100  # steps of training
GRADIENT_MIN = 2e-4  # [1/half picture] mean positional gradient above which detail is missing
FAR = 0.37  # of the extent: depth from which on a positional gradient counts in full (Pixel-GS)
FADING = 5e-4  # by which the logit of an opacity falls in each step while Gaussians are added
OPACITY_MIN = 0.005

MCMC_GROWTH = 1.05  # growth factor each time until the budget is used
MCMC_STOP, MCMC_LOGIT_RATE = 25_000, 5e-2
NOISE = 5e5  # times the learning rate of the means
OPACITY_COST = SCALE_COST = 0.01  # of the mean opacity and the mean scale
COPIES_MAX = 51  # of a Gaussian for which opacities and scales are computed
NEAR_SHARE = 0.1  # of a view's pixels that may show something nearer than the depth which counts for it
FREE_SHARE = 0.25  # of that depth: nobody photographs a thing from so near that all else is four times as far
MIN_ALPHA = 0.5  # a pixel of lower opacity has no depth


def logit(p: float) -> float:
    """Inverse of the logistic function."""
    return float(np.log(p / (1.0 - p)))


@dataclass
class AdaptiveDensity:
    """Kerbl 2023, Sec. 5: split where positional gradients are large, prune what is faint.

    Unlike there, all are split along their longest axis instead of cloned or scattered (Improved-GS, Deng et al. 2025),
    opacities fall steadily instead of being reset, and large Gaussians are not pruned: what lies far behind the objects
    is meant to be large.

    cap      upper limit of Gaussians, frozen ones included; those with the largest gradients are split first
    stop     step after which none are added or removed
    """

    population: Population
    cap: int
    opacity_cost: float = 0.0
    scale_cost: float = 0.0
    fading: float = FADING
    stop: int = STOP

    def after(self, step: int, mean_rate: float) -> None:
        """Act after a step, counted from 1."""
        if START < step < self.stop and step % EVERY == 0:
            self.refine()

    def refine(self) -> None:
        """Split and prune once, up to `cap` Gaussians."""
        p = self.population
        n = p.count
        gradient = p.gradient_sum.to_numpy()[:n] / np.maximum(p.gradient_count.to_numpy()[:n], 1.0)
        gradient[: p.frozen] = 0.0
        divided = np.flatnonzero(gradient > GRADIENT_MIN)
        room = max(0, min(self.cap, p.capacity) - n)
        if len(divided) > room:
            divided = np.sort(divided[np.argsort(-gradient[divided], kind="stable")[:room]])
        p.copy(divided, np.arange(n, n + len(divided)), moments=False)
        p.splats.count = n + len(divided)
        if len(divided):
            p.split(divided.astype(np.int32), n)
        p.remove(p.parameters.logit.to_numpy()[: p.count] < logit(OPACITY_MIN))
        p.clear_statistics()


@dataclass
class MonteCarlo:
    """Kheradmand 2024: a budget of `cap` Gaussians; dead ones are relocated to live ones, and noise is added to all."""

    population: Population
    cap: int
    rng: np.random.Generator
    opacity_cost: float = OPACITY_COST
    scale_cost: float = SCALE_COST
    fading: float = 0.0
    stop: int = MCMC_STOP

    def after(self, step: int, mean_rate: float) -> None:
        """Act after a step, counted from 1."""
        p = self.population
        if START < step < self.stop and step % EVERY == 0:
            self.relocate()
            self.grow()
            p.activate()
        p.add_noise(p.frozen, p.count, NOISE * mean_rate, int(self.rng.integers(1 << 32)))

    def relocate(self) -> None:
        """Move dead Gaussians to live ones, drawn by their opacity."""
        p = self.population
        opacity = self._opacities()
        dead, alive = np.flatnonzero(opacity <= OPACITY_MIN), np.flatnonzero(opacity > OPACITY_MIN)
        if len(dead) and len(alive):
            self._share(p.frozen + alive[self._draw(opacity[alive], len(dead))], p.frozen + dead)

    def grow(self) -> None:
        """Add Gaussians as long as the budget lasts."""
        p = self.population
        n = p.count
        added = min(self.cap, p.capacity, int(MCMC_GROWTH * n) + 1) - n
        if added > 0 and n > p.frozen:
            opacity = self._opacities()
            p.splats.count = n + added
            self._share(p.frozen + self._draw(opacity, added), np.arange(n, n + added))

    def _opacities(self) -> np.ndarray:
        """Opacities of all Gaussians that are not frozen, float64."""
        p = self.population
        return 1.0 / (1.0 + np.exp(-p.parameters.logit.to_numpy()[p.frozen : p.count].astype(np.float64)))

    def _draw(self, weights: np.ndarray, count: int) -> np.ndarray:
        return self.rng.choice(len(weights), count, p=weights / weights.sum())

    def _share(self, sources: np.ndarray, targets: np.ndarray) -> None:
        """Put copies of `sources` at `targets`, so that all copies of one together look like it."""
        p = self.population
        rows, copies = np.unique(sources, return_counts=True)
        opacity = 1.0 / (1.0 + np.exp(-p.parameters.logit.to_numpy()[rows].astype(np.float64)))
        log_scale = p.parameters.log_scale.to_numpy()[rows].astype(np.float64)
        new, factor = shared_opacity_and_scale(opacity, np.minimum(copies + 1, COPIES_MAX))
        new = np.clip(new, OPACITY_MIN, 1.0 - 1e-6)
        log_scale += np.log(factor)[:, None]
        logits = np.log(new / (1.0 - new))
        p.set_opacity_and_scale(rows.astype(np.int32), logits.astype(np.float32), log_scale.astype(np.float32))
        p.copy(sources, targets, moments=False)


def shared_opacity_and_scale(opacity: np.ndarray, copies: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Opacity of each of N copies of a Gaussian, and the factor on its scale, so that together they look like the one.

    o_new = 1 - (1 - o)^(1/N);  factor = o / sum_{i=1..N} sum_{k<i} C(i-1, k) (-1)^k o_new^(k+1) / sqrt(k+1)
                                                                                       (Kheradmand 2024, eq. 9)
    """
    new = 1.0 - (1.0 - opacity) ** (1.0 / copies)
    total = np.zeros_like(opacity)
    for i in range(1, int(copies.max(initial=0)) + 1):
        term = sum(comb(i - 1, k) * (-1.0) ** k * new ** (k + 1) / np.sqrt(k + 1.0) for k in range(i))
        total += np.where(i <= copies, term, 0.0)
    return new, opacity / total


def near_depth(depth: np.ndarray, alpha: np.ndarray) -> float:
    """Depth beyond which all but NEAR_SHARE of a picture's opaque pixels lie; NaN if it has none."""
    opaque = alpha > MIN_ALPHA
    return float(np.quantile(depth[opaque], NEAR_SHARE)) if opaque.any() else float("nan")


def free_radii(cameras: Sequence[Camera], depths: np.ndarray) -> np.ndarray:
    """Radii (V,) of the balls around the cameras where nothing was photographed; depths: the views' near depths (V,).

    They reach to the next camera at most, so that a wall close behind a dense row of cameras stays. 0 where a view
    shows nothing.
    """
    positions = np.array([c.position for c in cameras])
    apart = np.linalg.norm(positions[:, None] - positions, axis=2)
    np.fill_diagonal(apart, np.inf)
    return np.minimum(FREE_SHARE * np.nan_to_num(depths), apart.min(axis=1))


def in_free_space(means: np.ndarray, cameras: Sequence[Camera], radii: np.ndarray) -> np.ndarray:
    """Mask (N,) of the points (N, 3) in one of the balls."""
    inside = np.zeros(len(means), bool)
    for camera, radius in zip(cameras, radii, strict=True):
        inside |= np.linalg.norm(means - camera.position, axis=1) < radius
    return inside
