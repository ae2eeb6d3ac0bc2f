"""Two small tables before the stage, on which the things to throw lie."""

from __future__ import annotations

import numpy as np

from studio.shapes import Surface, beveled_box, join, lathe, smooth_curve, tube
from studio.stage.hall import GILT
from studio.textures import cloth, mix, plain, srgb

TABLE_X, TABLE_Z, TABLE_TOP, TABLE_HALF = 0.70, 1.18, 0.86, (0.31, 0.17)  # [m] left and right; scenes repeat them
TABLE_THICKNESS = 0.04  # [m]


def prop_tables() -> list[Surface]:
    """Square tops with a velvet cover and a gold border on turned gilt feet."""
    tops, feet = [], []
    for s in (-1, 1):
        at = (s * TABLE_X, TABLE_TOP - 0.5 * TABLE_THICKNESS, TABLE_Z)
        size = (2 * TABLE_HALF[0], TABLE_THICKNESS, 2 * TABLE_HALF[1])
        tops.append(beveled_box(size, 0.006).moved(translation=at))
        curve = [
            (0.0, 0.03),
            (0.020, 0.03),
            (0.034, 0.10),
            (0.018, 0.24),
            (0.040, 0.42),
            (0.022, 0.60),
            (0.030, 0.74),
            (0.06, 0.82),
        ]
        feet.append(lathe(smooth_curve(curve, 50), 28).moved(translation=(at[0], 0.0, TABLE_Z)))
        for k in range(3):
            a = 2 * np.pi * (k + 0.25) / 3
            leg = np.array([(0.0, 0.16, 0.0), (0.10, 0.12, 0.0), (0.17, 0.03, 0.0), (0.20, 0.012, 0.0)])
            path = np.stack([leg[:, 0] * np.cos(a), leg[:, 1], leg[:, 0] * np.sin(a)], 1) + (at[0], 0, TABLE_Z)
            feet.append(tube(smooth_curve(path, 14), 0.014, 10))
    velvet = cloth("7a1420", 0.006, 0.10, 0.05, 601)

    def cover(p, n):
        u, v = TABLE_HALF[0] - np.abs(np.abs(p[:, 0]) - TABLE_X), TABLE_HALF[1] - np.abs(p[:, 2] - TABLE_Z)
        border = (np.abs(np.minimum(u, v) - 0.020) < 0.005) | (n[:, 1] < 0.5)
        return mix(velvet(p, n), srgb(GILT), 0.9 * border)

    return [
        Surface("table covers", join(*tops), cover, 0.0125),
        Surface("table feet", join(*feet), plain(GILT, 0.06), 0.018, gloss=0.2, roughness=0.3),
    ]
