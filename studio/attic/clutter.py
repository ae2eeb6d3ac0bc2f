"""Clutter of the attic: trunk, suitcases, shelf, rocking chair, dress form, mirror, birdcage, a bulb."""

from __future__ import annotations

import numpy as np

from studio.attic.attic_shell import KNEE, PINE, Z0, dusty, old_boards, roof_height
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
from studio.textures import cloth, fbm, mix, plain, smoothstep, srgb, wood

BULB_AT = (0.42, 1.72, 0.34)  # [m]
LAMP_COLOUR = np.array([1.0, 0.74, 0.45])  # linear RGB
TRUNK = ((-1.18, 0.0, -0.50), (0.78, 0.50, 0.46))  # [m] middle of its foot, and size: so does it these


def clutter() -> list[Surface]:
    """All that stands about."""
    return [
        *trunk(),
        *suitcases(),
        *shelf(),
        *rocking_chair(),
        *dress_form(),
        *mirror(),
        *birdcage(),
        *bulb(),
        *carpets(),
        *frames(),
    ]


def lamps() -> list[Lamp]:
    """The bulb that hangs from a tie."""
    return [Lamp(np.array(BULB_AT), 0.03, 2.6 * LAMP_COLOUR)]


def trunk() -> list[Surface]:
    """Domed steamer trunk with wooden battens, brass corners, leather straps."""
    at, (w, h, d) = TRUNK
    a = np.linspace(0, np.pi, 16)
    dome = np.concatenate(
        [[(d / 2, 0.0)], np.stack([d / 2 * np.cos(a), 0.34 + (h - 0.34) * np.sin(a)], 1), [(-d / 2, 0.0)]]
    )
    body = grid_mesh(np.stack([np.stack([0 * dome[:, 0] + x, dome[:, 1], dome[:, 0]], 1) for x in (-w / 2, w / 2)], 0))
    ends = []
    for s in (-1, 1):
        rim = np.stack([0 * dome[:, 0] + s * w / 2, dome[:, 1], dome[:, 0]], 1)
        foot = np.stack([0 * dome[:, 0] + s * w / 2, 0 * dome[:, 1], dome[:, 0]], 1)
        ends.append(grid_mesh(np.stack([foot, rim] if s > 0 else [rim, foot], 1)))
    wider = [np.stack([0 * dome[:, 0] + x, dome[:, 1], dome[:, 0]], 1) * (1, 1.012, 1.02) for x in (-0.30, -0.02, 0.30)]
    hoops = join(*(grid_mesh(np.stack([rim - (0.022, 0, 0), rim + (0.022, 0, 0)], 0)) for rim in wider))
    edge = [
        box((-w / 2 - 0.006, y - 0.018, s * (d / 2) - 0.006), (w / 2 + 0.006, y + 0.018, s * (d / 2) + 0.006))
        for s in (-1, 1)
        for y in (0.02, 0.34)
    ]
    lock = beveled_box((0.07, 0.09, 0.014), 0.004).moved(translation=(0, 0.33, d / 2 + 0.012))
    handles = [
        tube(
            [(s * (w / 2 + 0.004), 0.24, -0.06), (s * (w / 2 + 0.03), 0.21, 0.0), (s * (w / 2 + 0.004), 0.24, 0.06)],
            0.009,
            8,
        )
        for s in (-1, 1)
    ]
    return [
        Surface("trunk", join(body, *ends), dusty("3f5248", 0.6, 0.08, 81), 0.0115).placed(None, at),
        Surface("trunk hoops", hoops, wood(PINE, axis=1, across=0, seed=83), 0.010).placed(None, at),
        Surface(
            "trunk edges", join(*edge), wood(PINE, axis=0, across=1, seed=85), 0.012, grain=(1, 0, 0), stretch=2.0
        ).placed(None, at),
        Surface("trunk lock", join(lock, *handles), plain("9a7430", 0.10, 0.02), 0.0075, gloss=0.2).placed(None, at),
    ]


