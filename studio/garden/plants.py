"""Plants of the garden: hedges, an apple tree, flower beds."""

from __future__ import annotations

import numpy as np

from studio.garden.ground import HIGH, LOW
from studio.shapes import Surface, box, grid_mesh, join, leaf_mesh, smooth_curve, superellipsoid, tube
from studio.textures import fbm, hash_uniform, mix, noise, plain, smoothstep, srgb

HEDGE_HEIGHT, HEDGE_DEPTH = 1.55, 0.55  # [m]
TREE_AT = (-2.15, -2.35)  # [m] x, z
TRUNK_RADIUS = 0.13  # [m]
BEDS = [((-3.3, -3.95), (-0.9, -3.45)), ((-0.6, -3.95), (0.95, -3.45))]  # [m] x, z of low and high corners
# Rings of flowers on the lawn: x, z of the middle [m], colour; scenes repeat the places.
RINGS = [((-0.95, 0.15), "e88a3a"), ((-0.25, -0.85), "8d6fc0"), ((-1.25, -1.45), "e4607a"), ((0.55, -1.55), "f6f0e4"),
         ((0.45, 0.25), "f2c53b")]  # fmt: skip
RING_RADIUS, RING_FLOWERS = 0.46, 15  # [m]
FLOWERS = [
    ("e4607a", 0.030),
    ("f6f0e4", 0.026),
    ("f2b93b", 0.026),
    ("8d6fc0", 0.022),
    ("e88aa8", 0.034),
]  # colour, size


def plants() -> list[Surface]:
    """All of them."""
    return [*hedges(), *apple_tree(), *flower_beds(), *flower_rings()]


def leaves_on(rng, points, normals, size: float, flatness: float = 0.6):
    """Leaves of about `size` [m] at points (N, 3) that look along the normals (N, 3), more or less."""
    n = len(points)
    face = normals * flatness + rng.normal(size=(n, 3)) * 0.55
    face /= np.linalg.norm(face, axis=1, keepdims=True)
    along = np.cross(face, rng.normal(size=(n, 3)))
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    length = size * (0.7 + 0.6 * rng.random((n, 1)))
    return leaf_mesh(points, length * along, 0.62 * length * np.cross(face, along))


def foliage(light: str, dark: str, seed: int, scale: float = 30.0):
    """Greens that differ from leaf to leaf."""

    def colour_at(p, n):
        q = np.floor(p * scale).astype(int)
        t = hash_uniform(q[:, 0] * 7919 + q[:, 1] * 104729 + q[:, 2], seed)
        c = mix(srgb(dark), srgb(light), np.clip(0.75 * t + 0.35 * fbm(p * 1.5, 2, seed + 1) + 0.12, 0, 1))
        return c

    return colour_at


def hedges() -> list[Surface]:
    """Clipped beech round three sides; the far side has the fence."""
    rng = np.random.default_rng(601)
    (x0, z0), (x1, z1), d, h = LOW, HIGH, HEDGE_DEPTH, HEDGE_HEIGHT
    runs = [((x0 - d, z0 - d), (x0, z1 + d)), ((x1, z0 - d), (x1 + d, z1 + d)), ((x0, z1), (x1, z1 + d))]
    cores, points, normals = [], [], []
    for (a, b), (c, e) in runs:
        cores.append(box((a + 0.03, -0.02, b + 0.03), (c - 0.03, h - 0.03, e - 0.03)))
        along_z = (e - b) > (c - a)
        length = (e - b) if along_z else (c - a)
        inner = (c if a < x0 else a) if along_z else b
        for count, on_top in ((int(560 * length), False), (int(230 * length), True)):
            t, u = rng.random(count), rng.random(count)
            if on_top:
                x, y, z = a + u * (c - a), h + 0 * t, b + t * (e - b)
                if not along_z:
                    x, z = a + t * (c - a), b + u * (e - b)
                face = np.tile([0.0, 1.0, 0.0], (count, 1))
            elif along_z:
                x, y, z = inner + 0 * t, h * u, b + t * (e - b)
                face = np.tile([1.0 if a < x0 else -1.0, 0.0, 0.0], (count, 1))
            else:
                x, y, z = a + t * (c - a), h * u, inner + 0 * t
                face = np.tile([0.0, 0.0, -1.0], (count, 1))
            p = np.stack([x, y, z], 1)
            bulge = 0.05 * noise(p * 2.2, 602) + 0.025 * rng.normal(size=count)
            points.append(p + (bulge + 0.02)[:, None] * face)
            normals.append(face)
    mesh = leaves_on(rng, np.concatenate(points), np.concatenate(normals), 0.085, 0.25)
    return [
        Surface("hedge core", join(*cores), plain("44602a", 0.25, 0.1), 0.075, width=1.15),
        Surface("hedge", mesh, foliage("9dbb5e", "547a36", 603), 0.05, translucency=0.35, leaves=True),
    ]


