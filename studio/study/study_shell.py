"""The shell of the study: parquet, panelled and papered walls, the window with its curtains, the trees outside."""

from __future__ import annotations

import numpy as np

from studio.light_sources import Opening, Sun
from studio.shapes import Mesh, Surface, box, grid_mesh, join, quad, tube
from studio.textures import OAK, WALNUT, cloth, fbm, hash_uniform, mix, noise, plain, smoothstep, srgb, wood
from studio.walls import reveal, wall_sheet, within

ROOM_LOW, ROOM_HIGH = (-1.9, 0.0, -1.75), (1.9, 2.7, 2.2)  # [m] scenes/table_brick_game.py repeats them
(X0, Y0, Z0), (X1, Y1, Z1) = ROOM_LOW, ROOM_HIGH
WINDOW_Z, WINDOW_Y = (-1.05, 0.55), (0.97, 2.30)  # [m] in the left wall
REVEAL = 0.16  # [m] depth of the window in the wall
DADO = 0.92  # [m] height of the panelling
DOOR = (-0.45, 0.45, 0.0, 2.05)  # [m] x from, to, y from, to: in the near wall
CASING = 0.09  # [m] width of the boards around it
BLOCK = 0.09  # [m] width of a block of the parquet; it is four times as long
SUN = Sun(np.array([0.78, -0.55, 0.22]) / np.linalg.norm([0.78, -0.55, 0.22]), np.array([1.0, 0.84, 0.62]) * 15)
FILL_LIGHT = (0.14, 0.14, 0.13)  # added to frames seen against the sky, like a photographer's fill light


def study_shell() -> list[Surface]:
    """Floor, walls, ceiling, mouldings, window, curtains and what is seen outside."""
    return [parquet(), *walls(), *mouldings(), *window(), *curtains(), *outside()]


def openings() -> list[Opening]:
    """The window."""
    (z0, z1), (y0, y1) = WINDOW_Z, WINDOW_Y
    return [Opening(np.array([X0 - 0.03, y0, z0]), np.array([0, 0, z1 - z0]), np.array([0, y1 - y0, 0]))]


def parquet() -> Surface:
    """Oak blocks in a basket weave: squares of four blocks, turned in turn."""
    along_x, along_z = (wood(OAK, axis=k, board=BLOCK, across=2 - k, seed=3) for k in (0, 2))
    square = 4 * BLOCK

    def colour_at(p, n):
        cell = np.floor(p[:, [0, 2]] / square).astype(int)
        turned = cell.sum(1) % 2 == 0
        across = np.where(turned, p[:, 2], p[:, 0])
        block = np.floor(across / BLOCK).astype(int)
        tag = cell[:, 0] * 7919 + cell[:, 1] * 104729 + block
        q = p + np.stack([9 * hash_uniform(tag, 1), 0 * across, 7 * hash_uniform(tag, 2)], 1).round(1) * BLOCK * 10
        c = np.where(turned[:, None], along_x(q, n), along_z(q, n))
        edge = np.minimum(np.abs(across / BLOCK - np.round(across / BLOCK)) * BLOCK, 1.0)
        ends = np.where(turned, p[:, 0], p[:, 2]) / square
        edge = np.minimum(edge, np.abs(ends - np.round(ends)) * square)
        tone = (0.70 + 0.36 * hash_uniform(tag, 3)) * (0.72 + 0.28 * smoothstep(0.0, 0.004, edge))
        return c * 0.9 * tone[:, None]

    mesh = quad((X0, 0, Z1), (X1 - X0, 0, 0), (0, 0, Z0 - Z1))
    return Surface("parquet", mesh, colour_at, 0.022, gloss=0.04, roughness=0.18)


