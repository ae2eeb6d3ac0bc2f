"""The bookcase that fills the far wall: cupboards below, shelves of many books above, a few ornaments among them."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from studio.shapes import (
    Mesh,
    Surface,
    beveled_box,
    box,
    grid_mesh,
    join,
    lathe,
    rotation_about,
    smooth_curve,
    superellipsoid,
)
from studio.study.study_shell import Z0, boards
from studio.textures import cloth, fbm, hash_uniform, mix, noise, plain, smoothstep, srgb

LEFT, RIGHT, BAYS = -1.02, 1.86, 3  # [m] along x
BASE_HEIGHT, TOP = 0.66, 2.42  # [m] of the cupboards, of the cornice
SHELVES = (0.70, 1.08, 1.43, 1.77, 2.09)  # [m] height of each shelf's upper side
DEPTH, BASE_DEPTH, BOARD = 0.27, 0.34, 0.026  # [m]
BOOK_DEPTH = 0.08  # [m]
LEATHERS = (
    "6b2a20",
    "35502f",
    "2f3f5e",
    "7a5530",
    "52303c",
    "8a6a3c",
    "3c3a36",
    "a5834f",
    "4a6260",
    "8f3b2c",
    "c3ae86",
)
GILT = "d9b25a"


def bookcases() -> list[Surface]:
    """The bookcase with all that stands in it."""
    return [*carcass(), *books(), *ornaments()]


def bay_edges() -> np.ndarray:
    """x of the uprights [m], (BAYS + 1,)."""
    return np.linspace(LEFT, RIGHT, BAYS + 1)


def carcass() -> list[Surface]:
    """Uprights, shelves, back, cupboard doors and cornice."""
    edges, front = bay_edges(), Z0 + DEPTH
    uprights = [box((x - BOARD / 2, BASE_HEIGHT, Z0), (x + BOARD / 2, TOP, front)) for x in edges]
    shelves = [
        box((a + BOARD / 2, y - BOARD, Z0), (b - BOARD / 2, y, front - 0.008))
        for a, b in pairwise(edges)
        for y in SHELVES[1:]
    ]
    back = box((LEFT, BASE_HEIGHT, Z0), (RIGHT, TOP, Z0 + 0.012))
    base = box((LEFT - 0.015, 0.0, Z0), (RIGHT + 0.02, BASE_HEIGHT, Z0 + BASE_DEPTH))
    worktop = beveled_box((RIGHT - LEFT + 0.06, 0.04, BASE_DEPTH + 0.02), 0.004).moved(
        translation=((LEFT + RIGHT) / 2, BASE_HEIGHT + 0.02, Z0 + (BASE_DEPTH + 0.02) / 2)
    )
    crown = [
        box((LEFT - 0.02 - e, TOP + h, Z0), (RIGHT + 0.03, TOP + h + 0.045, front + 0.02 + e))
        for h, e in ((0.0, 0.0), (0.045, 0.03))
    ]
    doors, panels, knobs = [], [], []
    z = Z0 + BASE_DEPTH
    for a, b in pairwise(edges):
        middle = 0.5 * (a + b)
        for x0, x1 in ((a + 0.02, middle - 0.003), (middle + 0.003, b - 0.02)):
            doors += [
                box((x0, 0.09, z), (x0 + 0.06, 0.63, z + 0.018)),
                box((x1 - 0.06, 0.09, z), (x1, 0.63, z + 0.018)),
            ]
            doors += [box((x0 + 0.06, y, z), (x1 - 0.06, y + 0.06, z + 0.018)) for y in (0.09, 0.57)]
            panels.append(box((x0 + 0.06, 0.15, z), (x1 - 0.06, 0.57, z + 0.006)))
            knob = x1 - 0.03 if x1 < middle else x0 + 0.03
            knobs.append(superellipsoid((0.024,) * 3, 1.0, 9).moved(translation=(knob, 0.40, z + 0.028)))
    return [
        boards([*uprights], "uprights", 31, 0.013, axis=1),
        boards([*shelves, *crown, worktop], "bookshelves", 33, 0.013),
        boards([base], "bookcase base", 35, 0.026),
        boards([back], "bookcase back", 36, 0.026, tone=0.5),
        boards(doors, "cupboard frames", 37, 0.017, axis=1),
        boards(panels, "cupboard panels", 39, 0.019, axis=1),
        Surface("cupboard knobs", join(*knobs), plain("a5834a", 0.05), 0.008, gloss=0.25),
    ]


def books() -> list[Surface]:
    """Rows of books on all shelves, with gaps for the ornaments."""
    edges, surfaces = bay_edges(), []
    rng = np.random.default_rng(77)
    for s, y in enumerate(SHELVES):
        clear = (SHELVES + (TOP - 0.02,))[s + 1] - BOARD - y
        for bay in range(BAYS):
            x, end = edges[bay] + BOARD / 2 + 0.004, edges[bay + 1] - BOARD / 2 - 0.004
            gap = GAPS.get((s, bay))
            runs = [(x, end)] if gap is None else [(x, x + gap[0]), (x + gap[1], end)]
            for k, (a, b) in enumerate(runs):
                if b - a > 0.05:
                    surfaces.append(row_of_books(f"books {s} {bay} {k}", a, b, y, clear, rng))
    for at, yaw, seed in STACKS:
        surfaces += lying_stack(at, yaw, seed)
    return surfaces


# Free space on a shelf, (shelf, bay): from and to along x, from the bay's left side [m].
GAPS = {
    (0, 0): (0.30, 0.72),
    (1, 1): (0.40, 0.68),
    (2, 2): (0.10, 0.45),
    (3, 0): (0.50, 0.93),
    (2, 0): (0.62, 0.93),
    (0, 2): (0.44, 0.93),
    (4, 1): (0.0, 0.33),
    (3, 2): (0.60, 0.93),
}
STACKS = (((-0.55, 0.70, Z0 + 0.16), 4, 1), ((1.58, 2.09 - 0.32, Z0 + 0.15), -7, 2), ((1.22, 0.70, Z0 + 0.16), 9, 3))


def row_of_books(name: str, start: float, end: float, y: float, clear: float, rng: np.random.Generator) -> Surface:
    """Upright books from `start` to `end` along x on the shelf at height y, under `clear` [m] of air: one surface."""
    edge, heights, fronts, tags = [start], [], [], []
    series, left = 0, 0
    while edge[-1] < end - 0.012:
        if left == 0:  # some books belong to a set and look alike
            left, series = int(rng.choice([1, 1, 2, 3, 5])), int(rng.integers(1 << 20))
            size = rng.uniform(0.018, 0.046), clear * rng.uniform(0.62, 0.90), rng.uniform(0.03, 0.07)
        width = min(size[0] * rng.uniform(0.9, 1.1), end - edge[-1])
        edge.append(edge[-1] + width)
        heights.append(size[1])
        fronts.append(Z0 + DEPTH - size[2])
        tags.append(series)
        left -= 1
    edge, heights, fronts, tags = (np.array(a) for a in (edge, heights, fronts, tags))
    meshes = [
        spine(a + 0.0008, b - 0.0008, y, y + h, z)
        for a, b, h, z in zip(edge[:-1], edge[1:], heights, fronts, strict=True)
    ]
    tones = np.array([srgb(c) for c in LEATHERS])

    def colour_at(p, n):
        k = np.clip(np.searchsorted(edge, p[:, 0]) - 1, 0, len(tags) - 1)
        tag = tags[k]
        c = tones[(hash_uniform(tag, 1) * len(tones)).astype(int)] * (0.75 + 0.5 * hash_uniform(tag, 2))[:, None]
        c = c * (1 + 0.16 * fbm(p * (60, 25, 60), 3, 5))[:, None]
        v = (p[:, 1] - y) / heights[k]
        front = n[:, 2] > 0.3
        bands = np.zeros(len(p), bool)
        for level in (0.10, 0.30, 0.78, 0.92):
            bands |= np.abs(v - level - 0.04 * (hash_uniform(tag, 3) - 0.5)) < 0.0022 / heights[k]
        gilt = front & bands & (hash_uniform(tag, 4) < 0.75)
        label = front & (v > 0.62) & (v < 0.75) & (hash_uniform(tag, 5) < 0.55)
        c = np.where(label[:, None], mix(c * 0.5, srgb("e6d9b4"), (hash_uniform(tag, 6) > 0.5) * 0.8), c)
        u = (p[:, 0] - edge[k]) / (edge[k + 1] - edge[k])
        title = label & (np.abs(v - 0.685) < 0.02) & (u > 0.25) & (u < 0.75)
        c = np.where((gilt | title)[:, None], srgb(GILT), c)
        top = n[:, 1] > 0.7
        return np.where(top[:, None], srgb("d8cba6") * (1 + 0.15 * noise(p * (900, 20, 20), 7))[:, None], c)

    return Surface(name, join(*meshes), colour_at, 0.0115, grain=(0, 1, 0), stretch=2.2, gloss=0.02)


def spine(x0: float, x1: float, y0: float, y1: float, z: float) -> Mesh:
    """A standing book with a rounded spine at z; what is deeper in the shelf than BOOK_DEPTH nobody sees."""
    u = np.linspace(0, 1, 5)
    bulge = 0.18 * (x1 - x0) * np.sin(np.pi * u)
    x, front = x0 + u * (x1 - x0), z + bulge
    back = z - BOOK_DEPTH
    outline = np.concatenate([np.stack([x, front], 1), [(x1, back), (x0, back)]])
    wall = grid_mesh(
        np.stack([np.stack([outline[:, 0], 0 * outline[:, 0] + h, outline[:, 1]], 1) for h in (y0, y1)], 1),
        close_u=True,
    )
    count = len(outline)
    centre = outline.mean(0)
    vertices = np.concatenate([np.insert(outline, 1, y1, axis=1), [[centre[0], y1, centre[1]]]])
    lid = Mesh(vertices, np.array([(k, (k + 1) % count, count) for k in range(count)]))
    return join(wall, lid)


def lying_stack(at, yaw: float, seed: int) -> list[Surface]:
    """Three or four books that lie on one another."""
    rng, surfaces, y = np.random.default_rng(seed), [], 0.0
    for k in range(4 if seed % 2 else 3):
        w, h, d = rng.uniform(0.19, 0.24), rng.uniform(0.022, 0.04), rng.uniform(0.14, 0.18)
        colour = LEATHERS[int(rng.integers(len(LEATHERS)))]
        surfaces += closed_book(w, h, d, colour, (0, y, 0), yaw + rng.uniform(-8, 8), f"stack {seed} {k}", at)
        y += h
    return surfaces


def closed_book(
    w: float, h: float, d: float, colour: str, offset, yaw: float, name: str, at, spacing=0.013
) -> list[Surface]:
    """A book that lies flat, its spine towards +z: cover boards and pages."""
    t = 0.0032
    cover = join(
        box((-w / 2, 0, -d / 2), (w / 2, t, d / 2)),
        box((-w / 2, h - t, -d / 2), (w / 2, h, d / 2)),
        box((-w / 2, t, d / 2 - t), (w / 2, h - t, d / 2)),
    )
    pages = box((-w / 2 + 0.005, t, -d / 2 + 0.005), (w / 2 - 0.005, h - t, d / 2 - t))

    def paper(p, n):
        return srgb("e2d6b5") * (1 + 0.12 * noise(p * (15, 900, 15), 3))[:, None]

    r = rotation_about("y", yaw)
    return [
        Surface(f"{name} cover", cover, cloth(colour, 0.008, 0.08), spacing, gloss=0.02)
        .placed(r, offset)
        .placed(None, at),
        Surface(f"{name} pages", pages, paper, spacing).placed(r, offset).placed(None, at),
    ]


def ornaments() -> list[Surface]:
    """A vase, a clock, a model ship's worth of small things in the gaps."""
    vase = smooth_curve(
        [(0.0, 0.0), (0.035, 0.001), (0.06, 0.06), (0.065, 0.11), (0.03, 0.17), (0.024, 0.20), (0.036, 0.225)], 40
    )

    def glaze(p, n):
        wave = np.abs(p[:, 1] - 0.09 - 0.012 * np.sin(6 * np.arctan2(p[:, 2], p[:, 0])))
        return mix(srgb("eef0ee"), srgb("2b4f8a"), smoothstep(0.020, 0.012, wave) + (np.abs(p[:, 1] - 0.165) < 0.006))

    bust_profile = smooth_curve([(0.0, 0.0), (0.05, 0.0), (0.05, 0.02), (0.022, 0.035), (0.020, 0.06)], 20)
    bust = [
        lathe(bust_profile, 24),
        superellipsoid((0.15, 0.09, 0.08), 0.8, 16).moved(translation=(0, 0.095, 0)),
        superellipsoid((0.045, 0.07, 0.045), 0.9, 12).moved(translation=(0, 0.15, 0.0)),
        superellipsoid((0.078, 0.105, 0.09), 0.9, 18).moved(translation=(0, 0.205, 0.006)),
        superellipsoid((0.018, 0.03, 0.03), 0.9, 8).moved(translation=(0, 0.20, 0.053)),
        superellipsoid((0.084, 0.06, 0.094), 0.9, 16).moved(translation=(0, 0.235, -0.006)),
    ]
    edges = bay_edges()
    return [
        Surface("blue vase", lathe(vase, 40), glaze, 0.006, gloss=0.05, roughness=0.1).placed(
            position=(edges[1] + 0.54, SHELVES[1], Z0 + 0.15)
        ),
        Surface("bust", join(*bust), plain("e4ded0", 0.03, 0.04), 0.0075).placed(
            rotation_about("y", 12), (edges[2] + 0.275, SHELVES[2], Z0 + 0.15)
        ),
        *mantel_clock((edges[0] + 0.78, SHELVES[2], Z0 + 0.16)),
        *hourglass((edges[1] + 0.20, SHELVES[4], Z0 + 0.16)),
        Surface(
            "box of letters",
            beveled_box((0.24, 0.13, 0.16), 0.006).moved(translation=(0, 0.065, 0)),
            plain("5a2f22", 0.08, 0.05),
            0.0085,
            gloss=0.04,
        ).placed(rotation_about("y", 6), (edges[0] + 0.72, SHELVES[3], Z0 + 0.15)),
    ]


