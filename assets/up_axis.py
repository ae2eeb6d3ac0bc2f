"""Guess of the up axis and the size of a splat, and the rotation that brings it into the asset's frame.

Structure from motion leaves the frame free, and tools differ (y down from COLMAP, y up from editors). The evidence is
how the object was photographed: it stood on its underside, which no picture shows. There Gaussians are large and
opaque, since no picture split or thinned them, they are dark, or they are missing. A hollow that was captured opens
upwards. And the object stood stably. Scenes stand on a plane (assets/level_planes.py).
"""

from __future__ import annotations

import numpy as np

from assets.gaussians import Gaussians
from assets.level_planes import AXES, axis_name, hollow_columns, scene_votes
from core.errors import BadInput
from core.spherical_harmonics import C0

VIEW_PIXELS = 64  # on the longest side of the six views
LUMA = np.array([0.299, 0.587, 0.114])  # BT.601
FOOT_HEIGHT = 0.05  # of the extent: the part that the object stands on
LAYER_THICKNESS = 0.06  # of the extent: surfaces this close, seen from above and below, are one layer

# Weights of the cues. They differ by 0.1 to 0.7 between a toy's top and underside; a flat side lit from a window
# reaches 0.2 of brightness.
CUE_WEIGHTS = {"size": 1.0, "opacity": 2.0, "brightness": 2.0, "open": 1.5, "hollow": 1.0, "stable": 0.6}
BODY_VOTE_UNIT, SCENE_VOTE_UNIT = 0.1, 0.03  # a vote larger by this much is e times as likely
# Prior votes, by the axes that files use.
UP_PRIOR = {"-y": 0.10, "+y": 0.08, "+z": 0.05, "-z": 0.0, "+x": -0.05, "-x": -0.05}
PLAUSIBLE_SIZE = (0.05, 0.6)  # [m] largest extent of objects for the hand; beyond, units are arbitrary
DEFAULT_SIZE = 0.25  # [m]
SIZE_RANGE = (0.01, 10.0)  # [m] accepted from the user


