"""Decoration of the study: carpet, globe, armchair with a floor lamp, pictures, a map, the plant on the sill."""

from __future__ import annotations

import numpy as np

from studio.doors import casing, panelled_leaf
from studio.light_sources import Lamp
from studio.shapes import (
    Surface,
    beveled_box,
    box,
    grid_mesh,
    join,
    lathe,
    quad,
    rotation_about,
    smooth_curve,
    superellipsoid,
    tube,
)
from studio.study.study_shell import CASING, DOOR, WINDOW_Y, X0, X1, Z0, Z1, boards
from studio.textures import WALNUT, cloth, fbm, mix, noise, plain, smoothstep, srgb, wood

FLOOR_LAMP_AT = (1.52, 0.0, -0.95)  # [m]
GLOBE_AT = (-1.42, 0.0, -1.20)  # [m]
LAMP_COLOUR = np.array([1.0, 0.72, 0.42])  # linear RGB


def study_decor() -> list[Surface]:
    """All decoration."""
    return [carpet(), *globe(), *armchair(), *floor_lamp(), *pictures(), *world_map(), *door(), *sill_plant()]


def decor_lamps() -> list[Lamp]:
    """The bulb of the floor lamp."""
    x, y, z = FLOOR_LAMP_AT
    return [Lamp(np.array([x, y + 1.52, z]), 0.03, 1.6 * LAMP_COLOUR)]


def carpet() -> Surface:
    """Persian carpet: a medallion, corners, and a border of rosettes."""
    half = np.array([1.25, 0.95])
    mesh = beveled_box((2 * half[0], 0.012, 2 * half[1]), 0.004).moved(translation=(0, 0.006, 0.15))
    weave = cloth((1.0, 1.0, 1.0), 0.014, 0.10, 0.05, 61)
    red, blue, cream, gold = srgb("8e2f28"), srgb("2a3a5c"), srgb("dccfae"), srgb("b98a46")

    def colour_at(p, n):
        x, z = np.abs(p[:, 0]), np.abs(p[:, 2] - 0.15)
        edge = np.minimum(half[0] - x, half[1] - z)
        vine = np.sin(38 * x + 2 * np.sin(17 * z)) * np.sin(38 * z + 2 * np.sin(17 * x))
        c = mix(red, gold, 0.8 * smoothstep(0.72, 0.86, np.abs(vine)))
        r = np.hypot(x / 0.62, z / 0.46)
        wave = r + 0.05 * np.cos(16 * np.arctan2(z / 0.46, x / 0.62))
        c = np.where((wave < 1.0)[:, None], mix(blue, cream, 0.9 * smoothstep(0.75, 0.9, np.abs(vine))), c)
        c = np.where(((wave < 1.0) & (wave > 0.94) | (wave < 0.52) & (wave > 0.47))[:, None], cream, c)
        c = np.where((wave < 0.47)[:, None], mix(red, gold, smoothstep(0.6, 0.8, np.abs(vine))), c)
        corner = np.hypot((x - half[0] + 0.24) / 0.40, (z - half[1] + 0.24) / 0.40)
        c = np.where(((corner < 1.0) & (edge > 0.24))[:, None], mix(blue, gold, smoothstep(0.7, 0.85, np.abs(vine))), c)
        u = np.where(half[0] - x < half[1] - z, z, x)
        petal = np.hypot((u / 0.16) % 1 - 0.5, (edge - 0.14) / 0.16)
        border = mix(blue, red, smoothstep(0.34, 0.28, petal))
        border = mix(border, cream, smoothstep(0.15, 0.11, petal))
        c = np.where((edge < 0.23)[:, None], border, c)
        line = (np.abs(edge - 0.225) < 0.010) | (np.abs(edge - 0.055) < 0.010)
        c = np.where(line[:, None], gold, c)
        c = np.where((edge < 0.03)[:, None], cream, c)
        return c * weave(p, n)

    return Surface("carpet", mesh, colour_at, 0.0145, grain=(0, 0, 1), stretch=1.5)


