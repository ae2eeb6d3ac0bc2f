"""Plush toys of the wild: elephant, penguin, frog, dinosaur."""

from __future__ import annotations

import numpy as np

from studio.creatures.creature import Creature, Part, Seam, pair
from studio.creatures.implicit import ellipsoid, limb
from studio.creatures.plush import CREAM, ROSE, button_eyes, cheeks, goggle_eyes, on_surface, sewn, smile, toy
from studio.shapes import rotation_about
from studio.textures import mix, smoothstep, srgb


def toy_elephant() -> Creature:
    """A blue-grey elephant on four legs; 0.24 m high, 0.35 m long."""
    skin = "92a7bd"
    ear = rotation_about("y", -35)
    trunk = [(0, 0.155, 0.11), (0, 0.11, 0.145), (0, 0.065, 0.155), (0, 0.042, 0.18), (0, 0.06, 0.203)]
    tusk = [(0.03, 0.135, 0.112), (0.036, 0.112, 0.135), (0.034, 0.108, 0.156)]
    body = [
        Part(ellipsoid((0, 0.118, -0.03), (0.075, 0.072, 0.092)), skin),
        Part(ellipsoid((0, 0.168, 0.07), (0.062, 0.064, 0.056)), skin, 0.02),
        Part(limb(trunk, [0.032, 0.024, 0.02, 0.018, 0.015]), skin, 0.012),
        *pair(Part(ellipsoid((0.093, 0.172, 0.045), (0.06, 0.066, 0.014), ear), skin, 0.006)),
        *pair(Part(ellipsoid((0.097, 0.17, 0.055), (0.043, 0.048, 0.01), ear), ROSE, 0.002, 0.003)),
        *(
            p
            for z in (0.035, -0.085)
            for p in pair(Part(limb([(0.048, 0.1, z), (0.05, 0.03, z + 0.004)], [0.038, 0.036]), skin, 0.012))
        ),
        Part(limb([(0, 0.14, -0.115), (0, 0.1, -0.137), (0, 0.08, -0.137)], [0.01, 0.009, 0.013]), skin, 0.006),
    ]
    toes = [
        part
        for z in (0.075, -0.045)
        for x in (0.032, 0.05, 0.068)
        for part in pair(sewn(body, (x, 0.024, z), (0.008, 0.009, 0.005), CREAM))
    ]
    face = [
        *pair(Part(limb(tusk, [0.009, 0.008, 0.005]), CREAM, 0.0)),
        *button_eyes(body, (0.036, 0.19, 0.13), 0.0085),
        *cheeks(body, (0.05, 0.158, 0.115), 0.009),
        *toes,
    ]
    seam = Seam((0, 0, 0), (1, 0, 0), lambda p: (p[:, 1] > 0.12) & ((p[:, 2] < 0.03) | (p[:, 1] > 0.2)))
    return toy([*body, *face], (-0.18, -0.01, -0.18), (0.18, 0.27, 0.25), seams=[seam])


def toy_penguin() -> Creature:
    """A penguin that stands; 0.28 m."""
    coat, white, orange = "2b3446", "f6f3ec", "f0902c"

    def shirt(p, n, colour):
        x, y, z = p.T
        belly = smoothstep(1.04, 0.96, np.hypot(x / 0.058, (y - 0.1) / 0.085)) * (z > 0)
        face = smoothstep(1.04, 0.96, np.hypot((np.abs(x) - 0.02) / 0.032, (y - 0.208) / 0.034)) * (z > 0.02)
        return mix(colour, srgb(white), np.clip(belly + face, 0, 1))

    flipper = [(0.07, 0.165, 0.0), (0.102, 0.11, 0.006), (0.108, 0.07, 0.012)]
    body = [
        Part(limb([(0, 0.075, 0), (0, 0.13, 0)], [0.08, 0.07], 0.88), coat),
        Part(ellipsoid((0, 0.212, 0.004), (0.066, 0.06, 0.06)), coat, 0.03),
        *pair(Part(limb(flipper, [0.02, 0.024, 0.013], 0.55, (1, 0.4, 0)), coat, 0.008)),
        *pair(Part(ellipsoid((0.038, 0.015, 0.05), (0.035, 0.017, 0.044)), orange, 0.004, 0.0)),
        Part(limb([(0, 0.06, -0.06), (0, 0.03, -0.09)], [0.025, 0.01]), coat, 0.015),
    ]
    face = [
        Part(limb([(0, 0.206, 0.05), (0, 0.2, 0.086)], [0.017, 0.005], 0.7, (0, 1, 0)), orange, 0.0),
        *button_eyes(body, (0.027, 0.222, 0.07), 0.0085),
        *cheeks(body, (0.042, 0.2, 0.06), 0.0095, "f3b1aa"),
    ]
    seam = Seam((0, 0, 0), (1, 0, 0), lambda p: p[:, 2] < -0.02)
    return toy([*body, *face], (-0.14, -0.01, -0.12), (0.14, 0.3, 0.13), pattern=shirt, seams=[seam])


