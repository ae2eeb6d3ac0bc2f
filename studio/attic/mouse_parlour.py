"""Place behind the boxes: a mouse's parlour in the wall, with a candle, a spool for a table, a stamp for a picture."""

from __future__ import annotations

import numpy as np

from studio.attic.attic_shell import HOLE_HEIGHT, HOLE_X, Z0
from studio.light_sources import Lamp
from studio.shapes import (
    Mesh,
    Surface,
    beveled_box,
    box,
    join,
    lathe,
    quad,
    rotation_about,
    smooth_curve,
    superellipsoid,
    tube,
)
from studio.textures import BEECH, cloth, fbm, mix, noise, plain, smoothstep, srgb, wood

DEPTH = 0.20  # [m] of the parlour behind the wall
X0, X1, BACK, TOP = HOLE_X[0] - 0.05, HOLE_X[1] + 0.05, Z0 - DEPTH, HOLE_HEIGHT + 0.03  # [m] it is wider than its door
CANDLE_AT = (0.095, 0.0, Z0 - 0.125)  # [m]
MOUSE_AT = (-0.045, 0.0, Z0 - 0.085)  # [m]
FLAME = np.array([1.0, 0.66, 0.30])  # linear RGB


def mouse_parlour() -> list[Surface]:
    """Walls, furniture and the mouse."""
    return [*parlour_walls(), *candle(), *table_and_bed(), *mouse(), *picture(), *doorway()]


def candles() -> list[Lamp]:
    """The flame."""
    x, y, z = CANDLE_AT
    return [Lamp(np.array([x, y + 0.105, z]), 0.008, 0.030 * FLAME)]


def parlour_walls() -> list[Surface]:
    """Striped paper, a floor of matchsticks, a ceiling."""

    def paper(p, n):
        u = np.where(np.abs(n[:, 0]) > 0.5, p[:, 2], p[:, 0])
        stripe = smoothstep(-0.2, 0.2, np.sin(2 * np.pi * u / 0.026))
        c = mix(srgb("e2c9a0"), srgb("b5584a"), 0.75 * stripe)
        return np.where((p[:, 1] < 0.035)[:, None], srgb("8a6a44"), c)

    z1 = Z0 - 0.012
    walls = join(
        quad((X0, 0, BACK), (X1 - X0, 0, 0), (0, TOP, 0)),
        quad((X0, 0, z1), (0, 0, BACK - z1), (0, TOP, 0)),
        quad((X1, 0, BACK), (0, 0, z1 - BACK), (0, TOP, 0)),
    )
    floor = quad((X0, 0, Z0), (X1 - X0, 0, 0), (0, 0, BACK - Z0))
    lid = quad((X0, TOP, BACK), (X1 - X0, 0, 0), (0, 0, z1 - BACK))
    front = join(
        quad((HOLE_X[0], 0, z1), (X0 - HOLE_X[0], 0, 0), (0, TOP, 0)),
        quad((X1, 0, z1), (HOLE_X[1] - X1, 0, 0), (0, TOP, 0)),
    )
    return [
        Surface("parlour paper", walls, paper, 0.0058, uniform=True),
        Surface("parlour inside", join(lid, front), plain("c9a878", 0.05), 0.012, uniform=True),
        Surface("parlour floor", floor, wood(BEECH, axis=2, board=0.014, across=0, seed=5), 0.0055, uniform=True),
    ]


def doorway() -> list[Surface]:
    """The rounded edge of the boards around the arch."""
    half, spring = HOLE_X[1] * 0.93, HOLE_HEIGHT - HOLE_X[1] - 0.005
    a = np.linspace(0, np.pi, 30)
    path = np.concatenate([[(half, 0.0)], np.stack([half * np.cos(a), spring + half * np.sin(a)], 1), [(-half, 0.0)]])
    trim = tube(np.insert(path, 2, Z0 + 0.002, axis=1), 0.010, 10, up=(0, 0, 1))
    return [Surface("doorway", trim, wood(BEECH, axis=1, across=0, seed=7), 0.0055, uniform=True)]


