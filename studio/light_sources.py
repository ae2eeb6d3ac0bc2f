"""Where light comes from: the sky through openings, the sun, lamps."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from studio.textures import ramp


@dataclass(frozen=True)
class Opening:
    """Parallelogram that daylight enters through: corner and two edges [m]."""

    corner: np.ndarray
    a: np.ndarray
    b: np.ndarray


@dataclass(frozen=True)
class Lamp:
    """Glowing ball: centre, radius [m] and radiant intensity per steradian, linear RGB."""

    centre: np.ndarray
    radius: float
    intensity: np.ndarray


SUN = np.array([0.50, -0.66, 0.62]) / np.linalg.norm([0.50, -0.66, 0.62])  # direction of travel
SUN_IRRADIANCE = np.array([1.0, 0.86, 0.66]) * 22
SUN_SPREAD = 0.018  # [rad] wider than the real one: thin cloud


def outside(direction: np.ndarray) -> np.ndarray:
    """Radiance (N, 3) of what is seen through an opening: bright sky over a garden."""
    up = direction[:, 1:2]
    sky = np.array([3.6, 4.2, 5.0]) * (1 + 0.35 * np.clip(up, 0, 1))
    garden = np.array([1.5, 1.7, 1.1])
    return garden + (sky - garden) * ramp(-0.02, 0.12, up)
