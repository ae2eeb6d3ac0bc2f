"""The hall before the stage: carpet, ceiling, sconces, chandelier, rows of seats."""

from __future__ import annotations

import numpy as np

from studio.light_sources import Lamp
from studio.shapes import Surface, box, join, lathe, quad, smooth_curve, superellipsoid, tube
from studio.stage.hall_walls import GILT, X0, X1, Y1, Z0, Z1, walls
from studio.textures import WALNUT, cloth, fbm, mix, plain, srgb, wood

SCONCE_Y, SCONCE_Z = 1.95, (1.1, 2.9)  # [m] on both side walls
BULB = np.array([1.0, 0.66, 0.34])  # linear RGB of dimmed filaments
CHANDELIER = (0.0, 3.05, 3.4)  # [m] centre of its bowl
SEAT_ROWS = (2.75, 3.55, 4.35)  # [m] z of the rows
SEAT_X = (-2.05, -1.45, -0.85, 0.85, 1.45, 2.05)  # [m] of the seats of a row, with an aisle between them


def hall() -> list[Surface]:
    """Everything on the spectators' side."""
    return [carpet(), *walls(), ceiling(), *sconces(), *chandelier(), *seats()]


def lamps() -> list[Lamp]:
    """The sconces' bulbs, and the light of a chandelier above the seats."""
    found = [
        Lamp(np.array([s * (abs(x) - 0.14), SCONCE_Y + 0.07, z]), 0.03, 0.8 * BULB)
        for x, s in ((X0, -1), (X1, 1))
        for z in SCONCE_Z
    ]
    return [*found, Lamp(np.array(CHANDELIER), 0.10, 7.0 * BULB)]


def carpet() -> Surface:
    """Wine-red carpet with a small gold pattern."""
    pile = cloth((1.0, 1.0, 1.0), 0.012, 0.12, 0.05, 301)
    ground, gold = srgb("5a1a20"), srgb("a8813a")

    def colour_at(p, n):
        u, v = p[:, 0] / 0.30, p[:, 2] / 0.30
        row = np.floor(v)
        u = u + 0.5 * (row % 2) - np.floor(u + 0.5 * (row % 2)) - 0.5
        v = v - row - 0.5
        flower = np.abs(u) + np.abs(v) < 0.16 + 0.05 * np.cos(4 * np.arctan2(v, u))
        return np.where(flower[:, None], gold, ground) * pile(p, n)

    return Surface("carpet", quad((X0, 0, Z1), (X1 - X0, 0, 0), (0, 0, Z0 - Z1)), colour_at, 0.033, width=1.1)


def ceiling() -> Surface:
    """Plaster with a gilt rosette."""

    def colour_at(p, n):
        r = np.hypot(p[:, 0], p[:, 2] - 3.3)
        petal = r * (1 + 0.10 * np.cos(12 * np.arctan2(p[:, 2] - 3.3, p[:, 0])))
        line = (np.abs(petal - 0.9) < 0.05) | (np.abs(r - 1.25) < 0.04) | (petal < 0.25)
        return mix(srgb("d8ccb0"), srgb(GILT), 0.7 * line) * (1 + 0.03 * fbm(p * 2, 2, 315))[:, None]

    top = quad((X0, Y1, Z0), (X1 - X0, 0, 0), (0, 0, Z1 - Z0))
    return Surface("ceiling", top, colour_at, 0.055, width=1.2)


def sconces() -> list[Surface]:
    """Brass wall lamps with two candles and glass shades, two on each side."""
    brass = {"gloss": 0.30, "roughness": 0.25}
    plate, arms, shades, bulbs = [], [], [], []
    for x, s in ((X0, 1), (X1, -1)):
        for z in SCONCE_Z:
            plate.append(
                superellipsoid((0.03, 0.26, 0.12), 1.0, 12).moved(translation=(x + 0.012 * s, SCONCE_Y - 0.06, z))
            )
            for k in (-1, 1):
                at = np.array([x + 0.14 * s, SCONCE_Y, z + 0.10 * k])
                path = [(x + 0.01 * s, SCONCE_Y - 0.08, z), (x + 0.09 * s, SCONCE_Y - 0.13, z + 0.05 * k), tuple(at)]
                arms.append(tube(smooth_curve(path, 12), 0.009, 10))
                cup = [(0.016, 0.0), (0.045, 0.035), (0.058, 0.085), (0.050, 0.115)]
                shades.append(lathe(smooth_curve(cup, 12), 24).moved(translation=at))
                bulbs.append(superellipsoid((0.035, 0.06, 0.035), 1.0, 10).moved(translation=at + (0, 0.05, 0)))
    glow = {"blocks_light": False, "emission": tuple(6.0 * BULB)}
    return [
        Surface("sconces", join(*plate, *arms), plain("a97c2c", 0.05), 0.017, **brass),
        Surface("sconce shades", join(*shades), plain("f6dfb4", 0.02), 0.012, emission=tuple(1.6 * BULB),
                blocks_light=False, translucency=0.6),
        Surface("sconce bulbs", join(*bulbs), plain("ffffff", 0.0), 0.012, **glow),
    ]  # fmt: skip


def chandelier() -> list[Surface]:
    """A glass bowl in a brass ring on three chains."""
    bowl = smooth_curve([(0.0, -0.20), (0.16, -0.17), (0.28, -0.08), (0.32, 0.02)], 16)
    a = np.linspace(0, 2 * np.pi, 48)
    ring = tube(np.stack([0.325 * np.cos(a), 0.02 + 0 * a, 0.325 * np.sin(a)], 1), 0.018, 10)
    chains = [
        tube([(0.32 * np.cos(b), 0.02, 0.32 * np.sin(b)), (0, Y1 - CHANDELIER[1], 0)], 0.007, 10)
        for b in (0.5, 2.6, 4.7)
    ]
    surfaces = [
        Surface("chandelier bowl", lathe(bowl, 36), plain("f8e2b8", 0.03), 0.020, emission=tuple(2.6 * BULB),
                blocks_light=False, translucency=0.6),
        Surface("chandelier", join(ring, *chains), plain("a97c2c", 0.05), 0.030, gloss=0.3, roughness=0.25),
    ]  # fmt: skip
    return [s.placed(position=CHANDELIER) for s in surfaces]


def seats() -> list[Surface]:
    """Folding seats in red plush with wooden arms, in rows that face the stage."""
    cushions, frames = [], []
    for z in SEAT_ROWS:
        for x in SEAT_X:
            back = superellipsoid((0.50, 0.56, 0.13), 0.35, 16).moved(translation=(x, 0.72, z + 0.22))
            seat = superellipsoid((0.50, 0.13, 0.44), 0.35, 14).moved(translation=(x, 0.43, z - 0.02))
            cushions += [back, seat]
            frames.append(box((x - 0.23, 0.0, z + 0.10), (x + 0.23, 0.38, z + 0.16)))
        for x in np.unique(np.round([s * 0.3 + c for c in SEAT_X for s in (-1, 1)], 3)):
            frames.append(box((x - 0.025, 0.0, z - 0.20), (x + 0.025, 0.62, z + 0.24)))
    plush = cloth("a32028", 0.02, 0.06, 0.05, 321)
    return [
        Surface("seat cushions", join(*cushions), plush, 0.052, width=1.1),
        Surface("seat frames", join(*frames), wood(WALNUT, axis=1, across=2, seed=323), 0.060, gloss=0.03),
    ]
