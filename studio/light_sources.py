"""Light sources of a room: openings to the sky, the open sky, sun, lamps and spot lights."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from studio.textures import smoothstep

SPOT_EDGE = 0.15  # part of a spot light's half-angle over which it fades


@dataclass(frozen=True)
class Opening:
    """Parallelogram through which daylight enters: corner and two edges [m]."""

    corner: np.ndarray
    a: np.ndarray
    b: np.ndarray

    def lets_through(self, origins: np.ndarray, directions: np.ndarray) -> np.ndarray:
        """Mask (N,) of rays from `origins` (N, 3) along `directions` (N, 3) that pass the opening."""
        face = np.cross(self.a, self.b)
        slope = directions @ face
        with np.errstate(divide="ignore", invalid="ignore"):
            t = (self.corner - origins) @ face / slope
            at = origins + t[:, None] * directions - self.corner
            u, v = (np.cross(at, self.b) @ face) / (face @ face), (np.cross(self.a, at) @ face) / (face @ face)
        return (t > 0) & (u >= 0) & (u <= 1) & (v >= 0) & (v <= 1)


@dataclass(frozen=True)
class Lamp:
    """Luminous sphere, or a spot light if it has an axis.

    centre      [m]
    radius      [m]
    intensity   radiant intensity per steradian, linear RGB
    axis        direction in which a spot light shines, (3,); None: it shines all around
    half_angle  [rad] between a spot light's axis and the edge of its cone
    """

    centre: np.ndarray
    radius: float
    intensity: np.ndarray
    axis: np.ndarray | None = None
    half_angle: float = np.pi

    def towards(self, direction: np.ndarray) -> np.ndarray:
        """Intensity (N, 3) of the light that leaves in unit directions (N, 3)."""
        if self.axis is None:
            return np.broadcast_to(self.intensity, direction.shape)
        axis = np.asarray(self.axis) / np.linalg.norm(self.axis)
        angle = np.arccos(np.clip(direction @ axis, -1, 1))
        return smoothstep(self.half_angle, (1 - SPOT_EDGE) * self.half_angle, angle)[:, None] * self.intensity


@dataclass(frozen=True)
class Sun:
    """Sun: direction of travel (3,), irradiance linear RGB (3,), and spread [rad] (wide as through thin cloud)."""

    direction: np.ndarray
    irradiance: np.ndarray
    spread: float = 0.018


def sky_over_garden(direction: np.ndarray) -> np.ndarray:
    """Radiance (N, 3) seen in directions (N, 3): bright sky over a garden."""
    up = direction[:, 1:2]
    sky = np.array([3.6, 4.2, 5.0]) * (1 + 0.35 * np.clip(up, 0, 1))
    garden = np.array([1.5, 1.7, 1.1])
    return garden + (sky - garden) * smoothstep(-0.02, 0.12, up)


@dataclass(frozen=True)
class LightSources:
    """All that emits light, besides luminous surfaces.

    openings  where the sky shines in; None: outdoors, it shines from all directions. () with no sky: a closed room
    lamps     lamps and spot lights
    sun       None: none
    sky       radiance (N, 3) in directions (N, 3) of rays that leave the scene
    """

    openings: list[Opening] | tuple | None = ()
    lamps: list[Lamp] | tuple = ()
    sun: Sun | None = None
    sky: Callable[[np.ndarray], np.ndarray] = sky_over_garden

    def sky_beyond(self, origins: np.ndarray, directions: np.ndarray) -> np.ndarray:
        """Radiance (N, 3) met by rays that hit nothing: the sky's, in a room only through its openings.

        Elsewhere they left at a joint, e.g. behind a skirting board.
        """
        if self.openings is None:
            return self.sky(directions)
        through = np.zeros(len(origins), bool)
        for opening in self.openings:
            through |= opening.lets_through(origins, directions)
        return np.where(through[:, None], self.sky(directions), 0.0)
