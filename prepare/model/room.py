"""The shell of the dining room: floor, walls, openings, mouldings, and the garden outside."""

from __future__ import annotations

import numpy as np

from prepare.model.layout import DOOR_X, DOOR_Y, ROOM_HIGH, ROOM_LOW, WINDOW_Y, WINDOW_Z
from prepare.model.light import Opening
from prepare.model.shapes import Mesh, Part, box, join, quad
from prepare.model.textures import OAK, fbm, mix, noise, plain, ramp, random_of, srgb, wood

(X0, Y0, Z0), (X1, Y1, Z1) = ROOM_LOW, ROOM_HIGH
PLANK = (X1 - X0) / 26  # [m] width of a floor board
DADO = 0.90  # [m] height of the white panelling
REVEAL = 0.14  # [m] depth of door and window
WHITE = "e9e4d8"


def shell() -> list[Part]:
    """All parts of the shell."""
    return [floor(), *walls(), *mouldings(), *door(), *window(), *garden()]


def openings() -> list[Opening]:
    """Where daylight comes in."""
    dx, dy = DOOR_X[1] - DOOR_X[0], DOOR_Y[1] - DOOR_Y[0]
    wz, wy = WINDOW_Z[1] - WINDOW_Z[0], WINDOW_Y[1] - WINDOW_Y[0]
    at = np.array
    return [
        Opening(at([DOOR_X[0], DOOR_Y[0], Z0 - 0.03]), at([dx, 0, 0]), at([0, dy, 0])),
        Opening(at([X0 - 0.03, WINDOW_Y[0], WINDOW_Z[0]]), at([0, 0, wz]), at([0, wy, 0])),
    ]


def floor() -> Part:
    """Staggered oak boards along z."""
    boards = []
    for i in range(26):
        ends = _board_ends(i)
        for z0, z1 in zip(ends[:-1], ends[1:], strict=True):
            boards.append(quad((X0 + i * PLANK, 0, z1), (PLANK, 0, 0), (0, 0, z0 - z1)))
    grain = wood(OAK, axis=2, board=PLANK, across=0, seed=3)

    def of(p, n):
        column = np.floor((p[:, 0] - X0) / PLANK).astype(int).clip(0, 25)
        ends = np.array([_board_ends(i) for i in range(26)])
        row = (p[:, 2:3] > ends[column, 1:-1]).sum(1)
        board = column * 8 + row
        near_end = np.abs(p[:, 2:3] - ends[column]).min(1)
        q = p + np.stack([0 * p[:, 0], 0.06 * random_of(board, 5), 9 * random_of(board, 6)], 1)
        tone = 0.80 + 0.40 * random_of(board, 7)
        warm = 1 + 0.10 * (random_of(board, 8) - 0.5)[:, None] * (1, 0, -1)
        return grain(q, n) * (tone * (0.75 + 0.25 * ramp(0, 0.004, near_end)))[:, None] * warm * 0.92

    return Part("floor", join(*boards), of, 0.0112, grain=(0, 0, 1), stretch=3.0, gloss=0.035, roughness=0.16)


def walls() -> list[Part]:
    """Four walls and the ceiling; sage green above the panelling, warm white below."""
    green, white = srgb("a9b29a"), srgb(WHITE)

    def paint(p, n):
        brushed = 1 + 0.05 * fbm(p * (2.0, 2.6, 2.0), 4, 11) + 0.03 * noise(p * 30, 12)
        return np.where(p[:, 1:2] < DADO, white, green) * brushed[:, None]

    def ceiling(p, n):
        return srgb("efece4") * (1 + 0.03 * fbm(p * 1.5, 3, 13))[:, None]

    height, depth = Y1 - Y0, Z1 - Z0
    far = _with_hole((X0, Y0, Z0), (X1 - X0, 0, 0), (0, height, 0), DOOR_X, DOOR_Y)
    left = _with_hole(
        (X0, Y0, Z1), (0, 0, -depth), (0, height, 0), (Z1 - WINDOW_Z[1], Z1 - WINDOW_Z[0]), WINDOW_Y, True
    )
    right = quad((X1, Y0, Z0), (0, 0, depth), (0, height, 0))
    near = quad((X1, Y0, Z1), (X0 - X1, 0, 0), (0, height, 0))
    top = quad((X0, Y1, Z0), (X1 - X0, 0, 0), (0, 0, depth))
    return [
        Part("far wall", far, paint, 0.020),
        Part("left wall", left, paint, 0.026),
        Part("right wall", right, paint, 0.026),
        Part("near wall", near, paint, 0.045),
        Part("ceiling", top, ceiling, 0.060),
    ]


