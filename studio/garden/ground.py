"""Ground and sky of the garden: lawn with blades of grass, gravel path, meadow and trees beyond, clouds."""

from __future__ import annotations

import numpy as np

from studio.shapes import Surface, grid_mesh, leaf_mesh, quad
from studio.textures import fbm, hash_uniform, mix, noise, smoothstep, srgb

LOW, HIGH = (-3.6, -4.2), (3.6, 3.0)  # [m] x, z of the lawn between the hedges
PATH_WIDTH = 0.62  # [m]
BLADES = 44_000  # before they are thinned out
PLAY = (0.0, 0.1)  # [m] x, z: the grass is densest round it
SKY_RADIUS = 16.0  # [m]
GRASS = ("6f9440", "9db45a", "587a34")


def ground() -> list[Surface]:
    """All of it."""
    return [lawn(), *grass(), path(), meadow(), sky()]


def path_x(z) -> np.ndarray:
    """x of the middle of the path [m] at z [m]."""
    z = np.asarray(z, float)
    return 1.85 - 0.35 * np.sin(0.75 * z + 0.4) - 0.08 * (z + 1.0)


def on_path(x, z, margin: float = 0.0) -> np.ndarray:
    """Mask of places on the path, or within `margin` [m] of it."""
    return np.abs(x - path_x(z)) < PATH_WIDTH / 2 + margin


def mown(p: np.ndarray) -> np.ndarray:
    """Colour (N, 3) of the lawn: patches, and faint stripes of the mower."""
    light, yellow, dark = (srgb(c) for c in GRASS)
    c = mix(dark, light, smoothstep(-0.5, 0.5, fbm(p * (1.3, 0, 1.3), 3, 501)))
    c = mix(c, yellow, 0.5 * smoothstep(0.05, 0.5, fbm(p * (0.8, 0, 0.8), 2, 505)))
    stripe = smoothstep(-0.25, 0.25, np.sin(2 * np.pi * (p[:, 0] + 0.5 * p[:, 2]) / 0.9))
    return c * (0.92 + 0.14 * stripe)[:, None]


def lawn() -> Surface:
    """The ground under the grass."""

    def colour_at(p, n):
        tufts = 0.70 + 0.30 * noise(p * (26, 0, 26), 503) + 0.25 * noise(p * (70, 0, 70), 504)
        return mown(p) * tufts.clip(0.25, 1.3)[:, None]

    (x0, z0), (x1, z1) = LOW, HIGH
    return Surface("lawn", quad((x0, 0, z1), (x1 - x0, 0, 0), (0, 0, z0 - z1)), colour_at, 0.030, width=1.1)


def grass() -> list[Surface]:
    """Blades, the nearer the denser; daisies among them."""
    rng = np.random.default_rng(511)
    (x0, z0), (x1, z1) = LOW, HIGH
    x, z = rng.uniform(x0 + 0.1, x1 - 0.1, BLADES), rng.uniform(z0 + 0.1, z1 - 0.1, BLADES)
    spread = np.hypot(x - PLAY[0], z - PLAY[1])
    keep = (rng.random(BLADES) < smoothstep(4.2, 1.6, spread)) & ~on_path(x, z, 0.02)
    x, z, spread = x[keep], z[keep], spread[keep]
    n = len(x)
    height = (0.030 + 0.022 * rng.random(n)) * (1 + 0.12 * spread)
    lean = rng.normal(size=(n, 2)) * 0.35
    along = height[:, None] * np.stack([lean[:, 0], np.ones(n), lean[:, 1]], 1)
    turn = rng.uniform(0, np.pi, n)
    width = (0.0075 + 0.002 * rng.random(n)) * (1 + 0.35 * spread)
    across = width[:, None] * np.stack([np.cos(turn), 0 * turn, np.sin(turn)], 1)
    mesh = leaf_mesh(np.stack([x, 0.45 * height, z], 1), along, across)

    def blade(p, n):
        q = np.floor(p * (90, 0, 90)).astype(int)
        tone = 0.75 + 0.65 * hash_uniform(q[:, 0] * 7919 + q[:, 2], 512)
        return mown(p * (1, 0, 1)) * tone[:, None] * (1.15, 1.1, 0.85)

    options = {"translucency": 0.45, "leaves": True}
    surfaces = [Surface("grass", mesh, blade, 0.02, **options)]
    count = 170
    x, z = rng.uniform(-2.6, 1.3, count), rng.uniform(-3.2, 2.2, count)
    patch = noise(np.stack([x, 0 * x, z], 1) * 0.9, 513) > 0.0
    x, z = x[patch & ~on_path(x, z, 0.1)], z[patch & ~on_path(x, z, 0.1)]
    for name, colour, size, y in (("daisies", "fbf8ee", 0.026, 0.042), ("daisy hearts", "f3c53c", 0.009, 0.046)):
        flat = np.zeros((len(x), 3))
        discs = leaf_mesh(flat + np.stack([x, 0 * x + y, z], 1), flat + (0, 0, size), flat + (size, 0, 0))
        tone = srgb(colour)
        surfaces.append(Surface(name, discs, lambda p, n, tone=tone: tone + 0 * p, 0.02, **options))
    return surfaces


