"""Plush toys of the sea and the air: octopus, whale, star, ladybird."""

from __future__ import annotations

import numpy as np

from studio.creatures.creature import Creature, Part, Seam, pair
from studio.creatures.implicit import ellipsoid, limb
from studio.creatures.plush import BLACK, ROSE, buttons, smile, toy
from studio.textures import mix, smoothstep, srgb


def toy_octopus() -> Creature:
    """A violet octopus on eight curled arms; 0.2 m high."""
    skin, sucker = "9a6cc4", "e9c9ea"

    def under(p, n, colour):
        low = smoothstep(0.25, 0.6, -n[:, 1]) * (p[:, 1] < 0.05)
        dots = [
            (0.035, 0.168, -0.015),
            (-0.03, 0.175, -0.02),
            (0.012, 0.17, -0.045),
            (-0.055, 0.13, -0.035),
            (0.055, 0.125, -0.04),
        ]
        near = np.min([np.linalg.norm(p - d, axis=1) for d in dots], axis=0)
        return mix(mix(colour, srgb(sucker), low), srgb("b892dc"), 0.9 * smoothstep(0.019, 0.015, near))

    angles = np.pi * (np.arange(8) + 0.5) / 4
    arms = []
    for a in angles:
        out = np.array([np.sin(a), 0, np.cos(a)])
        aside = np.array([np.cos(a), 0, -np.sin(a)])
        path = [
            0.035 * out + [0, 0.05, 0],
            0.085 * out + [0, 0.022, 0],
            0.128 * out + 0.012 * aside + [0, 0.022, 0],
            0.138 * out + 0.03 * aside + [0, 0.042, 0],
        ]
        arms.append(Part(limb(path, [0.03, 0.024, 0.017, 0.009]), skin, 0.012))
    parts = [
        Part(ellipsoid((0, 0.125, -0.004), (0.078, 0.076, 0.074)), skin),
        Part(ellipsoid((0, 0.06, 0), (0.058, 0.035, 0.056)), skin, 0.03),
        *arms,
        *pair(Part(ellipsoid((0.027, 0.125, 0.064), (0.0155, 0.018, 0.01)), "faf7ef", 0.0)),
        *pair(Part(ellipsoid((0.025, 0.124, 0.0715), (0.0085, 0.011, 0.006)), BLACK, 0.0, glint=True)),
        smile(0.092, 0.073, 0.034, 0.007, 0.005),
        *pair(Part(ellipsoid((0.046, 0.101, 0.0575), (0.01, 0.007, 0.005)), ROSE, 0.0)),
    ]
    return toy(parts, (-0.18, -0.01, -0.18), (0.18, 0.22, 0.18), hair=0.004, pattern=under)


def toy_whale() -> Creature:
    """A blue whale with a pleated white belly; 0.32 m long."""
    skin, belly = "3f7fb8", "f3f3ee"

    def pleats(p, n, colour):
        x, y, z = p.T
        white = smoothstep(0.062, 0.054, y - 0.05 * z) * (z > -0.08) * (np.abs(x) < 0.076)
        groove = 0.35 * smoothstep(0.55, 0.9, np.cos(2 * np.pi * x / 0.017)) * (y < 0.06) * (z > -0.06)
        return mix(mix(colour, srgb(belly), white), srgb("9fb6c8"), groove * white)

    parts = [
        Part(
            limb([(0, 0.08, 0.06), (0, 0.078, 0.0), (0, 0.085, -0.075), (0, 0.115, -0.14)], [0.077, 0.08, 0.05, 0.02]),
            skin,
        ),
        *pair(
            Part(
                limb(
                    [(0.0, 0.122, -0.145), (0.04, 0.14, -0.172), (0.072, 0.145, -0.195)],
                    [0.018, 0.023, 0.008],
                    0.45,
                    (0, 1, 0.4),
                ),
                skin,
                0.008,
            )
        ),
        *pair(
            Part(
                limb(
                    [(0.065, 0.06, 0.035), (0.105, 0.035, 0.01), (0.125, 0.025, -0.02)],
                    [0.018, 0.021, 0.008],
                    0.45,
                    (0.4, 1, 0),
                ),
                skin,
                0.008,
            )
        ),
        *(
            Part(
                limb(
                    [(0, 0.158, 0.03), (0.012 * s, 0.188, 0.03), (0.03 * s, 0.196, 0.03), (0.036 * s, 0.184, 0.03)],
                    [0.009, 0.009, 0.009, 0.006],
                ),
                "a8d8ee",
                0.006,
                0.003,
            )
            for s in (1, -1)
        ),
        *buttons(0.07, 0.092, 0.083, 0.0078),
        smile(0.066, 0.1365, 0.12, 0.004, 0.062),
        *pair(Part(ellipsoid((0.072, 0.073, 0.088), (0.006, 0.007, 0.009)), ROSE, 0.0)),
    ]
    return toy(parts, (-0.16, -0.02, -0.24), (0.16, 0.22, 0.17), hair=0.004, pattern=pleats)


