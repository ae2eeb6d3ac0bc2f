"""Rings of flowers that stand by themselves: marks of the animals' places where no garden is."""

from __future__ import annotations

import numpy as np

from assets.asset import Asset
from studio.detail import Detail
from studio.finish import flat_sh, sample_albedo, sharpened, to_gaussians, tone_map
from studio.garden.plants import RINGS, ring_of_flowers
from studio.surface_sampling import sample_surfaces

COUNT, SIZE, HEIGHT = 26, 0.06, 0.09  # flowers, and their petals and height [m]: more than a lawn hides them


def flower_ring(number: int, rng: np.random.Generator, detail: Detail, report) -> Asset:
    """Ring `number` of the garden's, which stays where it is; its origin is at the middle of the ground."""
    surfaces = ring_of_flowers(rng, (0.0, 0.0), RINGS[number][1], count=COUNT, size=SIZE, height=HEIGHT)
    surfels = sample_surfaces(surfaces, rng, detail)
    colours = sharpened(surfels, tone_map(sample_albedo(surfels, surfaces, rng)))
    g = to_gaussians(surfels, flat_sh(colours), np.ones(len(surfels)))
    return Asset(g, provenance={"made_by": "vrgs build", "name": f"flower_ring_{number}"})