def globe() -> list[Surface]:
    """Terrestrial globe on a three-legged stand, by the window."""
    r, y = 0.225, 0.86

    def earth(p, n):
        d = p / np.linalg.norm(p, axis=1, keepdims=True)
        land = fbm(d * 1.9 + 3.1, 5, 201) + 0.10 * np.cos(3 * np.arctan2(d[:, 2], d[:, 0]))
        sea = mix(srgb("a9bfa8"), srgb("6f9aa5"), smoothstep(0.15, -0.35, land))
        ground = mix(srgb("d2b478"), srgb("a98a4f"), smoothstep(0.10, 0.40, land))
        c = mix(sea, ground, smoothstep(0.03, 0.06, land))
        c = mix(c, srgb("e9e2cc"), smoothstep(0.86, 0.93, np.abs(d[:, 1])))
        latitude, longitude = np.arcsin(d[:, 1]) / np.pi * 12, np.arctan2(d[:, 2], d[:, 0]) / np.pi * 12
        grid = np.minimum(np.abs(latitude - np.round(latitude)), np.abs(longitude - np.round(longitude)))
        return c * (1 - 0.25 * smoothstep(0.06, 0.03, grid))[:, None]

    tilt = rotation_about("z", -23)
    a = np.linspace(0, 2 * np.pi, 60)
    meridian = tube(np.stack([0.247 * np.cos(a), 0.247 * np.sin(a), 0 * a], 1), 0.008, 8, up=(0, 0, 1)).moved(tilt)
    horizon = lathe([(0.262, -0.010), (0.318, -0.010), (0.318, 0.010), (0.262, 0.010), (0.262, -0.010)], 56)
    legs = []
    for t in np.radians((90, 210, 330)):
        c, s = np.cos(t), np.sin(t)
        legs.append(
            tube(
                smooth_curve(
                    [
                        (0.29 * c, 0.85, 0.29 * s),
                        (0.22 * c, 0.58, 0.22 * s),
                        (0.14 * c, 0.36, 0.14 * s),
                        (0.24 * c, 0.04, 0.24 * s),
                        (0.27 * c, 0.012, 0.27 * s),
                    ],
                    24,
                ),
                0.018,
                10,
            )
        )
    hub = lathe([(0.0, 0.31), (0.15, 0.32), (0.15, 0.345), (0.0, 0.35)], 32)
    axis = tube([(0, -0.26, 0), (0, 0.26, 0)], 0.006, 8).moved(tilt)
    timber = wood(WALNUT, axis=1, across=0, seed=211)
    at = np.array(GLOBE_AT)
    return [
        Surface("earth", superellipsoid((2 * r,) * 3, 1.0, 36), earth, 0.0090, gloss=0.04, roughness=0.15).placed(
            tilt, at + (0, y, 0)
        ),
        Surface("meridian", join(meridian, axis), plain("b08a3c", 0.04), 0.008, gloss=0.28).placed(
            None, at + (0, y, 0)
        ),
        Surface("horizon", horizon, timber, 0.011, gloss=0.04).placed(None, at + (0, y, 0)),
        Surface("globe stand", join(*legs, hub), timber, 0.012, gloss=0.04).placed(None, at),
    ]


def armchair() -> list[Surface]:
    """Wing chair of worn leather in the corner under the floor lamp."""
    leather = plain("7c4526", 0.16, 0.10, 5)
    parts = [
        superellipsoid((0.62, 0.26, 0.62), 0.35, 22).moved(translation=(0, 0.32, 0.02)),
        superellipsoid((0.56, 0.14, 0.58), 0.35, 22).moved(translation=(0, 0.47, 0.05)),
        superellipsoid((0.66, 0.80, 0.20), 0.4, 24).moved(rotation_about("x", -10), (0, 0.78, -0.28)),
        *(superellipsoid((0.16, 0.40, 0.66), 0.4, 22).moved(translation=(s * 0.36, 0.44, 0.0)) for s in (-1, 1)),
        *(superellipsoid((0.10, 0.46, 0.24), 0.5, 20).moved(translation=(s * 0.34, 0.90, -0.20)) for s in (-1, 1)),
    ]
    feet = [
        tube([(0.27 * sx, 0, 0.25 * sz), (0.27 * sx, 0.2, 0.25 * sz)], [0.018, 0.028], 10)
        for sx in (-1, 1)
        for sz in (-1, 1)
    ]
    cushion = superellipsoid((0.36, 0.34, 0.13), 0.6, 20).moved(rotation_about("x", -16), (0.02, 0.70, -0.13))
    r, at = rotation_about("y", -48), (1.32, 0.0, -0.42)
    return [
        Surface("armchair", join(*parts), leather, 0.018, gloss=0.04, roughness=0.3).placed(r, at),
        Surface("armchair feet", join(*feet), plain("3a2416", 0.1), 0.014).placed(r, at),
        Surface("cushion", cushion, cloth("a33b2f", 0.010, 0.12, 0.05, 9), 0.013).placed(r, at),
    ]


