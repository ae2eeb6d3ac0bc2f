"""Up axis of a capture, from its cameras.

People hold a camera level to a few degrees, upright or turned by a quarter, but tilt it up or down as they like. So the
horizontal axis of each picture is nearly perpendicular to the vertical, and these axes determine it as soon as the
cameras look in different directions. The mean up vector of the pictures decides what they leave open.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

ROLL = np.radians(4.0)  # standard deviation of a hand-held camera's roll
TILT = np.radians(25.0)  # standard deviation of a tilt shared by all photographs, as of a table seen from above
OUTLIER = 3.0  # standard deviations of roll beyond which the cost is constant
# Cost of a picture turned by 0, 1, 2, 3 quarters, as -log of how seldom that is: most cameras store pictures upright.
QUARTER_COST = np.array([0.0, 2.0, 5.0, 2.0])
STARTS = 60  # cameras whose axes are tried as the initial vertical
ITERATIONS = 20


@dataclass(frozen=True)
class CameraUp:
    """Vertical estimated from cameras.

    direction  unit, (3,), in the capture's frame
    error      standard deviation of its angle [rad], in the direction in which it is largest
    quarters   number of quarter turns of each picture, 0 to 3, (V,)
    """

    direction: np.ndarray
    error: float
    quarters: np.ndarray


def up_of_cameras(world_to_camera: np.ndarray) -> CameraUp:
    """The vertical of cameras (V, 4, 4), +z ahead and +y down, V > 0.

    With horizontal axes x_i and a mean up m it is the maximum of a posterior,
        u ~ (sum_i w_i x_i x_i^T / ROLL^2 + I / TILT^2)^-1 m / TILT^2,
    with weights w_i that leave outliers out. It starts at the best of the pictures' own axes.
    """
    right, down, _ = np.moveaxis(world_to_camera[:, :3, :3], 1, 0)
    axes = np.stack([-down, right, down, -right], 1)  # up in the world if the picture is turned by 0, 1, 2, 3 quarters
    some = axes[:: -(-len(axes) // STARTS)].reshape(-1, 3)
    mean = -down.sum(0)
    starts = np.concatenate([_unit(mean)[None], some])
    up = starts[np.argmin([_costs(axes, u).min(1).sum() for u in starts])]
    for _ in range(ITERATIONS):
        quarters = _costs(axes, up).argmin(1)
        level, own = (axes[np.arange(len(axes)), (quarters + k) % 4] for k in (1, 0))
        weight = 1 / (1 + (level @ up / (OUTLIER * ROLL)) ** 2) ** 2  # Geman and McClure
        mean = weight @ own
        precision = (weight[:, None] * level).T @ level / ROLL**2 + np.eye(3) / TILT**2
        up = _unit(np.linalg.solve(precision, _unit(mean) / TILT**2))
    across = np.linalg.svd(up[None])[2][1:]
    return CameraUp(up, float(np.linalg.eigvalsh(across @ precision @ across.T)[0] ** -0.5), quarters)


def _costs(axes: np.ndarray, up: np.ndarray) -> np.ndarray:
    """Cost (V, 4) of each picture for each number of quarter turns, given the vertical `up`."""
    along = axes @ up  # (V, 4)
    roll = np.roll(along, -1, axis=1)  # sine of the roll that is left
    held = np.minimum((roll / ROLL) ** 2, OUTLIER**2) / 2
    tilt = (1 - along.clip(-1, 1)) / TILT**2  # about half the square of the angle
    return held + np.minimum(tilt, OUTLIER**2) + QUARTER_COST


def _unit(v: np.ndarray) -> np.ndarray:
    """The vector (3,) with length 1; zero stays zero."""
    return v / max(np.linalg.norm(v), 1e-12)
