"""Play things of the room: a rug, building blocks, a ball, books and boxes, a train; pictures, bunting and a lamp."""

from __future__ import annotations

import numpy as np

from studio.childrens_room.bed_and_tent import SHELF_BOARD, SHELF_COLUMNS, SHELF_LEVEL, SHELF_TOP, SHELF_X
from studio.childrens_room.painted_shell import X0, X1, Z0
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
    superellipsoid,
    tube,
)
from studio.solids import Solid, cuboid, placed, sphere
from studio.textures import cloth, fbm, mix, noise, plain, smoothstep, srgb

RUG_RADIUS, RUG_HEIGHT = 1.02, 0.010  # [m]
RAINBOW = ("e07a5f", "f2a65a", "f2cc6b", "8fb996", "7fa7c9", "a893c4")
LAMP_AT, LAMP_RADIUS = (0.25, 2.02, 0.35), 0.21  # [m]
LAMP_COLOUR = np.array([1.0, 0.87, 0.70])  # linear RGB
BLOCK = 0.078  # [m]
LETTERS = {
    "A": (".###.", "#...#", "#####", "#...#", "#...#"),
    "B": ("####.", "#...#", "####.", "#...#", "####."),
    "C": (".####", "#....", "#....", "#....", ".####"),
}
# Building blocks on the floor: (x, y of the base, z) [m], turn [degrees].
BLOCKS = [
    ((1.22, 0.0, -0.05), 12), ((1.305, 0.0, 0.0), 31), ((1.26, BLOCK, -0.025), 50), ((1.38, 0.0, 0.16), -22),
    ((1.10, 0.0, 0.08), 66),
]  # fmt: skip
BALL_AT, BALL_RADIUS = (0.93, 0.12, -1.42), 0.12  # [m]


def play_things() -> list[Surface]:
    """All surfaces."""
    return [rug(), *blocks(), ball(), *on_the_shelf(), *books(), *boxes(), *pictures(), *bunting(), *lantern()]


def solids() -> list[Solid]:
    """Signed distances of the things on the floor, for collisions."""
    half = BLOCK / 2
    cubes = [
        placed(cuboid((-half, -0.02 if at[1] == 0 else 0.0, -half), (half, BLOCK, half)), rotation_about("y", turn), at)
        for at, turn in BLOCKS
    ]
    return [*cubes, sphere(BALL_AT, BALL_RADIUS)]


def lamps() -> list[Lamp]:
    """The paper lantern."""
    return [Lamp(np.array(LAMP_AT), LAMP_RADIUS, 1.3 * LAMP_COLOUR)]


def rug() -> Surface:
    """Round rug: a sun among rings."""
    profile = [(RUG_RADIUS, 0.0), (RUG_RADIUS, RUG_HEIGHT - 0.004), (RUG_RADIUS - 0.006, RUG_HEIGHT), (0.0, RUG_HEIGHT)]
    weave = cloth((1.0, 1.0, 1.0), 0.014, 0.12, 0.05, 301)

    def colour_at(p, n):
        r, angle = np.hypot(p[:, 0], p[:, 2]), np.arctan2(p[:, 2], p[:, 0])
        ray = 0.5 + 0.5 * np.cos(16 * angle)
        c = srgb("f4e7cc") * np.ones((len(p), 1))
        c = np.where((r < 0.30 + 0.16 * ray)[:, None], srgb("f2c25e"), c)
        c = np.where((r < 0.27)[:, None], srgb("f0a556"), c)
        for k, (low, high) in enumerate(((0.56, 0.62), (0.66, 0.76), (0.80, 0.84))):
            c = np.where(((r > low) & (r < high))[:, None], srgb(("e58f74", "8fb9b0", "e58f74")[k]), c)
        c = np.where((r > 0.90)[:, None], srgb("7f9fc0"), c)
        return c * weave(p, n)

    return Surface("rug", lathe(profile, 96), colour_at, 0.0128, uniform=True)


