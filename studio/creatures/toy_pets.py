"""Plush toys of the nursery: teddy, rabbit, cat, duck."""

from __future__ import annotations

import numpy as np

from studio.creatures.creature import Creature, Part, Seam, pair
from studio.creatures.implicit import ellipsoid, limb
from studio.creatures.plush import BLACK, CREAM, ROSE, button_eyes, cheeks, sewn, smile, thread, toy
from studio.shapes import rotation_about
from studio.textures import mix, smoothstep, srgb


def toy_teddy() -> Creature:
    """A honey-coloured bear that sits, with a red bow; 0.3 m."""
    fur, ribbon = "c98d4b", "c5313a"
    loop = rotation_about("z", 18)
    arm = [(0.058, 0.145, 0.012), (0.088, 0.115, 0.045), (0.09, 0.085, 0.075)]
    body = [
        Part(ellipsoid((0, 0.095, 0), (0.072, 0.088, 0.064)), fur),
        Part(ellipsoid((0, 0.095, 0.022), (0.05, 0.062, 0.046)), CREAM, 0.006),
        Part(ellipsoid((0, 0.222, 0.006), (0.071, 0.063, 0.062)), fur, 0.012),
        Part(ellipsoid((0, 0.206, 0.058), (0.032, 0.026, 0.022)), CREAM, 0.008),
        *pair(Part(ellipsoid((0.057, 0.272, 0), (0.028, 0.028, 0.014)), fur, 0.008)),
        *pair(Part(ellipsoid((0.058, 0.272, 0.009), (0.017, 0.017, 0.008)), CREAM, 0.003)),
        *pair(Part(limb(arm, [0.029, 0.028, 0.026]), fur, 0.008)),
        *pair(Part(limb([(0.045, 0.042, 0.03), (0.062, 0.036, 0.125)], [0.036, 0.033]), fur, 0.01)),
        *pair(Part(ellipsoid((0.063, 0.037, 0.15), (0.024, 0.026, 0.011)), CREAM, 0.003)),
    ]
    face = [
        sewn(body, (0, 0.218, 0.09), (0.013, 0.0095, 0.008), BLACK, glint=True),
        thread(body, [(0, 0.21, 0.09), (0, 0.205, 0.09), (0, 0.197, 0.09)]),
        smile(body, (0.195, 0.09), 0.028, 0.005),
        *button_eyes(body, (0.029, 0.238, 0.07), 0.0085),
        *pair(Part(ellipsoid((0.026, 0.16, 0.066), (0.026, 0.016, 0.01), loop), ribbon, 0.0)),
        Part(ellipsoid((0, 0.159, 0.071), (0.01, 0.011, 0.01)), "a3222c", 0.0),
    ]
    seam = Seam((0, 0, 0), (1, 0, 0), lambda p: (p[:, 1] > 0.245) | ((p[:, 1] < 0.14) & (p[:, 1] > 0.02)))
    return toy([*body, *face], (-0.14, -0.01, -0.09), (0.14, 0.32, 0.18), seams=[seam])


