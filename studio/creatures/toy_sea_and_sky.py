"""Plush toys of the sea and the air: octopus, whale, star, ladybird."""

from __future__ import annotations

import numpy as np

from studio.creatures.creature import Creature, Part, Seam, pair
from studio.creatures.implicit import ellipsoid, limb
from studio.creatures.plush import WHITE, button_eyes, cheeks, goggle_eyes, smile, toy
from studio.textures import mix, smoothstep, srgb


def toy_octopus() -> Creature:
    """A violet octopus on eight curled arms; 0.2 m high."""
    skin, sucker = "a274cb", "ecd0ec"

    def spotted(p, n, colour):
        under = smoothstep(0.25, 0.6, -n[:, 1]) * (p[:, 1] < 0.05)
        dots = [
            (0.035, 0.168, -0.015),
            (-0.03, 0.175, -0.02),
            (0.012, 0.17, -0.045),
            (-0.055, 0.13, -0.035),
            (0.055, 0.125, -0.04),
        ]
        near = np.min([np.linalg.norm(p - d, axis=1) for d in dots], axis=0)
        return mix(mix(colour, srgb(sucker), under), srgb("c29fe2"), 0.9 * smoothstep(0.019, 0.016, near))

    arms = []
    for angle in np.pi * (np.arange(8) + 0.5) / 4:
        out, aside = np.array([np.sin(angle), 0, np.cos(angle)]), np.array([np.cos(angle), 0, -np.sin(angle)])
        path = [
            0.035 * out + [0, 0.05, 0],
            0.085 * out + [0, 0.022, 0],
            0.128 * out + 0.012 * aside + [0, 0.022, 0],
            0.138 * out + 0.03 * aside + [0, 0.045, 0],
        ]
        arms.append(Part(limb(path, [0.03, 0.024, 0.018, 0.012]), skin, 0.012))
    body = [
        Part(ellipsoid((0, 0.125, -0.004), (0.078, 0.076, 0.074)), skin),
        Part(ellipsoid((0, 0.06, 0), (0.058, 0.035, 0.056)), skin, 0.03),
        *arms,
    ]
    face = [
        *goggle_eyes(body, (0.027, 0.127, 0.09), 0.016),
        smile(body, (0.094, 0.09), 0.036, 0.008),
        *cheeks(body, (0.047, 0.103, 0.07), 0.009),
    ]
    return toy([*body, *face], (-0.18, -0.01, -0.18), (0.18, 0.22, 0.18), sole=0.006, pattern=spotted)


def toy_whale() -> Creature:
    """A blue whale with a white belly; 0.34 m long."""
    skin, belly = "4a8cc4", "f3f3ee"

    def pleats(p, n, colour):
        x, y, z = p.T
        white = smoothstep(0.06, 0.054, y - 0.05 * z) * (z > -0.08) * (np.abs(x) < 0.076)
        groove = 0.5 * smoothstep(0.4, 0.8, np.cos(2 * np.pi * x / 0.022)) * (y < 0.055) * (z > -0.06)
        return mix(mix(colour, srgb(belly), white), srgb("9fb6c8"), groove * white)

    fluke = [(0.0, 0.122, -0.145), (0.04, 0.14, -0.172), (0.072, 0.145, -0.195)]
    fin = [(0.065, 0.06, 0.035), (0.105, 0.035, 0.01), (0.125, 0.025, -0.02)]
    spout = [(0, 0.152, 0.03), (0.012, 0.185, 0.03), (0.028, 0.194, 0.03), (0.036, 0.18, 0.03)]
    body = [
        Part(
            limb([(0, 0.08, 0.06), (0, 0.078, 0.0), (0, 0.085, -0.075), (0, 0.115, -0.14)], [0.077, 0.08, 0.05, 0.022]),
            skin,
        ),
        *pair(Part(limb(fluke, [0.02, 0.025, 0.011], 0.5, (0, 1, 0.4)), skin, 0.008)),
        *pair(Part(limb(fin, [0.02, 0.023, 0.011], 0.5, (0.4, 1, 0)), skin, 0.008)),
        *pair(Part(limb(spout, [0.011, 0.011, 0.011, 0.008]), "b4dff2", 0.004, 0.003)),
    ]
    face = [
        *button_eyes(body, (0.068, 0.094, 0.095), 0.0085),
        smile(body, (0.068, 0.14), 0.1, 0.012, "1f4a70"),
        *cheeks(body, (0.07, 0.075, 0.1), 0.0095),
    ]
    return toy([*body, *face], (-0.16, -0.02, -0.24), (0.16, 0.22, 0.17), pattern=pleats)


def toy_star() -> Creature:
    """A yellow star that smiles; 0.28 m."""
    fur, middle = "f9d34e", np.array([0.0, 0.125, 0.0])
    rays = []
    for angle in 2 * np.pi * np.arange(5) / 5:
        out = np.array([np.sin(angle), np.cos(angle), 0.0])
        path = [middle + 0.02 * out, middle + 0.08 * out, middle + 0.128 * out]
        rays.append(Part(limb(path, [0.06, 0.037, 0.016], 0.8), fur, 0.018))
    body = [Part(ellipsoid(middle, (0.075, 0.075, 0.055)), fur), *rays]
    face = [
        *button_eyes(body, (0.026, 0.138, 0.07), 0.009),
        smile(body, (0.112, 0.07), 0.036, 0.009),
        *cheeks(body, (0.046, 0.118, 0.06), 0.01, "f39a78"),
    ]
    seam = Seam((0, 0, 0), (0, 0, 1))
    return toy([*body, *face], (-0.16, -0.01, -0.08), (0.16, 0.28, 0.08), seams=[seam])


def toy_ladybird() -> Creature:
    """A red ladybird with seven spots; 0.26 m long."""
    wing, black = "da3030", "2b2725"
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
        near = np.min([np.hypot(x - a, z - b) for a, b in spots], axis=0)
        spot = smoothstep(0.0195, 0.0175, near) * (y > 0.05) * (z < 0.075)
        line = smoothstep(0.0042, 0.003, np.abs(x)) * (z < 0.04) * (y > 0.05)
        return mix(colour, srgb(black), np.clip(spot + line, 0, 1))

    feeler = [(0.022, 0.118, 0.105), (0.034, 0.148, 0.118), (0.046, 0.165, 0.126)]
    legs = [
        p
        for z in (0.055, 0.0, -0.06)
        for p in pair(Part(limb([(0.06, 0.03, z), (0.108, 0.018, 1.25 * z)], [0.017, 0.019]), black, 0.005))
    ]
    body = [
        Part(ellipsoid((0, 0.03, -0.01), (0.088, 0.03, 0.1)), black),
        Part(ellipsoid((0, 0.055, -0.018), (0.095, 0.075, 0.108)), wing, 0.008),
        Part(ellipsoid((0, 0.078, 0.09), (0.052, 0.047, 0.042)), black, 0.005),
        *pair(Part(limb(feeler, [0.009, 0.008, 0.014]), black, 0.004)),
        *legs,
    ]
    face = [
        *goggle_eyes(body, (0.022, 0.09, 0.14), 0.0145),
        smile(body, (0.06, 0.14), 0.036, 0.007, WHITE),
        *cheeks(body, (0.037, 0.07, 0.12), 0.0085, "e07a70"),
    ]
    return toy([*body, *face], (-0.15, -0.01, -0.15), (0.15, 0.2, 0.16), pattern=dotted)