def candle() -> list[Surface]:
    """A candle end in a bottle cap, with its flame."""
    cap = lathe([(0.0, 0.0), (0.022, 0.0), (0.024, 0.008), (0.019, 0.008), (0.018, 0.003), (0.0, 0.003)], 24)
    wax = lathe(smooth_curve([(0.012, 0.003), (0.0125, 0.05), (0.011, 0.082), (0.006, 0.086), (0.0, 0.084)], 24), 20)
    flame = lathe(smooth_curve([(0.0, 0.088), (0.0045, 0.096), (0.0035, 0.108), (0.0, 0.124)], 20), 16)
    glow = tuple(9 * FLAME)
    surfaces = [
        Surface("bottle cap", cap, plain("b08a3c", 0.05), 0.0040, gloss=0.2, uniform=True),
        Surface("candle end", wax, plain("efe2bd", 0.03), 0.0042, uniform=True),
        Surface("flame", flame, plain("ffffff", 0.0), 0.0030, emission=glow, blocks_light=False, uniform=True),
    ]
    return [s.placed(None, CANDLE_AT) for s in surfaces]


def table_and_bed() -> list[Surface]:
    """A thread spool as a table with a wedge of cheese, a matchbox as a bed with a blanket."""
    spool = smooth_curve(
        [
            (0.0, 0.0),
            (0.034, 0.0),
            (0.034, 0.006),
            (0.020, 0.010),
            (0.019, 0.044),
            (0.034, 0.048),
            (0.034, 0.055),
            (0.0, 0.055),
        ],
        44,
    )

    def thread(p, n):
        wound = (p[:, 1] > 0.010) & (p[:, 1] < 0.045)
        yarn = srgb("2f5f8f") * (1 + 0.25 * np.sin(p[:, 1:2] * 4000))
        return np.where(wound[:, None], yarn, srgb("c9a06a"))

    corners = np.array([(0, 0), (0.040, -0.013), (0.040, 0.013)])
    v = np.concatenate([np.insert(corners, 1, y, axis=1) for y in (0.0, 0.022)])
    triangles = [(0, 1, 2), (3, 5, 4), (0, 3, 4), (0, 4, 1), (1, 4, 5), (1, 5, 2), (2, 5, 3), (2, 3, 0)]
    wedge = Mesh(v, np.array(triangles))

    def cheese(p, n):
        return mix(srgb("f2c44a"), srgb("b98a28"), 0.8 * smoothstep(0.22, 0.34, noise(p * 130, 9)))

    bed = box((-0.045, 0, -0.024), (0.045, 0.020, 0.024))
    blanket = superellipsoid((0.060, 0.022, 0.052), 0.5, 16).moved(translation=(0.014, 0.022, 0))
    pillow = superellipsoid((0.024, 0.016, 0.040), 0.7, 12).moved(translation=(-0.032, 0.024, 0))
    at, bed_at, turn = (0.045, 0.0, Z0 - 0.075), (-0.115, 0.0, Z0 - 0.155), rotation_about("y", 72)
    wool = cloth("7a9a5a", 0.004, 0.2, 0.05, 3)
    return [
        Surface("spool", lathe(spool, 28), thread, 0.0042, uniform=True).placed(None, at),
        Surface("cheese", wedge, cheese, 0.0036, uniform=True).placed(
            rotation_about("y", 35), (at[0] - 0.018, 0.055, at[2])
        ),
        Surface("matchbox", bed, plain("d9b23c", 0.06, 0.01), 0.0045, uniform=True).placed(turn, bed_at),
        Surface("blanket", blanket, wool, 0.0042, uniform=True).placed(turn, bed_at),
        Surface("pillow", pillow, plain("ece6da", 0.03), 0.0042, uniform=True).placed(turn, bed_at),
    ]