def suitcases() -> list[Surface]:
    """Three suitcases on one another, a hat box on top."""
    surfaces, y = [], 0.0
    for k, (w, h, d, colour, turn) in enumerate(
        ((0.62, 0.20, 0.42, "7a4a28", -6), (0.55, 0.17, 0.38, "8f2f2a", 7), (0.46, 0.15, 0.32, "b59a62", -12))
    ):
        case = superellipsoid((w, h, d), 0.16, 18).moved(translation=(0, h / 2, 0))
        straps = [
            box((x - 0.016, -0.001, -d / 2 - 0.003), (x + 0.016, h + 0.003, d / 2 + 0.003)) for x in (-w / 4, w / 4)
        ]
        handle = tube(
            [(-0.06, h / 2, d / 2), (-0.05, h / 2, d / 2 + 0.03), (0.05, h / 2, d / 2 + 0.03), (0.06, h / 2, d / 2)],
            0.009,
            8,
        )
        seam = [box((-w / 2 - 0.002, h * 0.62, -d / 2 - 0.002), (w / 2 + 0.002, h * 0.62 + 0.006, d / 2 + 0.002))]
        r, at = rotation_about("y", turn), (-1.52, y, 0.32)
        surfaces.append(Surface(f"suitcase {k}", case, dusty(colour, 0.45, 0.05, 91 + k), 0.0125).placed(r, at))
        surfaces.append(
            Surface(f"suitcase straps {k}", join(*straps, handle, *seam), plain("3a2416", 0.10, 0.02), 0.016).placed(
                r, at
            )
        )
        y += h
    hat = lathe(
        smooth_curve(
            [(0.0, 0.0), (0.15, 0.0), (0.152, 0.13), (0.158, 0.13), (0.158, 0.165), (0.15, 0.172), (0.0, 0.175)], 60
        ),
        40,
    )

    def stripes(p, n):
        a = np.arctan2(p[:, 2], p[:, 0])
        c = mix(srgb("d9b9a8"), srgb("8f6a70"), smoothstep(-0.15, 0.15, np.sin(24 * a)) * (np.abs(n[:, 1]) < 0.5))
        return mix(c, (0.36, 0.33, 0.29), 0.35 * np.clip(n[:, 1], 0, 1))

    return [*surfaces, Surface("hat box", hat, stripes, 0.0095).placed(None, (-1.50, y, 0.30))]


def shelf() -> list[Surface]:
    """Low shelf at the right knee wall with jars, paint pots, a lantern and old books."""
    x0, x1, z0, z1 = KNEE[0] - 0.30, KNEE[0] - 0.01, -1.02, -0.42
    planks = [box((x0, y - 0.02, z0), (x1, y, z1)) for y in (0.06, 0.34, 0.62)]
    planks += [box((x0, 0.0, z), (x1, 0.62, z + 0.022)) for z in (z0, z1 - 0.022)]
    rng = np.random.default_rng(5)
    pots, lids, books = [], [], []
    for y, first in ((0.06, z0 + 0.08), (0.34, z0 + 0.07)):
        z = first
        while z < z1 - 0.10:
            radius, height = rng.uniform(0.035, 0.055), rng.uniform(0.10, 0.19)
            profile = [
                (0.0, 0.0),
                (radius, 0.0),
                (radius, 0.8 * height),
                (0.75 * radius, 0.9 * height),
                (0.75 * radius, height),
                (0.0, height),
            ]
            at = (x0 + 0.075, y, z)
            pots.append(lathe(profile, 22).moved(translation=at))
            lids.append(
                lathe(
                    [(0.82 * radius, 0.985 * height), (0.82 * radius, height + 0.014), (0.0, height + 0.014)], 18
                ).moved(translation=at)
            )
            z += 2 * radius + rng.uniform(0.012, 0.04)

    def glass(p, n):
        k = np.floor(p[:, 2] / 0.11) + 7 * np.floor(p[:, 1] / 0.28)
        tone = np.array([srgb(c) for c in ("8a5a3a", "6a7a4a", "9a8a5a", "5a6a7a", "a0664a")])
        return tone[(k.astype(int) * 3) % 5]

    y = 0.62
    for k in range(9):
        w, h = rng.uniform(0.02, 0.045), rng.uniform(0.11, 0.17)
        z = z0 + 0.03 + 0.045 * k
        books.append(box((x0 + 0.01, y, z), (x0 + 0.11, y + h, z + w)))

    def spines(p, n):
        k = np.floor((p[:, 2] - z0 - 0.03) / 0.045).astype(int).clip(0, 8)
        tone = np.array([srgb(c) for c in ("6a3a30", "3f5248", "7a6a48", "4a4660", "8a5a3a")])
        return tone[(k * 2) % 5] * (1 + 0.12 * fbm(p * 30, 2, 3))[:, None]

    return [
        Surface("shelf", join(*planks), old_boards(PINE, 2, 0, 4.0, 101, 0.3), 0.014, grain=(0, 0, 1), stretch=2.0),
        Surface("jars", join(*pots), glass, 0.0095, gloss=0.06, roughness=0.1),
        Surface("lids", join(*lids), plain("8a8478", 0.12, 0.02), 0.0085, gloss=0.1),
        Surface("old books", join(*books), spines, 0.011),
    ]


