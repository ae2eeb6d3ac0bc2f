"""Elastic toys for the table: a rubber ball with stars, and a bear of jelly."""

from __future__ import annotations

import numpy as np

from assets.asset import Asset
from core.material import Material
from studio.detail import Detail
from studio.handled import handled, solid_cage, solid_grid, solid_mesh
from studio.shapes import Surface, superellipsoid
from studio.solids import sphere
from studio.textures import fbm, mix, smoothstep, srgb

BALL_RADIUS = 0.042  # [m]
BALL_MATERIAL = Material(young=3e4, poisson=0.35, density=900.0, friction=0.7, damping=30.0)
BEAR_MATERIAL = Material.named("jelly", young=1.2e4, poisson=0.35, friction=0.7, kinetic_friction=0.5, damping=30.0)
SEAM = 0.006  # [m] width of the rounded seams between the bear's parts
# Centre, radii [m] of the bear's ellipsoids before scaling; it sits and faces +z.
BEAR_PARTS = (
    ((0.0, 0.020, 0.0), (0.024, 0.026, 0.021)),  # belly
    ((0.0, 0.057, 0.002), (0.020, 0.018, 0.017)),  # head
    ((0.0, 0.052, 0.018), (0.0085, 0.007, 0.008)),  # muzzle
    ((0.0155, 0.071, 0.0), (0.0072, 0.0075, 0.006)),  # ears
    ((-0.0155, 0.071, 0.0), (0.0072, 0.0075, 0.006)),
    ((0.023, 0.030, 0.011), (0.0075, 0.014, 0.0095)),  # arms
    ((-0.023, 0.030, 0.011), (0.0075, 0.014, 0.0095)),
    ((0.0165, 0.006, 0.017), (0.0100, 0.0105, 0.017)),  # legs
    ((-0.0165, 0.006, 0.017), (0.0100, 0.0105, 0.017)),
)


def rubber_ball(rng: np.random.Generator, detail: Detail, report) -> Asset:
    """The asset `rubber_ball`. Taichi must be running."""
    r = BALL_RADIUS
    vertices = detail.cage_vertices(160)
    grid = solid_grid(sphere((0, 0, 0), r), (-r, -r, -r), (r, r, r), vertices)
    mesh = superellipsoid((2 * r, 2 * r, 2 * r), 1.0, 40)
    surface = Surface("rubber ball", mesh, ball_colour, 0.0026, uniform=True)
    cage = solid_cage(grid, vertices)
    return handled("rubber_ball", [surface], cage, BALL_MATERIAL, rng, detail, distance=grid, gleam=0.16, degree=2)


def ball_colour(p, n):
    """Red rubber with a white belt and yellow stars on both sides."""
    d = p / np.linalg.norm(p, axis=1, keepdims=True)
    c = np.broadcast_to(srgb("d0342c"), p.shape) * (1 + 0.04 * fbm(p * 80, 2, 1))[:, None]
    belt = smoothstep(0.30, 0.28, np.abs(d[:, 1]))
    c = mix(c, srgb("f3ead8"), belt)
    c = mix(c, srgb("2c62a8"), smoothstep(0.17, 0.15, np.abs(d[:, 1])))
    angle = np.arctan2(d[:, 2], d[:, 0])
    radius = np.hypot(d[:, 0], d[:, 2])
    star = 0.34 + 0.20 * np.abs(((angle * 5 / (2 * np.pi)) % 1) - 0.5) * 2
    return mix(c, srgb("f2c23a"), smoothstep(0.02, -0.02, radius - star) * (np.abs(d[:, 1]) > 0.5))


def jelly_bear(rng: np.random.Generator, detail: Detail, report) -> Asset:
    """The asset `jelly_bear`, whose origin lies at the centre of its base. Taichi must be running."""
    vertices = detail.cage_vertices(220)
    grid = solid_grid(bear_distance, (-0.032, 0.0, -0.022), (0.032, 0.080, 0.036), vertices)
    surface = Surface("jelly bear", solid_mesh(grid), bear_colour, 0.0021, uniform=True)
    cage = solid_cage(grid, vertices)
    return handled("jelly_bear", [surface], cage, BEAR_MATERIAL, rng, detail, distance=grid, gleam=0.22, degree=2)


def bear_distance(p: np.ndarray) -> np.ndarray:
    """Distance (N,) [m], negative inside: a smooth union of ellipsoids, cut flat where the bear sits."""
    total = None
    for centre, radii in BEAR_PARTS:
        q, r = p - np.array(centre), np.array(radii)
        inner, outer = np.linalg.norm(q / r, axis=1), np.linalg.norm(q / r**2, axis=1)
        d = inner * (inner - 1) / np.maximum(outer, 1e-9)
        if total is None:
            total = d
        else:  # polynomial smooth minimum (Quilez)
            h = (0.5 + 0.5 * (total - d) / SEAM).clip(0, 1)
            total = total * (1 - h) + d * h - SEAM * h * (1 - h)
    return np.maximum(total, -p[:, 1])


def bear_colour(p, n):
    """Green jelly: deep where it is thick, light where light shines through; eyes and nose are dents."""
    deep, light = srgb("1f7a35"), srgb("86d264")
    thin = smoothstep(0.012, 0.034, np.abs(p[:, 0])) + smoothstep(0.058, 0.078, p[:, 1])
    c = mix(deep, light, np.clip(0.30 + 0.5 * thin + 0.25 * n[:, 1] + 0.12 * fbm(p * 70, 2, 9), 0, 1))
    for x, y, r in ((0.0075, 0.0605, 0.0028), (-0.0075, 0.0605, 0.0028), (0.0, 0.0545, 0.0030)):
        dent = smoothstep(r, 0.6 * r, np.hypot(p[:, 0] - x, p[:, 1] - y)) * (n[:, 2] > 0.2)
        c = mix(c, srgb("0f3d1c"), 0.9 * dent)
    return c
