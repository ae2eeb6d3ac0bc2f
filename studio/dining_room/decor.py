"""Decoration: lamps, curtains, a picture, a vase and books on the sideboard."""

from __future__ import annotations

import numpy as np

from studio.dining_room.shell import DOOR_X, ROOM_HIGH, ROOM_LOW, WINDOW_Z, Z0
from studio.light_sources import Lamp
from studio.shapes import Surface, box, grid_mesh, join, lathe, quad, rotation_about, smooth_curve, superellipsoid, tube
from studio.textiles import drape
from studio.textures import WALNUT, cloth, fbm, mix, noise, plain, smoothstep, srgb, wood

LAMP_AT = (0.0, 1.72, 0.0)  # [m] lower rim of the pendant lamp
SIDE_LAMP_AT = (1.52, 0.80, -1.96)  # [m] foot of the lamp on the sideboard
CURTAIN_OFFSET = 0.17  # [m] from the wall: Gaussians that overlap in depth would mix
LAMP_COLOUR = np.array([1.0, 0.72, 0.42])  # linear RGB


def decor() -> list[Surface]:
    """Lamps, curtains, picture, vase and books."""
    return [*pendant(), *side_lamp(), *curtains(), *picture(), *vase()]


def lamps() -> list[Lamp]:
    """The light bulbs."""
    x, y, z = LAMP_AT
    sx, sy, sz = SIDE_LAMP_AT
    return [
        Lamp(np.array([x, y + 0.10, z]), 0.035, 2.1 * LAMP_COLOUR),
        Lamp(np.array([sx, sy + 0.33, sz]), 0.03, 0.75 * LAMP_COLOUR),
    ]


def pendant() -> list[Surface]:
    """Enamelled pendant lamp over the table, white inside."""
    curve = smooth_curve(
        [(0.200, 0.0), (0.192, 0.030), (0.150, 0.085), (0.085, 0.125), (0.040, 0.160), (0.030, 0.195)], 40
    )
    outer, inner = lathe(curve, 56), lathe((curve - (0.020, 0.0)).clip(0.004)[::-1], 56)
    x, y, z = LAMP_AT
    cord = tube([(x, y + 0.19, z), (x, 2.3, z), (x, ROOM_HIGH[1], z)], 0.0045, 10)
    rose = lathe([(0.05, 2.57), (0.05, 2.6)], 24)
    bulb = superellipsoid((0.07, 0.085, 0.07), 1.0, 14).moved(translation=(0, 0.10, 0))
    surfaces = [
        Surface("shade", outer, plain("2f4a45", 0.03), 0.0082, gloss=0.05, roughness=0.12),
        Surface("shade inside", inner, plain("f4ead6", 0.02), 0.0100),
        Surface("bulb", bulb, plain("ffffff", 0.0), 0.006, emission=tuple(14 * LAMP_COLOUR), blocks_light=False),
    ]
    surfaces = [p.placed(position=LAMP_AT) for p in surfaces]
    return [*surfaces, Surface("cord", join(cord, rose), plain("3a3a38"), 0.008)]


def side_lamp() -> list[Surface]:
    """Small lamp on the sideboard: ceramic foot, luminous linen shade."""
    foot = smooth_curve(
        [(0.0, 0.0), (0.050, 0.001), (0.056, 0.012), (0.066, 0.070), (0.048, 0.135), (0.016, 0.172), (0.011, 0.21)], 40
    )
    shade = np.stack([np.linspace(0.135, 0.095, 12), np.linspace(0.225, 0.405, 12)], 1)
    linen = cloth("f3dcb4", 0.005, 0.10, 0.03, 71)
    surfaces = [
        Surface("lamp foot", lathe(foot, 40), plain("3f6f78", 0.10, 0.03), 0.0055, gloss=0.05, roughness=0.1),
        Surface("lamp shade", lathe(shade, 48), linen, 0.0065, translucency=0.45, emission=tuple(1.55 * LAMP_COLOUR)),
    ]
    return [p.placed(position=SIDE_LAMP_AT) for p in surfaces]