def robust_bounds(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Lower and upper corner (3,) of all but the outermost 0.5 % of points (N, 3) on each side."""
    low, high = np.percentile(points, [0.5, 99.5], axis=0)
    return low, high


def outermost_points(points: np.ndarray, axis: int, low: np.ndarray, longest: float) -> tuple[np.ndarray, np.ndarray]:
    """Index of the lowest and of the highest point along `axis` in each column that holds any, (C,) each."""
    others = [i for i in range(3) if i != axis]
    pixel = np.floor((points[:, others] - low[others]) / longest * VIEW_PIXELS).astype(np.int64)
    flat = pixel[:, 0] * (4 * VIEW_PIXELS) + pixel[:, 1]
    order = np.lexsort([points[:, axis], flat])
    edge = np.flatnonzero(np.diff(flat[order])) + 1
    return order[np.r_[0, edge]], order[np.r_[edge - 1, len(order) - 1]]


def convex_hull(points: np.ndarray) -> np.ndarray:
    """Corners (C, 2) of the convex hull of points (N, 2), counterclockwise (Andrew 1979); fewer than three of a line.

    Not SciPy's, because that takes a quarter of a second to import.
    """
    corners = []
    ordered = points[np.lexsort(points.T[::-1])].tolist()
    for sweep in (ordered, ordered[::-1]):  # the lower half, then the upper
        half = []
        for x, y in sweep:
            while len(half) > 1:
                (x0, y0), (x1, y1) = half[-2:]
                if (x1 - x0) * (y - y0) > (y1 - y0) * (x - x0):
                    break
                half.pop()
            half.append((x, y))
        corners += half[:-1]
    return np.array(corners).reshape(-1, 2)


def surface_centre(points: np.ndarray, longest: float) -> np.ndarray:
    """Centre (3,) of the surface that points (N, 3) lie on, independent of their density."""
    cell = np.floor(points / longest * VIEW_PIXELS).clip(-(1 << 20), (1 << 20) - 1).astype(np.int64) + (1 << 20)
    key = np.sort(cell[:, 0] << 42 | cell[:, 1] << 21 | cell[:, 2])  # faster than rows
    key = key[np.flatnonzero(np.diff(key, prepend=-1))]
    cells = np.stack([key >> 42, key >> 21 & (1 << 21) - 1, key & (1 << 21) - 1], 1) - (1 << 20)
    return cells.mean(0) * longest / VIEW_PIXELS


def tipping_slope(points: np.ndarray, centre: np.ndarray, axis: int, sign: int, longest: float) -> float:
    """Slope (-0.5 to 0.5) at which an object on its lowest part tips over; negative if it falls by itself."""
    h = sign * points[:, axis]
    foot = points[h < np.percentile(h, 0.3) + FOOT_HEIGHT * longest][:, [i for i in range(3) if i != axis]]
    sides = convex_hull(foot) - np.delete(centre, axis)
    along = np.roll(sides, -1, axis=0) - sides
    length = np.hypot(*along.T)
    if len(sides) < 3 or length.min() == 0.0:  # a point or a line
        return -0.5
    inside = ((sides[:, 0] * along[:, 1] - sides[:, 1] * along[:, 0]) / length).min()  # distance to the nearest side
    return float(np.clip(inside / max(sign * centre[axis] - np.percentile(h, 0.3), 1e-12), -0.5, 0.5))


def up_cues(gaussians: Gaussians) -> dict[str, dict[str, float]]:
    """Evidence for each axis to point up, by cue; larger is more likely."""
    g = gaussians.select(gaussians.opacities >= min(0.3, np.median(gaussians.opacities)))
    points = g.means.astype(np.float64)
    low, high = robust_bounds(points)
    longest = (high - low).max()
    sigma = np.sort(g.log_scales, axis=1)[:, 1]  # the middle one: the width of a disc
    centre = surface_centre(points, longest)
    luma = np.clip(0.5 + C0 * g.sh[:, 0], 0, 1) @ LUMA
    found = {}
    for axis in range(3):
        below, above = outermost_points(points, axis, low, longest)
        h = points[:, axis]
        single = h[above] - h[below] < LAYER_THICKNESS * longest
        middle = (h[below] + h[above]) / 2
        height = 2 * (middle - low[axis]) / max(high[axis] - low[axis], 1e-12) - 1  # -1 bottom, 1 top
        hollow = {s: hollow_columns(points, points[hit], axis, s, longest) for s, hit in ((1, above), (-1, below))}
        single &= ~(hollow[1] | hollow[-1])  # a cup's floor is a single layer where its underside is missing
        plus = {
            "size": float(sigma[below].mean() - sigma[above].mean()),
            "opacity": float(g.opacities[below].mean() - g.opacities[above].mean()),
            "brightness": float(luma[above].mean() - luma[below].mean()),
            "open": float((single * height.clip(-1, 1)).mean()),
            "hollow": float(hollow[1].mean() - hollow[-1].mean()),
        }
        for sign in (1, -1):
            values = {name: sign * value for name, value in plus.items()}
            values["stable"] = tipping_slope(points, centre, axis, sign, longest)
            found[axis_name(axis, sign)] = values
    return found


def guess_up_axis(gaussians: Gaussians) -> tuple[str, float]:
    """The axis of the file that points up, "+x", "-x", ... "-z", and the confidence, 0 to 1.

    For a room or a garden, by its planes. The confidence is a softmax of votes: it ranks guesses, it is no frequency.
    """
    votes, unit = scene_votes(gaussians), SCENE_VOTE_UNIT
    if votes is not None:
        votes = {up: vote + 0.1 * UP_PRIOR[up] for up, vote in votes.items()}
    else:
        unit = BODY_VOTE_UNIT
        votes = {
            up: UP_PRIOR[up] + sum(CUE_WEIGHTS[name] * value for name, value in of.items())
            for up, of in up_cues(gaussians).items()
        }
    return most_likely(votes, unit)


def most_likely(votes: dict[str, float], unit: float) -> tuple[str, float]:
    """The axis with the largest vote, and its softmax, in which a vote larger by `unit` counts e times as much."""
    up = max(AXES, key=lambda name: votes[name])
    return up, float(1 / sum(np.exp((vote - votes[up]) / unit) for vote in votes.values()))


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