def floor_lamp() -> list[Surface]:
    """Floor lamp: brass stand, luminous pleated shade."""
    stand = lathe(
        smooth_curve([(0.0, 0.0), (0.14, 0.001), (0.142, 0.014), (0.05, 0.035), (0.014, 0.06), (0.011, 1.40)], 50), 28
    )
    v, a = np.linspace(0, 1, 10)[None], np.linspace(0, 2 * np.pi, 97)[:-1, None]
    radius = (0.20 - 0.09 * v) * (1 + 0.02 * np.cos(32 * a))
    points = np.broadcast_arrays(radius * np.cos(a), 1.38 + 0.26 * v, -radius * np.sin(a))
    shade = grid_mesh(np.stack(points, -1), close_u=True)
    return [
        Surface("lamp stand", stand, plain("9a7430", 0.05), 0.011, gloss=0.25).placed(None, FLOOR_LAMP_AT),
        Surface(
            "lamp pleats",
            shade,
            cloth("f3d9a8", 0.008, 0.06, 0.03, 71),
            0.013,
            translucency=0.5,
            emission=(1.5, 0.98, 0.50),
        ).placed(None, FLOOR_LAMP_AT),
    ]


def framed(name: str, width: float, height: float, painting, rotation, position, bar: float = 0.045) -> list[Surface]:
    """A picture in a gilded frame; `painting(u, v)` colours it, u and v from 0 to 1. It hangs in x-y and faces +z."""
    w, h = width / 2, height / 2
    bars = join(
        box((-w - bar, -h - bar, 0), (w + bar, -h, 0.03)),
        box((-w - bar, h, 0), (w + bar, h + bar, 0.03)),
        box((-w - bar, -h, 0), (-w, h, 0.03)),
        box((w, -h, 0), (w + bar, h, 0.03)),
    )
    canvas = quad((-w, -h, 0.012), (width, 0, 0), (0, height, 0))

    def colour_at(p, n):
        return painting((p[:, 0] + w) / width, (p[:, 1] + h) / height)

    return [
        Surface(f"{name} frame", bars, plain("a8843f", 0.18, 0.02), 0.011, gloss=0.12).placed(rotation, position),
        Surface(name, canvas, colour_at, 0.0115).placed(rotation, position),
    ]