def blocks() -> list[Surface]:
    """Wooden cubes with letters in coloured frames."""
    surfaces, mesh = [], beveled_box((BLOCK, BLOCK, BLOCK), 0.004).moved(translation=(0, BLOCK / 2, 0))
    for k, (at, turn) in enumerate(BLOCKS):
        rows = np.array([[c == "#" for c in row] for row in list(LETTERS.values())[k % 3]])
        tone = srgb(RAINBOW[(2 * k) % 6])

        def face(p, n, rows=rows, tone=tone):
            q = (p - (0, BLOCK / 2, 0)) / BLOCK
            axis = np.abs(n).argmax(1)
            u = np.choose(axis, [-q[:, 2] * np.sign(n[:, 0]), q[:, 0], q[:, 0] * np.sign(n[:, 2])])
            v = np.choose(axis, [q[:, 1], -q[:, 2] * np.sign(n[:, 1]), q[:, 1]])
            column = np.floor((u + 0.29) / 0.116).astype(int)
            row = 4 - np.floor((v + 0.29) / 0.116).astype(int)
            inside = (column >= 0) & (column < 5) & (row >= 0) & (row < 5)
            ink = inside & rows[row.clip(0, 4), column.clip(0, 4)]
            frame = np.maximum(np.abs(u), np.abs(v)) > 0.38
            c = srgb("ecd9b4") * (1 + 0.06 * noise(p * (30, 90, 30), 311))[:, None]
            return np.where((ink | frame)[:, None], tone, c)

        surfaces.append(Surface("block", mesh, face, 0.0058, gloss=0.02).placed(rotation_about("y", turn), at))
    return surfaces


def ball() -> Surface:
    """Striped ball."""
    tones = np.array([srgb(c) for c in ("e07a5f", "f7f1e3", "7fa7c9", "f7f1e3", "f2cc6b", "f7f1e3")])

    def colour_at(p, n):
        stripe = np.floor(np.arctan2(p[:, 2], p[:, 0]) / (2 * np.pi) * 6).astype(int) % 6
        return np.where((np.abs(p[:, 1]) > 0.96 * BALL_RADIUS)[:, None], srgb("7fa7c9"), tones[stripe])

    mesh = superellipsoid((2 * BALL_RADIUS,) * 3, 1.0, 32)
    return Surface("ball", mesh, colour_at, 0.0098, gloss=0.04, roughness=0.15).placed(rotation_about("z", 28), BALL_AT)


