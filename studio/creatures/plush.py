"""Common features of plush toys: short fleece, soft filling, button eyes, embroidery."""

from __future__ import annotations

import numpy as np

from core.material import Material
from studio.creatures.creature import Creature, Part, pair, surface_of
from studio.creatures.implicit import ellipsoid, limb
from studio.shapes import smooth_curve

BLACK, THREAD, CREAM, ROSE, WHITE = "14100e", "4a2f2a", "f5ead6", "e79a9a", "faf7ef"
FLEECE = 0.0045  # [m]
SOLE = 0.012  # [m] above the lowest point of the round shapes: what a toy sits on is flat
PLUSH = Material.named("plush", damping=20.0)  # fibre fill: a toy that is dropped neither bounces nor rolls for long
NEWTON_STEPS = 8  # from a point near a surface to it


def toy(parts: list[Part], low, high, hair: float = FLEECE, **options) -> Creature:
    """A toy of these parts in fleece of that depth [m]."""
    usual = {"sole": SOLE, "lift": 0.55, "curl": 0.4, "border": 0.002, "mottle": 0.06, "from_below": 0.68}
    return Creature(parts, low, high, PLUSH, hair, **(usual | options))


def on_surface(body: list[Part], points) -> tuple[np.ndarray, np.ndarray]:
    """Points (N, 3) of the surface of joined parts near the given ones, and its normals there."""
    p = np.atleast_2d(np.asarray(points, float))
    for _ in range(NEWTON_STEPS):
        distance, normal = surface_of(body, p)
        p = p - distance[:, None] * normal
    return p, normal


def sewn(body: list[Part], at, radii, colour: str, depth: float = 0.3, glint: bool = False) -> Part:
    """An ellipsoid sewn onto the surface near `at`, sunk into it by `depth` of its thickness, its last of three radii.

    The first lies across, the second upwards.
    """
    p, n = on_surface(body, at)
    across = np.cross((0.0, 1.0, 0.0), n[0])
    across /= np.linalg.norm(across)
    rotation = np.stack([across, np.cross(n[0], across), n[0]], 1)
    return Part(ellipsoid(p[0] + (0.5 - depth) * radii[2] * n[0], radii, rotation), colour, 0.0, glint=glint)


def button_eyes(body: list[Part], at, radius: float) -> list[Part]:
    """Two black button eyes."""
    return pair(sewn(body, at, (radius, radius, 0.8 * radius), BLACK, 0.0, glint=True))


def goggle_eyes(body: list[Part], at, radius: float) -> list[Part]:
    """Two white eyes of felt with large black pupils that look a little inwards."""
    x, y, z = at
    white = sewn(body, at, (radius, 1.1 * radius, 0.5 * radius), WHITE, 0.2)
    pupil = sewn(
        [white], (x - 0.12 * radius, y, z + 2 * radius), (0.62 * radius, 0.75 * radius, 0.3 * radius), BLACK, 0.2, True
    )
    return pair(white) + pair(pupil)


def cheeks(body: list[Part], at, radius: float, colour: str = ROSE) -> list[Part]:
    """Two rosy cheeks of felt."""
    return pair(sewn(body, at, (1.25 * radius, 0.85 * radius, 0.4 * radius), colour, 0.0))


def thread(body: list[Part], path, colour: str = THREAD, radius: float = 0.0017) -> Part:
    """A line embroidered on the surface near the given path (K, 3)."""
    p, n = on_surface(body, smooth_curve(path, 9))
    return Part(limb(p + (0.4 * FLEECE + radius) * n, [radius] * len(p), count=len(p)), colour, 0.0)


def smile(body: list[Part], at, width: float, depth: float, colour: str = THREAD, radius: float = 0.0017) -> Part:
    """A smile of this width [m] with its middle near `at` = (y, z) and its corners `depth` higher."""
    t = np.linspace(-1, 1, 7)
    y, z = at
    return thread(body, np.stack([0.5 * width * t, y + depth * t**2, np.full(7, z)], 1), colour, radius)