def mouse() -> list[Surface]:
    """A mouse in a red waistcoat, that looks at whoever has found it."""

    def fur(p, n):
        c = srgb("9a8878") * (1 + 0.16 * noise(p * (420, 160, 420), 3))[:, None]
        return mix(c, srgb("d8cabb"), 0.6 * smoothstep(0.25, 0.7, n[:, 2]) * (p[:, 1] < 0.072))

    def ball(size, at, rotation=None, count=12):
        return superellipsoid(size, 1.0, count).moved(rotation, at)

    def both(make):
        return join(*(make(s) for s in (-1, 1)))

    def arm(s):
        return tube(
            [(s * 0.026, 0.062, 0.006), (s * 0.030, 0.050, 0.022), (s * 0.012, 0.046, 0.036)], [0.009, 0.008, 0.006], 10
        )

    def whisker(s):
        return join(
            *(
                tube([(s * 0.008, 0.083 + 0.002 * k, 0.040), (s * 0.036, 0.084 + 0.007 * k, 0.036)], 0.0006, 6)
                for k in (-1, 0, 1)
            )
        )

    body = join(
        ball((0.062, 0.074, 0.056), (0, 0.036, 0), count=20),
        ball((0.046, 0.044, 0.050), (0, 0.088, 0.006), count=18),
        ball((0.022, 0.020, 0.030), (0, 0.082, 0.030)),
        both(lambda s: ball((0.030, 0.016, 0.042), (s * 0.020, 0.008, 0.022))),
        both(arm),
    )
    tail = smooth_curve(
        [(0.01, 0.010, -0.026), (0.055, 0.006, -0.030), (0.078, 0.008, -0.004), (0.066, 0.006, 0.028)], 24
    )
    parts = {
        "mouse": (body, fur, 0.0033),
        "waistcoat": (
            ball((0.066, 0.042, 0.060), (0, 0.046, 0), count=20),
            cloth("b23a30", 0.004, 0.15, 0.05, 5),
            0.0036,
        ),
        "ears": (
            both(lambda s: ball((0.034, 0.034, 0.009), (s * 0.023, 0.112, -0.002), rotation_about("y", 18 * s))),
            fur,
            0.0036,
        ),
        "ears inside": (
            both(lambda s: ball((0.022, 0.023, 0.006), (s * 0.0225, 0.111, 0.0025), rotation_about("y", 18 * s))),
            plain("d8a09a", 0.05),
            0.0034,
        ),
        "eyes": (
            both(lambda s: ball((0.009, 0.010, 0.008), (s * 0.0115, 0.094, 0.0265))),
            plain("14100e", 0.0),
            0.0022,
        ),
        "nose": (ball((0.009, 0.007, 0.007), (0, 0.084, 0.0445)), plain("c9706a", 0.03), 0.0022),
        "tail": (tube(tail, np.linspace(0.0042, 0.0018, 24), 8), plain("c99a90", 0.06, 0.01), 0.0030),
        "whiskers": (both(whisker), plain("e6dfd2", 0.0), 0.0022),
    }
    glint = both(lambda s: ball((0.003, 0.003, 0.003), (s * 0.0115 + 0.0015, 0.0965, 0.0305), count=6))
    surfaces = [Surface(name, mesh, colour, spacing, uniform=True) for name, (mesh, colour, spacing) in parts.items()]
    surfaces.append(Surface("glint", glint, plain("ffffff", 0.0), 0.0016, emission=(1.2, 1.2, 1.2), uniform=True))
    return [s.placed(rotation_about("y", 8), MOUSE_AT) for s in surfaces]


def picture() -> list[Surface]:
    """A postage stamp on the wall."""

    def stamp(p, n):
        x, y = p[:, 0] / 0.026, p[:, 1] / 0.032
        hill = y < -0.1 + 0.4 * fbm(np.stack([x * 2, 0 * x, 0 * x], 1), 2, 7)
        c = np.where(hill[:, None], srgb("3f7a55"), srgb("9cc7d8"))
        c = np.where((np.hypot(x - 0.35, y - 0.45) < 0.2)[:, None], srgb("f2c94a"), c)
        return np.where((np.maximum(np.abs(x), np.abs(y)) > 0.80)[:, None], srgb("f0e8d6"), c)

    plate = beveled_box((0.052, 0.064, 0.003), 0.0008).moved(translation=(0, 0, 0.0015))
    return [Surface("stamp", plate, stamp, 0.0036, uniform=True).placed(rotation_about("z", -4), (-0.02, 0.185, BACK))]
