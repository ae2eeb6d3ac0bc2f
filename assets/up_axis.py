"""Guess of the up axis and the size of a splat, and the rotation that brings it into the asset's frame.

Structure from motion leaves the frame free, and tools differ (y down from COLMAP, y up from editors). A guess is a
probability for each of the six axes: a conditional logit model of cues (assets/up_cues.py) times how often files have
that axis up. `vrgs.py bench orientation` fits the model on some hundreds of turned and cut objects and rooms, and
checks on others that a said 80% is right in 80 of 100 cases.
"""

from __future__ import annotations

import numpy as np

from assets.gaussians import Gaussians
from assets.level_planes import AXES
from core.errors import BadInput

# log P(up | cues) = sum_k WEIGHTS[k] cue_k(up) + const, fitted by `vrgs.py bench orientation --fit`: of a thing to take
# into the hand, and of a room, a table top or open ground.
WEIGHTS = {
    "body": {
        "bright": 10.7,
        "open": 4.91,
        "low": 0.868,
        "foot": 3.74,
        "unlike": 4.9,
        "askew": -8.95,
        "shelves": 7.1,
        "sharp": 13.5,
        "stable": 5.23,
    },
    "scene": {
        "bright": 9.77,
        "open": -0.276,
        "low": 0.54,
        "foot": 0.63,
        "unlike": 1.66,
        "askew": -5.58,
        "shelves": 13.7,
        "sharp": 6.61,
        "stable": 16.2,
    },
}
# Of a file that may be either, what both models say is added in these parts (a logarithmic opinion pool, Genest & Zidek
# 1986), fitted to all cases. The mean of their probabilities would be less sure than it is right: so is every mean of
# calibrated forecasts (Ranjan & Gneiting 2010).
POOL = {"body": 0.84, "scene": 0.24}
# Share of the cases, fitted, in which the cues mean nothing: no guess is surer than that leaves it.
LAPSE = {"body": 0.0093, "scene": 0.0072, None: 0.013}
# Frequencies of a file's up axis: of 30 splats that public programs for the web place in their code, 18 have -y up
# (COLMAP's), 10 +y, one +z and one -z. Two more are added to each.
FILE_PRIOR = {"-y": 0.48, "+y": 0.29, "+z": 0.07, "-z": 0.07, "+x": 0.05, "-x": 0.04}
UNSURE = 0.8  # below, the user is shown the alternatives
ALTERNATIVE_MIN = 0.02  # probability of an axis that is shown as one
PLAUSIBLE_SIZE = (0.05, 0.6)  # [m] largest extent of objects for the hand; beyond, units are arbitrary
DEFAULT_SIZE = 0.25  # [m]
SIZE_RANGE = (0.01, 10.0)  # [m] accepted from the user


def robust_bounds(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Lower and upper corner (3,) of all but the outermost 0.5 % of points (N, 3) on each side."""
    low, high = np.percentile(points, [0.5, 99.5], axis=0)
    return low, high


def up_probabilities(
    gaussians: Gaussians, prior: dict[str, float] | None = None, kind: str | None = None
) -> dict[str, float]:
    """Probability of each axis of the file, "+x" to "-z", to point up.

    prior  of the axes; None: FILE_PRIOR
    kind   "body" or "scene"; None: it may be either
    """
    from assets.up_cues import up_cues

    return probabilities_from(up_cues(gaussians), prior, kind)


def probabilities_from(
    cues: dict[str, dict[str, float]], prior: dict[str, float] | None = None, kind: str | None = None
) -> dict[str, float]:
    """As `up_probabilities`, from the cues of each axis."""
    prior = prior or FILE_PRIOR
    given = np.array([prior[up] for up in AXES])
    given /= given.sum()
    parts = {kind: 1.0} if kind else POOL
    votes = np.array(
        [sum(parts[k] * w * cues[up][name] for k in parts for name, w in WEIGHTS[k].items()) for up in AXES]
    )
    likely = given * np.exp(votes - votes.max())
    p = (1 - LAPSE[kind]) * likely / likely.sum() + LAPSE[kind] * given
    return dict(zip(AXES, p.tolist(), strict=True))


def guess_up_axis(gaussians: Gaussians, kind: str | None = None) -> tuple[str, float]:
    """The most probable up axis of a file, "+x", "-x", ... "-z", and its probability."""
    return most_likely(up_probabilities(gaussians, kind=kind))


def most_likely(probabilities: dict[str, float]) -> tuple[str, float]:
    """The most probable axis, and its probability."""
    up = max(probabilities, key=probabilities.get)
    return up, probabilities[up]


def alternatives(probabilities: dict[str, float]) -> list[str]:
    """The axes that may well point up, most probable first; one alone if that is sure."""
    ranked = sorted(probabilities, key=probabilities.get, reverse=True)
    if not ranked or probabilities[ranked[0]] >= UNSURE:
        return ranked[:1]
    return [up for up in ranked if probabilities[up] >= ALTERNATIVE_MIN]


def describe_guess(up: str, confidence: float) -> str:
    """A guess in words, for the terminal."""
    return f"{up} (guessed, {confidence:.0%} sure; --up overrides)"


def rotation_to_up(up: str) -> np.ndarray:
    """The smallest rotation (3, 3) that takes the axis `up` of the file to +y. Raises BadInput."""
    if up not in AXES:
        raise BadInput(f"up axis {up!r} is unknown; one of {', '.join(sorted(AXES))}")
    return {
        "+y": np.eye(3),
        "-y": np.diag([1.0, -1.0, -1.0]),  # half a turn about x, as from COLMAP's cameras to OpenGL's
        "+z": np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]]),
        "-z": np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]]),
        "+x": np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]]),
        "-x": np.array([[0.0, 1, 0], [-1, 0, 0], [0, 0, 1]]),
    }[up]


def body_size(longest: float, scale: float | None) -> float:
    """Size [m] of an object with the largest extent `longest` in the file: `scale` if given, else that if plausible.

    Raises BadInput.
    """
    if scale is None:
        return longest if PLAUSIBLE_SIZE[0] <= longest <= PLAUSIBLE_SIZE[1] else DEFAULT_SIZE
    if not SIZE_RANGE[0] <= scale <= SIZE_RANGE[1]:
        raise BadInput(f"a size of {scale:g} m is out of range ({SIZE_RANGE[0]} to {SIZE_RANGE[1]:g})")
    return float(scale)