def curtains() -> list[Surface]:
    """Linen drapes at door and window, on wooden rods."""
    linen = cloth("dccdae", 0.012, 0.06, 0.03, 81)
    surfaces = []

    def curtain(name, span, seed, to_room):
        mesh = drape(span, (0.015, 2.30), 4, seed, to_room)
        surfaces.append(Surface(name, mesh, linen, 0.0115, grain=(0, 1, 0), stretch=3.5, translucency=0.38, width=1.12))

    for a, b, seed in ((DOOR_X[0] - 0.36, DOOR_X[0] + 0.10, 1.0), (DOOR_X[1] - 0.08, DOOR_X[1] + 0.34, 2.0)):
        curtain("curtain", (a, b), seed, lambda u, y, d: (u, y, Z0 + CURTAIN_OFFSET + d))
    for a, b, seed in ((WINDOW_Z[0] - 0.34, WINDOW_Z[0] + 0.06, 3.0), (WINDOW_Z[1] - 0.06, WINDOW_Z[1] + 0.34, 4.0)):
        curtain("side curtain", (a, b), seed, lambda u, y, d: (ROOM_LOW[0] + CURTAIN_OFFSET + d, y, u))
    brown, left = plain("4a3220"), ROOM_LOW[0] + CURTAIN_OFFSET
    rod = tube(
        [(DOOR_X[0] - 0.42, 2.325, Z0 + CURTAIN_OFFSET), (DOOR_X[1] + 0.40, 2.325, Z0 + CURTAIN_OFFSET)], 0.013, 12
    )
    side_rod = tube([(left, 2.325, WINDOW_Z[0] - 0.4), (left, 2.325, WINDOW_Z[1] + 0.4)], 0.013, 12)
    surfaces.append(Surface("rod", rod, brown, 0.010, grain=(1, 0, 0), stretch=5.0))
    return [*surfaces, Surface("side rod", side_rod, brown, 0.010, grain=(0, 0, 1), stretch=5.0)]


def picture() -> list[Surface]:
    """Framed painting over the sideboard: evening over hills and a lake."""
    x0, x1, y0, y1, z = 0.62, 1.32, 1.04, 1.56, Z0 + 0.012
    bars = []
    for inset, w, depth in ((0.0, 0.036, 0.026), (0.036, 0.010, 0.016)):
        a, b, c, d = x0 + inset, x1 - inset, y0 + inset, y1 - inset
        bars += [box((a, c, Z0), (b, c + w, Z0 + depth)), box((a, d - w, Z0), (b, d, Z0 + depth))]
        bars += [box((a, c + w, Z0), (a + w, d - w, Z0 + depth)), box((b - w, c + w, Z0), (b, d - w, Z0 + depth))]
    canvas = quad((x0 + 0.045, y0 + 0.045, z), (x1 - x0 - 0.09, 0, 0), (0, y1 - y0 - 0.09, 0))

    def painting(p, n):
        u, v = (p[:, 0] - x0) / (x1 - x0), (p[:, 1] - y0) / (y1 - y0)
        q = np.stack([u * 3, v * 3, 0 * u], 1)
        stroke = fbm(q * (3, 9, 1), 4, 91)
        c = mix(srgb("e8a15c"), srgb("6f93b4"), smoothstep(0.52, 0.98, v + 0.05 * stroke))
        c = mix(c, srgb("f6d9a0"), 0.8 * smoothstep(0.10, 0.0, np.abs(v - 0.60 + 0.03 * stroke) - 0.03))
        c = np.where((np.hypot((u - 0.66) * 1.35, v - 0.66) < 0.055)[:, None], srgb("fdf0c4"), c)
        for k, (level, rough, tone) in enumerate(
            ((0.53, 0.10, "8a86a0"), (0.47, 0.08, "5f6d7c"), (0.41, 0.05, "3f5450"))
        ):
            ridge = level + rough * fbm(np.stack([u * (2.2 + k), 0 * u + k, 0 * u], 1), 4, 92 + k)
            c = np.where((v < ridge)[:, None], srgb(tone) * (1 + 0.25 * stroke)[:, None], c)
        lake = mix(srgb("d99a62"), srgb("4c6478"), smoothstep(0.34, 0.16, v + 0.06 * noise(q * (2, 22, 1), 96)))
        c = np.where((v < 0.355)[:, None], lake, c)
        bank = 0.15 + 0.10 * u + 0.06 * fbm(np.stack([u * 4, 0 * u, 0 * u], 1), 4, 97)
        c = np.where((v < bank)[:, None], mix(srgb("3d4a2a"), srgb("7d6a34"), smoothstep(-0.5, 0.6, stroke)), c)
        return c * (1 + 0.07 * noise(q * 40, 98))[:, None]

    return [
        Surface("frame", join(*bars), wood(WALNUT, axis=0, across=1, seed=99), 0.0075, gloss=0.03),
        Surface("canvas", canvas, painting, 0.0085, uniform=True),
    ]


