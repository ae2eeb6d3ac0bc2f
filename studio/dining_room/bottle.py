"""The bottle, peg of the ring toss: dark green glass with a label and a foil capsule."""

from __future__ import annotations

import numpy as np

from studio.dining_room.furniture import TABLE_TOP
from studio.shapes import Mesh, Surface, grid_mesh, lathe, smooth_curve
from studio.textures import mix, plain, smoothstep, srgb

BOTTLE_AT = (0.0, TABLE_TOP, -0.15)  # [m] centre of its base in the room
BOTTLE_HEIGHT = 0.30  # [m]
BODY_RADIUS, NECK_RADIUS = 0.0368, 0.0138  # [m]
TRANSMITTANCE = np.array([0.10, 0.30, 0.07])  # along the diameter of the body, linear RGB
LABEL_Y, LABEL_HALF_ANGLE = (0.058, 0.148), np.radians(78)  # [m], [rad] to either side of +z
LETTERS = np.array(  # "VR-GS"
    [
        [dot == "#" for dot in row]
        for row in (
            "#...#.####.........###...####",
            "#...#.#...#.......#...#.#....",
            "#...#.#...#.......#.....#....",
            "#...#.####..#####.#.###..###.",
            "#...#.#.#.........#...#.....#",
            ".#.#..#..#........#...#.....#",
            "..#...#...#........###..####.",
        )
    ]
)
LETTER_DOT = 0.0019  # [m]
FOIL_Y = 0.238  # [m] lower end of the foil


def profile() -> np.ndarray:
    """Outline (K, 2) as (radius, y) [m], from the axis at the bottom to the axis at the top."""
    body, neck = BODY_RADIUS, NECK_RADIUS
    side = smooth_curve(
        [(body - 0.004, 0.0), (body - 0.0008, 0.0035), (body, 0.010), (body, 0.100), (body, 0.175), (0.0350, 0.192),
         (0.0285, 0.208), (0.0205, 0.222), (0.0162, 0.236), (neck + 0.0004, 0.255), (neck, 0.285)],
        90,
    )  # fmt: skip
    lip = [(neck + 0.0016, 0.2855), (neck + 0.0016, 0.2965), (neck + 0.0002, BOTTLE_HEIGHT)]
    return np.concatenate([[(0.0, 0.0)], side, lip, [(0.0, BOTTLE_HEIGHT)]])


def bottle_surfaces() -> list[Surface]:
    """Glass, foil and label, placed in the room."""
    curve = profile()
    cut = int(np.searchsorted(curve[1:-4, 1], FOIL_Y)) + 1
    foil = curve[cut:] + np.where(curve[cut:, :1] > 0, (0.0004, 0.0), (0.0, 0.0))
    surfaces = [
        Surface("glass", lathe(curve[: cut + 2], 64), plain(TRANSMITTANCE * 0.12), 0.0038, uniform=True),
        Surface("foil", lathe(foil, 48), plain("5c0f16", 0.04), 0.0034, uniform=True),
        Surface("label", _label_mesh(), label, 0.0019, uniform=True),
    ]
    return [p.placed(position=BOTTLE_AT) for p in surfaces]


def label(p, n):
    """Albedo (N, 3) of the label: cream paper with a red foot, gold lines and an emblem of three rings."""
    u = np.arctan2(p[:, 0], p[:, 2]) * BODY_RADIUS  # [m] along the paper, 0 in the middle
    v = p[:, 1] - LABEL_Y[0]
    height = LABEL_Y[1] - LABEL_Y[0]
    gold, red = srgb("b08a3c"), srgb("8e2420")
    c = np.broadcast_to(srgb("f3ead2"), p.shape)
    c = np.where((v < 0.022)[:, None], red, c)
    for y, half in ((0.0245, 0.0012), (height - 0.006, 0.0012)):
        c = np.where((np.abs(v - y) < half)[:, None], gold, c)
    for x, y, colour in ((-0.0095, 0.0575, "c8321f"), (0.0095, 0.0575, "1c5fae"), (0.0, 0.068, "e0a416")):
        ring = np.abs(np.hypot(u - x, v - y) - 0.0085)
        c = mix(c, srgb(colour), 1 - smoothstep(0.0013, 0.0021, ring))
    row, column = np.floor((0.0415 - v) / LETTER_DOT).astype(int), np.floor(u / LETTER_DOT + 14.5).astype(int)
    inside = (row >= 0) & (row < 7) & (column >= 0) & (column < 29)
    letters = inside & LETTERS[row.clip(0, 6), column.clip(0, 28)]
    return mix(c, srgb("3a2a26"), 0.95 * letters)


def _label_mesh() -> Mesh:
    """Sheet of paper around the body."""
    a = np.linspace(-LABEL_HALF_ANGLE, LABEL_HALF_ANGLE, 60)
    y = np.linspace(*LABEL_Y, 12)
    r = BODY_RADIUS + 0.0004
    points = np.stack(np.broadcast_arrays(r * np.sin(a)[:, None], y[None], r * np.cos(a)[:, None]), -1)
    return grid_mesh(points)