def walls() -> list[Surface]:
    """Walnut panelling below, green paper with a woven pattern above, and the ceiling."""
    panel = wood(WALNUT, axis=1, board=0.28, across=0, seed=8)
    panel_side = wood(WALNUT, axis=1, board=0.28, across=2, seed=9)
    green, light = srgb("66806c"), srgb("8aa088")

    def paper(p, n):
        u = np.where(np.abs(n[:, 0]) > 0.5, p[:, 2], p[:, 0])
        a, b = u / 0.15, p[:, 1] / 0.22
        row = np.floor(b)
        x, y = (a + 0.5 * (row % 2)) % 1 - 0.5, b % 1 - 0.5
        leaf = smoothstep(0.36, 0.30, np.hypot(2.1 * x, 1.25 * y)) - smoothstep(0.25, 0.19, np.hypot(2.1 * x, 1.25 * y))
        bud = smoothstep(0.13, 0.08, np.hypot(2.0 * x, 1.1 * y))
        return mix(green, light, 0.75 * np.clip(leaf + bud, 0, 1)) * (1 + 0.03 * fbm(p * 2, 2, 11))[:, None]

    def ceiling(p, n):
        return srgb("ece7da") * (1 + 0.02 * fbm(p * 1.5, 2, 13))[:, None]

    sides = {
        "far": ((X0, X1), [], lambda u, v: (u, v, Z0)),
        "left": ((Z1, Z0), [(*WINDOW_Z, *WINDOW_Y)], lambda u, v: (X0, v, u)),
        "right": ((Z0, Z1), [], lambda u, v: (X1, v, u)),
        "near": ((X1, X0), [_doorway()], lambda u, v: (u, v, Z1)),
    }
    surfaces = []
    for name, (span, holes, to_room) in sides.items():
        lower = wall_sheet(span, (0.10, DADO - 0.02), holes, to_room)
        upper = wall_sheet(span, (DADO + 0.015, Y1 - 0.07), holes, to_room)
        timber = panel if name in ("far", "near") else panel_side
        fine = {"far": 0.020, "near": 0.034}.get(name, 0.022)
        surfaces.append(Surface(f"{name} panelling", lower, timber, fine, grain=(0, 1, 0), stretch=2.0, gloss=0.02))
        surfaces.append(Surface(f"{name} paper", upper, paper, fine, width=1.05))
    top = quad((X0, Y1, Z0), (X1 - X0, 0, 0), (0, 0, Z1 - Z0))
    return [*surfaces, Surface("ceiling", top, ceiling, 0.065, width=1.2)]


def mouldings() -> list[Surface]:
    """Skirting, dado rail and panel stiles of walnut, a white cornice."""
    runs, stiles, cornice = [], [], []
    left, right, *_ = _doorway()
    for low, high, depth in ((0.0, 0.10, 0.018), (DADO - 0.03, DADO + 0.015, 0.024)):
        runs += [
            box((X0, low, Z0), (X1, high, Z0 + depth)),
            box((X0, low, Z0), (X0 + depth, high, Z1)),
            box((X1 - depth, low, Z0), (X1, high, Z1)),
            box((X0, low, Z1 - depth), (left, high, Z1)),
            box((right, low, Z1 - depth), (X1, high, Z1)),
        ]
    for z in np.arange(Z0 + 0.45, Z1, 0.62):
        for x0, x1 in ((X0, X0 + 0.014), (X1 - 0.014, X1)):
            if not (x0 == X0 and WINDOW_Z[0] < z < WINDOW_Z[1]):
                stiles.append(box((x0, 0.10, z - 0.035), (x1, DADO - 0.03, z + 0.035)))
    for low, high, depth in ((Y1 - 0.07, Y1, 0.06), (Y1 - 0.10, Y1 - 0.07, 0.03)):
        cornice += [
            box((X0, low, Z0), (X1, high, Z0 + depth)),
            box((X0, low, Z0), (X0 + depth, high, Z1)),
            box((X1 - depth, low, Z0), (X1, high, Z1)),
            box((X0, low, Z1 - depth), (X1, high, Z1)),
        ]
    timber = wood(WALNUT, axis=2, across=1, seed=14)
    return [
        Surface("rails", _in_room(runs), timber, 0.022, grain=(0, 0, 1), stretch=2.0, gloss=0.03),
        Surface("stiles", _in_room(stiles), timber, 0.020, gloss=0.03),
        Surface("cornice", _in_room(cornice), plain("ece7da", 0.01), 0.034),
    ]


def _doorway() -> tuple[float, float, float, float]:
    """The door with its casing: x from, to, y from, to [m]."""
    x0, x1, y0, y1 = DOOR
    return x0 - CASING, x1 + CASING, y0, y1 + CASING


def _in_room(meshes: list[Mesh]) -> Mesh:
    """The meshes without faces that lie in a wall."""
    return within(join(*meshes), ROOM_LOW, ROOM_HIGH)


def window() -> list[Surface]:
    """Sash window of two casements with glazing bars, and a deep sill with a plant pot's worth of room."""
    (z0, z1), (y0, y1) = WINDOW_Z, WINDOW_Y
    x, middle = X0 - 0.08, 0.5 * (z0 + z1)
    bars = []
    for a, b in ((z0, middle - 0.004), (middle + 0.004, z1)):
        bars += [box((x, y0, a), (x + 0.045, y1, a + 0.05)), box((x, y0, b - 0.05), (x + 0.045, y1, b))]
        bars += [
            box((x, low, a + 0.05), (x + 0.045, high, b - 0.05)) for low, high in ((y0, y0 + 0.06), (y1 - 0.06, y1))
        ]
        for t in (1 / 3, 2 / 3):
            y = y0 + t * (y1 - y0)
            bars.append(box((x + 0.008, y - 0.011, a + 0.05), (x + 0.037, y + 0.011, b - 0.05)))
        half = 0.5 * (a + b)
        bars.append(box((x + 0.008, y0 + 0.06, half - 0.011), (x + 0.037, y1 - 0.06, half + 0.011)))
    w = 0.08
    trim = [
        box((X0, y0 - w, z0 - w), (X0 + 0.02, y1 + w, z0)),
        box((X0, y0 - w, z1), (X0 + 0.02, y1 + w, z1 + w)),
        box((X0, y1, z0), (X0 + 0.02, y1 + w, z1)),
    ]
    sill = box((X0 - REVEAL, y0 - 0.035, z0 - 0.07), (X0 + 0.09, y0, z1 + 0.07))
    inner = reveal((z0, y0), (z1, y1), REVEAL, lambda u, v, w_: (X0 - w_, v, u), flip=True)
    white = plain("ebe5d6", 0.01)
    return [
        Surface("window", join(*bars), white, 0.015, emission=FILL_LIGHT),
        Surface("window trim", _in_room(trim), white, 0.018),
        Surface("window sill", join(sill, inner), white, 0.017, gloss=0.03),
    ]


