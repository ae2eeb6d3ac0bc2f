"""Robust least squares where a model answers for many parameters at once: Gauss-Newton by finite differences, damped.

minimise sum_i rho(r_i / s) + |(theta - centre) / spread|^2,   rho of Cauchy, s from the residuals themselves
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

Model = Callable[[np.ndarray], np.ndarray]  # parameters (C, P) to residuals (C, N), NaN where there is no datum

OUTLIER = 3.0  # deviations s at which a residual counts half
DAMPINGS = (0.0, 1e-3, 1e-2, 1e-1, 1.0, 10.0, 100.0)  # of the steps that are tried, relative to the curvature
MOST_STEPS = 12
SMALL_STEP = 0.02  # standard errors: what a step moves at the end
SMALL_GAIN = 1e-4  # relative fall of the loss that is not worth another step
BLOCKS = 10  # stretches of time that are taken as independent
BLOCK_QUANTILE = 1.833  # of Student's t with BLOCKS - 1 degrees of freedom: 5% to each side


@dataclass(frozen=True)
class Prior:
    """Weak knowledge of each parameter: centre, spread, bounds and the step of finite differences, (P,) each."""

    centre: np.ndarray
    spread: np.ndarray
    low: np.ndarray
    high: np.ndarray
    step: np.ndarray


@dataclass(frozen=True)
class Fitted:
    """A minimum: parameters (P,), residuals (N,), their scale s, their derivatives (N, P), and the curvature (P, P)."""

    theta: np.ndarray
    residuals: np.ndarray
    scale: float
    jacobian: np.ndarray
    curvature: np.ndarray
    steps: int

    def shift(self, residuals: np.ndarray) -> np.ndarray:
        """The shift of the minimum where the model gives these residuals (N,) at `theta`, to first order, (P,)."""
        return -np.linalg.solve(self.curvature, gradient(self.jacobian, residuals, self.scale))

    def half_widths(self, block: np.ndarray) -> np.ndarray:
        """Half widths (P,) of 90% intervals, by residuals that agree within blocks (N,) of data and not among them.

        Residuals of a smooth motion are correlated: independent ones would make intervals several times too narrow.
        Where steps ended although the derivatives ask for one, as at impacts, they are not known better than to that.
        """
        inverse, weights = np.linalg.inv(self.curvature), weights_of(self.residuals, self.scale) / self.scale**2
        shifts = []  # of the minimum, where one block is left out: the jackknife
        for b in np.unique(block):
            J, w = self.jacobian[block == b], weights[block == b]
            pull = J.T @ (w * np.nan_to_num(self.residuals[block == b]))
            shifts.append(np.linalg.solve(self.curvature - J.T @ (w[:, None] * J), pull))
        among = (len(shifts) - 1) / len(shifts) * (np.array(shifts) ** 2).sum(0)
        asked = np.abs(self.shift(self.residuals))
        return np.hypot(BLOCK_QUANTILE * np.sqrt(np.maximum(among, np.diag(inverse))), asked)


def weights_of(residuals: np.ndarray, scale: float) -> np.ndarray:
    """Weights of Cauchy's loss, (..., N); 0 where there is no datum."""
    return np.where(np.isfinite(residuals), 1 / (1 + (np.nan_to_num(residuals) / (OUTLIER * scale)) ** 2), 0.0)


def loss_of(residuals: np.ndarray, scale: float) -> np.ndarray:
    """Cauchy's loss, (...,)."""
    square = (np.nan_to_num(residuals) / (OUTLIER * scale)) ** 2
    return 0.5 * OUTLIER**2 * np.log1p(square).sum(-1)


def scale_of(residuals: np.ndarray, least: float) -> float:
    """Robust standard deviation of residuals, at least `least`."""
    known = np.abs(residuals[np.isfinite(residuals)])
    return max(1.4826 * float(np.median(known)), least)


def gradient(jacobian: np.ndarray, residuals: np.ndarray, scale: float) -> np.ndarray:
    return jacobian.T @ (weights_of(residuals, scale) * np.nan_to_num(residuals)) / scale**2


def minimise(
    model: Model, start: np.ndarray, prior: Prior, least_scale: float, progress=lambda done: None, steps=MOST_STEPS
) -> Fitted:
    """The minimum that damped Gauss-Newton reaches from `start` (P,); `least_scale`: the data's noise."""
    theta, r, J, scale, H = start.copy(), None, None, least_scale, None
    for k in range(steps + 1):
        sign = np.where(theta + prior.step > prior.high, -1.0, 1.0)
        r, J = derivatives(model, theta, sign * prior.step)
        scale = scale_of(r, least_scale)
        w = weights_of(r, scale)[:, None]
        H = J.T @ (w * J) / scale**2 + np.diag(prior.spread**-2.0)
        g = gradient(J, r, scale) + (theta - prior.centre) / prior.spread**2
        progress(k / steps)
        if k == steps:
            break
        trials = np.stack([theta - np.linalg.solve(H + d * np.diag(np.diag(H)), g) for d in DAMPINGS])
        trials = np.clip(trials, prior.low, prior.high)
        pull = (((trials - prior.centre) / prior.spread) ** 2).sum(1) / 2
        losses = loss_of(model(trials), scale) + pull
        before = loss_of(r, scale) + (((theta - prior.centre) / prior.spread) ** 2).sum() / 2
        losses = np.where(np.isfinite(losses), losses, np.inf)
        best = int(losses.argmin())
        if not losses[best] < before * (1 - SMALL_GAIN):
            break
        moved = np.abs(trials[best] - theta) / np.sqrt(np.diag(np.linalg.inv(H)))
        theta = trials[best]
        if moved.max() < SMALL_STEP:
            break
    progress(1.0)
    return Fitted(theta, r, scale, J, H, k)


def derivatives(model: Model, theta: np.ndarray, step: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Residuals (N,) at theta, and their forward differences (N, P); 0 where there is no datum."""
    rows = model(np.concatenate([theta[None], theta + np.diag(step)]))
    return rows[0], np.nan_to_num((rows[1:] - rows[0]) / step[:, None]).T