def vase() -> list[Surface]:
    """White vase with eucalyptus, and a small stack of books, on the sideboard."""
    body = smooth_curve(
        [(0.0, 0.0), (0.038, 0.001), (0.050, 0.040), (0.055, 0.085), (0.040, 0.140), (0.020, 0.175), (0.023, 0.20)], 40
    )
    rng = np.random.default_rng(111)
    stems, leaves = [], []
    for k in range(7):
        a, lean = 0.9 * k + 0.2 * rng.normal(), 0.20 + 0.10 * (k % 3)
        t = np.linspace(0, 1, 10)[:, None]
        out = np.array([np.cos(a), 0.0, 0.6 * np.sin(a)])
        path = np.array([0, 0.17, 0]) + (0.22 + 0.03 * rng.normal()) * (t * (0, 1, 0) + lean * (t + t**2) * out)
        stems.append(tube(path, 0.0018, 10))
        for j in range(2, 10):
            for side in (-1, 1):
                yaw, tilt = np.degrees(a) + 80 * side + 25 * rng.normal(), 25 * rng.normal()
                disc = _disc(0.016 - 0.0008 * j).moved(
                    rotation_about("y", -yaw) @ rotation_about("z", 20) @ rotation_about("x", tilt), path[j]
                )
                leaves.append(disc)
    surfaces = [
        Surface("vase", lathe(body, 40), plain("ece8de", 0.02), 0.0055, gloss=0.04, roughness=0.15),
        Surface("twigs", join(*stems), plain("6a5a40", 0.1), 0.0070),
        Surface("eucalyptus", join(*leaves), plain("7f9a86", 0.14, 0.03), 0.0075, translucency=0.3),
    ]
    surfaces = [p.placed(position=(0.60, 0.80, Z0 + 0.20)) for p in surfaces]
    for k, (w, h, d, colour) in enumerate(
        ((0.21, 0.030, 0.15, "8a5a3a"), (0.19, 0.024, 0.14, "4f6a5a"), (0.17, 0.020, 0.12, "c9b48a"))
    ):
        low = 0.80 + (0.0, 0.030, 0.054)[k]
        book = box((-w / 2, 0, -d / 2), (w / 2, h, d / 2))
        surfaces.append(
            Surface("shelf book", book, cloth(colour, 0.01, 0.05), 0.0075).placed(
                rotation_about("y", 8 - 11 * k), (1.02, low, Z0 + 0.2)
            )
        )
    return surfaces


def _disc(radius: float):
    """Round leaf in the x-z plane, its stalk at the origin."""
    u, v = np.linspace(0.05, 1, 4)[:, None], np.linspace(0, 2 * np.pi, 11)[None]
    x = radius * (1 + u * np.cos(v))
    return grid_mesh(np.stack(np.broadcast_arrays(x, 0.15 * x**2 / radius, radius * u * np.sin(v)), -1))