def curtains() -> list[Surface]:
    """Heavy curtains of ochre cloth at both sides of the window, on a brass rod."""
    x = X0 + 0.13
    sheets = []
    for z_open, z_far in ((WINDOW_Z[0] - 0.02, WINDOW_Z[0] - 0.36), (WINDOW_Z[1] + 0.02, WINDOW_Z[1] + 0.40)):
        u = np.linspace(0, 1, 40)[:, None]
        v = np.linspace(0, 1, 14)[None]
        waist = 1 - 0.42 * np.exp(-(((v - 0.42) / 0.22) ** 2))  # gathered by a tie
        z = z_far + (z_open - z_far) * u * waist
        fold = 0.035 * np.sin(2 * np.pi * 5.5 * u) * (0.6 + 0.4 * v)
        sheets.append(grid_mesh(np.stack(np.broadcast_arrays(x + fold, 0.03 + 2.38 * v, z), -1)))
    rod = tube([(x, 2.43, WINDOW_Z[0] - 0.45), (x, 2.43, WINDOW_Z[1] + 0.5)], 0.014, 12)
    ties = []
    for z in (WINDOW_Z[0] - 0.25, WINDOW_Z[1] + 0.28):
        a = np.linspace(0, 2 * np.pi, 20)
        ties.append(tube(np.stack([x + 0.055 * np.cos(a), 1.03 + 0.02 * np.cos(a), z + 0.13 * np.sin(a)], 1), 0.012, 8))
    return [
        Surface(
            "curtains",
            join(*sheets),
            cloth("b9853f", 0.010, 0.12, 0.06, 21),
            0.017,
            grain=(0, 1, 0),
            stretch=2.0,
            translucency=0.12,
        ),
        Surface("ties", join(*ties), plain("8a5a22", 0.06, 0.02), 0.010),
        Surface("curtain rod", rod, plain("9a7430", 0.05), 0.012, grain=(0, 0, 1), stretch=4.0, gloss=0.25),
    ]


def outside() -> list[Surface]:
    """Trees and sky behind the window: bright and soft, as a camera exposed for the room sees them."""

    def view(p, n):
        leaves = fbm(p * (1.0, 1.4, 1.4), 4, 23)
        green = mix(srgb("6f8f55"), srgb("c6d394"), smoothstep(-0.5, 0.6, leaves + 0.2 * (p[:, 1] - 1)))
        sky = mix(srgb("eef1f0"), srgb("cfe0f2"), smoothstep(1.5, 4.0, p[:, 1]))
        crown = p[:, 1] - 1.55 - 0.7 * fbm(p * (0.0, 0.0, 0.7), 3, 25) - 0.3 * leaves
        c = mix(green, sky, smoothstep(-0.12, 0.16, crown))
        trunk = smoothstep(0.09, 0.05, np.abs(p[:, 2] + 0.1 + 0.05 * noise(p * (1, 2, 0), 27))) * (p[:, 1] < 2.1)
        return mix(c, srgb("7a6a55"), 0.8 * trunk)

    back = quad((-6.0, -0.6, 5.0), (0, 0, -9.0), (0, 5.4, 0))
    options = {"blocks_light": False, "uniform": True, "width": 1.2}
    return [Surface("outside", back, view, 0.11, emission=(3.4, 3.5, 3.4), **options)]


def boards(
    meshes: list[Mesh], name: str, seed: int, spacing: float = 0.013, axis: int = 0, tone: float = 1.25
) -> Surface:
    """Walnut boards with the grain along `axis`, as the study's furniture is made of; `tone` is their lightness."""
    across = 1 if axis != 1 else 0
    grain = tuple(float(k == axis) for k in range(3))
    tones = tuple(tone * np.array(t) for t in WALNUT)
    return Surface(
        name,
        _in_room(meshes),
        wood(tones, axis=axis, across=across, seed=seed),
        spacing,
        grain=grain,
        stretch=2.2,
        gloss=0.035,
        roughness=0.2,
    )