def toy_star() -> Creature:
    """A sleepy yellow star; 0.27 m."""
    fur, middle = "f7ce46", np.array([0.0, 0.125, 0.0])
    rays = []
    for k in range(5):
        a = 2 * np.pi * k / 5
        out = np.array([np.sin(a), np.cos(a), 0.0])
        rays.append(
            Part(
                limb([middle + 0.02 * out, middle + 0.08 * out, middle + 0.128 * out], [0.06, 0.037, 0.014], 0.78),
                fur,
                0.018,
            )
        )
    parts = [
        Part(ellipsoid(middle, (0.075, 0.075, 0.055)), fur),
        *rays,
        *buttons(0.028, 0.137, 0.046, 0.0085),
        smile(0.112, 0.0565, 0.034, 0.008, 0.003),
        *pair(Part(ellipsoid((0.05, 0.118, 0.043), (0.012, 0.008, 0.006)), "f09a7c", 0.0)),
    ]
    return toy(parts, (-0.16, -0.01, -0.08), (0.16, 0.28, 0.08), seams=[Seam((0, 0, 0), (0, 0, 1))])


def toy_ladybird() -> Creature:
    """A red ladybird with seven spots; 0.24 m long."""
    wing, black = "d42a2a", "25211f"
    spots = [
        (0.0, 0.045),
        (0.048, 0.02),
        (-0.048, 0.02),
        (0.055, -0.04),
        (-0.055, -0.04),
        (0.03, -0.082),
        (-0.03, -0.082),
    ]

    def dotted(p, n, colour):
        x, y, z = p.T
        near = np.min([np.hypot(1.15 * (x - a), z - b) / (0.019 if a or b < 0 else 0.017) for a, b in spots], axis=0)
        black_part = smoothstep(1.06, 0.94, near) * (y > 0.05) * (z < 0.075)
        line = smoothstep(0.0042, 0.0028, np.abs(x)) * (z < 0.04) * (y > 0.05)
        return mix(colour, srgb(black), np.clip(black_part + line, 0, 1))

    feelers = [(0.022, 0.118, 0.105), (0.034, 0.15, 0.118), (0.048, 0.168, 0.128)]
    legs = [
        pair(Part(limb([(0.06, 0.03, z), (0.108, 0.018, 1.25 * z)], [0.015, 0.016]), black, 0.005))
        for z in (0.055, 0.0, -0.06)
    ]
    parts = [
        Part(ellipsoid((0, 0.03, -0.01), (0.088, 0.03, 0.1)), black),
        Part(ellipsoid((0, 0.055, -0.018), (0.095, 0.075, 0.108)), wing, 0.008),
        Part(ellipsoid((0, 0.078, 0.09), (0.052, 0.047, 0.042)), black, 0.005),
        *pair(Part(limb(feelers, [0.006, 0.005, 0.01]), black, 0.004)),
        *(part for leg in legs for part in leg),
        *pair(Part(ellipsoid((0.022, 0.09, 0.122), (0.014, 0.0165, 0.01)), "faf7ef", 0.0)),
        *pair(Part(ellipsoid((0.0205, 0.0885, 0.129), (0.0075, 0.0095, 0.006)), "14100e", 0.0, glint=True)),
        smile(0.062, 0.127, 0.034, 0.006, 0.006),
        *pair(Part(ellipsoid((0.037, 0.069, 0.116), (0.009, 0.006, 0.006)), ROSE, 0.0)),
    ]
    return toy(parts, (-0.15, -0.01, -0.15), (0.15, 0.2, 0.16), hair=0.004, pattern=dotted)