def toy_frog() -> Creature:
    """A green frog that squats; 0.19 m."""
    skin, dark = "74ba4c", "458a30"

    def spots(p, n, colour):
        x, y, z = p.T
        belly = smoothstep(0.15, 0.35, n[:, 2] - 0.7 * n[:, 1]) * (np.abs(x) < 0.052) * (y < 0.088)
        colour = mix(colour, srgb("e9eeb4"), belly)
        dots = [(0.03, -0.05), (-0.028, -0.062), (0.0, -0.02), (0.045, -0.015), (-0.047, -0.01)]
        near = np.min([np.hypot(x - a, z - b) for a, b in dots], axis=0)
        return mix(colour, srgb(dark), 0.8 * smoothstep(0.014, 0.01, near) * (n[:, 1] > 0.1) * (y > 0.08))

    thigh = [(0.05, 0.05, -0.05), (0.098, 0.06, 0.005), (0.085, 0.022, -0.045)]
    arm = [(0.05, 0.075, 0.06), (0.062, 0.038, 0.085), (0.062, 0.018, 0.095)]
    body = [
        Part(limb([(0, 0.065, -0.045), (0, 0.09, 0.03)], [0.062, 0.06]), skin),
        Part(ellipsoid((0, 0.117, 0.045), (0.077, 0.046, 0.056)), skin, 0.02),
        *pair(Part(ellipsoid((0.042, 0.16, 0.045), (0.027, 0.027, 0.025)), skin, 0.01)),
        *pair(Part(limb(thigh, [0.034, 0.027, 0.021]), skin, 0.008)),
        *pair(Part(limb([(0.085, 0.014, -0.045), (0.107, 0.013, 0.03)], [0.02, 0.025], 0.6, (0, 1, 0)), skin, 0.006)),
        *pair(Part(limb(arm, [0.022, 0.019, 0.018]), skin, 0.008)),
        *pair(Part(ellipsoid((0.064, 0.013, 0.108), (0.028, 0.014, 0.024)), skin, 0.005)),
    ]
    face = [
        *goggle_eyes(body, (0.043, 0.168, 0.08), 0.0175),
        smile(body, (0.103, 0.12), 0.1, 0.016, "2f5a24", 0.0022),
        *cheeks(body, (0.057, 0.112, 0.09), 0.0095, "f0a08c"),
    ]
    return toy([*body, *face], (-0.15, -0.01, -0.13), (0.15, 0.21, 0.15), sole=0.008, pattern=spots)


def toy_dinosaur() -> Creature:
    """A teal long-necked dinosaur with orange plates on its back; 0.3 m high, 0.42 m long."""
    skin, dark, plate, belly = "4fb0a2", "328478", "f0923a", "f1e6b8"
    crest = [
        (0.268, 0.118),
        (0.222, 0.094),
        (0.183, 0.05),
        (0.18, 0.0),
        (0.17, -0.05),
        (0.138, -0.098),
        (0.098, -0.142),
        (0.07, -0.182),
    ]
    sizes = [0.016, 0.022, 0.027, 0.03, 0.029, 0.024, 0.019, 0.014]

    def front(p, n, colour):
        x, y, z = p.T
        under = (
            smoothstep(0.35, 0.55, -n[:, 1] + 0.55 * n[:, 2] * (y > 0.14))
            * (np.abs(x) < 0.04)
            * (y > 0.03)
            * (y < 0.235)
        )
        dots = np.sin(150 * y + 3) * np.sin(130 * z) * (np.abs(n[:, 0]) > 0.45) * (y > 0.09)
        return mix(mix(colour, srgb(dark), 0.75 * smoothstep(0.5, 0.7, dots)), srgb(belly), under)

    body = [
        Part(ellipsoid((0, 0.11, -0.01), (0.064, 0.062, 0.092)), skin),
        Part(limb([(0, 0.13, 0.05), (0, 0.19, 0.105), (0, 0.235, 0.125)], [0.045, 0.033, 0.03]), skin, 0.03),
        Part(limb([(0, 0.245, 0.125), (0, 0.24, 0.172)], [0.039, 0.031]), skin, 0.015),
        Part(limb([(0, 0.1, -0.08), (0, 0.065, -0.145), (0, 0.038, -0.205)], [0.046, 0.028, 0.012]), skin, 0.03),
        *(
            p
            for z in (0.045, -0.06)
            for p in pair(Part(limb([(0.048, 0.085, z), (0.054, 0.028, z + 0.008)], [0.034, 0.031]), skin, 0.012))
        ),
    ]
    spine, normal = on_surface(body, [(0, *at) for at in crest])
    plates = []
    for at, n, r in zip(spine, normal, sizes, strict=True):
        across = np.array([1.0, 0.0, 0.0])
        plates.append(
            Part(
                ellipsoid(at + 0.35 * r * n, (0.0075, 0.75 * r, r), np.stack([across, np.cross(n, across), n], 1)),
                plate,
                0.0,
            )
        )
    face = [
        *plates,
        *button_eyes(body, (0.03, 0.262, 0.16), 0.008),
        smile(body, (0.226, 0.22), 0.05, 0.009),
        *pair(sewn(body, (0.011, 0.25, 0.22), (0.003, 0.0035, 0.002), dark)),
        *cheeks(body, (0.03, 0.24, 0.185), 0.0075, "f2a488"),
    ]
    return toy([*body, *face], (-0.12, -0.01, -0.24), (0.12, 0.31, 0.23), pattern=front)
