"""How long a substep may be: dt sqrt(max kappa) <= 0.3 (MATH: above it the Jacobi sum over tets diverges)."""

from __future__ import annotations

import numpy as np

from assets.errors import BadInput
from scenes.scene import Material

LIMIT = 0.3  # measured bound of dt sqrt(max kappa) for unaveraged Jacobi with one sweep


def lame(material: Material) -> tuple[float, float]:
    """mu and lam = lambda_L + mu [Pa] of the stable neo-Hookean energy."""
    E, nu = material.young, material.poisson
    mu = E / (2 * (1 + nu))
    return mu, E * nu / ((1 + nu) * (1 - 2 * nu)) + mu


def stiffness_bounds(rest: np.ndarray, tets: np.ndarray, w: np.ndarray, material: Material) -> np.ndarray:
    """kappa = (lambda_L + 2 mu) V sum_a w_a |grad N_a|^2 of each tet [1/s^2], (T,) float64.

    It bounds the tet's squared frequency if its corners moved with their inverse masses w alone.
    """
    mu, lam = lame(material)
    D = np.swapaxes(rest[tets[:, 1:]] - rest[tets[:, :1]], 1, 2)
    gradients = np.linalg.inv(D)  # row k = grad N_{k+1}
    gradients = np.concatenate([-gradients.sum(1, keepdims=True), gradients], axis=1)
    return (lam + mu) * np.linalg.det(D) / 6 * (w[tets] * (gradients**2).sum(-1)).sum(1)


def largest_substep(kappa: float) -> float:
    """The longest stable substep [s] for a largest kappa [1/s^2]."""
    return LIMIT / np.sqrt(max(kappa, 1e-12))


def choose_substep(kappa: float, forced: float | None) -> float:
    """The forced substep [s] if it is stable, else BadInput; without one the longest stable one."""
    longest = largest_substep(kappa)
    if forced is None:
        return longest
    if not 0 < forced <= 1.0001 * longest:
        raise BadInput(
            f"a substep of {forced:g} s is not stable for these meshes and materials: at most {longest:.3g} s"
        )
    return forced