def rocking_chair() -> list[Surface]:
    """Rocking chair with a blanket over its back, at the left."""
    rails = []
    for s in (-1, 1):
        x = 0.24 * s
        t = np.linspace(-1, 1, 20)
        rails.append(tube(np.stack([0 * t + x, 0.02 + 0.10 * t**2, 0.46 * t], 1), 0.018, 10))
        rails += [
            tube([(x, 0.05, 0.22), (x, 0.42, 0.22), (x, 0.62, 0.23)], 0.017, 10),
            tube([(x, 0.05, -0.20), (x, 0.42, -0.20), (x * 0.95, 1.02, -0.36)], 0.017, 10),
        ]
        rails.append(tube([(x, 0.63, 0.26), (x, 0.64, 0.0), (x, 0.62, -0.24)], 0.020, 10, flat=0.6))
    for k in range(6):
        x = 0.09 * (k - 2.5) * 0.9
        rails.append(tube([(x, 0.44, -0.20), (x, 1.0, -0.355)], 0.010, 8))
    rails += [tube([(-0.25, y, z), (0.25, y, z)], 0.017, 10) for y, z in ((1.02, -0.36), (0.20, 0.22), (0.20, -0.20))]
    seat = beveled_box((0.50, 0.03, 0.46), 0.01).moved(translation=(0, 0.43, 0.01))
    u, v = np.linspace(-0.22, 0.22, 14)[:, None], np.linspace(0, 1, 24)[None]
    y = 1.055 - 0.40 * np.abs(v - 0.38) - 0.02 * np.sin(24 * u) * (v > 0.4)
    z = (
        -0.36
        + np.where(v < 0.38, -0.04 - 0.06 * (0.38 - v), 0.045 + 0.30 * (v - 0.38) * 0.5)
        + 0.012 * np.sin(20 * u + 2)
    )
    blanket = grid_mesh(np.stack(np.broadcast_arrays(u, y, z), -1))

    def squares(p, n):
        c = np.array([srgb(k) for k in ("a8453a", "d9b45a", "4f6f7a", "7a8f5a", "c9b89a")])
        patch = (np.floor(p[:, 0] / 0.075) * 3 + np.floor(p[:, 1] / 0.075) * 5).astype(int) % 5
        return c[patch] * (1 + 0.12 * fbm(p * 60, 2, 3))[:, None]

    r, at = rotation_about("y", 52), (-0.98, 0.0, 1.20)
    return [
        Surface("rocking chair", join(*rails, seat), plain("5a3820", 0.16, 0.05), 0.019, gloss=0.03).placed(r, at),
        Surface("patchwork", blanket, squares, 0.012, translucency=0.05).placed(r, at),
    ]


