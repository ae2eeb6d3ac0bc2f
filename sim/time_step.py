"""Integrator, substep and schedule of a frame, and the stiffness that they bear (NumPy only).

XPBD needs dt sqrt(max kappa) <= 0.3 (above it the Jacobi sum over tets diverges). What would then need microscopic
substeps (stiff materials, fine meshes, slivers) is integrated by VBD, which is stable at any dt.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from core.errors import BadInput
from core.material import Material

STABILITY_LIMIT = 0.3  # of dt sqrt(max kappa), measured for unaveraged Jacobi with one sweep
# Substeps of XPBD that cost as much as one of VBD, two sweeps and the modal correction: of the bear of `vrgs.py bench
# demos --detail paper` on an H200 (the horse: 13), of the cat of 2.3k vertices of `bench scene` on two CPU cores.
VBD_COST = {"cuda": 9.5, "cpu": 14.0}
MAX_XPBD_SUBSTEPS = 5000  # a frame, if XPBD is forced
VBD_SUBSTEP = 1 / 1260  # [s]
SWEEPS = {"xpbd": 1, "vbd": 2}  # a substep. With one sweep of VBD, light stiff plates jump from the floor
# Lengths of a body that a pressure wave crosses in a substep of VBD. Two sweeps and the modes do not converge where it
# crosses more: a tiny displacement by a contact stores many times the body's energy, and throws it. Of 144
# cubes, bars, plates and rings thrown at 5 m/s, none came back faster than it went at 3, 6 and 8 lengths; at 39, most.
WAVE_CROSSINGS = 6.0
MIN_VBD_SUBSTEP = 1 / 60 / 256  # [s]; what would need shorter ones is made softer, see `clamp_stiffness`
INTEGRATORS = ("auto", "xpbd", "vbd")


def lame(material: Material) -> tuple[float, float]:
    """mu and lam = lambda_L + mu [Pa] of the stable neo-Hookean energy."""
    mu, lame_lambda = material.lame_parameters
    return mu, lame_lambda + mu


def wave_speed(material: Material) -> float:
    """Speed of pressure waves [m/s], sqrt((lambda_L + 2 mu) / rho)."""
    return math.sqrt(sum(lame(material)) / material.density)


def clamp_stiffness(material: Material, length: float) -> Material:
    """Soften the material of a body of this largest extent [m] as far as VBD needs.

    A wave crosses the body in at least MIN_VBD_SUBSTEP / WAVE_CROSSINGS: for 6 cm of 10 kg/m^3 and nu = 0.3 that limits
    Young's modulus to 5.7e7 Pa. The simulated material stands in `BodyModel.material`, the given one in its `body`.
    """
    ratio = WAVE_CROSSINGS * length / MIN_VBD_SUBSTEP / wave_speed(material)
    return material if ratio >= 1.0 else replace(material, young=material.young * ratio**2)


def stiffness_bounds(inverse: np.ndarray, volumes: np.ndarray, inv_mass: np.ndarray, material: Material) -> np.ndarray:
    """kappa = (lambda_L + 2 mu) V sum_a w_a |grad N_a|^2 of each tet [1/s^2], (T,) float64.

    It bounds the tet's squared frequency if its corners moved with their inverse masses alone. inverse = D_m^-1
    (T, 3, 3) [1/m], its rows the gradients of corners 1 to 3; volumes (T,) [m^3]; inv_mass (T, 4) [1/kg].
    """
    mu, lam = lame(material)
    gradients = np.concatenate([-inverse.sum(1, keepdims=True), inverse], axis=1)
    return (lam + mu) * volumes * (inv_mass * (gradients**2).sum(-1)).sum(1)


def largest_substep(kappa: float) -> float:
    """Longest stable substep of XPBD [s] for a largest kappa [1/s^2]."""
    return STABILITY_LIMIT / np.sqrt(max(kappa, 1e-12))


@dataclass(frozen=True)
class Integration:
    """Integrator "xpbd" or "vbd", and its substep [s]."""

    integrator: str
    substep: float


def choose_integration(
    kappa: float,
    *,
    frame_dt: float,
    integrator: str = "auto",
    substep: float | None = None,
    stiffest: str = "bodies",
    crossing_time: float = math.inf,
    device: str = "cpu",
) -> Integration:
    """Choose for a largest kappa [1/s^2] and frames of frame_dt [s].

    `stiffest` names the body in errors; a pressure wave crosses a body in `crossing_time` [s] or longer.
    "auto" is XPBD where its rule allows the forced substep, or without one if its substeps cost at most as much as
    VBD's on this device ("cuda" or "cpu"), else VBD. None: the longest substep of the rule, or VBD_SUBSTEP, or less
    after WAVE_CROSSINGS.
    """
    longest = largest_substep(kappa)
    if integrator not in INTEGRATORS:
        raise BadInput(f"integrator must be one of {', '.join(INTEGRATORS)}, not {integrator!r}")
    if substep is not None and not 0 < substep <= frame_dt:
        raise BadInput(f"a substep must be between 0 and the frame of {frame_dt:.3g} s, not {substep:g} s")
    stable = substep is None or substep <= 1.0001 * longest
    usual = min(VBD_SUBSTEP, frame_dt, WAVE_CROSSINGS * crossing_time)
    cheap = substep is not None or usual <= VBD_COST[device] * longest
    if integrator == "vbd" or (integrator == "auto" and not (stable and cheap)):
        return Integration("vbd", substep or usual)
    if not stable:
        raise BadInput(f"{stiffest}: a substep of {substep:g} s is not stable with XPBD: at most {longest:.3g} s")
    if math.ceil(frame_dt / longest) > MAX_XPBD_SUBSTEPS:
        raise BadInput(f"{stiffest}: too stiff for XPBD: {frame_dt / longest:.3g} substeps a frame")
    return Integration("xpbd", substep or longest)


@dataclass(frozen=True)
class Schedule:
    """Division of a frame into searches for contacts, launches, and substeps.

    launches[k] launches of `substeps` substeps each follow search k.
    """

    substeps: int
    launches: tuple[int, ...]

    @classmethod
    def of(cls, substeps: float, searches: int, max_substeps: int) -> Schedule:
        """Schedule at least this many substeps, at most max_substeps a launch, with evenly spread searches."""
        total = max(searches, math.ceil(substeps - 1e-6))
        launches = max(searches, -(-total // max_substeps))
        begins = [-(-k * launches // searches) for k in range(searches + 1)]
        return cls(-(-total // launches), tuple(b - a for a, b in pairwise(begins)))

    @property
    def total_substeps(self) -> int:
        return self.substeps * sum(self.launches)
