"""Tableware, fruit, books and a plant on the table, with the solids that represent them in collisions."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from studio.dining_room.furniture import TABLE_TOP
from studio.shapes import (
    Mesh,
    Surface,
    beveled_box,
    box,
    grid_mesh,
    join,
    lathe,
    rotation_about,
    smooth_curve,
    superellipsoid,
    tube,
)
from studio.solids import Solid, cuboid, placed, revolved, sphere
from studio.textures import cloth, fbm, mix, noise, plain, smoothstep, speckled, srgb

Models = tuple[list[Surface], list[Solid]]


def tableware() -> Models:
    """Surfaces and solids of all objects on the table, in the world frame."""
    models = [
        _place_on_table(fruit_bowl(), 0, (0.52, -0.12), 10),
        _place_on_table(mug(), 150, (-0.455, 0.12), 11),
        _place_on_table(breakfast(), 0, (-0.61, -0.04), 12),
        _place_on_table(books(), 14, (0.63, 0.24), 13),
        _place_on_table(plant(), 0, (-0.46, -0.29), 14),
        _place_on_table(candle(), 0, (0.27, -0.34), 15),
    ]
    return [p for surfaces, _ in models for p in surfaces], [s for _, solids in models for s in solids]


def fruit_bowl() -> Models:
    """Turquoise stoneware bowl with apples, oranges, lemons, a pear and bananas."""
    outside = smooth_curve(
        [(0.0, 0.0), (0.052, 0.0), (0.056, 0.006), (0.098, 0.032), (0.132, 0.078), (0.140, 0.084)], 40
    )
    inside = smooth_curve([(0.137, 0.086), (0.126, 0.076), (0.092, 0.038), (0.050, 0.014), (0.0, 0.011)], 36)
    glaze = speckled("3f8f95", "2b5f66", 0.15, 0.004, 101)
    surfaces = [
        Surface("bowl", lathe(np.concatenate([outside, inside]), 72), glaze, 0.0048, gloss=0.05, roughness=0.10)
    ]
    solids = [revolved([*outside[::3], (0.110, 0.084), (0.0, 0.092)])]
    fruit = [
        (apple("c22f24", "e9b44a", 1), (0.058, 0.075, 0.040), (20, 30), 0.037),
        (orange(2), (-0.048, 0.078, 0.052), (0, 0), 0.039),
        (apple("8fb23a", "c9cf5e", 3), (-0.060, 0.076, -0.040), (-25, 160), 0.036),
        (orange(4), (0.030, 0.080, -0.060), (60, 40), 0.038),
        (lemon(5), (0.000, 0.118, 0.022), (8, 35), 0.028),
        (apple("a5231f", "d8803a", 6), (0.012, 0.074, 0.088), (35, 200), 0.034),
        (lemon(7), (0.082, 0.090, -0.018), (-10, 110), 0.026),
    ]
    for shapes, at, (tilt, yaw), radius in fruit:
        r = rotation_about("y", yaw) @ rotation_about("x", tilt)
        surfaces += [p.placed(r, at) for p in shapes]
        solids.append(sphere(at, radius))
    for k in range(3):
        r, at = rotation_about("y", 52 + 7 * k), (-0.052 + 0.022 * k, 0.096 + 0.004 * k, -0.052 + 0.016 * k)
        surfaces += [p.placed(r, at) for p in banana(k)]
    solids += [sphere((-0.03 + t, 0.122 - 9 * t * t, -0.05 - 0.9 * t), 0.024) for t in (-0.05, 0.0, 0.05)]
    return surfaces, solids


def apple(red: str, yellow: str, seed: int) -> list[Surface]:
    """Apple with streaks, dimple and stalk."""
    a = np.linspace(-np.pi / 2, np.pi / 2, 40)
    r = 0.038 * np.cos(a) * (1 + 0.06 * np.sin(a))
    y = 0.033 * np.sin(a) - 0.012 * np.exp(-((r / 0.010) ** 2)) * np.sign(np.sin(a))

    def colour_at(p, n):
        angle = np.arctan2(p[:, 2], p[:, 0])
        streak = noise(np.stack([3.5 * np.cos(angle) * 3, 3.5 * np.sin(angle) * 3, p[:, 1] * 18], 1), seed)
        side = 0.35 * np.cos(angle + seed) + 0.5 * noise(p * 28, seed + 1)
        c = mix(srgb(red), srgb(yellow), smoothstep(0.10, 0.75, side + 0.55 * streak))
        c = mix(c, srgb("8a7a3a"), 0.8 * smoothstep(0.008, 0.003, np.hypot(p[:, 0], p[:, 2])))
        return c * (1 + 0.25 * (noise(p * 420, seed + 2) > 0.42))[:, None]

    stalk = tube([(0, 0.018, 0), (0.001, 0.030, 0.001), (0.005, 0.040, 0.003)], 0.0013, 10)
    body = Surface("apple", lathe(np.stack([r, y], 1), 44), colour_at, 0.0040, gloss=0.05, roughness=0.16)
    return [body, Surface("stalk", stalk, plain("4a3420"), 0.003)]


def orange(seed: int) -> list[Surface]:
    """Orange with a pored skin."""

    def colour_at(p, n):
        pores = smoothstep(0.15, 0.5, noise(p * 520, seed))
        c = srgb("f0861c") * (1 - 0.20 * pores + 0.12 * noise(p * 40, seed + 1))[:, None]
        return mix(c, srgb("5f6a2a"), smoothstep(0.005, 0.003, np.hypot(p[:, 0], p[:, 2])) * (p[:, 1] > 0))

    return [
        Surface("orange", superellipsoid((0.078, 0.074, 0.078), 1.0, 28), colour_at, 0.0040, gloss=0.04, roughness=0.22)
    ]


def lemon(seed: int) -> list[Surface]:
    """Lemon, its long axis along x."""
    curve = smooth_curve([(0, -0.042), (0.006, -0.040), (0.011, -0.034), (0.024, -0.018), (0.027, 0.0), (0.023, 0.019),
                    (0.010, 0.034), (0.006, 0.041), (0, 0.044)], 40)  # fmt: skip

    def colour_at(p, n):
        return (
            srgb("f2cf2e")
            * (1 - 0.14 * smoothstep(0.1, 0.5, noise(p * 420, seed)) + 0.10 * noise(p * 50, seed + 1))[:, None]
        )

    mesh = lathe(curve, 36).moved(rotation_about("z", 90))
    return [Surface("lemon", mesh, colour_at, 0.0038, gloss=0.04, roughness=0.2)]


def banana(seed: int) -> list[Surface]:
    """Banana bent in the x-y plane, its ends up."""
    t = np.linspace(-1, 1, 22)
    path = np.stack([0.085 * np.sin(0.95 * t) / np.sin(0.95), 0.052 * (1 - np.cos(0.95 * t)), 0 * t], 1)
    radius = 0.0165 * (1 - np.abs(t) ** 5 * 0.72) * (1 - 0.1 * t)

    def colour_at(p, n):
        end = smoothstep(0.078, 0.086, np.abs(p[:, 0]))
        spots = smoothstep(0.42, 0.60, noise(p * (120, 240, 240), 130 + seed))
        c = srgb("f0c52f") * (1 + 0.12 * noise(p * (12, 60, 60), 131))[:, None]
        c = mix(c, srgb("7a5522"), 0.5 * spots.clip(0, 1))
        return mix(c, srgb("4c4420"), end)

    return [Surface("banana", tube(path, radius, 14), colour_at, 0.0042, gloss=0.03, roughness=0.25)]


def mug() -> Models:
    """Cream mug with a blue rim, half full of coffee."""
    outside = smooth_curve(
        [(0.0, 0.0), (0.034, 0.0), (0.0385, 0.004), (0.041, 0.030), (0.041, 0.090), (0.0405, 0.094)], 40
    )
    inside = smooth_curve([(0.0375, 0.0945), (0.0365, 0.090), (0.0363, 0.070)], 12)
    handle_path = [
        (0.039, 0.075, 0),
        (0.058, 0.078, 0),
        (0.070, 0.062, 0),
        (0.068, 0.040, 0),
        (0.054, 0.026, 0),
        (0.040, 0.024, 0),
    ]
    handle = tube(smooth_curve(handle_path, 28), 0.0058, 12, flat=1.0, up=(0, 0, 1))
    glaze = plain("ece0c6", 0.03, 0.05, 141)

    def colour_at(p, n):
        return mix(glaze(p, n), srgb("2f5f8a") * 1.0, smoothstep(0.0725, 0.0745, p[:, 1] + 0.0012 * noise(p * 90, 142)))

    coffee = lathe([(0.0368, 0.072), (0.0, 0.072)], 40)
    surfaces = [
        Surface("mug", lathe(np.concatenate([outside, inside]), 56), colour_at, 0.0037, gloss=0.05, roughness=0.10),
        Surface("handle", handle, colour_at, 0.0037, gloss=0.05, roughness=0.10),
        Surface("coffee", coffee, plain((0.030, 0.013, 0.006), 0.05), 0.0042, gloss=0.04, roughness=0.05),
    ]
    return surfaces, [
        revolved([*outside[::3], (0.0, 0.094)]),
        placed(cuboid((0.036, 0.020, -0.006), (0.075, 0.082, 0.006))),
    ]


def breakfast() -> Models:
    """Plate with two croissants on a folded napkin's edge."""
    under = smooth_curve([(0.0, 0.0), (0.062, 0.0), (0.066, 0.004), (0.092, 0.010), (0.122, 0.019)], 28)
    over = smooth_curve([(0.1235, 0.0205), (0.118, 0.0215), (0.090, 0.0145), (0.070, 0.0075), (0.0, 0.0068)], 30)
    glaze = plain("f0ebe0", 0.03, 0.04, 151)

    def colour_at(p, n):
        r = np.hypot(p[:, 0], p[:, 2])
        ring = smoothstep(0.1130, 0.1145, r)
        return mix(glaze(p, n), srgb("2f5f8a"), 0.9 * ring)

    surfaces = [
        Surface("plate", lathe(np.concatenate([under, over]), 72), colour_at, 0.0046, gloss=0.05, roughness=0.10)
    ]
    solids = [revolved([*under[::3], (0.118, 0.0215), (0.0, 0.0215)])]
    for yaw, x, z in ((25, 0.005, 0.030), (-160, -0.005, -0.038)):
        surfaces.append(croissant(yaw).placed(rotation_about("y", yaw), (x, 0.026, z)))
        solids += [
            placed(sphere((0.030 * s, 0.022, 0.0), 0.023), rotation_about("y", yaw), (x, 0.0, z)) for s in (-1, 0, 1)
        ]
    napkin = beveled_box((0.13, 0.004, 0.21), 0.0012).moved(rotation_about("y", 78), (0.0, 0.002, 0.205))
    surfaces.append(Surface("napkin", napkin, cloth("c8553a", 0.0035, 0.2, 0.05, 155), 0.0052))
    return surfaces, solids


