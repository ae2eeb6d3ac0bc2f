"""The bear: a brown cub, 0.6 m high and 0.9 m long."""

from __future__ import annotations

import numpy as np

from studio.creatures.creature import Creature, Part, pair, tissue
from studio.creatures.implicit import ellipsoid, limb
from studio.textures import mix, smoothstep, srgb

BROWN, DARK, TAN, BLACK = "8a5a34", "5a3820", "c99d6b", "15100d"
YOUNG = 6e4  # [Pa]


def bear() -> Creature:
    """The model."""
    claws = [
        part
        for z in (0.293, -0.107)
        for k in (-1, 0, 1)
        for part in pair(
            Part(
                limb([(0.115 + 0.024 * k, 0.03, z - 0.01), (0.115 + 0.025 * k, 0.012, z + 0.014)], [0.008, 0.004]),
                "e8dcc4",
                0.0,
            )
        )
    ]
    parts = [
        Part(
            limb([(0, 0.325, -0.21), (0, 0.345, 0.0), (0, 0.35, 0.16)], [0.145, 0.172, 0.155]),
            BROWN,
            comb=(0, -0.5, -1),
        ),
        Part(ellipsoid((0, 0.43, 0.12), (0.11, 0.09, 0.13)), BROWN, 0.06, comb=(0, 0.1, -1)),
        Part(limb([(0, 0.38, 0.2), (0, 0.43, 0.3)], [0.135, 0.11]), BROWN, 0.06, 0.03, (0, -0.6, -0.8)),
        Part(ellipsoid((0, 0.465, 0.34), (0.118, 0.105, 0.105)), BROWN, 0.03, 0.018),
        *pair(Part(ellipsoid((0.07, 0.435, 0.335), (0.05, 0.05, 0.06)), BROWN, 0.03, 0.026, (0.8, -0.5, -0.5))),
        Part(limb([(0, 0.44, 0.41), (0, 0.43, 0.475)], [0.062, 0.045]), TAN, 0.025, 0.01, (0, 0.3, -1)),
        *pair(Part(ellipsoid((0.088, 0.557, 0.315), (0.042, 0.044, 0.02)), BROWN, 0.02, 0.012, (0.3, 1, -0.2))),
        *pair(
            Part(
                limb([(0.1, 0.3, 0.15), (0.113, 0.16, 0.165), (0.115, 0.06, 0.18)], [0.095, 0.08, 0.068]),
                BROWN,
                0.04,
                0.024,
            )
        ),
        *pair(Part(ellipsoid((0.115, 0.036, 0.215), (0.062, 0.036, 0.08)), DARK, 0.03, 0.014)),
        *pair(
            Part(
                limb([(0.1, 0.3, -0.19), (0.115, 0.17, -0.19), (0.115, 0.06, -0.21)], [0.125, 0.092, 0.07]),
                BROWN,
                0.04,
                0.026,
            )
        ),
        *pair(Part(ellipsoid((0.115, 0.036, -0.185), (0.062, 0.036, 0.08)), DARK, 0.03, 0.014)),
        Part(ellipsoid((0, 0.4, -0.36), (0.04, 0.04, 0.035)), BROWN, 0.03, 0.02),
        Part(ellipsoid((0, 0.452, 0.518), (0.029, 0.02, 0.017)), BLACK, 0.0, glint=True),
        Part(limb([(0, 0.44, 0.521), (0, 0.413, 0.516)], [0.004, 0.004]), DARK, 0.0),
        *pair(
            Part(
                limb([(0, 0.413, 0.516), (0.018, 0.404, 0.508), (0.032, 0.408, 0.492)], [0.004, 0.004, 0.003]),
                DARK,
                0.0,
            )
        ),
        *pair(Part(ellipsoid((0.05, 0.497, 0.428), 0.0145), BLACK, 0.0, glint=True)),
        *claws,
    ]
    return Creature(
        parts, (-0.28, -0.02, -0.46), (0.28, 0.66, 0.6), tissue(YOUNG), hair=0.032, lift=0.3, pattern=pattern
    )


def pattern(p: np.ndarray, n: np.ndarray, colour: np.ndarray) -> np.ndarray:
    """Darker towards the paws, a light crescent on the chest, light insides of the ears."""
    x, y, z = p.T
    colour = mix(colour, srgb(DARK), 0.8 * smoothstep(0.2, 0.05, y))
    ring = np.hypot(x / 1.3, y - 0.39)
    crescent = smoothstep(0.02, 0.008, np.abs(ring - 0.07)) * (y < 0.37) * smoothstep(0.25, 0.55, n[:, 2]) * (z > 0.2)
    inside = (
        (y > 0.53) * smoothstep(0.55, 0.85, n[:, 2]) * smoothstep(0.034, 0.022, np.hypot(np.abs(x) - 0.088, y - 0.557))
    )
    return mix(colour, srgb(TAN), np.clip(0.85 * crescent + 0.8 * inside, 0, 1))