def pictures() -> list[Surface]:
    """A ship at sea over the globe, two botanical prints at the left wall's end, a portrait by the door."""

    def ship(u, v):
        q = np.stack([3 * u, 3 * v, 0 * u], 1)
        stroke = fbm(q * (3, 6, 1), 4, 301)
        c = mix(srgb("d9c09a"), srgb("7f95a0"), smoothstep(0.45, 0.95, v + 0.08 * stroke))
        sea = mix(srgb("3f5c62"), srgb("7f9a94"), smoothstep(-0.3, 0.5, noise(q * (3, 26, 1), 303) + 0.3 * stroke))
        c = np.where((v < 0.36 + 0.02 * stroke)[:, None], sea, c)
        hull = (np.abs(u - 0.5) < 0.17 - 0.5 * (0.42 - v)) & (v > 0.33) & (v < 0.40)
        c = np.where(hull[:, None], srgb("3a241a"), c)
        for x, w, top in ((0.42, 0.075, 0.80), (0.56, 0.085, 0.86), (0.66, 0.05, 0.70)):
            sail = (
                (np.abs(u - x - 0.03 * np.sin(6 * v)) < w * (1 - 0.55 * (v - 0.42) / (top - 0.42)))
                & (v > 0.43)
                & (v < top)
            )
            c = np.where(
                sail[:, None], mix(srgb("f0e3c4"), srgb("c4ab84"), smoothstep(-0.1, 0.25, u - x + 0.2 * stroke)), c
            )
        return c * (1 + 0.06 * noise(q * 40, 305))[:, None]

    def leaf(seed):
        def painting(u, v):
            c = (
                np.broadcast_to(srgb("e9dfc6"), (len(u), 3))
                * (1 + 0.03 * noise(np.stack([u * 9, v * 9, 0 * u], 1), seed))[:, None]
            )
            stem = (np.abs(u - 0.5 - 0.06 * np.sin(4 * v + seed)) < 0.010) & (v > 0.12) & (v < 0.84)
            c = np.where(stem[:, None], srgb("5d6b3a"), c)
            for k in range(8):
                side, base = (-1) ** k, 0.22 + 0.075 * k
                x, y = (u - 0.5 - 0.06 * np.sin(4 * base + seed)) * side, (v - base)
                s, t = 0.85 * x + 0.5 * y, -0.5 * x + 0.85 * y
                blade = (s > 0) & (s < 0.26) & (np.abs(t) < 0.045 * np.sin(np.pi * np.clip(s / 0.26, 0, 1)))
                c = np.where(
                    blade[:, None], mix(srgb("6f8a45"), srgb("3f5c30"), np.clip(4 * np.abs(t) / 0.05 - 1, 0, 1)), c
                )
            bloom = np.hypot(u - 0.5 - 0.06 * np.sin(4 * 0.86 + seed), (v - 0.86) * 1.3) < 0.075
            return np.where(bloom[:, None], srgb(("b8483c", "7a5a9a")[seed % 2]), c)

        return painting

    def portrait(u, v):
        q = np.stack([4 * u, 4 * v, 0 * u], 1)
        c = mix(
            srgb("3a2c20"),
            srgb("6a4e34"),
            smoothstep(-0.4, 0.6, fbm(q, 4, 311) + 0.6 * (0.6 - np.hypot(u - 0.4, v - 0.6))),
        )
        coat = v < 0.42 - 0.9 * (u - 0.5) ** 2 - 0.15 * np.abs(u - 0.5)
        c = np.where(coat[:, None], srgb("232a36") * (1 + 0.3 * fbm(q * 2, 3, 313))[:, None], c)
        collar = (np.abs(u - 0.5) < 0.10 * (0.46 - v) / 0.14) & (v < 0.46) & (v > 0.30)
        c = np.where(collar[:, None], srgb("e6dcc8"), c)
        head = np.hypot((u - 0.5) / 0.145, (v - 0.60) / 0.175)
        skin = mix(srgb("d8a780"), srgb("8f5c40"), smoothstep(-0.1, 0.15, u - 0.5))
        c = np.where((head < 1)[:, None], skin, c)
        across = np.abs(u - 0.5)
        eyes = np.hypot((across - 0.058) / 0.024, (v - 0.615) / 0.014) < 1
        brows = np.hypot((across - 0.060) / 0.036, (v - 0.648) / 0.009) < 1
        nose = np.hypot((u - 0.515) / 0.018, (v - 0.572) / 0.034) < 1
        mouth = np.hypot((u - 0.5) / 0.046, (v - 0.508) / 0.010) < 1
        for part, tone in ((eyes, "2a1c16"), (brows, "5a4636"), (nose, "a06a4a"), (mouth, "8a4038")):
            c = np.where(part[:, None], srgb(tone), c)
        hair = (np.hypot((u - 0.5) / 0.165, (v - 0.66) / 0.165) < 1) & (v > 0.67 - 0.8 * np.abs(u - 0.5) ** 1.2)
        return np.where(hair[:, None], srgb("6a5a4a"), c)

    left, right = rotation_about("y", 90), rotation_about("y", -90)
    return [
        *framed("ship", 0.60, 0.44, ship, None, (-1.46, 1.62, Z0 + 0.004)),
        *framed("print", 0.30, 0.42, leaf(1), left, (X0 + 0.004, 1.60, 1.26), 0.025),
        *framed("print", 0.30, 0.42, leaf(2), left, (X0 + 0.004, 1.60, 1.72), 0.025),
        *framed("portrait", 0.46, 0.60, portrait, right, (X1 - 0.004, 1.66, -0.62)),
    ]