def croissant(seed: int) -> Surface:
    """Crescent with rolled ridges, browned on top."""
    t = np.linspace(-1, 1, 60)
    angle = 1.25 * t
    path = np.stack([0.052 * np.sin(angle), 0 * t, 0.040 * (1 - np.cos(angle)) - 0.012], 1)
    ridge = 1 - 0.16 * np.abs(np.sin(3.5 * np.pi * t)) ** 0.6
    radius = 0.024 * np.sqrt(np.clip(1 - np.abs(t) ** 2.2, 0.02, 1)) * ridge

    def colour_at(p, n):
        brown = 0.5 + 0.35 * n[:, 1] + 0.5 * noise(p * 70, seed % 50) + 0.35 * noise(p * 300, 161)
        return mix(srgb("e2ad63"), srgb("9a5420"), smoothstep(0.0, 1.0, brown))

    return Surface("croissant", tube(path, radius, 18, flat=0.85), colour_at, 0.0040, gloss=0.035, roughness=0.3)


def books() -> Models:
    """Two cloth-bound books, the upper one turned."""
    surfaces, solids = [], []
    stack = (((0.24, 0.030, 0.17), "7a2f2a", 0.0, 0), ((0.205, 0.024, 0.145), "27486a", 0.030, 11))
    for (w, h, d), colour, y, yaw in stack:
        r, at = rotation_about("y", yaw), (0.0, y, 0.0)
        covers = join(
            box((-w / 2, 0.0, -d / 2), (w / 2, 0.003, d / 2)),
            box((-w / 2, h - 0.003, -d / 2), (w / 2, h, d / 2)),
            box((-w / 2, 0.003, d / 2 - 0.003), (w / 2, h - 0.003, d / 2)),
        )
        pages = box((-w / 2 + 0.005, 0.003, -d / 2 + 0.005), (w / 2 - 0.005, h - 0.003, d / 2 - 0.003))
        linen = cloth(colour, 0.0025, 0.16, 0.06, 171)

        def bound(p, n, w=w, d=d, h=h, linen=linen):
            u, v = np.abs(p[:, 0]), np.abs(p[:, 2])
            line = (np.abs(np.minimum(w / 2 - u, d / 2 - v) - 0.014) < 0.0014) & (n[:, 1] > 0.5)
            title = (u < 0.052) & (np.abs(p[:, 2] + 0.022) < 0.007) & (np.sin(p[:, 0] * 520) > -0.4) & (n[:, 1] > 0.5)
            yawe = (np.abs(p[:, 1] - h / 2) < 0.0045) & (u < 0.060) & (np.sin(p[:, 0] * 600) > -0.3) & (n[:, 2] > 0.5)
            return mix(linen(p, n), srgb("c9a04e"), 0.9 * (line | title | yawe))

        def paper(p, n):
            return srgb("ead9b4") * (0.90 + 0.14 * noise(p * (6, 1500, 6), 173))[:, None]

        surfaces.append(Surface("book", covers, bound, 0.0062).placed(r, at))
        surfaces.append(Surface("pages", pages, paper, 0.0050, grain=(1, 0, 0), stretch=3.0).placed(r, at))
        solids.append(
            placed(cuboid((-w / 2, -y, -d / 2), (w / 2, h, d / 2)), r, at)
        )  # extends down to the table: no seam
    return surfaces, solids