def path() -> Surface:
    """Gravel path."""
    z, u = np.linspace(HIGH[1], LOW[1], 60)[:, None], np.linspace(-0.5, 0.5, 9)[None]
    wobble = 0.03 * np.sin(7 * z + 3 * u)
    x = path_x(z) + u * PATH_WIDTH + wobble
    mesh = grid_mesh(np.stack(np.broadcast_arrays(x, 0.012 - 0.02 * (2 * u) ** 4 + 0 * z, z), -1)[:, ::-1])

    def colour_at(p, n):
        grain = noise(p * (55, 0, 55), 521) + 0.6 * noise(p * (120, 0, 120), 522)
        c = mix(srgb("8f7a5a"), srgb("c4b28e"), smoothstep(-0.5, 0.6, grain))
        return c * (1 + 0.10 * fbm(p * (2, 0, 2), 2, 523))[:, None]

    return Surface("path", mesh, colour_at, 0.028, width=1.1)


def meadow() -> Surface:
    """Surroundings of the garden, up to the sky."""
    r = SKY_RADIUS + 1.0

    def colour_at(p, n):
        return mix(srgb("6f8f45"), srgb("a9b765"), smoothstep(-0.4, 0.4, fbm(p * (0.5, 0, 0.5), 3, 531)))

    mesh = quad((-r, -0.03, r), (2 * r, 0, 0), (0, 0, -2 * r))
    return Surface("meadow", mesh, colour_at, 0.22, width=1.2)


def sky() -> Surface:
    """Dome with clouds over a line of trees; luminous, and no hindrance to the light that it stands for."""
    lat, lon = np.linspace(np.pi / 2, -0.10, 26)[None], np.linspace(0, 2 * np.pi, 72, endpoint=False)[:, None]
    points = np.broadcast_arrays(np.cos(lat) * np.cos(lon), np.sin(lat) + 0 * lon, -np.cos(lat) * np.sin(lon))
    mesh = grid_mesh(SKY_RADIUS * np.stack(points, -1), close_u=True)

    def colour_at(p, n):
        d = p / np.linalg.norm(p, axis=1, keepdims=True)
        up = d[:, 1]
        blue = mix(srgb("cfe3f0"), srgb("4a90d6"), smoothstep(0.0, 0.7, up))
        q = d / np.maximum(up + 0.25, 0.1)[:, None] * (1.5, 0, 1.5)
        cloud = smoothstep(0.02, 0.34, fbm(q + (0.3, 0, 1.1), 4, 541) + 0.05) * smoothstep(0.03, 0.2, up)
        c = mix(blue, srgb("fdfdfb"), 0.92 * cloud)
        lon = np.stack([np.arctan2(d[:, 2], d[:, 0]) * 4, 0 * up, 0 * up], 1)
        crowns = 0.115 + 0.045 * fbm(lon * 2.0, 4, 543) + 0.03 * noise(lon * 9, 544)
        leaves = fbm(d * 14, 3, 545)
        wood = mix(srgb("3d5a33"), srgb("6f8f4c"), smoothstep(-0.4, 0.5, leaves + 4 * (up - 0.08)))
        wood = mix(wood, srgb("9fb9c4"), 0.25)
        return mix(c, wood, smoothstep(crowns + 0.012, crowns - 0.012, up))

    options = {"emission": (2.3, 2.3, 2.3), "blocks_light": False, "uniform": True}
    return Surface("sky", mesh, colour_at, 0.30, width=1.2, **options)
