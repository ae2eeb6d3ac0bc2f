"""The rabbit: sitting, 0.36 m to the tips of its ears."""

from __future__ import annotations

import numpy as np

from studio.creatures.creature import Creature, Part, pair, tissue
from studio.creatures.implicit import ellipsoid, limb
from studio.textures import mix, smoothstep, srgb

BROWN, WHITE, PINK, BLACK = "a08260", "f5eee2", "e0a6a0", "15100d"
YOUNG = 3e4  # [Pa]


def rabbit() -> Creature:
    """The model."""
    parts = [
        Part(
            limb([(0, 0.085, -0.085), (0, 0.105, -0.02), (0, 0.12, 0.045)], [0.08, 0.082, 0.062]),
            BROWN,
            comb=(0, -0.5, -1),
        ),
        Part(ellipsoid((0, 0.195, 0.095), (0.052, 0.05, 0.06)), BROWN, 0.03, 0.009),
        *pair(Part(ellipsoid((0.028, 0.178, 0.112), (0.03, 0.028, 0.034)), BROWN, 0.02, 0.012, (0.6, -0.4, -0.7))),
        Part(ellipsoid((0, 0.178, 0.143), (0.024, 0.021, 0.02)), WHITE, 0.012, 0.005, (0, 0.2, -1)),
        *pair(
            Part(
                limb(
                    [(0.022, 0.235, 0.075), (0.034, 0.285, 0.055), (0.04, 0.335, 0.035), (0.042, 0.36, 0.025)],
                    [0.017, 0.026, 0.024, 0.011],
                    0.6,
                ),
                BROWN,
                0.01,
                0.006,
            )
        ),
        *pair(Part(ellipsoid((0.065, 0.075, -0.065), (0.045, 0.068, 0.075)), BROWN, 0.012, comb=(0.2, -0.6, -0.6))),
        *pair(
            Part(
                limb([(0.075, 0.02, -0.075), (0.078, 0.018, 0.03)], [0.02, 0.019], 0.9, (0, 1, 0)),
                BROWN,
                0.015,
                0.007,
                (0, 0.1, 1),
            )
        ),
        *pair(
            Part(
                limb([(0.035, 0.1, 0.065), (0.033, 0.05, 0.085), (0.033, 0.018, 0.095)], [0.03, 0.02, 0.017]),
                BROWN,
                0.015,
                0.007,
            )
        ),
        *pair(Part(ellipsoid((0.033, 0.015, 0.108), (0.019, 0.015, 0.025)), WHITE, 0.01, 0.006)),
        Part(ellipsoid((0, 0.09, -0.172), 0.036), WHITE, 0.008, 0.016, (0, 0.8, -0.6)),
        Part(ellipsoid((0, 0.187, 0.163), (0.008, 0.006, 0.005)), PINK, 0.0, glint=True),
        *pair(Part(limb([(0, 0.181, 0.164), (0, 0.175, 0.164), (0.01, 0.169, 0.16)], [0.0014] * 3), "6b4a40", 0.0)),
        *pair(Part(ellipsoid((0.044, 0.207, 0.121), (0.01, 0.0125, 0.0115)), BLACK, 0.0, glint=True)),
    ]
    return Creature(parts, (-0.15, -0.02, -0.24), (0.15, 0.39, 0.2), tissue(YOUNG), hair=0.014, pattern=pattern)


def pattern(p: np.ndarray, n: np.ndarray, colour: np.ndarray) -> np.ndarray:
    """White belly, chin and rings round the eyes; pink insides of the ears, dark tips."""
    x, y, z = p.T
    under = smoothstep(0.35, 0.75, -n[:, 1]) * (y > 0.035)
    bib = smoothstep(0.35, 0.7, n[:, 2]) * (y < 0.15) * (z > 0.03) * (np.abs(x) < 0.045)
    eye = smoothstep(
        0.021, 0.015, np.linalg.norm(p - np.array([0.044, 0.207, 0.121]) * np.sign(x)[:, None] ** [1, 0, 0], axis=1)
    )
    colour = mix(colour, srgb(WHITE), np.clip(under + bib + 0.8 * eye, 0, 1))
    middle = np.interp(y, [0.235, 0.285, 0.335, 0.36], [0.022, 0.034, 0.04, 0.042])
    inside = (y > 0.245) * smoothstep(0.4, 0.8, n[:, 2]) * smoothstep(0.016, 0.009, np.abs(np.abs(x) - middle))
    colour = mix(colour, srgb(PINK), 0.85 * inside)
    return mix(colour, srgb("4a3828"), 0.8 * smoothstep(0.345, 0.365, y))
