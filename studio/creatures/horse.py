"""The horse: a chestnut foal, 1.0 m to the tips of its ears, 0.72 m at the withers."""

from __future__ import annotations

import numpy as np

from studio.creatures.creature import Creature, Part, pair, tissue
from studio.creatures.implicit import ellipsoid, limb
from studio.textures import mix, smoothstep, srgb

CHESTNUT, DARK, MUZZLE, WHITE, HOOF, BLACK = "96562b", "3a2318", "6b4a3a", "f4ece0", "3b342f", "15100d"
YOUNG = 2.5e05  # [Pa]


def horse() -> Creature:
    """The model."""
    fore = [(0.09, 0.52, 0.2), (0.098, 0.33, 0.215), (0.104, 0.2, 0.21), (0.108, 0.07, 0.215)]
    hind = [(0.09, 0.57, -0.26), (0.104, 0.42, -0.235), (0.106, 0.3, -0.31), (0.108, 0.19, -0.3), (0.11, 0.07, -0.28)]
    crest = [(0, 0.975, 0.435), (0, 0.93, 0.34), (0, 0.84, 0.26), (0, 0.75, 0.175)]
    tail = [(0, 0.7, -0.385), (0, 0.65, -0.455), (0, 0.5, -0.49), (0, 0.32, -0.47)]
    parts = [
        Part(
            limb([(0, 0.61, -0.25), (0, 0.59, -0.04), (0, 0.61, 0.18)], [0.15, 0.15, 0.145]),
            CHESTNUT,
            comb=(0, -0.6, -1),
        ),
        Part(ellipsoid((0, 0.65, -0.25), (0.135, 0.12, 0.15)), CHESTNUT, 0.05, comb=(0, -1, -0.5)),
        Part(ellipsoid((0, 0.59, 0.22), (0.12, 0.14, 0.12)), CHESTNUT, 0.05, comb=(0, -1, -0.2)),
        Part(
            limb([(0, 0.66, 0.2), (0, 0.78, 0.31), (0, 0.9, 0.41)], [0.125, 0.095, 0.075], 0.78, (1, 0, 0)),
            CHESTNUT,
            0.06,
            comb=(0, -1, -0.7),
        ),
        Part(
            limb([(0, 0.915, 0.42), (0, 0.85, 0.515), (0, 0.775, 0.585)], [0.079, 0.066, 0.052], 0.88, (1, 0, 0)),
            CHESTNUT,
            0.03,
            0.012,
        ),
        *pair(Part(ellipsoid((0.03, 0.87, 0.44), (0.035, 0.065, 0.06)), CHESTNUT, 0.03, 0.012)),
        Part(ellipsoid((0, 0.765, 0.6), (0.05, 0.048, 0.047)), MUZZLE, 0.02, 0.006),
        *pair(
            Part(
                limb([(0.036, 0.965, 0.405), (0.044, 1.005, 0.41), (0.048, 1.06, 0.405)], [0.024, 0.026, 0.006], 0.5),
                CHESTNUT,
                0.015,
                0.01,
            )
        ),
        *pair(Part(limb(fore, [0.084, 0.058, 0.046, 0.044]), CHESTNUT, 0.05)),
        *pair(Part(ellipsoid((0.098, 0.32, 0.222), (0.047, 0.05, 0.045)), CHESTNUT, 0.03)),
        *pair(Part(limb([(0.108, 0.085, 0.215), (0.11, 0.02, 0.225)], [0.046, 0.064]), HOOF, 0.012, 0.0)),
        *pair(Part(limb(hind, [0.125, 0.087, 0.055, 0.047, 0.045]), CHESTNUT, 0.05)),
        *pair(Part(limb([(0.11, 0.085, -0.28), (0.112, 0.02, -0.27)], [0.046, 0.064]), HOOF, 0.012, 0.0)),
        Part(limb(crest, [0.045, 0.05, 0.055, 0.04], 0.55, (1, 0, 0)), DARK, 0.012, 0.085, (0.75, -1.0, -0.2)),
        Part(ellipsoid((0, 0.968, 0.468), (0.035, 0.035, 0.025)), DARK, 0.01, 0.07, (0.1, -1, 0.45)),
        Part(limb(tail, [0.035, 0.05, 0.058, 0.02]), DARK, 0.02, 0.12),
        *pair(Part(ellipsoid((0.064, 0.895, 0.463), (0.014, 0.019, 0.021)), BLACK, 0.0, glint=True)),
        *pair(Part(ellipsoid((0.028, 0.785, 0.637), (0.009, 0.012, 0.008)), BLACK, 0.0)),
    ]
    return Creature(
        parts,
        (-0.25, -0.04, -0.62),
        (0.25, 1.1, 0.7),
        tissue(YOUNG),
        hair=0.022,
        lift=0.12,
        mottle=0.07,
        border=0.01,
        pattern=pattern,
    )


def pattern(p: np.ndarray, n: np.ndarray, colour: np.ndarray) -> np.ndarray:
    """A white blaze down the face, white stockings, and a lighter belly."""
    x, y, z = p.T
    width = 0.012 + 0.014 * smoothstep(0.86, 0.92, y)
    blaze = smoothstep(1.0, 0.6, np.abs(x) / width) * (z > 0.47) * (y > 0.78) * (y < 0.95) * (n[:, 2] > 0.15)
    stocking = smoothstep(0.2, 0.165, y + 0.02 * np.sin(40 * x)) * (y > 0.075) * (np.abs(x) > 0.03)
    colour = mix(colour, srgb("c98a54"), 0.7 * smoothstep(0.3, 0.9, -n[:, 1]) * (y > 0.4))
    return mix(colour, srgb(WHITE), np.clip(blaze + stocking, 0, 1))