def plant() -> Models:
    """Herb in a terracotta pot."""
    outside = smooth_curve([(0.0, 0.0), (0.040, 0.0), (0.043, 0.003), (0.054, 0.072)], 20)
    rim = [(0.060, 0.0725), (0.061, 0.0925)]
    inside = [(0.055, 0.0935), (0.053, 0.080)]
    clay = plain("b5653c", 0.10, 0.03, 181)
    pot = Surface("pot", lathe(np.concatenate([outside, rim, inside]), 56), clay, 0.0046, gloss=0.01)
    soil = Surface("soil", lathe([(0.0545, 0.082), (0.0, 0.086)], 32), plain((0.035, 0.022, 0.014), 0.5, 0.006), 0.0060)
    rng = np.random.default_rng(182)
    leaves, stems = [], []
    for k in range(15):
        a, lean = 2.4 * k + 0.3 * rng.normal(), 0.15 + 0.55 * (k / 15) + 0.06 * rng.normal()
        height = 0.15 - 0.05 * (k / 15) + 0.015 * rng.normal()
        s = np.linspace(0, 1, 9)[:, None]
        out = np.array([np.cos(a), 0, np.sin(a)])
        path = np.array([0, 0.082, 0]) + 0.018 * out + s * height * np.cos(lean) * np.array([0, 1, 0])
        path = path + (0.35 * s + 0.65 * s**2) * height * np.sin(lean) * out
        stems.append(tube(path, 0.0016, 10))
        for j in (3, 4, 5, 6, 7, 8):
            for side in (-1, 1) if j < 8 else (0, 1):
                yaw = a + (side * 1.25 if j < 8 else 0.9 * side) + 0.35 * rng.normal()
                size = (0.020 + 0.014 * np.sin(np.pi * (j - 2) / 7)) * (1 + 0.15 * rng.normal())
                leaves.append(
                    _leaf(size, 0.30 + 0.25 * rng.normal()).moved(rotation_about("y", -np.degrees(yaw)), path[j])
                )

    def green(p, n):
        young = smoothstep(0.10, 0.24, p[:, 1])
        c = mix(srgb("3d6a2c"), srgb("86a848"), 0.75 * young + 0.25 * fbm(p * 45, 2, 183))
        return c * (1 + 0.15 * noise(p * 260, 184))[:, None]

    surfaces = [pot, soil, Surface("stems", join(*stems), plain("5f7a38", 0.1), 0.0070)]
    surfaces.append(Surface("leaves", join(*leaves), green, 0.0052, translucency=0.35))
    return surfaces, [revolved([*outside[::3], *rim, (0.0, 0.0935)])]


