"""Scenery: a painted backdrop of dusk over hills and a lake, and cut-out trees and waves before it."""

from __future__ import annotations

import numpy as np

from studio.shapes import Mesh, Surface, grid_mesh
from studio.stage.house import HOUSE_TOP, STAGE_BACK, STAGE_HALF_WIDTH, STAGE_TOP
from studio.textures import fbm, hash_uniform, mix, noise, smoothstep, srgb

MOON = (0.62, 2.02)  # [m] x and y of its centre
MOON_RADIUS = 0.26  # [m]
HORIZON = 1.38  # [m]


def scenery() -> list[Surface]:
    """The backdrop and the cut-outs."""
    return [backdrop(), *cut_outs()]


def backdrop() -> Surface:
    """Canvas across the whole back: sky with moon, clouds and stars, three ranges of hills, a lake."""
    a = STAGE_HALF_WIDTH
    u, v = np.linspace(-a, a, 40)[:, None], np.linspace(STAGE_TOP, HOUSE_TOP, 24)[None, :]
    mesh = grid_mesh(np.stack(np.broadcast_arrays(u, v, STAGE_BACK + 0 * u * v), -1))
    return Surface("backdrop", mesh, painted_sky, 0.0205, uniform=True, width=1.05)


def painted_sky(p, n):
    """Albedo of the backdrop, in broad brush strokes."""
    x, y = p[:, 0], p[:, 1]
    flat = np.stack([x, y, 0 * x], 1)
    stroke = fbm(flat * (2.2, 7.0, 1.0), 4, 401)
    up = (y - HORIZON) / (2.9 - HORIZON) + 0.06 * stroke
    sky = mix(srgb("f0a060"), srgb("b86a80"), smoothstep(0.02, 0.24, up))
    sky = mix(sky, srgb("4a4a90"), smoothstep(0.18, 0.55, up))
    sky = mix(sky, srgb("1c2458"), smoothstep(0.5, 1.0, up))
    cloud = smoothstep(
        0.10, 0.45, fbm(flat * (1.1, 4.2, 1.0) + 3.0, 5, 403) + 0.35 * np.exp(-(((up - 0.30) / 0.16) ** 2))
    )
    sky = mix(sky, mix(srgb("f4b890"), srgb("7a6aa8"), smoothstep(0.1, 0.6, up)), 0.55 * cloud)
    r = np.hypot(x - MOON[0], y - MOON[1])
    sky = mix(sky, srgb("e8d8b8"), 0.55 * np.exp(-np.maximum(r - MOON_RADIUS, 0) / 0.16))
    mare = smoothstep(0.0, 0.5, fbm(flat * 7.0, 3, 405))
    sky = mix(
        sky, mix(srgb("fff6dc"), srgb("e2cfa4"), 0.7 * mare), smoothstep(MOON_RADIUS + 0.012, MOON_RADIUS - 0.012, r)
    )
    cell = np.floor(flat[:, :2] / 0.17).astype(np.int64)
    key = cell[:, 0] * 7919 + cell[:, 1]
    star = 0.17 * (cell + 0.5 + 0.6 * (np.stack([hash_uniform(key, 1), hash_uniform(key, 2)], 1) - 0.5))
    size = 0.009 + 0.010 * hash_uniform(key, 3)
    bright = (
        (np.hypot(*(flat[:, :2] - star).T) < size)
        & (hash_uniform(key, 4) > 0.62)
        & (up > 0.5)
        & (r > MOON_RADIUS + 0.1)
    )
    c = np.where(bright[:, None], srgb("fff4d0"), sky)
    for k, (level, rough, tone) in enumerate(((1.62, 0.34, "6a6a98"), (1.50, 0.26, "46567e"), (1.40, 0.20, "2c4258"))):
        ridge = level + rough * fbm(np.stack([x * (0.9 + 0.5 * k) + 5 * k, 0 * x, 0 * x], 1), 4, 411 + k)
        hill = mix(srgb(tone), srgb("c88a70"), 0.35 * smoothstep(0.10, 0.0, ridge - y))
        c = np.where((y < ridge)[:, None], hill * (1 + 0.22 * stroke)[:, None], c)
    shore = 1.20 + 0.015 * fbm(np.stack([x * 3, 0 * x, 0 * x], 1), 3, 421)
    ripple = noise(flat * (3.0, 42.0, 1.0), 423)
    lake = mix(srgb("2c4470"), srgb("c88a78"), smoothstep(0.95, 1.2, y + 0.05 * ripple))
    path = smoothstep(0.26, 0.05, np.abs(x - MOON[0]) * (1.0 + 0.8 * np.abs(ripple)))
    lake = mix(lake, srgb("ffe9b8"), 0.75 * path * smoothstep(-0.25, 0.25, ripple))
    return np.where((y < shore)[:, None], lake, c) * (1 + 0.05 * noise(flat * 30, 425))[:, None]