def apple_tree() -> list[Surface]:
    """Old apple tree: a leaning trunk, five boughs, a round crown, red apples."""
    rng = np.random.default_rng(611)
    x, z = TREE_AT
    trunk = smooth_curve([(0, -0.05, 0), (0.03, 0.4, 0.02), (-0.03, 0.9, 0.0), (0.05, 1.35, 0.05)], 20)
    radii = np.interp(np.linspace(0, 1, 20), [0, 0.12, 0.6, 1], [1.45, 1.0, 0.85, 0.8]) * TRUNK_RADIUS
    wood, tips = [tube(trunk, radii, 16)], []
    for k in range(6):
        a = 2 * np.pi * k / 6 + 0.4
        out = np.array([np.cos(a), 0.0, np.sin(a)])
        tip = np.array([0.05, 1.75 + 0.25 * (k % 2), 0.05]) + (0.75 + 0.15 * (k % 3)) * out
        middle = np.array([0.05, 1.45, 0.05]) + 0.35 * out
        bough = smooth_curve([(0.05, 1.25, 0.05), middle, tip], 10)
        wood.append(tube(bough, np.linspace(0.07, 0.02, 10), 10))
        tips.append(tip)
    tips += [np.array([0.05, 2.35, 0.05]), np.array([0.35, 2.15, 0.2]), np.array([-0.3, 2.2, -0.1])]
    points, normals = [], []
    for tip in tips:
        d = rng.normal(size=(620, 3))
        d /= np.linalg.norm(d, axis=1, keepdims=True)
        r = 0.56 * np.cbrt(rng.uniform(0.35, 1.0, (620, 1)))
        points.append(tip + d * r * (1.0, 0.72, 1.0))
        normals.append(d + (0, 0.5, 0))
    crown = leaves_on(rng, np.concatenate(points), np.concatenate(normals), 0.105)
    apples = []
    for k in range(34):
        tip, d = tips[k % len(tips)], rng.normal(size=3)
        at = tip + d / np.linalg.norm(d) * (0.50, 0.36, 0.50)
        apples.append(superellipsoid((0.075, 0.07, 0.075), 1.0, 8).moved(translation=at - (0, 0.05, 0)))

    def bark(p, n):
        furrow = noise(p * (38, 7, 38), 612) + 0.5 * noise(p * (90, 20, 90), 613)
        return mix(srgb("5a4636"), srgb("a08c74"), smoothstep(-0.5, 0.6, furrow))

    def blush(p, n):
        return mix(srgb("c92f28"), srgb("e8b24a"), smoothstep(0.0, 0.5, noise(p * 14, 614)))

    surfaces = [
        Surface("trunk", join(*wood), bark, 0.016),
        Surface("crown", crown, foliage("97b356", "46672d", 615), 0.05, translucency=0.4, leaves=True),
        Surface("apples", join(*apples), blush, 0.020, gloss=0.04),
    ]
    return [s.placed(position=(x, 0.0, z)) for s in surfaces]


