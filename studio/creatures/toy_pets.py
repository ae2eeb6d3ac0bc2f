"""Plush toys of the nursery: teddy, rabbit, cat, duck."""

from __future__ import annotations

import numpy as np

from studio.creatures.creature import Creature, Part, Seam, pair
from studio.creatures.implicit import ellipsoid, limb
from studio.creatures.plush import BLACK, CREAM, ROSE, buttons, smile, thread, toy
from studio.shapes import rotation_about
from studio.textures import mix, smoothstep, srgb


def toy_teddy() -> Creature:
    """A honey-coloured bear that sits, with a red bow; 0.29 m."""
    fur, ribbon = "c58a4a", "c5313a"
    loop = rotation_about("z", 18)
    parts = [
        Part(ellipsoid((0, 0.095, 0), (0.072, 0.088, 0.064)), fur),
        Part(ellipsoid((0, 0.095, 0.022), (0.05, 0.062, 0.046)), CREAM, 0.006),
        Part(ellipsoid((0, 0.222, 0.006), (0.071, 0.063, 0.062)), fur, 0.012),
        Part(ellipsoid((0, 0.206, 0.058), (0.032, 0.026, 0.022)), CREAM, 0.008),
        *pair(Part(ellipsoid((0.057, 0.272, 0), (0.028, 0.028, 0.014)), fur, 0.008)),
        *pair(Part(ellipsoid((0.058, 0.272, 0.009), (0.017, 0.017, 0.008)), CREAM, 0.003)),
        *pair(
            Part(
                limb([(0.058, 0.145, 0.012), (0.088, 0.115, 0.045), (0.09, 0.085, 0.075)], [0.029, 0.028, 0.026]),
                fur,
                0.008,
            )
        ),
        *pair(Part(limb([(0.045, 0.042, 0.03), (0.062, 0.036, 0.125)], [0.036, 0.033]), fur, 0.01)),
        *pair(Part(ellipsoid((0.063, 0.037, 0.15), (0.024, 0.026, 0.011)), CREAM, 0.003)),
        Part(ellipsoid((0, 0.216, 0.079), (0.012, 0.009, 0.007)), BLACK, 0.0, glint=True),
        thread([(0, 0.208, 0.081), (0, 0.197, 0.08)]),
        smile(0.195, 0.0795, 0.026, 0.004, 0.003),
        *buttons(0.029, 0.238, 0.061, 0.008),
        *pair(Part(ellipsoid((0.026, 0.158, 0.064), (0.025, 0.015, 0.009), loop), ribbon, 0.0)),
        Part(ellipsoid((0, 0.157, 0.068), (0.009, 0.01, 0.009)), "a3222c", 0.0),
    ]
    seams = [Seam((0, 0, 0), (1, 0, 0), lambda p: (p[:, 1] > 0.23) | ((p[:, 1] < 0.14) & (p[:, 1] > 0.03)))]
    return toy(parts, (-0.14, -0.01, -0.09), (0.14, 0.32, 0.18), seams=seams)


def toy_rabbit() -> Creature:
    """A pale grey rabbit with ears that hang down; 0.28 m."""
    fur = "b9b4c0"
    parts = [
        Part(ellipsoid((0, 0.088, 0), (0.064, 0.082, 0.058)), fur),
        Part(ellipsoid((0, 0.082, 0.02), (0.044, 0.056, 0.042)), CREAM, 0.006),
        Part(ellipsoid((0, 0.203, 0.006), (0.062, 0.06, 0.056)), fur, 0.012),
        *pair(Part(ellipsoid((0.013, 0.186, 0.052), (0.018, 0.015, 0.014)), CREAM, 0.005)),
        *pair(
            Part(
                limb(
                    [
                        (0.03, 0.25, 0),
                        (0.062, 0.285, 0),
                        (0.09, 0.25, 0.006),
                        (0.098, 0.17, 0.012),
                        (0.096, 0.125, 0.014),
                    ],
                    [0.015, 0.02, 0.024, 0.029, 0.013],
                    0.42,
                    (0.5, 0, 1),
                ),
                fur,
                0.008,
            )
        ),
        *pair(
            Part(
                limb(
                    [(0.093, 0.235, 0.0175), (0.102, 0.17, 0.024), (0.1, 0.135, 0.022)],
                    [0.009, 0.016, 0.007],
                    0.3,
                    (0.5, 0, 1),
                ),
                ROSE,
                0.002,
                0.003,
            )
        ),
        *pair(
            Part(
                limb([(0.05, 0.13, 0.015), (0.072, 0.1, 0.05), (0.066, 0.08, 0.075)], [0.024, 0.023, 0.021]), fur, 0.008
            )
        ),
        *pair(Part(limb([(0.04, 0.035, 0.03), (0.052, 0.03, 0.125)], [0.032, 0.028]), fur, 0.01)),
        *pair(Part(ellipsoid((0.053, 0.03, 0.147), (0.019, 0.021, 0.009)), ROSE, 0.003, 0.003)),
        Part(ellipsoid((0, 0.045, -0.065), 0.026), CREAM, 0.004, 0.009),
        Part(ellipsoid((0, 0.199, 0.065), (0.009, 0.007, 0.006)), "d9707c", 0.0),
        *buttons(0.03, 0.215, 0.052, 0.0078),
        smile(0.173, 0.062, 0.02, 0.003, 0.003),
    ]
    seams = [Seam((0, 0, 0), (1, 0, 0), lambda p: ((p[:, 1] < 0.14) & (p[:, 2] > 0)) | (p[:, 1] > 0.225))]
    return toy(parts, (-0.14, -0.01, -0.11), (0.14, 0.33, 0.18), seams=seams)