def world_map() -> list[Surface]:
    """Old map of two hemispheres on the right wall."""

    def painting(u, v):
        c = (
            np.broadcast_to(srgb("dcc89a"), (len(u), 3))
            * (1 + 0.10 * fbm(np.stack([u * 6, v * 4, 0 * u], 1), 4, 321))[:, None]
        )
        for k, cx in enumerate((0.27, 0.73)):
            x, y = (u - cx) / 0.215, (v - 0.5) / 0.40
            r = np.hypot(x, y)
            z = np.sqrt(np.clip(1 - r * r, 0, 1))
            d = np.stack([x, y, z], 1) if k == 0 else np.stack([-x, y, -z], 1)
            land = fbm(d * 1.9 + 3.1, 5, 201)
            grid = np.minimum(
                np.abs((y * 5) % 1 - 0.5),
                np.abs((x / np.maximum(np.sqrt(np.clip(1 - y * y, 0.02, 1)), 0.1) * 5) % 1 - 0.5),
            )
            globe_ = mix(srgb("b9c2a4"), srgb("b98f55"), smoothstep(0.02, 0.06, land))
            globe_ = (
                globe_
                * (1 - 0.2 * smoothstep(0.06, 0.02, grid))[:, None]
                * (1 - 0.25 * smoothstep(0.03, 0.0, np.abs(land - 0.04)))[:, None]
            )
            c = np.where((r < 1)[:, None], globe_, c)
            c = np.where((np.abs(r - 1.02) < 0.022)[:, None], srgb("5c4326"), c)
        edge = np.minimum(np.minimum(u, 1 - u) * 1.6, np.minimum(v, 1 - v))
        return np.where((np.abs(edge - 0.03) < 0.006)[:, None], srgb("6b4a2a"), c)

    return framed("map", 1.24, 0.76, painting, rotation_about("y", -90), (X1 - 0.004, 1.62, 0.75), 0.035)


def door() -> list[Surface]:
    """The door in the near wall, behind the player."""
    x0, x1, y0, y1 = DOOR
    leaf, face = (x0, x1, y0 + 0.008, y1), Z1 - 0.022
    panels = [(a, a + 0.32, c, d) for a in (x0 + 0.09, x1 - 0.41) for c, d in ((0.20, 0.85), (1.02, 1.92))]
    meshes = [*panelled_leaf(leaf, panels, face, 0.014), *casing(DOOR, CASING, Z1 - 0.04, Z1)]
    knob = superellipsoid((0.055,) * 3, 1.0, 14).moved(translation=(x0 + 0.045, 1.0, face - 0.03))
    return [
        boards(meshes, "door", 341, 0.020, axis=1),
        Surface("door knob", knob, plain("a5834a"), 0.010, gloss=0.25),
    ]


def sill_plant() -> list[Surface]:
    """A fern in a clay pot on the window sill."""
    pot = smooth_curve(
        [
            (0.0, 0.0),
            (0.050, 0.0),
            (0.072, 0.10),
            (0.078, 0.10),
            (0.080, 0.125),
            (0.066, 0.125),
            (0.060, 0.105),
            (0.0, 0.105),
        ],
        40,
    )
    rng = np.random.default_rng(7)
    fronds = []
    for k in range(17):
        a, rise = 2.4 * k, rng.uniform(0.16, 0.30)
        t, s = np.linspace(0, 1, 16)[:, None], np.linspace(-1, 1, 5)[None]
        out = 0.20 * rng.uniform(0.7, 1.15) * t
        width = 0.030 * np.sin(np.pi * t**0.6) * (0.65 + 0.35 * np.cos(26 * t))
        x, z = out * np.cos(a) - s * width * np.sin(a), out * np.sin(a) + s * width * np.cos(a)
        y = 0.11 + rise * (1.9 * t - 1.6 * t**2) - 0.1 * np.abs(s) * width
        fronds.append(grid_mesh(np.stack(np.broadcast_arrays(x, y, z), -1)))
    at = (X0 + 0.0, WINDOW_Y[0], 0.28)
    return [
        Surface("clay pot", lathe(pot, 32), plain("a8603c", 0.10, 0.04), 0.008).placed(None, at),
        Surface("fern", join(*fronds), plain("5f8f45", 0.18, 0.03), 0.0085, translucency=0.35).placed(None, at),
    ]
