"""The shell of the children's room: boards, walls with painted hills and clouds, a window, and the trees outside."""

from __future__ import annotations

import numpy as np

from studio.light_sources import Opening, Sun
from studio.shapes import Surface, box, join, quad, tube
from studio.textiles import drape
from studio.textures import cloth, fbm, hash_uniform, mix, plain, smoothstep, srgb, wood
from studio.walls import reveal, wall_sheet

ROOM_LOW, ROOM_HIGH = (-1.9, 0.0, -1.7), (1.9, 2.45, 2.1)  # [m] scenes repeat them for their analytic colliders
WINDOW_X, WINDOW_Y = (-0.85, 0.35), (0.86, 1.98)  # [m] in the far wall
REVEAL = 0.12  # [m] depth of the window in the wall
(X0, Y0, Z0), (X1, Y1, Z1) = ROOM_LOW, ROOM_HIGH
BOARD = 0.145  # [m] width of a floor board
PINE = ((0.64, 0.45, 0.27), (0.47, 0.29, 0.145))
CREAM, CLOUD = "f5ecdc", "ffffff"
HILLS = (("c3d7c0", 0.98, 0.10), ("9fc1ab", 0.74, 0.13), ("7fa893", 0.46, 0.09))  # colour, height, amplitude [m]
SUN = Sun(np.array([0.50, -0.66, 0.62]) / np.linalg.norm([0.50, -0.66, 0.62]), np.array([1.0, 0.86, 0.66]) * 22)
CURTAIN_OFFSET = 0.10  # [m] from the wall


def shell() -> list[Surface]:
    """Floor, walls, ceiling, skirting, window with curtains, and the view."""
    return [floor(), *walls(), skirting(), *window(), *curtains(), *outside()]


def openings() -> list[Opening]:
    """The window, through which daylight enters."""
    (x0, x1), (y0, y1) = WINDOW_X, WINDOW_Y
    return [Opening(np.array([x0, y0, Z0 - 0.03]), np.array([x1 - x0, 0, 0]), np.array([0, y1 - y0, 0]))]


def floor() -> Surface:
    """Pale pine boards along x."""
    grain = wood(PINE, axis=0, board=BOARD, across=2, seed=201)

    def colour_at(p, n):
        board = np.floor((p[:, 2] - Z0) / BOARD).astype(int)
        start = 1.7 * hash_uniform(board, 202)
        piece = board * 7 + np.floor((p[:, 0] + start) / 1.7).astype(int)
        end = np.abs((p[:, 0] + start) / 1.7 - np.round((p[:, 0] + start) / 1.7)) * 1.7
        q = p + np.stack([5 * hash_uniform(piece, 203), 0 * end, 0 * end], 1)
        tone = (0.90 + 0.18 * hash_uniform(piece, 204)) * (0.72 + 0.28 * smoothstep(0, 0.004, end))
        return grain(q, n) * tone[:, None]

    mesh = quad((X0, 0, Z1), (X1 - X0, 0, 0), (0, 0, Z0 - Z1))
    return Surface("floor", mesh, colour_at, 0.0135, grain=(1, 0, 0), stretch=3.2, gloss=0.03, roughness=0.2)


def walls() -> list[Surface]:
    """Four walls and the ceiling."""

    def paint(along: int, seed: int):
        def colour_at(p, n):
            x, y = p[:, along] + 5.3 * seed, p[:, 1]
            c = srgb(CREAM) * np.ones((len(p), 1))
            puff = np.zeros(len(p))
            for k in range(6):  # a cloud is a row of discs on a flat base
                cx, cy = 1.55 * np.floor((x + 0.4) / 1.55) + 0.35, 1.86 - 0.16 * (np.floor((x + 0.4) / 1.55) % 2)
                dx = x - cx - 0.12 * (k - 2.5)
                r = 0.085 + 0.075 * np.sin(1.3 * k + 0.4) ** 2
                puff = np.maximum(puff, smoothstep(r + 0.012, r - 0.012, np.hypot(dx, y - cy)) * (y > cy - 0.05))
            c = mix(c, srgb(CLOUD), puff)
            for k, (tone, height, amplitude) in enumerate(HILLS):
                crest = height + amplitude * np.sin(x * (1.9 + 0.8 * k) + 2.1 * k) * np.cos(0.7 * x + k)
                c = mix(c, srgb(tone), smoothstep(crest + 0.012, crest - 0.012, y))
            return c * (1 + 0.02 * fbm(p * 1.7, 2, 211 + seed))[:, None]

        return colour_at

    window = (*WINDOW_X, *WINDOW_Y)
    sides = {
        "far": ((X0, X1), [window], lambda u, v: (u, v, Z0), 0, 0.0145),
        "left": ((Z1, Z0), [], lambda u, v: (X0, v, u), 2, 0.017),
        "right": ((Z0, Z1), [], lambda u, v: (X1, v, u), 2, 0.017),
        "near": ((X1, X0), [], lambda u, v: (u, v, Z1), 0, 0.03),
    }
    surfaces = [
        Surface(f"{name} wall", wall_sheet(span, (0.08, Y1), holes, to_room), paint(axis, k), fineness, width=1.15)
        for k, (name, (span, holes, to_room, axis, fineness)) in enumerate(sides.items())
    ]
    top = quad((X0, Y1, Z0), (X1 - X0, 0, 0), (0, 0, Z1 - Z0))
    return [*surfaces, Surface("ceiling", top, plain("f3efe6", 0.01), 0.06, width=1.2)]