def dress_form() -> list[Surface]:
    """Tailor's dummy on a turned foot, by the right slope."""
    outline = smooth_curve(
        [
            (0.0, 0.80),
            (0.135, 0.81),
            (0.155, 0.90),
            (0.118, 1.06),
            (0.150, 1.22),
            (0.135, 1.34),
            (0.060, 1.40),
            (0.045, 1.46),
            (0.0, 1.47),
        ],
        60,
    )
    body = lathe(outline, 40)
    body = type(body)(body.vertices * (1.0, 1.0, 0.72), body.faces)
    foot = lathe(
        smooth_curve(
            [(0.0, 0.0), (0.16, 0.0), (0.16, 0.02), (0.03, 0.05), (0.02, 0.30), (0.03, 0.5), (0.018, 0.82)], 50
        ),
        24,
    )
    knob = lathe(smooth_curve([(0.012, 1.46), (0.03, 1.49), (0.0, 1.53)], 16), 20)

    def linen(p, n):
        seam = (np.abs(p[:, 0]) < 0.003) | (np.abs(p[:, 1] - 1.06) < 0.003)
        return np.where(seam[:, None], srgb("6a5a48"), cloth("c9b79a", 0.008, 0.12, 0.08, 5)(p, n))

    at, r = (1.00, 0.0, 1.15), rotation_about("y", -35)
    return [
        Surface("dress form", body, linen, 0.012).placed(r, at),
        Surface("dress form stand", join(foot, knob), plain("4a2c18", 0.12, 0.04), 0.012, gloss=0.04).placed(r, at),
    ]


def mirror() -> list[Surface]:
    """Tall gilded mirror that leans at the far gable, left of the trunk: dull with age."""
    w, h = 0.46, 1.02
    bar = 0.06
    frame = join(
        box((-w / 2 - bar, 0, -0.02), (-w / 2, h + bar, 0.025)),
        box((w / 2, 0, -0.02), (w / 2 + bar, h + bar, 0.025)),
        box((-w / 2, 0, -0.02), (w / 2, bar, 0.025)),
        box((-w / 2, h, -0.02), (w / 2, h + bar, 0.025)),
    )
    glass = quad((-w / 2, bar, 0.004), (w, 0, 0), (0, h - bar, 0))

    def dull(p, n):
        spots = smoothstep(0.15, 0.5, fbm(p * 9, 4, 3))
        return mix((0.42, 0.45, 0.45), (0.16, 0.14, 0.11), spots)

    r = rotation_about("x", -9)
    at = (-1.02, 0.0, Z0 + 0.19)
    return [
        Surface("mirror frame", frame, plain("a07c38", 0.25, 0.03), 0.011, gloss=0.12).placed(r, at),
        Surface("mirror", glass, dull, 0.013, gloss=0.55, roughness=0.05).placed(r, at),
    ]


def birdcage() -> list[Surface]:
    """Empty birdcage that hangs from a rafter."""
    x, y, z, radius = 0.98, 1.05, -0.62, 0.125
    wires = []
    for a in np.linspace(0, 2 * np.pi, 15)[:-1]:
        t = np.linspace(0, np.pi / 2, 8)
        path = [
            (radius * np.cos(a), 0.0, radius * np.sin(a)),
            *[(radius * np.cos(u) * np.cos(a), 0.20 + 0.11 * np.sin(u), radius * np.cos(u) * np.sin(a)) for u in t],
        ]
        wires.append(tube(path, 0.0022, 6))
    circle = np.linspace(0, 2 * np.pi, 40)
    wires += [
        tube(np.stack([radius * np.cos(circle), 0 * circle + h, radius * np.sin(circle)], 1), 0.0032, 6)
        for h in (0.01, 0.20)
    ]
    wires.append(tube([(-radius, 0.10, 0), (radius, 0.10, 0)], 0.005, 8))
    base = lathe([(0.0, -0.015), (radius + 0.01, -0.015), (radius + 0.01, 0.008), (0.0, 0.008)], 32)
    hang = tube([(0, 0.31, 0), (0, roof_height(x) - y + 0.05, 0)], 0.003, 6)
    return [
        Surface("birdcage", join(*wires, hang), plain("a58a4a", 0.08, 0.02), 0.0105, gloss=0.15).placed(
            None, (x, y, z)
        ),
        Surface("birdcage base", base, plain("8a6a34", 0.08, 0.02), 0.009, gloss=0.1).placed(None, (x, y, z)),
    ]


