"""The shell of the dining room: floor, walls, openings, mouldings, and the garden outside."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from studio.light_sources import Opening, Sun
from studio.shapes import Mesh, Surface, box, join, quad
from studio.textures import OAK, fbm, hash_uniform, mix, noise, plain, smoothstep, srgb, wood
from studio.walls import reveal, wall_sheet, within

ROOM_LOW, ROOM_HIGH = (-2.0, 0.0, -2.2), (2.0, 2.6, 2.3)  # [m] scenes repeat them for their analytic colliders
# Openings: (low, high) across the wall [m]. The garden door is in the far wall, the window in the left one.
DOOR_X, DOOR_Y = (-1.45, -0.35), (0.04, 2.12)
WINDOW_Z, WINDOW_Y = (-0.55, 0.95), (0.85, 2.12)
REVEAL = 0.14  # [m] depth of door and window in the wall
(X0, Y0, Z0), (X1, Y1, Z1) = ROOM_LOW, ROOM_HIGH
PLANK_WIDTH = (X1 - X0) / 26  # [m]
DADO_HEIGHT = 0.90  # [m] of the white panelling
ARCHITRAVE_WIDTH = 0.065  # [m] of the frame around the door
PANEL_Y, BAR_WIDTH = (0.21, 0.77), 0.022  # [m] height of the panel frames, width of their bars
FAR_PANELS = [(X0 + 0.10, DOOR_X[0] - 0.15), (DOOR_X[1] + 0.17, 0.62), (0.74, X1 - 0.12)]  # along x
SIDE_PANELS = [(Z0 + 0.12, -1.15), (-1.03, 0.0), (0.12, 1.15), (1.27, Z1 - 0.12)]  # along z
WHITE = "efebe2"
SUNLIGHT = np.array([0.50, -0.66, 0.62])  # direction in which the sun's light travels
SUN = Sun(SUNLIGHT / np.linalg.norm(SUNLIGHT), np.array([1.0, 0.86, 0.66]) * 22)
FILL_LIGHT = (0.16, 0.16, 0.16)  # added to frames seen against the sky, like a photographer's fill light


def shell() -> list[Surface]:
    """Floor, walls, mouldings, door and window."""
    return [floor(), *walls(), *mouldings(), *door(), *window()]


def openings() -> list[Opening]:
    """Openings through which daylight enters."""
    dx, dy = DOOR_X[1] - DOOR_X[0], DOOR_Y[1] - DOOR_Y[0]
    wz, wy = WINDOW_Z[1] - WINDOW_Z[0], WINDOW_Y[1] - WINDOW_Y[0]
    at = np.array
    return [
        Opening(at([DOOR_X[0], DOOR_Y[0], Z0 - 0.03]), at([dx, 0, 0]), at([0, dy, 0])),
        Opening(at([X0 - 0.03, WINDOW_Y[0], WINDOW_Z[0]]), at([0, 0, wz]), at([0, wy, 0])),
    ]


def floor() -> Surface:
    """Staggered oak boards along z."""
    boards = []
    for i in range(26):
        ends = _board_ends(i)
        for z0, z1 in pairwise(ends):
            boards.append(quad((X0 + i * PLANK_WIDTH, 0, z1), (PLANK_WIDTH, 0, 0), (0, 0, z0 - z1)))
    grain = wood(OAK, axis=2, board=PLANK_WIDTH, across=0, seed=3)

    def colour_at(p, n):
        column = np.floor((p[:, 0] - X0) / PLANK_WIDTH).astype(int).clip(0, 25)
        ends = np.array([_board_ends(i) for i in range(26)])
        row = (p[:, 2:3] > ends[column, 1:-1]).sum(1)
        board = column * 8 + row
        near_end = np.abs(p[:, 2:3] - ends[column]).min(1)
        q = p + np.stack([0 * p[:, 0], 0.06 * hash_uniform(board, 5), 9 * hash_uniform(board, 6)], 1)
        tone = 0.80 + 0.40 * hash_uniform(board, 7)
        warm = 1 + 0.10 * (hash_uniform(board, 8) - 0.5)[:, None] * (1, 0, -1)
        return grain(q, n) * (tone * (0.75 + 0.25 * smoothstep(0, 0.004, near_end)))[:, None] * warm * 0.92

    return Surface("floor", join(*boards), colour_at, 0.0112, grain=(0, 0, 1), stretch=3.0, gloss=0.035, roughness=0.16)


def walls() -> list[Surface]:
    """Four walls and the ceiling; sage green above the panelling, warm white below."""
    green, white = srgb("a9b29a"), srgb(WHITE)

    def paint(p, n):
        brushed = 1 + 0.025 * fbm(p * (1.2, 1.6, 1.2), 2, 11)
        return np.where(p[:, 1:2] < DADO_HEIGHT, white, green) * brushed[:, None]

    def ceiling(p, n):
        return srgb("efece4") * (1 + 0.02 * fbm(p * 1.5, 2, 13))[:, None]

    sides = {
        "far": ((X0, X1), [*_bars(FAR_PANELS)], lambda u, v: (u, v, Z0)),
        "left": ((Z1, Z0), [(*WINDOW_Z, *WINDOW_Y), *_bars(SIDE_PANELS)], lambda u, v: (X0, v, u)),
        "right": ((Z0, Z1), _bars(SIDE_PANELS), lambda u, v: (X1, v, u)),
        "near": ((X1, X0), [], lambda u, v: (u, v, Z1)),
    }
    sides["far"][1].append(
        (DOOR_X[0] - ARCHITRAVE_WIDTH, DOOR_X[1] + ARCHITRAVE_WIDTH, 0.0, DOOR_Y[1] + ARCHITRAVE_WIDTH)
    )
    fineness = {"far": 0.012, "left": 0.016, "right": 0.016, "near": 0.030}
    surfaces = []
    for name, (span, holes, to_room) in sides.items():  # left out behind the rails
        lower = wall_sheet(span, (0.118, DADO_HEIGHT - 0.042), holes, to_room)
        upper = wall_sheet(span, (DADO_HEIGHT + 0.012, Y1 - 0.07), holes, to_room)
        surfaces.append(Surface(f"{name} panelling", lower, paint, fineness[name], width=1.1))
        surfaces.append(
            Surface(f"{name} wall", upper, paint, {"far": 0.020, "near": 0.045}.get(name, 0.030), width=1.2)
        )
    top = quad((X0, Y1, Z0), (X1 - X0, 0, 0), (0, 0, Z1 - Z0))
    return [*surfaces, Surface("ceiling", top, ceiling, 0.060, width=1.2)]


def mouldings() -> list[Surface]:
    """Skirting, dado rail, panel frames and a cornice."""
    white = plain(WHITE, 0.01)
    runs = [  # (x, z) from and to along each wall, and its inward normal
        ((X0, Z0), (DOOR_X[0] - ARCHITRAVE_WIDTH, Z0), "z+"),
        ((DOOR_X[1] + ARCHITRAVE_WIDTH, Z0), (X1, Z0), "z+"),
        ((X0, Z0), (X0, Z1), "x+"),
        ((X1, Z0), (X1, Z1), "x-"),
        ((X0, Z1), (X1, Z1), "z-"),
    ]
    low, meshes = DADO_HEIGHT - 0.02, []
    for a, b, side in runs:
        meshes += [_strip(a, b, side, 0.0, 0.10, 0.016), _strip(a, b, side, 0.10, 0.118, 0.009)]
        meshes += [_strip(a, b, side, low, DADO_HEIGHT + 0.012, 0.020), _strip(a, b, side, low - 0.022, low, 0.010)]
    for a, b, side in (((X0, Z0), (X1, Z0), "z+"), *runs[2:]):
        meshes.append(_strip(a, b, side, Y1 - 0.07, Y1, 0.05))
    depth = 0.009
    frames = [box((a, c, Z0 - depth), (b, d, Z0 + depth)) for a, b, c, d in _bars(FAR_PANELS)]
    for a, b, c, d in _bars(SIDE_PANELS):
        frames += [box((X0 - depth, c, a), (X0 + depth, d, b)), box((X1 - depth, c, a), (X1 + depth, d, b))]
    frames = [within(m, ROOM_LOW, ROOM_HIGH) for m in frames]
    return [
        Surface("mouldings", join(*meshes), white, 0.034, gloss=0.02),
        Surface("panel frames", join(*frames), white, 0.026, gloss=0.02),
    ]


def door() -> list[Surface]:
    """Glazed garden door of two leaves, white, with an architrave."""
    (x0, x1), (y0, y1) = DOOR_X, DOOR_Y
    middle, z = 0.5 * (x0 + x1), Z0 - 0.06
    bars = []
    for a, b in ((x0, middle - 0.003), (middle + 0.003, x1)):
        bars += [box((a, y0, z), (a + 0.055, y1, z + 0.045)), box((b - 0.055, y0, z), (b, y1, z + 0.045))]
        for low, high in ((y0, y0 + 0.17), (y0 + 0.80, y0 + 0.83), (y0 + 1.42, y0 + 1.45), (y1 - 0.06, y1)):
            bars.append(box((a + 0.055, low, z + 0.004), (b - 0.055, high, z + 0.041)))
    w = ARCHITRAVE_WIDTH
    trim = [
        box((x0 - w, 0, Z0), (x0, y1 + w, Z0 + 0.022)),
        box((x1, 0, Z0), (x1 + w, y1 + w, Z0 + 0.022)),
        box((x0, y1, Z0), (x1, y1 + w, Z0 + 0.022)),
        box((x0, 0, Z0 - REVEAL), (x1, y0, Z0 + 0.01)),
    ]
    inner = reveal((x0, y0), (x1, y1), REVEAL, lambda u, v, w: (u, v, Z0 - w))
    white = plain("f1eee6", 0.01)
    handle = join(
        box((middle - 0.040, 0.98, z + 0.045), (middle - 0.022, 1.12, z + 0.050)),
        box((middle - 0.036, 1.045, z + 0.05), (middle - 0.026, 1.055, z + 0.09)),
        box((middle - 0.135, 1.042, z + 0.078), (middle - 0.026, 1.058, z + 0.092)),
    )
    return [
        Surface("door", join(*bars), white, 0.011, emission=FILL_LIGHT),
        Surface("architrave", join(*trim, inner), white, 0.017, emission=FILL_LIGHT),
        Surface("handle", handle, plain("8a6a30", 0.05), 0.006, gloss=0.25),
    ]


def window() -> list[Surface]:
    """Casement window in the left wall, with a sill."""
    (z0, z1), (y0, y1) = WINDOW_Z, WINDOW_Y
    x, middle = X0 - 0.06, 0.5 * (z0 + z1)
    bars = []
    for a, b in ((z0, middle - 0.003), (middle + 0.003, z1)):
        bars += [box((x, y0, a), (x + 0.045, y1, a + 0.05)), box((x, y0, b - 0.05), (x + 0.045, y1, b))]
        for low, high in ((y0, y0 + 0.06), (y0 + 0.80, y0 + 0.825), (y1 - 0.06, y1)):
            bars.append(box((x + 0.004, low, a + 0.05), (x + 0.041, high, b - 0.05)))
    sill = box((X0 - REVEAL, y0 - 0.03, z0 - 0.05), (X0 + 0.07, y0, z1 + 0.05))
    inner = reveal((z0, y0), (z1, y1), REVEAL, lambda u, v, w: (X0 - w, v, u), flip=True)
    white = plain("f1eee6", 0.01)
    return [
        Surface("window", join(*bars), white, 0.018, emission=FILL_LIGHT),
        Surface("sill", join(sill, inner), white, 0.018, gloss=0.03),
    ]


def garden() -> list[Surface]:
    """Terrace, hedge and sky: bright and soft, as a camera exposed for the room sees them."""

    def terrace(p, n):
        stone = 0.80 + 0.14 * fbm(p * (1.6, 1, 1.6), 3, 21) + 0.05 * noise(p * 9, 22)
        joint = np.minimum(*(np.abs((p[:, k] / 0.6 + 0.5) % 1 - 0.5) for k in (0, 2)))
        stone = stone * (0.85 + 0.15 * smoothstep(0, 0.05, joint))
        return mix(srgb("c9b896"), srgb("b7c08c"), smoothstep(-5.3, -5.6, p[:, 2])) * stone[:, None]

    def hedge(p, n):
        leaves = fbm(p * (1.3, 1.5, 1.3), 4, 23)
        green = mix(srgb("7f9a5c"), srgb("c2d08e"), smoothstep(-0.5, 0.6, leaves + 0.25 * (p[:, 1] - 1)))
        sky = mix(srgb("e8eef2"), srgb("cfe2f5"), smoothstep(1.5, 4.0, p[:, 1]))
        crown = p[:, 1] - 1.75 - 0.55 * fbm(p * (0.8, 0.0, 0.8), 3, 25) - 0.25 * leaves
        return mix(green, sky * 1.0, smoothstep(-0.12, 0.16, crown))

    outdoors = {"blocks_light": False, "uniform": True}
    ground = quad((-5.5, -0.12, Z0 - REVEAL), (6.5, 0, 0), (0, 0, -4.8))
    back = quad((-6.5, -0.3, -7.0), (8.5, 0, 0), (0, 4.4, 0))
    side_back = quad((-5.6, -0.3, 4.5), (0, 0, -9.0), (0, 4.4, 0))
    return [
        Surface("terrace", ground, terrace, 0.12, width=1.2, emission=(3.0, 2.9, 2.7), **outdoors),
        Surface("hedge", back, hedge, 0.12, width=1.2, emission=(3.6, 3.7, 3.6), **outdoors),
        Surface("side hedge", side_back, hedge, 0.15, width=1.2, emission=(3.6, 3.7, 3.6), **outdoors),
    ]


def _board_ends(column: int) -> np.ndarray:
    """z of the four board ends of a column [m]: two staggered joints between the walls."""
    first = Z0 + 0.5 + 1.3 * hash_uniform(np.array(column), 1)
    return np.array([Z0, first, first + 1.1 + 0.6 * hash_uniform(np.array(column), 2), Z1])


def _bars(panels) -> list[tuple[float, float, float, float]]:
    """The four bars (along from, to, up from, to) of each panel frame."""
    v0, v1 = PANEL_Y
    bars = []
    for a, b in panels:
        bars += [
            (a, b, v0, v0 + BAR_WIDTH),
            (a, b, v1 - BAR_WIDTH, v1),
            (a, a + BAR_WIDTH, v0 + BAR_WIDTH, v1 - BAR_WIDTH),
        ]
        bars.append((b - BAR_WIDTH, b, v0 + BAR_WIDTH, v1 - BAR_WIDTH))
    return bars


def _strip(a, b, side: str, low: float, high: float, depth: float) -> Mesh:
    """Box along a wall from a to b (x, z), protruding by `depth` towards `side`; its back is left out."""
    p, q = np.array([a[0], low, a[1]]), np.array([b[0], high, b[1]])
    axis, sign = (0 if side[0] == "x" else 2), (1 if side[1] == "+" else -1)
    (p if sign < 0 else q)[axis] += sign * depth
    (q if sign < 0 else p)[axis] -= sign * depth
    return within(box(np.minimum(p, q), np.maximum(p, q)), ROOM_LOW, ROOM_HIGH)
