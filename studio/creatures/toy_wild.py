"""Plush toys of the wild: elephant, penguin, frog, dinosaur."""

from __future__ import annotations

import numpy as np

from studio.creatures.creature import Creature, Part, Seam, pair
from studio.creatures.implicit import ellipsoid, limb
from studio.creatures.plush import BLACK, CREAM, ROSE, buttons, smile, thread, toy
from studio.shapes import rotation_about
from studio.textures import mix, smoothstep, srgb


def toy_elephant() -> Creature:
    """A blue-grey elephant on four legs; 0.25 m high, 0.3 m long."""
    skin = "8fa3b8"
    ear = rotation_about("y", -35)
    parts = [
        Part(ellipsoid((0, 0.118, -0.03), (0.075, 0.072, 0.092)), skin),
        Part(ellipsoid((0, 0.168, 0.07), (0.062, 0.064, 0.056)), skin, 0.02),
        Part(
            limb(
                [(0, 0.155, 0.11), (0, 0.11, 0.145), (0, 0.065, 0.155), (0, 0.042, 0.18), (0, 0.058, 0.205)],
                [0.032, 0.024, 0.02, 0.018, 0.014],
            ),
            skin,
            0.012,
        ),
        *pair(Part(ellipsoid((0.093, 0.172, 0.045), (0.06, 0.066, 0.012), ear), skin, 0.006)),
        *pair(Part(ellipsoid((0.098, 0.17, 0.054), (0.043, 0.048, 0.009), ear), ROSE, 0.002, 0.003)),
        *(
            p
            for z in (0.035, -0.085)
            for p in pair(Part(limb([(0.046, 0.1, z), (0.047, 0.033, z + 0.004)], [0.037, 0.034]), skin, 0.012))
        ),
        *(
            p
            for z in (0.035, -0.085)
            for p in pair(Part(ellipsoid((0.047, 0.012, z + 0.03), (0.022, 0.011, 0.008)), CREAM, 0.003, 0.002))
        ),
        *pair(
            Part(
                limb([(0.03, 0.135, 0.112), (0.036, 0.115, 0.135), (0.034, 0.108, 0.152)], [0.009, 0.008, 0.005]),
                CREAM,
                0.004,
                0.002,
            )
        ),
        Part(limb([(0, 0.14, -0.118), (0, 0.1, -0.14), (0, 0.075, -0.14)], [0.009, 0.006, 0.01]), skin, 0.006),
        *buttons(0.036, 0.192, 0.113, 0.0078),
    ]
    seams = [Seam((0, 0, 0), (1, 0, 0), lambda p: (p[:, 1] > 0.12) & ((p[:, 2] < 0.03) | (p[:, 1] > 0.2)))]
    return toy(parts, (-0.18, -0.01, -0.18), (0.18, 0.27, 0.25), hair=0.004, seams=seams)


def toy_penguin() -> Creature:
    """A penguin that stands; 0.28 m."""
    coat, orange = "2b3446", "f0902c"

    def shirt(p, n, colour):
        x, y, z = p.T
        belly = smoothstep(1.05, 0.95, np.hypot(x / 0.058, (y - 0.1) / 0.085)) * (z > 0)
        face = (
            smoothstep(1.05, 0.93, np.hypot((np.abs(x) - 0.02) / 0.032, (y - 0.208) / 0.034)) * (z > 0.02) * (z < 0.062)
        )
        return mix(colour, srgb("f6f3ec"), np.clip(belly + face, 0, 1))

    parts = [
        Part(limb([(0, 0.075, 0), (0, 0.13, 0)], [0.08, 0.07], 0.88), coat),
        Part(ellipsoid((0, 0.212, 0.004), (0.066, 0.06, 0.06)), coat, 0.03),
        *pair(
            Part(
                limb(
                    [(0.07, 0.165, 0.0), (0.102, 0.11, 0.006), (0.108, 0.07, 0.012)],
                    [0.018, 0.022, 0.01],
                    0.5,
                    (1, 0.4, 0),
                ),
                coat,
                0.008,
            )
        ),
        *pair(Part(ellipsoid((0.038, 0.012, 0.05), (0.032, 0.012, 0.042)), orange, 0.006, 0.002)),
        Part(limb([(0, 0.205, 0.055), (0, 0.198, 0.088)], [0.016, 0.004]), orange, 0.003, 0.002),
        Part(limb([(0, 0.06, -0.06), (0, 0.03, -0.09)], [0.025, 0.008]), coat, 0.015),
        *buttons(0.029, 0.222, 0.055, 0.0078),
        *pair(Part(ellipsoid((0.043, 0.2, 0.048), (0.01, 0.007, 0.006)), "f0a6a0", 0.0)),
    ]
    seams = [Seam((0, 0, 0), (1, 0, 0), lambda p: p[:, 2] < -0.02)]
    return toy(parts, (-0.14, -0.01, -0.12), (0.14, 0.3, 0.13), pattern=shirt, seams=seams)