def toy_rabbit() -> Creature:
    """A pale grey rabbit with ears that hang down; 0.3 m."""
    fur = "c3bdc9"
    ear = [(0.03, 0.25, 0), (0.062, 0.285, 0), (0.09, 0.25, 0.006), (0.098, 0.17, 0.012), (0.096, 0.125, 0.014)]
    lining = [(0.094, 0.235, 0.0185), (0.103, 0.17, 0.025), (0.1, 0.135, 0.023)]
    arm = [(0.05, 0.13, 0.015), (0.072, 0.1, 0.05), (0.066, 0.08, 0.075)]
    body = [
        Part(ellipsoid((0, 0.088, 0), (0.064, 0.082, 0.058)), fur),
        Part(ellipsoid((0, 0.082, 0.02), (0.044, 0.056, 0.042)), CREAM, 0.006),
        Part(ellipsoid((0, 0.203, 0.006), (0.062, 0.06, 0.056)), fur, 0.012),
        *pair(Part(ellipsoid((0.013, 0.186, 0.052), (0.018, 0.015, 0.014)), CREAM, 0.005)),
        *pair(Part(limb(ear, [0.015, 0.02, 0.024, 0.029, 0.013], 0.5, (0.5, 0, 1)), fur, 0.008)),
        *pair(Part(limb(lining, [0.009, 0.016, 0.007], 0.3, (0.5, 0, 1)), ROSE, 0.002, 0.003)),
        *pair(Part(limb(arm, [0.024, 0.023, 0.021]), fur, 0.008)),
        *pair(Part(limb([(0.04, 0.035, 0.03), (0.052, 0.03, 0.125)], [0.032, 0.028]), fur, 0.01)),
        Part(ellipsoid((0, 0.045, -0.065), 0.026), CREAM, 0.004, 0.009),
    ]
    face = [
        *pair(sewn(body, (0.053, 0.03, 0.17), (0.017, 0.019, 0.006), ROSE)),
        sewn(body, (0, 0.199, 0.08), (0.0105, 0.008, 0.007), "d9707c"),
        *button_eyes(body, (0.03, 0.217, 0.06), 0.0085),
        thread(body, [(0, 0.193, 0.08), (0, 0.187, 0.08), (0, 0.18, 0.08)]),
        smile(body, (0.178, 0.075), 0.026, 0.004),
        *cheeks(body, (0.043, 0.19, 0.06), 0.009, "efb0b0"),
    ]
    seam = Seam((0, 0, 0), (1, 0, 0), lambda p: ((p[:, 1] < 0.14) & (p[:, 2] > 0)) | (p[:, 1] > 0.24))
    return toy([*body, *face], (-0.14, -0.01, -0.11), (0.14, 0.33, 0.18), seams=[seam])