def cut_outs() -> list[Surface]:
    """Trees at both sides and two rows of painted bushes, sawn out of boards."""
    surfaces = []
    for s, z, seed in ((-1, -1.28, 431), (1, -1.33, 433)):
        surfaces.append(tree(s, z, seed))
    for z, height, tone, seed in ((-1.56, 0.26, ("2c4a46", "5a7a58"), 441), (-1.40, 0.17, ("30502c", "86984a"), 443)):
        x = np.linspace(-STAGE_HALF_WIDTH, STAGE_HALF_WIDTH, 240)
        bump = height * (0.72 + 0.30 * np.abs(np.sin(3.1 * x + seed)) + 0.12 * np.abs(np.sin(11 * x)))
        bump *= 0.75 + 0.55 * (np.abs(x) / STAGE_HALF_WIDTH) ** 1.5  # lower in the middle
        t = np.linspace(0, 1, 8)
        points = np.stack(
            [np.broadcast_to(x[:, None], (240, 8)), STAGE_TOP + bump[:, None] * t, np.full((240, 8), z)], -1
        )

        def leaves(p, n, tone=tone, seed=seed, height=height):
            dab = fbm(p * (14, 14, 1), 3, seed)
            light = smoothstep(-0.4, 0.6, dab + 1.4 * ((p[:, 1] - STAGE_TOP) / height - 0.6))
            return mix(srgb(tone[0]), srgb(tone[1]), light)

        surfaces.append(Surface("bushes", grid_mesh(points), leaves, 0.019, uniform=True))
    return surfaces


def tree(side: int, z: float, seed: int) -> Surface:
    """A flat tree: trunk and a crown of painted foliage, its outline sawn in lobes."""
    x0, y0 = side * 1.30, STAGE_TOP
    a = np.linspace(0, 2 * np.pi, 220, endpoint=False)
    lobes = 0.40 * (1 + 0.10 * np.abs(np.sin(4.5 * a + seed)) + 0.05 * np.abs(np.sin(9 * a)))
    rim = np.stack([x0 + 1.05 * lobes * np.cos(a), y0 + 1.22 + 1.25 * lobes * np.sin(a)], 1)
    t = np.linspace(0.02, 1, 14)[:, None, None]
    middle = np.array([x0, y0 + 1.22])
    crown = np.concatenate([middle + t * (rim - middle), np.full((14, 220, 1), z)], 2)
    y = np.linspace(0, 0.95, 12)[:, None]
    half = 0.055 + 0.05 * np.exp(-y / 0.10) + 0.012 * np.sin(9 * y)
    across = np.linspace(-1, 1, 6)[None]
    trunk = np.stack(np.broadcast_arrays(x0 + half * across + 0.03 * np.sin(3 * y), y0 + y, z - 0.006), -1)
    one, two = grid_mesh(crown, close_v=True), grid_mesh(trunk[:, ::-1].transpose(1, 0, 2)[::-1])
    mesh = Mesh(
        np.concatenate([one.vertices, two.vertices]), np.concatenate([one.faces, two.faces + len(one.vertices)])
    )
    mesh = facing_hall(mesh)

    def colour_at(p, n):
        dab = fbm(p * (13, 13, 1), 3, seed)
        h = (p[:, 1] - middle[1]) / 0.5 - 0.5 * (p[:, 0] - x0) * side / 0.4
        green = mix(srgb("23402a"), srgb("7f9a48"), smoothstep(-0.8, 0.9, h + 1.5 * dab))
        bark = mix(srgb("4a3424"), srgb("7a5a3c"), smoothstep(-0.4, 0.4, noise(p * (60, 9, 1), seed + 1)))
        return np.where((p[:, 2] < z - 0.003)[:, None], bark, green)

    return Surface("tree", mesh, colour_at, 0.018, uniform=True)


def facing_hall(mesh: Mesh) -> Mesh:
    """The flat mesh with all faces turned to +z."""
    v = mesh.vertices[mesh.faces]
    away = np.cross(v[:, 1] - v[:, 0], v[:, 2] - v[:, 0])[:, 2] < 0
    faces = mesh.faces.copy()
    faces[away] = faces[away][:, ::-1]
    return Mesh(mesh.vertices, faces)