def flower_beds() -> list[Surface]:
    """Earth, green and blossoms before the fence, and round the foot of the tree."""
    rng = np.random.default_rng(621)
    u, v = np.linspace(0, 1, 24)[:, None], np.linspace(0, 1, 8)[None]
    mounds, plants_at, flowers = [], [], {colour: [] for colour, _ in FLOWERS}
    for (x0, z0), (x1, z1) in BEDS:
        y = 0.07 * np.sin(np.pi * u) ** 0.4 * np.sin(np.pi * v) ** 0.5 + 0.001
        points = np.stack(np.broadcast_arrays(x0 + (x1 - x0) * u, y, z1 + (z0 - z1) * v), -1)
        mounds.append(grid_mesh(points))
        count = int(13 * (x1 - x0))
        plants_at += list(
            zip(rng.uniform(x0 + 0.1, x1 - 0.1, count), rng.uniform(z0 + 0.1, z1 - 0.08, count), strict=True)
        )
    around = np.linspace(0, 2 * np.pi, 9)[:-1]
    plants_at += [(TREE_AT[0] + 0.34 * np.cos(a), TREE_AT[1] + 0.34 * np.sin(a)) for a in around]
    green_p, green_n = [], []
    for k, (x, z) in enumerate(plants_at):
        low = k >= len(plants_at) - len(around)
        height, radius = (0.16, 0.09) if low else (0.22 + 0.26 * rng.random(), 0.11 + 0.05 * rng.random())
        d = rng.normal(size=(46, 3))
        d = d / np.linalg.norm(d, axis=1, keepdims=True) * (1, 1, 1)
        p = np.array([x, 0.05 + 0.45 * height, z]) + d * (radius, 0.5 * height, radius)
        green_p.append(p[p[:, 1] > 0.02])
        green_n.append(d[p[:, 1] > 0.02])
        colour, size = FLOWERS[int(rng.integers(len(FLOWERS)))]
        d = rng.normal(size=(9, 3)) * (1, 0.5, 1) + (0, 0.9, 0.5)
        d /= np.linalg.norm(d, axis=1, keepdims=True)
        head = np.array([x, 0.06 + 0.5 * height, z]) + d * (radius * 1.1, 0.56 * height, radius * 1.1)
        flowers[colour].append(petals(rng, head, d, size))
    surfaces = [
        Surface("earth", join(*mounds), plain("4a3524", 0.35, 0.02), 0.04, width=1.1),
        Surface(
            "herbs",
            leaves_on(rng, np.concatenate(green_p), np.concatenate(green_n), 0.075),
            foliage("86a84e", "3f632c", 622, 40.0),
            0.05,
            translucency=0.35,
            leaves=True,
        ),
    ]
    return [*surfaces, *(blossoms(colour, parts) for colour, parts in flowers.items() if parts)]


def flower_rings() -> list[Surface]:
    """A ring of low flowers round each animal's place."""
    rng = np.random.default_rng(631)
    return [surface for at, colour in RINGS for surface in ring_of_flowers(rng, at, colour)]


def ring_of_flowers(
    rng, at: tuple[float, float], colour: str, *, count: int = RING_FLOWERS, size: float = 0.036, height: float = 0.055
) -> list[Surface]:
    """A ring of low flowers around x, z [m], with petals of about `size` [m] at a height [m]."""
    a = 2 * np.pi * np.arange(count) / count + rng.normal(size=count) * 0.03
    r = RING_RADIUS + 0.015 * rng.normal(size=count)
    y = height + 0.01 * rng.random(count)
    head = np.stack([at[0] + r * np.cos(a), y, at[1] + r * np.sin(a)], 1)
    up = np.array([0.0, 1.0, 0.25]) + 0.2 * rng.normal(size=head.shape)
    up /= np.linalg.norm(up, axis=1, keepdims=True)
    flowers = blossoms(colour, [petals(rng, head, up, size)])
    side = np.cross(up, (1.0, 0.0, 0.3))
    heart = leaf_mesh(head + size / 6 * up, size / 1.5 * side, size / 1.5 * np.cross(up, side))
    tone = "7a4a1c" if colour != "f6f0e4" else "f2b93b"
    return [flowers, Surface("hearts", heart, plain(tone, 0.05, 0.05), 0.05, translucency=0.3, leaves=True)]


def petals(rng, heads: np.ndarray, up: np.ndarray, size: float) -> tuple:
    """Centres and edges (5 N, 3) of the petals of blossoms at `heads` (N, 3) that look `up` (N, 3)."""
    parts = []
    for petal in range(5):
        a = 2 * np.pi * petal / 5 + rng.random()
        side = np.cross(up, (np.cos(a), 0.2, np.sin(a)))
        side /= np.linalg.norm(side, axis=1, keepdims=True)
        parts.append((heads + 0.55 * size * side, size * 1.15 * side, size * 0.9 * np.cross(up, side)))
    return tuple(np.concatenate(part) for part in zip(*parts, strict=True))


def blossoms(colour: str, parts: list[tuple]) -> Surface:
    """The petals `parts` in one colour."""
    mesh = leaf_mesh(*(np.concatenate(part) for part in zip(*parts, strict=True)))
    return Surface("petals", mesh, plain(colour, 0.08, 0.05), 0.05, translucency=0.4, leaves=True)