def toy_frog() -> Creature:
    """A green frog that squats; 0.18 m."""
    skin, dark = "69b545", "458a30"

    def spots(p, n, colour):
        x, y, z = p.T
        belly = smoothstep(0.1, 0.45, n[:, 2] - 0.7 * n[:, 1]) * (np.abs(x) < 0.052) * (y < 0.105)
        colour = mix(colour, srgb("e9eeb4"), belly)
        dots = [(0.03, -0.05), (-0.028, -0.062), (0.0, -0.02), (0.045, -0.015), (-0.047, -0.01)]
        near = np.min([np.hypot(x - a, z - b) for a, b in dots], axis=0)
        return mix(colour, srgb(dark), 0.8 * smoothstep(0.014, 0.01, near) * (n[:, 1] > 0.1) * (y > 0.08))

    parts = [
        Part(limb([(0, 0.065, -0.045), (0, 0.09, 0.03)], [0.062, 0.06]), skin),
        Part(ellipsoid((0, 0.115, 0.045), (0.075, 0.045, 0.055)), skin, 0.02),
        *pair(Part(ellipsoid((0.042, 0.16, 0.045), (0.026, 0.026, 0.024)), skin, 0.01)),
        *pair(
            Part(
                limb([(0.05, 0.05, -0.05), (0.098, 0.06, 0.005), (0.085, 0.02, -0.045)], [0.034, 0.026, 0.018]),
                skin,
                0.008,
            )
        ),
        *pair(
            Part(
                limb([(0.085, 0.016, -0.045), (0.105, 0.011, 0.03)], [0.016, 0.022], 0.5, (0, 1, 0)), skin, 0.006, 0.003
            )
        ),
        *pair(
            Part(
                limb([(0.05, 0.075, 0.06), (0.062, 0.035, 0.085), (0.06, 0.015, 0.095)], [0.021, 0.016, 0.015]),
                skin,
                0.008,
            )
        ),
        *pair(Part(ellipsoid((0.062, 0.011, 0.108), (0.026, 0.011, 0.022)), skin, 0.005, 0.003)),
        *pair(Part(ellipsoid((0.043, 0.164, 0.058), (0.018, 0.0185, 0.014)), "f7f5ea", 0.0)),
        *pair(Part(ellipsoid((0.042, 0.165, 0.066), (0.0095, 0.0115, 0.009)), BLACK, 0.0, glint=True)),
        smile(0.104, 0.1015, 0.098, 0.014, 0.028),
        *pair(Part(ellipsoid((0.052, 0.112, 0.083), (0.011, 0.008, 0.005)), "f0a08c", 0.0)),
    ]
    return toy(parts, (-0.15, -0.01, -0.13), (0.15, 0.21, 0.15), hair=0.004, pattern=spots)