def on_the_shelf() -> list[Surface]:
    """A ring tower, a globe, a wooden train, and a plant on top of the shelf."""
    y, z, parts = SHELF_TOP, Z0 + 0.19, []
    for k, tone in enumerate(RAINBOW):
        a = np.linspace(0, 2 * np.pi, 14, endpoint=False)
        major, minor = 0.062 - 0.008 * k, 0.017
        profile = np.stack([major + minor * np.cos(a), 0.018 + 0.033 * k + minor * np.sin(a)], 1)
        ring = lathe(profile, 32, closed=True).moved(translation=(0.31, y, z))
        parts.append(Surface("ring", ring, plain(tone, 0.02), 0.0062, gloss=0.05))
    top = superellipsoid((0.036, 0.036, 0.036), 1.0, 10).moved(translation=(0.31, y + 0.228, z))
    parts.append(Surface("tower top", top, plain("e07a5f", 0.02), 0.006))

    def sea(p, n):
        land = smoothstep(0.02, 0.10, fbm(p * 16, 3, 321))
        return mix(srgb("6fa3c7"), srgb("8fb96a"), land)

    foot = lathe([(0.05, 0.0), (0.05, 0.008), (0.012, 0.016), (0.010, 0.05)], 24).moved(translation=(-0.62, y, z))
    globe = superellipsoid((0.19, 0.19, 0.19), 1.0, 24)
    arc = np.linspace(-1.9, 1.9, 20)
    bow = tube(np.stack([0.107 * np.cos(arc) - 0.62, y + 0.145 + 0.107 * np.sin(arc), 0 * arc + z], 1), 0.005, 8)
    parts += [
        Surface("globe", globe, sea, 0.0085, gloss=0.04).placed(rotation_about("z", -23), (-0.62, y + 0.145, z)),
        Surface("globe foot", join(foot, bow), plain("c49a5a", 0.03), 0.0065, gloss=0.08),
    ]
    for k, (x, tone) in enumerate(((-0.33, "d9654f"), (-0.175, "f2b45a"), (-0.04, "7fa7c9"))):
        cart = [beveled_box((0.125, 0.03, 0.075), 0.005).moved(translation=(x, y + 0.036, z))]
        if k == 0:
            boiler = tube([(x - 0.055, y + 0.076, z), (x + 0.02, y + 0.076, z)], 0.026, 16)
            cab = beveled_box((0.045, 0.075, 0.066), 0.004).moved(translation=(x + 0.038, y + 0.087, z))
            chimney = tube([(x - 0.036, y + 0.09, z), (x - 0.036, y + 0.135, z)], [0.010, 0.015], 12)
            cart += [boiler, cab, chimney]
        else:
            cart.append(beveled_box((0.11, 0.038, 0.065), 0.004).moved(translation=(x, y + 0.068, z)))
        wheels = [
            tube([(x + s * 0.04, y + 0.018, z + t * 0.036), (x + s * 0.04, y + 0.018, z + t * 0.047)], 0.018, 14)
            for s in (-1, 1)
            for t in (-1, 1)
        ]
        parts.append(Surface("train", join(*cart), plain(tone, 0.02), 0.0068, gloss=0.04))
        parts.append(Surface("wheels", join(*wheels), plain("4a3a30", 0.03), 0.007))
    return parts


def books() -> list[Surface]:
    """Picture books in the lower right and upper left compartments, some leaning."""
    rng, surfaces = np.random.default_rng(331), []
    width = (SHELF_X[1] - SHELF_X[0] - SHELF_BOARD) / SHELF_COLUMNS
    low = (0.072, SHELF_LEVEL)
    for column, row, count in ((0, 1, 11), (2, 0, 8), (1, 1, 5)):
        x = SHELF_X[0] + SHELF_BOARD + column * width + 0.01
        for _ in range(count):
            t, h, d = 0.016 + 0.018 * rng.random(), 0.19 + 0.05 * rng.random(), 0.17 + 0.05 * rng.random()
            lean = 0 if rng.random() < 0.85 else -9
            tone = RAINBOW[rng.integers(6)] if rng.random() < 0.7 else ("f2e8d5", "c9655a", "5f7fa3")[rng.integers(3)]
            linen = cloth(tone, 0.010, 0.04, 0.02, 332)

            def spine(p, n, linen=linen, h=h):
                band = (np.abs(p[:, 1] - 0.82 * h) < 0.008) | (np.abs(p[:, 1] - 0.15 * h) < 0.005)
                return np.where(band[:, None], srgb("f7efdc"), linen(p, n))

            mesh = box((0, 0, -d), (t, h, 0))
            book = Surface("book", mesh, spine, 0.0085, grain=(0, 1, 0), stretch=1.6)
            surfaces.append(book.placed(rotation_about("z", lean), (x, low[row], Z0 + 0.30)))
            x += t + 0.003 + (0.03 if lean else 0.0)
    return surfaces