def toy_cat() -> Creature:
    """A grey tabby that sits, its tail round its side; 0.27 m."""
    fur, white = "8f939b", "f2eee8"

    def tabby(p, n, colour):
        x, y, z = p.T
        rings = np.sin(2 * np.pi * (y + 0.35 * np.abs(x)) / 0.034 + 1.5 * np.sin(25 * z))
        stripe = smoothstep(0.3, 0.6, rings) * (z < 0.02) * (y < 0.16)
        forehead = smoothstep(0.3, 0.6, np.cos(2 * np.pi * x / 0.026)) * (y > 0.222) * (np.abs(x) < 0.034)
        tail = smoothstep(0.1, 0.4, np.sin(2 * np.pi * (x + z) / 0.04)) * (y < 0.055) * (np.abs(x) > 0.075)
        front = smoothstep(0.2, 0.5, n[:, 2]) * (np.abs(x) < 0.04) * (y < 0.15)
        colour = mix(colour, srgb("4c4f58"), 0.85 * np.clip(stripe + forehead + tail, 0, 1) * (1 - front))
        return mix(colour, srgb(white), front * (y > 0.02))

    tail = [(0.02, 0.03, -0.07), (0.09, 0.024, -0.05), (0.112, 0.022, 0.02), (0.085, 0.022, 0.075)]
    body = [
        Part(ellipsoid((0, 0.08, -0.015), (0.066, 0.082, 0.068)), fur),
        Part(ellipsoid((0, 0.195, 0.022), (0.066, 0.054, 0.053)), fur, 0.014),
        *pair(Part(ellipsoid((0.015, 0.178, 0.066), (0.019, 0.015, 0.013)), white, 0.005)),
        *pair(
            Part(
                limb([(0.034, 0.228, 0.02), (0.045, 0.25, 0.02), (0.052, 0.27, 0.02)], [0.026, 0.017, 0.005], 0.55),
                fur,
                0.006,
            )
        ),
        *pair(Part(limb([(0.041, 0.233, 0.032), (0.048, 0.258, 0.027)], [0.013, 0.005], 0.4), ROSE, 0.002, 0.003)),
        *pair(
            Part(
                limb([(0.03, 0.12, 0.035), (0.032, 0.05, 0.056), (0.032, 0.02, 0.066)], [0.026, 0.021, 0.02]),
                fur,
                0.008,
            )
        ),
        *pair(Part(ellipsoid((0.032, 0.016, 0.076), (0.022, 0.018, 0.024)), white, 0.004)),
        *pair(Part(ellipsoid((0.058, 0.045, -0.005), (0.034, 0.046, 0.052)), fur, 0.01)),
        Part(limb(tail, [0.019, 0.021, 0.02, 0.014]), fur, 0.008),
    ]
    iris = sewn(body, (0.028, 0.207, 0.08), (0.0125, 0.013, 0.006), "7fb36a")
    pupil = sewn([iris], (0.0275, 0.207, 0.1), (0.0055, 0.0105, 0.003), BLACK, 0.2, glint=True)
    whiskers = [
        part
        for up in (1, -1)
        for part in pair(
            Part(
                limb(
                    [
                        (0.028, 0.178 + 0.004 * up, 0.076),
                        (0.05, 0.179 + 0.009 * up, 0.076),
                        (0.07, 0.178 + 0.013 * up, 0.07),
                    ],
                    [0.0011] * 3,
                ),
                white,
                0.0,
            )
        )
    ]
    face = [
        *pair(iris),
        *pair(pupil),
        sewn(body, (0, 0.189, 0.09), (0.009, 0.007, 0.006), "d9707c"),
        thread(body, [(0, 0.185, 0.09), (0, 0.18, 0.09), (0, 0.174, 0.09)]),
        smile(body, (0.172, 0.085), 0.032, 0.006),
        *whiskers,
    ]
    return toy([*body, *face], (-0.15, -0.01, -0.11), (0.15, 0.29, 0.12), pattern=tabby)


def toy_duck() -> Creature:
    """A yellow duckling; 0.23 m."""
    fur, beak = "f8cb3c", "ee7d22"
    wing = rotation_about("z", 12) @ rotation_about("x", -12)
    body = [
        Part(ellipsoid((0, 0.077, -0.01), (0.068, 0.066, 0.085)), fur),
        Part(limb([(0, 0.08, -0.075), (0, 0.115, -0.12)], [0.035, 0.012]), fur, 0.02),
        Part(ellipsoid((0, 0.165, 0.05), (0.052, 0.05, 0.05)), fur, 0.02),
        *pair(Part(ellipsoid((0.067, 0.085, -0.015), (0.014, 0.036, 0.056), wing), "eeb42c", 0.005)),
        *pair(Part(ellipsoid((0.036, 0.014, 0.05), (0.028, 0.016, 0.042)), beak, 0.004, 0.0)),
        Part(limb([(0, 0.205, 0.05), (0, 0.226, 0.042), (0, 0.228, 0.028)], [0.012, 0.009, 0.005]), fur, 0.008, 0.012),
    ]
    face = [
        Part(ellipsoid((0, 0.161, 0.106), (0.03, 0.008, 0.028)), beak, 0.0),
        Part(ellipsoid((0, 0.151, 0.1), (0.024, 0.006, 0.021)), "d96a18", 0.0),
        *button_eyes(body, (0.03, 0.18, 0.1), 0.0085),
        *cheeks(body, (0.04, 0.158, 0.09), 0.008, "f5a25c"),
    ]
    seam = Seam((0, 0, 0), (1, 0, 0), lambda p: ((p[:, 1] < 0.13) & (p[:, 2] > 0.04)) | (p[:, 2] < -0.02))
    return toy([*body, *face], (-0.12, -0.01, -0.15), (0.12, 0.25, 0.16), sole=0.018, seams=[seam])