def toy_dinosaur() -> Creature:
    """A teal long-necked dinosaur with orange plates on its back; 0.28 m high, 0.38 m long."""
    skin, plate, belly = "4aa79a", "f0923a", "f1e6b8"
    spine = [
        (0.0, 0.262, 0.132),
        (0.0, 0.215, 0.108),
        (0.0, 0.178, 0.06),
        (0.0, 0.178, 0.01),
        (0.0, 0.172, -0.04),
        (0.0, 0.145, -0.09),
        (0.0, 0.105, -0.135),
        (0.0, 0.075, -0.175),
    ]
    sizes = [0.014, 0.019, 0.024, 0.027, 0.026, 0.022, 0.017, 0.012]

    def front(p, n, colour):
        under = smoothstep(0.3, 0.62, -n[:, 1] + 0.55 * n[:, 2] * (p[:, 1] > 0.14)) * (np.abs(p[:, 0]) < 0.04)
        under = under * (p[:, 1] > 0.03) * (p[:, 1] < 0.235)
        dots = np.sin(p[:, 1] * 150 + 3) * np.sin(p[:, 2] * 130) * (np.abs(n[:, 0]) > 0.45) * (p[:, 1] > 0.09)
        colour = mix(colour, srgb("328478"), 0.75 * smoothstep(0.5, 0.7, dots))
        return mix(colour, srgb(belly), under)

    parts = [
        Part(ellipsoid((0, 0.11, -0.01), (0.064, 0.062, 0.092)), skin),
        Part(limb([(0, 0.13, 0.05), (0, 0.19, 0.105), (0, 0.235, 0.125)], [0.045, 0.033, 0.03]), skin, 0.03),
        Part(limb([(0, 0.245, 0.125), (0, 0.24, 0.172)], [0.037, 0.029]), skin, 0.015),
        Part(limb([(0, 0.1, -0.08), (0, 0.065, -0.145), (0, 0.038, -0.205)], [0.046, 0.027, 0.009]), skin, 0.03),
        *(
            p
            for z in (0.045, -0.06)
            for p in pair(Part(limb([(0.046, 0.085, z), (0.052, 0.028, z + 0.008)], [0.034, 0.029]), skin, 0.012))
        ),
        *(
            Part(ellipsoid(at, (0.0085, r, 0.85 * r), rotation_about("x", 25)), plate, 0.002, 0.003)
            for at, r in zip(spine, sizes, strict=True)
        ),
        *buttons(0.027, 0.262, 0.15, 0.007),
        smile(0.228, 0.2, 0.042, 0.008, 0.02),
        *pair(Part(ellipsoid((0.01, 0.25, 0.199), (0.0025, 0.003, 0.002)), "2a5f58", 0.0)),
    ]
    return toy(parts, (-0.12, -0.01, -0.24), (0.12, 0.31, 0.23), hair=0.004, pattern=front)


def toy_giraffe() -> Creature:
    """A giraffe that sits, with brown patches; 0.35 m."""
    coat, patch, hoof = "f2c45e", "a8642c", "6e4426"
    cells = np.random.default_rng(4).uniform((-0.08, 0, -0.08), (0.08, 0.34, 0.14), (170, 3))

    def patches(p, n, colour):
        gap = np.sort(np.linalg.norm(p[:, None] - cells, axis=2), axis=1)
        inside = smoothstep(0.004, 0.008, gap[:, 1] - gap[:, 0]) * (p[:, 1] > 0.03) * (p[:, 1] < 0.262)
        return mix(colour, srgb(patch), 0.9 * inside * (np.abs(p[:, 2]) < 0.06))

    parts = [
        Part(ellipsoid((0, 0.075, 0), (0.06, 0.072, 0.056)), coat),
        Part(limb([(0, 0.12, 0), (0, 0.2, 0.005), (0, 0.265, 0.01)], [0.042, 0.029, 0.027]), coat, 0.03),
        Part(limb([(0, 0.29, 0.012), (0, 0.272, 0.068)], [0.04, 0.028]), coat, 0.012),
        Part(ellipsoid((0, 0.266, 0.078), (0.03, 0.023, 0.02)), CREAM, 0.008),
        *pair(Part(limb([(0.016, 0.32, 0.005), (0.019, 0.343, 0.0)], [0.006, 0.0085]), hoof, 0.004, 0.002)),
        *pair(Part(limb([(0.034, 0.305, 0), (0.068, 0.315, -0.004)], [0.012, 0.006], 0.5), coat, 0.006)),
        *pair(
            Part(
                limb([(0.042, 0.12, 0.015), (0.07, 0.085, 0.045), (0.068, 0.06, 0.06)], [0.02, 0.018, 0.017]),
                coat,
                0.008,
            )
        ),
        *pair(Part(limb([(0.036, 0.03, 0.03), (0.055, 0.024, 0.115)], [0.026, 0.023]), coat, 0.01)),
        *pair(Part(ellipsoid((0.056, 0.024, 0.133), (0.023, 0.024, 0.014)), hoof, 0.003, 0.002)),
        *pair(Part(ellipsoid((0.07, 0.05, 0.066), (0.017, 0.015, 0.015)), hoof, 0.003, 0.002)),
        *buttons(0.03, 0.298, 0.042, 0.007),
        *pair(Part(ellipsoid((0.011, 0.272, 0.097), (0.0025, 0.003, 0.002)), hoof, 0.0)),
        smile(0.257, 0.0965, 0.028, 0.004, 0.006),
        thread([(0, 0.3, -0.028), (0, 0.24, -0.02), (0, 0.17, -0.026), (0, 0.13, -0.042)], hoof, 0.006),
    ]
    return toy(parts, (-0.12, -0.01, -0.09), (0.12, 0.37, 0.17), pattern=patches)
