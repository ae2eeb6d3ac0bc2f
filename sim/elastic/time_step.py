"""How long a substep may be, and which path takes it.

The Jacobi path needs dt sqrt(max kappa) <= 0.3 (MATH: above it the sum over tets diverges). What would need
microscopic substeps then - stiff materials, fine meshes, slivers - goes by descent, which holds at any dt.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from core.errors import BadInput
from core.material import Material

LIMIT = 0.3  # measured bound of dt sqrt(max kappa) for unaveraged Jacobi with one sweep
JACOBI_MOST = 400  # substeps a frame, the paper's number; with more, descent is cheaper
MOST_SUBSTEPS = 5000  # a frame, if the Jacobi path is forced
DESCENT_SUBSTEPS, DESCENT_SWEEPS = 64, 2  # a frame, a substep: for one cost, short steps err less than many sweeps
# Lengths of a body that a pressure wave crosses in a substep of descent. Two sweeps and the modes do not converge where
# it crosses more: what a contact moves by a hair's breadth stores many times the body's energy, and throws it. Of 144
# cubes, bars, plates and rings thrown at 5 m/s, none came back faster than it went at 3, 6 and 8 lengths; at 39, most.
CROSSINGS = 6.0
SHORTEST = 1 / 60 / 256  # [s]; what would need shorter substeps of descent is made softer, see `bearable`
PATHS = ("auto", "jacobi", "descent")


def lame(material: Material) -> tuple[float, float]:
    """mu and lam = lambda_L + mu [Pa] of the stable neo-Hookean energy."""
    E, nu = material.young, material.poisson
    mu = E / (2 * (1 + nu))
    return mu, E * nu / ((1 + nu) * (1 - 2 * nu)) + mu


def wave_speed(material: Material) -> float:
    """Of pressure waves [m/s], sqrt((lambda_L + 2 mu) / rho)."""
    return math.sqrt(sum(lame(material)) / material.density)


def bearable(material: Material, length: float) -> Material:
    """The material of a body of this largest extent [m] as it is simulated: one so light and stiff that a wave crosses
    the body in less than SHORTEST / CROSSINGS is softer. For 6 cm of 10 kg/m^3 and nu = 0.3 that begins at 5.7e7 Pa.
    """
    share = CROSSINGS * length / SHORTEST / wave_speed(material)
    return material if share >= 1.0 else replace(material, young=material.young * share**2)


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


@dataclass(frozen=True)
class Plan:
    """How a solver steps: path "jacobi" or "descent", substep [s], sweeps a substep."""

    path: str
    substep: float
    iterations: int


def choose_plan(
    kappa: float,
    *,
    frame_dt: float,
    path: str = "auto",
    substep: float | None = None,
    iterations: int | None = None,
    stiffest: str = "bodies",
    crossing: float = math.inf,
) -> Plan:
    """The plan for a largest kappa [1/s^2] and frames of frame_dt [s]; `stiffest` names the body in errors, `crossing`
    [s] is the shortest time in which a pressure wave crosses a body.

    Path "auto" is Jacobi where its rule allows the forced substep, or without one if it needs at most JACOBI_MOST
    substeps a frame, else descent. None: the longest substep of the rule and one sweep, or frame_dt / DESCENT_SUBSTEPS,
    or less after CROSSINGS, and DESCENT_SWEEPS.
    """
    longest = largest_substep(kappa)
    if path not in PATHS:
        raise BadInput(f"path must be one of {', '.join(PATHS)}, not {path!r}")
    if substep is not None and not 0 < substep <= frame_dt:
        raise BadInput(f"a substep must be between 0 and the frame of {frame_dt:.3g} s, not {substep:g} s")
    if iterations is not None and iterations < 1:
        raise BadInput(f"iterations must be at least 1, not {iterations}")
    stable = substep is None or substep <= 1.0001 * longest
    few = math.ceil(frame_dt / longest) <= JACOBI_MOST
    if path == "descent" or (path == "auto" and not (stable and (few or substep is not None))):
        usual = min(frame_dt / DESCENT_SUBSTEPS, CROSSINGS * crossing)
        return Plan("descent", substep or usual, iterations or DESCENT_SWEEPS)
    if not stable:
        raise BadInput(
            f"{stiffest}: a substep of {substep:g} s is not stable by the Jacobi path: at most {longest:.3g} s"
        )
    if math.ceil(frame_dt / longest) > MOST_SUBSTEPS:
        raise BadInput(f"{stiffest}: too stiff for the Jacobi path: {frame_dt / longest:.3g} substeps a frame")
    return Plan("jacobi", substep or longest, iterations or 1)