def candle() -> Models:
    """Beeswax candle in a brass holder."""
    foot = [(0.0, 0.0), (0.045, 0.0), (0.047, 0.004), (0.030, 0.010), (0.012, 0.018), (0.010, 0.034)]
    foot = smooth_curve([*foot, (0.020, 0.042), (0.021, 0.050)], 44)
    holder = lathe([*foot, (0.0, 0.050)], 40)
    wax = lathe([(0.0115, 0.050), (0.0112, 0.170), (0.0095, 0.1745), (0.0, 0.172)], 28)
    wick = tube([(0, 0.170, 0), (0.0005, 0.178, 0), (0.003, 0.184, 0)], 0.0011, 10)
    surfaces = [
        Surface("holder", holder, plain("9a7430", 0.04), 0.0040, gloss=0.30, roughness=0.2),
        Surface("candle", wax, plain("ecdcb0", 0.04), 0.0042, gloss=0.03),
        Surface("wick", wick, plain((0.02, 0.02, 0.02)), 0.0028),
    ]
    return surfaces, [revolved([*foot[::3], (0.0115, 0.050), (0.0112, 0.170), (0.0, 0.1745)])]


def _leaf(length: float, droop: float) -> Mesh:
    """Pointed leaf along x, folded along its rib."""
    u = np.linspace(0, 1, 7)[:, None]
    v = np.linspace(-1, 1, 5)[None]
    width = 0.36 * length * np.sin(np.pi * u**0.8)
    y = -droop * length * u**2 + 0.25 * length * u + 0.35 * width * np.abs(v)
    return grid_mesh(np.stack(np.broadcast_arrays(length * u, y, width * v), -1)[:, ::-1])


def _place_on_table(models: Models, yaw: float, at: tuple[float, float], object_id: int) -> Models:
    """Models on the table top at (x, z), turned by `yaw` degrees."""
    r, position = rotation_about("y", yaw), (at[0], TABLE_TOP, at[1])
    surfaces = [replace(p, object_id=object_id).placed(r, position) for p in models[0]]
    return surfaces, [placed(s, r, position) for s in models[1]]
