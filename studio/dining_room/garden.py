"""What is seen outside."""

from __future__ import annotations

import numpy as np

from studio.dining_room.layout import REVEAL, ROOM_LOW
from studio.shapes import Part, quad
from studio.textures import fbm, mix, noise, ramp, srgb

Z0 = ROOM_LOW[2]


def garden() -> list[Part]:
    """Terrace, hedge and sky: bright and soft, as a camera set for the room sees them."""

    def terrace(p, n):
        stone = 0.80 + 0.14 * fbm(p * (1.6, 1, 1.6), 3, 21) + 0.05 * noise(p * 9, 22)
        joint = np.minimum(*(np.abs((p[:, k] / 0.6 + 0.5) % 1 - 0.5) for k in (0, 2)))
        stone = stone * (0.85 + 0.15 * ramp(0, 0.05, joint))
        return mix(srgb("c9b896"), srgb("b7c08c"), ramp(-5.3, -5.6, p[:, 2])) * stone[:, None]

    def hedge(p, n):
        leaves = fbm(p * (1.3, 1.5, 1.3), 4, 23)
        green = mix(srgb("7f9a5c"), srgb("c2d08e"), ramp(-0.5, 0.6, leaves + 0.25 * (p[:, 1] - 1)))
        sky = mix(srgb("e8eef2"), srgb("cfe2f5"), ramp(1.5, 4.0, p[:, 1]))
        crown = p[:, 1] - 1.75 - 0.55 * fbm(p * (0.8, 0.0, 0.8), 3, 25) - 0.25 * leaves
        return mix(green, sky * 1.0, ramp(-0.12, 0.16, crown))

    outside = {"casts": False, "fixed": True}
    ground = quad((-5.5, -0.12, Z0 - REVEAL), (6.5, 0, 0), (0, 0, -4.8))
    back = quad((-6.5, -0.3, -7.0), (8.5, 0, 0), (0, 4.4, 0))
    side_back = quad((-5.6, -0.3, 4.5), (0, 0, -9.0), (0, 4.4, 0))
    return [
        Part("terrace", ground, terrace, 0.12, width=1.2, emission=(3.0, 2.9, 2.7), **outside),
        Part("hedge", back, hedge, 0.12, width=1.2, emission=(3.6, 3.7, 3.6), **outside),
        Part("side hedge", side_back, hedge, 0.15, width=1.2, emission=(3.6, 3.7, 3.6), **outside),
    ]