def boxes() -> list[Surface]:
    """Fabric boxes in the other compartments, each with a label."""
    width = (SHELF_X[1] - SHELF_X[0] - SHELF_BOARD) / SHELF_COLUMNS
    surfaces = []
    for column, row, tone in ((0, 0, "e9b872"), (1, 0, "8fb7a8"), (2, 1, "e2917c")):
        x = SHELF_X[0] + SHELF_BOARD + (column + 0.5) * width - 0.5 * SHELF_BOARD
        base, z = (0.072, SHELF_LEVEL)[row], Z0 + 0.33
        felt = cloth(tone, 0.010, 0.07, 0.04, 341)

        def front(p, n, felt=felt):
            label = (np.abs(p[:, 0]) < 0.05) & (np.abs(p[:, 1] - 0.12) < 0.03) & (n[:, 2] > 0.5)
            star = np.hypot(p[:, 0], p[:, 1] - 0.12) < 0.018
            return np.where(label[:, None], np.where(star[:, None], srgb("f0c777"), srgb("fbf6ea")), felt(p, n))

        body = beveled_box((width - 0.06, 0.215, 0.27), 0.008).moved(translation=(0, 0.1075, -0.135))
        surfaces.append(Surface("fabric box", body, front, 0.0095).placed(position=(x, base, z)))
    return surfaces


def pictures() -> list[Surface]:
    """A rainbow and a balloon over the bed, a moon on the right wall."""
    surfaces = []

    def rainbow(u, v):
        r = np.hypot(u, (v + 0.62) * 1.0)
        c = mix(srgb("d5e7f2"), srgb("f6efe0"), smoothstep(0.8, -0.9, v))
        for k, tone in enumerate(RAINBOW):
            c = np.where(((r > 0.92 - 0.085 * k) & (r <= 1.005 - 0.085 * k) & (v > -0.62))[:, None], srgb(tone), c)
        for cx in (-0.70, 0.70):
            puff = np.minimum.reduce([np.hypot(u - cx - d, v + 0.60 - e) - s for d, e, s in
                                      ((-0.17, 0, 0.17), (0.02, 0.08, 0.21), (0.19, 0, 0.16))])  # fmt: skip
            c = mix(c, srgb("fffdf6"), smoothstep(0.02, -0.02, puff))
        return c

    def balloon(u, v):
        c = mix(srgb("f7e3c8"), srgb("b9d6e8"), smoothstep(-0.9, 0.9, v))
        hill = -0.62 + 0.12 * np.sin(3 * u + 1)
        c = np.where((v < hill)[:, None], srgb("8fb97f"), c)
        x, y = u / (0.50 * np.clip(1.0 + 0.45 * (v - 0.22), 0.3, 1.1)), (v - 0.24) / 0.56
        inside = np.hypot(x, y) < 1
        gore = np.floor((x / np.sqrt(np.clip(1 - y * y, 0.05, 1)) + 1) * 3).astype(int) % 3
        c = np.where(inside[:, None], np.array([srgb(t) for t in ("e07a5f", "f2cc6b", "7fa7c9")])[gore], c)
        rope = (np.abs(np.abs(u) - 0.13 - 0.10 * (v + 0.42)) < 0.022) & (v < -0.28) & (v > -0.50)
        c = np.where(rope[:, None], srgb("7a5a3a"), c)
        return np.where(((np.abs(u) < 0.14) & (np.abs(v + 0.57) < 0.09))[:, None], srgb("9a6a3f"), c)

    def moon(u, v):
        c = mix(srgb("54679b"), srgb("2f3f6f"), smoothstep(-0.9, 0.9, v))
        c = np.where(((np.hypot(u + 0.05, v - 0.05) < 0.52) & (np.hypot(u - 0.20, v - 0.18) > 0.46))[:, None],
                     srgb("f6dc8f"), c)  # fmt: skip
        for x, y, s in (
            (0.5, 0.6, 0.07),
            (0.62, -0.1, 0.05),
            (-0.6, 0.62, 0.06),
            (0.3, -0.6, 0.06),
            (-0.68, -0.5, 0.05),
        ):
            c = np.where((np.abs(u - x) ** 0.6 + np.abs(v - y) ** 0.6 < (2.2 * s) ** 0.6)[:, None], srgb("fbf0c8"), c)
        return c

    for at, side, size, paint in (
        ((X0, 1.30, -1.02), 90, (0.62, 0.46), rainbow),
        ((X0, 1.36, -0.25), 90, (0.42, 0.54), balloon),
        ((X1, 1.34, 0.30), -90, (0.44, 0.56), moon),
    ):
        w, h = size
        canvas = quad((-w / 2, -h / 2, 0.012), (w, 0, 0), (0, h, 0))

        def colour_at(p, n, paint=paint, w=w, h=h):
            return paint(2 * p[:, 0] / w, 2 * p[:, 1] / h) * (1 + 0.04 * noise(p * 60, 351))[:, None]

        b = 0.026
        bars = [
            box((-w / 2 - b, s * (h / 2) + min(0, s) * b, 0), (w / 2 + b, s * (h / 2) + max(0, s) * b, 0.024))
            for s in (-1, 1)
        ]
        bars += [
            box((s * (w / 2) + min(0, s) * b, -h / 2, 0), (s * (w / 2) + max(0, s) * b, h / 2, 0.024)) for s in (-1, 1)
        ]
        turn = rotation_about("y", side)
        surfaces.append(Surface("picture", canvas, colour_at, 0.0092, uniform=True).placed(turn, at))
        surfaces.append(Surface("frame", join(*bars), plain("e8d2a6", 0.03), 0.010).placed(turn, at))
    return surfaces