def toy_cat() -> Creature:
    """A grey tabby that sits, its tail round its side; 0.26 m."""
    fur = "8f939b"

    def tabby(p, n, colour):
        x, y, z = p.T
        body = np.sin(2 * np.pi * (y + 0.35 * np.abs(x)) / 0.034 + 1.5 * np.sin(25 * z))
        stripe = smoothstep(0.35, 0.6, body) * (z < 0.02) * (y < 0.16)
        forehead = smoothstep(0.3, 0.6, np.cos(2 * np.pi * x / 0.026)) * (y > 0.215) * (np.abs(x) < 0.034)
        tail = smoothstep(0.1, 0.4, np.sin(2 * np.pi * (x + z) / 0.04)) * (y < 0.055) * (np.abs(x) > 0.075)
        front = smoothstep(0.2, 0.5, n[:, 2]) * (np.abs(x) < 0.04) * (y < 0.15)
        colour = mix(colour, srgb("4c4f58"), 0.85 * np.clip(stripe + forehead + tail, 0, 1) * (1 - front))
        return mix(colour, srgb("f2eee8"), front * (y > 0.02))

    parts = [
        Part(ellipsoid((0, 0.08, -0.015), (0.066, 0.082, 0.068)), fur),
        Part(ellipsoid((0, 0.195, 0.022), (0.064, 0.053, 0.053)), fur, 0.014),
        *pair(Part(ellipsoid((0.015, 0.178, 0.066), (0.019, 0.015, 0.013)), "f2eee8", 0.005)),
        *pair(
            Part(
                limb([(0.034, 0.228, 0.02), (0.044, 0.25, 0.02), (0.05, 0.268, 0.02)], [0.024, 0.015, 0.004], 0.5),
                fur,
                0.006,
            )
        ),
        *pair(Part(limb([(0.041, 0.233, 0.03), (0.047, 0.256, 0.026)], [0.013, 0.004], 0.4), ROSE, 0.002, 0.003)),
        *pair(
            Part(
                limb([(0.03, 0.12, 0.035), (0.032, 0.05, 0.056), (0.032, 0.02, 0.066)], [0.026, 0.021, 0.02]),
                fur,
                0.008,
            )
        ),
        *pair(Part(ellipsoid((0.032, 0.016, 0.076), (0.022, 0.016, 0.024)), "f2eee8", 0.004)),
        *pair(Part(ellipsoid((0.058, 0.045, -0.005), (0.034, 0.046, 0.052)), fur, 0.01)),
        Part(
            limb(
                [(0.02, 0.03, -0.07), (0.09, 0.024, -0.05), (0.112, 0.022, 0.02), (0.085, 0.022, 0.075)],
                [0.019, 0.021, 0.02, 0.014],
            ),
            fur,
            0.008,
        ),
        Part(ellipsoid((0, 0.188, 0.079), (0.008, 0.006, 0.005)), "d9707c", 0.0),
        smile(0.174, 0.0785, 0.024, 0.005, 0.003),
        *pair(Part(ellipsoid((0.029, 0.206, 0.068), (0.011, 0.0115, 0.006)), "7fb36a", 0.0, glint=False)),
        *pair(Part(ellipsoid((0.029, 0.206, 0.0715), (0.005, 0.0095, 0.004)), BLACK, 0.0, glint=True)),
        *(
            p
            for dy in (0.004, -0.004)
            for p in pair(
                thread(
                    [(0.026, 0.178 + dy, 0.075), (0.06, 0.178 + 3 * dy, 0.07), (0.08, 0.176 + 4 * dy, 0.062)],
                    "f5f2ec",
                    0.001,
                )
            )
        ),
    ]
    return toy(parts, (-0.15, -0.01, -0.11), (0.15, 0.29, 0.12), pattern=tabby)


def toy_duck() -> Creature:
    """A yellow duckling; 0.22 m."""
    fur, beak = "f6c838", "ee7d22"
    wing = rotation_about("z", 12) @ rotation_about("x", -12)
    parts = [
        Part(ellipsoid((0, 0.077, -0.01), (0.068, 0.066, 0.085)), fur),
        Part(limb([(0, 0.08, -0.075), (0, 0.115, -0.12)], [0.035, 0.012]), fur, 0.02),
        Part(ellipsoid((0, 0.165, 0.05), (0.052, 0.05, 0.05)), fur, 0.02),
        *pair(Part(ellipsoid((0.067, 0.085, -0.015), (0.013, 0.036, 0.056), wing), "eeb42c", 0.005)),
        Part(limb([(0, 0.205, 0.05), (0, 0.226, 0.042), (0, 0.228, 0.028)], [0.01, 0.008, 0.003]), fur, 0.008, 0.012),
        Part(ellipsoid((0, 0.161, 0.108), (0.028, 0.008, 0.027)), beak, 0.005, 0.002),
        Part(ellipsoid((0, 0.15, 0.102), (0.022, 0.006, 0.02)), "d96a18", 0.002, 0.002),
        *pair(Part(ellipsoid((0.036, 0.012, 0.05), (0.026, 0.011, 0.04)), beak, 0.006, 0.002)),
        *buttons(0.03, 0.18, 0.09, 0.0075),
    ]
    seams = [Seam((0, 0, 0), (1, 0, 0), lambda p: ((p[:, 1] < 0.13) & (p[:, 2] > 0.04)) | (p[:, 2] < -0.02))]
    return toy(parts, (-0.12, -0.01, -0.15), (0.12, 0.25, 0.16), seams=seams)
