"""Fruit for the bowl, each centred on its own origin."""

from __future__ import annotations

import numpy as np

from studio.shapes import Part, lathe, pillow, smooth, tube, turn
from studio.textures import mix, noise, plain, ramp, srgb


def apple(red: str, yellow: str, seed: int) -> list[Part]:
    """Apple with streaks, dimple and stalk."""
    a = np.linspace(-np.pi / 2, np.pi / 2, 40)
    r = 0.038 * np.cos(a) * (1 + 0.06 * np.sin(a))
    y = 0.033 * np.sin(a) - 0.012 * np.exp(-((r / 0.010) ** 2)) * np.sign(np.sin(a))

    def of(p, n):
        turn_ = np.arctan2(p[:, 2], p[:, 0])
        streak = noise(np.stack([3.5 * np.cos(turn_) * 3, 3.5 * np.sin(turn_) * 3, p[:, 1] * 18], 1), seed)
        side = 0.35 * np.cos(turn_ + seed) + 0.5 * noise(p * 28, seed + 1)
        c = mix(srgb(red), srgb(yellow), ramp(0.10, 0.75, side + 0.55 * streak))
        c = mix(c, srgb("8a7a3a"), 0.8 * ramp(0.008, 0.003, np.hypot(p[:, 0], p[:, 2])))
        return c * (1 + 0.25 * (noise(p * 420, seed + 2) > 0.42))[:, None]

    stalk = tube([(0, 0.018, 0), (0.001, 0.030, 0.001), (0.005, 0.040, 0.003)], 0.0013, 10)
    body = Part("apple", lathe(np.stack([r, y], 1), 44), of, 0.0040, gloss=0.05, roughness=0.16)
    return [body, Part("stalk", stalk, plain("4a3420"), 0.003)]


def orange(seed: int) -> list[Part]:
    """Orange with a pored skin."""

    def of(p, n):
        pores = ramp(0.15, 0.5, noise(p * 520, seed))
        c = srgb("f0861c") * (1 - 0.20 * pores + 0.12 * noise(p * 40, seed + 1))[:, None]
        return mix(c, srgb("5f6a2a"), ramp(0.005, 0.003, np.hypot(p[:, 0], p[:, 2])) * (p[:, 1] > 0))

    return [Part("orange", pillow((0.078, 0.074, 0.078), 1.0, 28), of, 0.0040, gloss=0.04, roughness=0.22)]


def lemon(seed: int) -> list[Part]:
    """Lemon, its long axis along x."""
    curve = smooth([(0, -0.042), (0.006, -0.040), (0.011, -0.034), (0.024, -0.018), (0.027, 0.0), (0.023, 0.019),
                    (0.010, 0.034), (0.006, 0.041), (0, 0.044)], 40)  # fmt: skip

    def of(p, n):
        return (
            srgb("f2cf2e") * (1 - 0.14 * ramp(0.1, 0.5, noise(p * 420, seed)) + 0.10 * noise(p * 50, seed + 1))[:, None]
        )

    mesh = lathe(curve, 36).moved(turn("z", 90))
    return [Part("lemon", mesh, of, 0.0038, gloss=0.04, roughness=0.2)]


def banana(seed: int) -> list[Part]:
    """Banana bent in the x-y plane, ends up."""
    t = np.linspace(-1, 1, 22)
    path = np.stack([0.085 * np.sin(0.95 * t) / np.sin(0.95), 0.052 * (1 - np.cos(0.95 * t)), 0 * t], 1)
    radius = 0.0165 * (1 - np.abs(t) ** 5 * 0.72) * (1 - 0.1 * t)

    def of(p, n):
        end = ramp(0.078, 0.086, np.abs(p[:, 0]))
        spots = ramp(0.42, 0.60, noise(p * (120, 240, 240), 130 + seed))
        c = srgb("f0c52f") * (1 + 0.12 * noise(p * (12, 60, 60), 131))[:, None]
        c = mix(c, srgb("7a5522"), 0.5 * spots.clip(0, 1))
        return mix(c, srgb("4c4420"), end)

    return [Part("banana", tube(path, radius, 14), of, 0.0042, gloss=0.03, roughness=0.25)]