def bulb() -> list[Surface]:
    """A bare bulb on a cord, under an enamel shade."""
    x, y, z = BULB_AT
    curve = smooth_curve([(0.150, 0.0), (0.135, 0.03), (0.05, 0.085), (0.025, 0.11), (0.022, 0.15)], 30)
    outer, inner = lathe(curve, 40), lathe((curve - (0.006, 0.0)).clip(0.004)[::-1], 40)
    glass = superellipsoid((0.062, 0.078, 0.062), 1.0, 14)
    cord = tube([(x, y + 0.18, z), (x, 2.05, z), (x, roof_height(x), z)], 0.005, 8)
    return [
        Surface("shade", outer, plain("3f5a52", 0.05), 0.0090, gloss=0.05).placed(None, (x, y + 0.03, z)),
        Surface("shade inside", inner, plain("f0e8d6", 0.02), 0.0105).placed(None, (x, y + 0.03, z)),
        Surface(
            "bulb", glass, plain("ffffff", 0.0), 0.007, emission=tuple(14 * LAMP_COLOUR), blocks_light=False
        ).placed(None, (x, y, z)),
        Surface("cord", cord, plain("2f2c28"), 0.010),
    ]


def carpets() -> list[Surface]:
    """Two rolled carpets along the right knee wall."""
    surfaces = []
    for k, (x, y, r, colour) in enumerate(((1.86, 0.11, 0.11, "8a3f34"), (1.68, 0.09, 0.09, "4a5a7a"))):
        roll = tube([(x, y, 0.35), (x, y, 1.9)], r, 22)

        def rolled(p, n, colour=colour, x=x, y=y):
            around = np.hypot(p[:, 0] - x, p[:, 1] - y)
            spiral = np.sin(around * 420)
            end = np.abs(n[:, 2]) > 0.7
            c = cloth(colour, 0.012, 0.18, 0.10, 7)(p, n)
            band = np.abs(((p[:, 2] - 0.35) / 0.31) % 1 - 0.5) < 0.06
            c = np.where((band & ~end)[:, None], srgb("c9b48a"), c)
            return np.where(end[:, None], c * (0.75 + 0.25 * spiral)[:, None], c)

        surfaces.append(Surface(f"carpet {k}", roll, rolled, 0.013))
    return surfaces


def frames() -> list[Surface]:
    """Picture frames that lean at the far gable, right of the boxes."""
    surfaces = []
    for k, (x, w, h, tilt, turn) in enumerate(((0.78, 0.52, 0.66, -10, 0), (0.98, 0.40, 0.50, -16, -8))):
        bar = 0.045
        bars = join(
            box((-w / 2 - bar, 0, 0), (-w / 2, h + 2 * bar, 0.03)),
            box((w / 2, 0, 0), (w / 2 + bar, h + 2 * bar, 0.03)),
            box((-w / 2, 0, 0), (w / 2, bar, 0.03)),
            box((-w / 2, h + bar, 0), (w / 2, h + 2 * bar, 0.03)),
        )
        canvas = quad((-w / 2, bar, 0.012), (w, 0, 0), (0, h, 0))

        def painting(p, n, k=k, w=w, h=h):
            u, v = p[:, 0] / w, p[:, 1] / h
            q = np.stack([3 * u, 3 * v, 0 * u + k], 1)
            stroke = fbm(q * (2, 5, 1), 4, 201 + k)
            c = mix(srgb("8a9aa0"), srgb("c9b48a"), smoothstep(0.8, 0.4, v + 0.1 * stroke))
            field = v < 0.45 + 0.05 * stroke
            c = np.where(field[:, None], mix(srgb("5f6a3a"), srgb("9a8a4a"), smoothstep(-0.3, 0.4, stroke)), c)
            tree = np.hypot((u - 0.18) / 0.16, (v - 0.62) / 0.20) + 0.3 * stroke < 1
            return np.where(tree[:, None], srgb("3a4a2c"), c) * 0.85

        r = rotation_about("y", turn) @ rotation_about("x", tilt)
        at = (x, 0.0, Z0 + 0.05 + 0.14 * (k + 1))
        surfaces += [
            Surface(f"frame {k}", bars, dusty(("8f6f34", "4a3020")[k], 0.4, 0.03, 211 + k), 0.011).placed(r, at),
            Surface(f"canvas {k}", canvas, painting, 0.012).placed(r, at),
        ]
    return surfaces