def mantel_clock(at) -> list[Surface]:
    """Round-topped clock of dark wood with a white face."""
    a = np.linspace(0, np.pi, 24)
    outline = np.concatenate(
        [[(-0.085, 0.0), (0.085, 0.0)], np.stack([0.085 * np.cos(a), 0.10 + 0.085 * np.sin(a)], 1)]
    )
    body = grid_mesh(np.stack([np.insert(outline, 2, z, axis=1) for z in (0.04, -0.04)], 1)[::-1], close_u=True)
    middle = np.array([[0.0, 0.09, 0.04]])
    front = np.concatenate([np.insert(outline, 2, 0.04, axis=1), middle])
    count = len(outline)
    lid = Mesh(front, np.array([(k, (k + 1) % count, count) for k in range(count)]))
    disc = lathe([(0.062, 0.0), (0.062, 0.004), (0.0, 0.004)], 40).moved(rotation_about("x", 90), (0, 0.105, 0.041))

    def face(p, n):
        x, y = p[:, 0], p[:, 1] - 0.105
        r, turn = np.hypot(x, y), np.arctan2(x, y) / (2 * np.pi) * 12
        tick = (np.abs(turn - np.round(turn)) < 0.11) & (r > 0.045) & (r < 0.054)
        for angle, length in ((305, 0.030), (60, 0.044)):
            d = np.array([np.sin(np.radians(angle)), np.cos(np.radians(angle))])
            along, aside = x * d[0] + y * d[1], np.abs(x * d[1] - y * d[0])
            tick |= (aside < 0.0022) & (along > -0.006) & (along < length)
        c = np.where(tick[:, None], srgb("26201a"), srgb("f2ead6"))
        return np.where((r > 0.057)[:, None], srgb("b08a3c"), c)

    timber = plain("4a2a18", 0.15, 0.05)
    return [
        Surface("clock", join(body, lid), timber, 0.008, gloss=0.05).placed(None, at),
        Surface("clock face", disc, face, 0.0042).placed(None, at),
    ]


def hourglass(at) -> list[Surface]:
    """Hourglass with sand, between two wooden plates."""
    glass = smooth_curve([(0.028, 0.012), (0.030, 0.03), (0.006, 0.075), (0.030, 0.12), (0.028, 0.138)], 30)
    plates = join(
        *(lathe([(0.040, y), (0.040, y + 0.012), (0.0, y + 0.012)], 24) for y in (0.0, 0.138)),
        *(lathe([(0.0, y), (0.040, y)], 24) for y in (0.138,)),
    )
    rods = [
        lathe([(0.004, 0.012), (0.004, 0.138)], 8).moved(None, (0.034 * np.cos(t), 0, 0.034 * np.sin(t)))
        for t in (0.3, 2.4, 4.5)
    ]

    def sand(p, n):
        full = (p[:, 1] < 0.045) | ((p[:, 1] > 0.078) & (p[:, 1] < 0.10))
        return np.where(full[:, None], srgb("d8b878"), srgb("b9c4c0"))

    return [
        Surface("hourglass", lathe(glass, 28), sand, 0.005, gloss=0.08).placed(None, at),
        Surface("hourglass frame", join(plates, *rods), plain("6b4022", 0.1, 0.02), 0.006).placed(None, at),
    ]