def skirting() -> Surface:
    """White skirting boards."""
    h, d = 0.08, 0.014
    boards = [
        quad((X0, 0, Z0 + d), (X1 - X0, 0, 0), (0, h, 0)), quad((X0, h, Z0 + d), (X1 - X0, 0, 0), (0, 0, -d)),
        quad((X0 + d, 0, Z1), (0, 0, Z0 - Z1), (0, h, 0)), quad((X0 + d, h, Z1), (0, 0, Z0 - Z1), (-d, 0, 0)),
        quad((X1 - d, 0, Z0), (0, 0, Z1 - Z0), (0, h, 0)), quad((X1 - d, h, Z0), (0, 0, Z1 - Z0), (d, 0, 0)),
        quad((X1, 0, Z1 - d), (X0 - X1, 0, 0), (0, h, 0)), quad((X1, h, Z1 - d), (X0 - X1, 0, 0), (0, 0, d)),
    ]  # fmt: skip
    return Surface("skirting", join(*boards), plain("f6f1e6", 0.01), 0.032)


def window() -> list[Surface]:
    """White casement window of two wings, its reveal and sill."""
    (x0, x1), (y0, y1) = WINDOW_X, WINDOW_Y
    z, middle, bars = Z0 - 0.07, 0.5 * (x0 + x1), []
    for a, b in ((x0, middle - 0.003), (middle + 0.003, x1)):
        bars += [box((a, y0, z), (a + 0.05, y1, z + 0.045)), box((b - 0.05, y0, z), (b, y1, z + 0.045))]
        for low, high in ((y0, y0 + 0.055), (y0 + 0.66, y0 + 0.685), (y1 - 0.055, y1)):
            bars.append(box((a + 0.05, low, z + 0.004), (b - 0.05, high, z + 0.041)))
    sill = box((x0 - 0.05, y0 - 0.03, Z0 - REVEAL), (x1 + 0.05, y0, Z0 + 0.08))
    inner = reveal((x0, y0), (x1, y1), REVEAL, lambda u, v, w: (u, v, Z0 - w))
    white = plain("f6f2e8", 0.01)
    return [
        Surface("window", join(*bars), white, 0.016, emission=(0.16, 0.16, 0.16)),  # as by a photographer's fill light
        Surface("sill", join(sill, inner), white, 0.017, gloss=0.03),
    ]


def curtains() -> list[Surface]:
    """Yellow drapes on a wooden rod."""
    (x0, x1), y, z = WINDOW_X, 2.12, Z0 + CURTAIN_OFFSET
    yellow, surfaces = cloth("efc46a", 0.012, 0.06, 0.03, 221), []
    for a, b, seed in ((x0 - 0.30, x0 + 0.04, 1.0), (x1 - 0.04, x1 + 0.30, 2.0)):
        mesh = drape((a, b), (0.70, y - 0.02), 5, seed, lambda u, v, d: (u, v, z + d))
        surfaces.append(
            Surface("curtain", mesh, yellow, 0.0125, grain=(0, 1, 0), stretch=3.0, translucency=0.4, width=1.12)
        )
    rod = tube([(x0 - 0.36, y, z), (x1 + 0.36, y, z)], 0.013, 12)
    return [*surfaces, Surface("rod", rod, plain("8a6238"), 0.010, grain=(1, 0, 0), stretch=5.0)]


def outside() -> list[Surface]:
    """Crowns of trees against the sky, bright and soft, as a camera exposed for the room sees them."""

    def view(p, n):
        leaves = fbm(p * (1.4, 1.6, 1.4), 4, 231)
        green = mix(srgb("7f9f55"), srgb("c9d98c"), smoothstep(-0.5, 0.6, leaves))
        sky = mix(srgb("eaf1f4"), srgb("bcd9f2"), smoothstep(1.2, 3.6, p[:, 1]))
        crown = p[:, 1] - 1.45 - 0.55 * fbm(p * (0.9, 0.0, 0.9), 3, 233) - 0.2 * leaves
        return mix(green, sky, smoothstep(-0.1, 0.14, crown))

    back = quad((-6.0, -1.0, -5.5), (10.5, 0, 0), (0, 6.0, 0))
    options = {"emission": (3.3, 3.4, 3.4), "blocks_light": False, "uniform": True}
    return [Surface("trees", back, view, 0.13, width=1.2, **options)]