def mouldings() -> list[Part]:
    """Skirting, dado rail, panel frames and a cornice."""
    white = plain(WHITE, 0.02)
    gap = 0.07  # the door's architrave ends the rails
    runs = [  # (from, to) along each wall, as boxes of the given height range and depth
        ((X0, Z0), (DOOR_X[0] - gap, Z0), "z+"),
        ((DOOR_X[1] + gap, Z0), (X1, Z0), "z+"),
        ((X0, Z0), (X0, Z1), "x+"),
        ((X1, Z0), (X1, Z1), "x-"),
        ((X0, Z1), (X1, Z1), "z-"),
    ]
    meshes = []
    for a, b, side in runs:
        meshes += [_strip(a, b, side, 0.0, 0.10, 0.016), _strip(a, b, side, 0.10, 0.118, 0.009)]
        low = DADO - 0.02
        meshes += [_strip(a, b, side, low, DADO + 0.012, 0.020), _strip(a, b, side, low - 0.022, low, 0.010)]
        meshes.append(_strip(a, b, side, Y1 - 0.07, Y1, 0.06))
    frames = []
    for x0, x1 in ((X0 + 0.10, DOOR_X[0] - 0.15), (DOOR_X[1] + 0.17, 0.62), (0.74, X1 - 0.12)):
        frames.append(_frame((x0, 0.21), (x1, 0.77), lambda u, v, w: (u, v, Z0 + w)))
    for z0, z1 in ((Z0 + 0.12, -1.15), (-1.03, 0.0), (0.12, 1.15)):
        frames.append(_frame((z0, 0.21), (z1, 0.77), lambda u, v, w: (X0 + w, v, u)))
        frames.append(_frame((z0, 0.21), (z1, 0.77), lambda u, v, w: (X1 - w, v, u)))
    return [
        Part("mouldings", join(*meshes), white, 0.034, gloss=0.02),
        Part("panel frames", join(*frames), white, 0.026, gloss=0.02),
    ]


def door() -> list[Part]:
    """Glazed garden door of two leaves, white, with an architrave."""
    (x0, x1), (y0, y1) = DOOR_X, DOOR_Y
    middle, z = 0.5 * (x0 + x1), Z0 - 0.06
    bars = []
    for a, b in ((x0, middle - 0.003), (middle + 0.003, x1)):
        bars += [box((a, y0, z), (a + 0.055, y1, z + 0.045)), box((b - 0.055, y0, z), (b, y1, z + 0.045))]
        for low, high in ((y0, y0 + 0.17), (y0 + 0.80, y0 + 0.83), (y0 + 1.42, y0 + 1.45), (y1 - 0.06, y1)):
            bars.append(box((a + 0.055, low, z + 0.004), (b - 0.055, high, z + 0.041)))
    w = 0.065
    trim = [
        box((x0 - w, 0, Z0), (x0, y1 + w, Z0 + 0.022)),
        box((x1, 0, Z0), (x1 + w, y1 + w, Z0 + 0.022)),
        box((x0, y1, Z0), (x1, y1 + w, Z0 + 0.022)),
        box((x0, 0, Z0 - REVEAL), (x1, y0, Z0 + 0.01)),
    ]
    inner = _reveal((x0, y0), (x1, y1), lambda u, v, w: (u, v, Z0 - w))
    white = plain("e6e1d5", 0.02)
    handle = join(
        box((middle - 0.040, 0.98, z + 0.045), (middle - 0.022, 1.12, z + 0.050)),
        box((middle - 0.036, 1.045, z + 0.05), (middle - 0.026, 1.055, z + 0.09)),
        box((middle - 0.135, 1.042, z + 0.078), (middle - 0.026, 1.058, z + 0.092)),
    )
    return [
        Part("door", join(*bars), white, 0.011, gloss=0.03),
        Part("architrave", join(*trim, inner), white, 0.017, gloss=0.02),
        Part("handle", handle, plain("8a6a30", 0.05), 0.006, gloss=0.25),
    ]


def window() -> list[Part]:
    """Casement window in the left wall, with a sill."""
    (z0, z1), (y0, y1) = WINDOW_Z, WINDOW_Y
    x, middle = X0 - 0.06, 0.5 * (z0 + z1)
    bars = []
    for a, b in ((z0, middle - 0.003), (middle + 0.003, z1)):
        bars += [box((x, y0, a), (x + 0.045, y1, a + 0.05)), box((x, y0, b - 0.05), (x + 0.045, y1, b))]
        for low, high in ((y0, y0 + 0.06), (y0 + 0.80, y0 + 0.825), (y1 - 0.06, y1)):
            bars.append(box((x + 0.004, low, a + 0.05), (x + 0.041, high, b - 0.05)))
    sill = box((X0 - REVEAL, y0 - 0.03, z0 - 0.05), (X0 + 0.07, y0, z1 + 0.05))
    inner = _reveal((z0, y0), (z1, y1), lambda u, v, w: (X0 - w, v, u), flip=True)
    white = plain("e6e1d5", 0.02)
    return [
        Part("window", join(*bars), white, 0.018, gloss=0.03),
        Part("sill", join(sill, inner), white, 0.018, gloss=0.03),
    ]


