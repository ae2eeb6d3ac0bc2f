"""The ball: soft foam rubber in six bands of colour, prepared as a user's body would be."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from assets.asset import Asset
from core.material import Material
from studio.detail import Detail
from studio.finish import flat_sh, sample_albedo, sharpened, to_gaussians, tone_map
from studio.shapes import Surface, superellipsoid
from studio.solids import sample_distance_grid, sphere
from studio.surface_sampling import sample_surfaces
from studio.textures import mix, srgb

RADIUS = 0.07  # [m]
VERTICES = 150
SPACING = 0.0052  # [m] of Gaussians
BANDS = ("d8382c", "f4ead6", "2a62b8", "f4ead6", "f0b02a", "f4ead6")
MATERIAL = Material(young=4e4, poisson=0.4, density=250.0, friction=0.6)  # of soft foam rubber


def ball(rng: np.random.Generator, detail: Detail, report) -> Asset:
    """The asset `ball`. Taichi must be running."""
    from prepare.pipeline import Options, prepare

    surface = Surface("ball", superellipsoid((2 * RADIUS,) * 3, 1.0, 40), bands, SPACING, uniform=True)
    c = sample_surfaces([surface], rng, detail)
    lit = 0.76 + 0.24 * c.normals[:, 1]
    colour = sharpened(c, tone_map(1.1 * sample_albedo(c, [surface], rng) * lit[:, None]))
    g = to_gaussians(c, flat_sh(colour), np.ones(len(c)))
    asset = prepare(g, Options(vertices=detail.cage_vertices(VERTICES), scale=2 * RADIUS, up="+y"))
    low, high = -RADIUS - 0.012, RADIUS + 0.012
    sdf = sample_distance_grid(
        [sphere((0, RADIUS, 0), RADIUS)], (low, low + RADIUS, low), (high, high + RADIUS, high), 0.004
    )
    return replace(asset, sdf=sdf, material=MATERIAL)


def bands(p, n):
    """Six gores with seams, and a white cap at either pole."""
    angle = np.arctan2(p[:, 0], p[:, 2]) / (2 * np.pi) * len(BANDS)
    c = np.stack([srgb(b) for b in BANDS])[np.floor(angle).astype(int) % len(BANDS)]
    seam = np.abs(angle - np.round(angle)) * np.hypot(p[:, 0], p[:, 2]) / RADIUS < 0.018
    c = mix(c, 0.6 * c, seam)
    return np.where((np.abs(p[:, 1]) > 0.90 * RADIUS)[:, None], srgb("f4ead6"), c)