def bunting() -> list[Surface]:
    """Pennants on a string along the far wall."""
    z, count = Z0 + 0.05, 17
    t = np.linspace(0, 1, 80)
    x = X0 + 0.02 + (X1 - X0 - 0.04) * t
    y = 2.36 - 0.30 * np.sin(np.pi * t)
    string = tube(np.stack([x, y, 0 * t + z], 1), 0.003, 6)
    surfaces = [Surface("string", string, plain("f6f0e2"), 0.012)]
    flags: dict[str, list] = {}
    for k in range(count):
        a = (k + 0.5) / count
        px, py = np.interp(a, t, x), np.interp(a, t, y)
        u, v = np.linspace(-0.085, 0.085, 8)[:, None], np.linspace(0, 1, 10)[None]
        points = np.broadcast_arrays(u * (1 - v), -0.20 * v - 0.002, 0.012 * np.sin(3 * v + k) * v)
        slope = np.degrees(np.arctan2(np.interp(a + 0.01, t, y) - py, np.interp(a + 0.01, t, x) - px))
        flag = grid_mesh(np.stack(points, -1)[:, ::-1]).moved(rotation_about("z", slope), (px, py, z))
        flags.setdefault(RAINBOW[k % 6], []).append(flag)
    for tone, meshes in flags.items():
        fabric = cloth(tone, 0.012, 0.05, 0.02, 361)
        surfaces.append(Surface("pennant", join(*meshes), fabric, 0.0125, translucency=0.3))
    return surfaces


def lantern() -> list[Surface]:
    """Paper globe that glows."""

    def paper(p, n):
        rib = np.abs((p[:, 1] / 0.032) % 1 - 0.5)
        return srgb("fff3dc") * (0.86 + 0.14 * smoothstep(0.0, 0.12, rib))[:, None]

    shade = superellipsoid((2 * LAMP_RADIUS,) * 3, 1.0, 28)
    cord = tube([(LAMP_AT[0], LAMP_AT[1] + LAMP_RADIUS, LAMP_AT[2]), (LAMP_AT[0], 2.45, LAMP_AT[2])], 0.004, 8)
    glow = tuple(1.1 * LAMP_COLOUR)
    return [
        Surface("lantern", shade, paper, 0.016, emission=glow, blocks_light=False).placed(position=LAMP_AT),
        Surface("lantern cord", cord, plain("e9e2d2"), 0.010),
    ]