def garden() -> list[Part]:
    """Terrace, hedge and sky: bright and soft, as a camera set for the room sees them."""

    def terrace(p, n):
        stone = 0.80 + 0.14 * fbm(p * (1.6, 1, 1.6), 3, 21) + 0.05 * noise(p * 9, 22)
        joint = np.minimum(*(np.abs((p[:, k] / 0.6 + 0.5) % 1 - 0.5) for k in (0, 2)))
        stone = stone * (0.85 + 0.15 * ramp(0, 0.05, joint))
        return mix(srgb("c9b896"), srgb("b7c08c"), ramp(-5.3, -5.6, p[:, 2])) * stone[:, None]

    def hedge(p, n):
        leaves = fbm(p * (1.3, 1.5, 1.3), 4, 23)
        green = mix(srgb("7f9a5c"), srgb("c2d08e"), ramp(-0.5, 0.6, leaves + 0.25 * (p[:, 1] - 1)))
        sky = mix(srgb("e8eef2"), srgb("cfe2f5"), ramp(1.5, 4.0, p[:, 1]))
        crown = p[:, 1] - 1.75 - 0.55 * fbm(p * (0.8, 0.0, 0.8), 3, 25) - 0.25 * leaves
        return mix(green, sky * 1.0, ramp(-0.12, 0.16, crown))

    outside = {"casts": False, "fixed": True}
    ground = quad((-5.5, -0.12, Z0 - REVEAL), (6.5, 0, 0), (0, 0, -4.8))
    back = quad((-6.5, -0.3, -7.0), (8.5, 0, 0), (0, 4.4, 0))
    side_back = quad((-5.6, -0.3, 4.5), (0, 0, -9.0), (0, 4.4, 0))
    return [
        Part("terrace", ground, terrace, 0.095, emission=(3.0, 2.9, 2.7), **outside),
        Part("hedge", back, hedge, 0.11, emission=(3.6, 3.7, 3.6), **outside),
        Part("side hedge", side_back, hedge, 0.13, emission=(3.6, 3.7, 3.6), **outside),
    ]


def _board_ends(column: int) -> np.ndarray:
    """z of the four board ends of a column [m]: two staggered joints between the walls."""
    first = Z0 + 0.5 + 1.3 * random_of(np.array(column), 1)
    return np.array([Z0, first, first + 1.1 + 0.6 * random_of(np.array(column), 2), Z1])


def _with_hole(corner, along, up, span, heights, relative: bool = False) -> Mesh:
    """Rectangle with a rectangular hole, `span` along it (world or, if `relative`, from the corner) and `heights`."""
    corner, along, up = (np.asarray(a, float) for a in (corner, along, up))
    length, height = np.linalg.norm(along), np.linalg.norm(up)
    start = 0.0 if relative else corner @ (along / length)
    u0, u1 = ((s - start) / length for s in span)
    v0, v1 = ((h - corner[1]) / height for h in heights)
    uv = np.array([(0, 0), (1, 0), (1, 1), (0, 1), (u0, v0), (u1, v0), (u1, v1), (u0, v1)])
    quads = np.array([(k, (k + 1) % 4, 4 + (k + 1) % 4, 4 + k) for k in range(4)])
    return Mesh(corner + uv[:, :1] * along + uv[:, 1:] * up, np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]]))


def _strip(a, b, side: str, low: float, high: float, depth: float) -> Mesh:
    """Box along a wall from a to b (x, z), standing out by `depth` towards `side`."""
    p, q = np.array([a[0], low, a[1]]), np.array([b[0], high, b[1]])
    axis, sign = (0 if side[0] == "x" else 2), (1 if side[1] == "+" else -1)
    (p if sign < 0 else q)[axis] += sign * depth
    return box(np.minimum(p, q), np.maximum(p, q))


def _frame(low, high, to_wall, width: float = 0.022, depth: float = 0.009) -> Mesh:
    """Rectangular frame of four bars on a wall; `to_wall` maps (along, up, out) to the world."""
    (u0, v0), (u1, v1) = low, high
    bars = [(u0, v0, u1, v0 + width), (u0, v1 - width, u1, v1), (u0, v0 + width, u0 + width, v1 - width)]
    bars.append((u1 - width, v0 + width, u1, v1 - width))
    meshes = []
    for a, b, c, d in bars:
        p, q = np.array(to_wall(a, b, 0.0)), np.array(to_wall(c, d, depth))
        meshes.append(box(np.minimum(p, q), np.maximum(p, q)))
    return join(*meshes)


def _reveal(low, high, to_wall, flip: bool = False) -> Mesh:
    """The four inner faces of an opening, `REVEAL` deep."""
    (u0, v0), (u1, v1) = low, high
    loop = [(u0, v0), (u1, v0), (u1, v1), (u0, v1)]
    meshes = []
    for (a, b), (c, d) in zip(loop, loop[1:] + loop[:1], strict=True):
        p, q, r = (np.array(to_wall(*t)) for t in ((a, b, 0), (c, d, 0), (a, b, REVEAL)))
        meshes.append(quad(p, r - p, q - p) if not flip else quad(p, q - p, r - p))
    return join(*meshes)
