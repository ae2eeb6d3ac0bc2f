"""The fox: 0.47 m to the tips of its ears, 0.85 m from nose to tail."""

from __future__ import annotations

import numpy as np

from studio.creatures.creature import Creature, Part, pair, tissue
from studio.creatures.implicit import ellipsoid, limb
from studio.textures import mix, smoothstep, srgb

ORANGE, CREAM, SOCK, BLACK = "d9752b", "f7eee0", "33211a", "17120f"
YOUNG = 8e4  # [Pa]


def fox() -> Creature:
    """The model."""
    parts = [
        Part(
            limb([(0, 0.255, -0.17), (0, 0.25, 0.0), (0, 0.265, 0.14)], [0.07, 0.066, 0.076]),
            ORANGE,
            comb=(0, -0.3, -1),
        ),
        Part(limb([(0, 0.29, 0.14), (0, 0.36, 0.22)], [0.062, 0.05]), ORANGE, 0.04, comb=(0, -0.8, -0.6)),
        Part(ellipsoid((0, 0.375, 0.24), (0.062, 0.053, 0.06)), ORANGE, 0.02, 0.012),
        *pair(Part(ellipsoid((0.042, 0.358, 0.245), (0.032, 0.028, 0.036)), CREAM, 0.02, 0.022, (0.7, -0.5, -0.6))),
        Part(limb([(0, 0.365, 0.27), (0, 0.352, 0.33)], [0.034, 0.017]), ORANGE, 0.02, 0.006, (0, 0.2, -1)),
        *pair(
            Part(
                limb([(0.034, 0.405, 0.225), (0.046, 0.44, 0.222), (0.056, 0.478, 0.218)], [0.03, 0.022, 0.005], 0.5),
                ORANGE,
                0.012,
                0.007,
            )
        ),
        *pair(
            Part(
                limb([(0.04, 0.25, 0.12), (0.044, 0.13, 0.125), (0.044, 0.025, 0.135)], [0.045, 0.027, 0.024]),
                ORANGE,
                0.03,
                0.009,
            )
        ),
        *pair(Part(ellipsoid((0.044, 0.02, 0.15), (0.026, 0.02, 0.036)), SOCK, 0.015, 0.006)),
        *pair(
            Part(
                limb(
                    [(0.04, 0.24, -0.15), (0.052, 0.15, -0.13), (0.05, 0.1, -0.17), (0.048, 0.025, -0.16)],
                    [0.062, 0.044, 0.027, 0.024],
                ),
                ORANGE,
                0.03,
                0.011,
            )
        ),
        *pair(Part(ellipsoid((0.048, 0.02, -0.145), (0.026, 0.02, 0.036)), SOCK, 0.015, 0.006)),
        Part(
            limb([(0, 0.275, -0.2), (0, 0.28, -0.29), (0, 0.24, -0.4), (0, 0.2, -0.48)], [0.032, 0.048, 0.06, 0.016]),
            ORANGE,
            0.02,
            0.032,
        ),
        Part(ellipsoid((0, 0.362, 0.348), (0.014, 0.011, 0.011)), BLACK, 0.0, glint=True),
        *pair(Part(ellipsoid((0.033, 0.387, 0.288), 0.0105), BLACK, 0.0, glint=True)),
    ]
    return Creature(parts, (-0.14, -0.02, -0.54), (0.14, 0.52, 0.4), tissue(YOUNG), hair=0.018, pattern=pattern)


def pattern(p: np.ndarray, n: np.ndarray, colour: np.ndarray) -> np.ndarray:
    """White bib, belly, muzzle's underside and tip of the tail; dark socks and backs of the ears."""
    x, y, z = p.T
    tail_tip = smoothstep(-0.405, -0.43, z)
    bib = (
        smoothstep(-0.1, 0.35, n[:, 2] - 0.6 * n[:, 1] - 0.45)
        * (z > 0.1)
        * (y > 0.14)
        * (np.abs(x) < 0.075)
        * (y < 0.345)
    )
    belly = smoothstep(0.72, 0.9, -n[:, 1]) * (y > 0.16) * (np.abs(z) < 0.2)
    chin = smoothstep(0.356, 0.346, y - 0.1 * (z - 0.3)) * (z > 0.255) * (y > 0.3)
    sock = smoothstep(0.125, 0.085, y) * (np.abs(x) > 0.015)
    ear_back = (y > 0.435) * smoothstep(-0.2, 0.2, -n[:, 2])
    ear_inside = (y > 0.415) * smoothstep(0.45, 0.8, n[:, 2]) * (z > 0.2) * smoothstep(0.022, 0.032, np.abs(x))
    colour = mix(colour, srgb(CREAM), np.clip(tail_tip + bib + belly + chin + 0.8 * ear_inside, 0, 1))
    return mix(colour, srgb(SOCK), np.clip(sock + 0.9 * ear_back, 0, 1))
