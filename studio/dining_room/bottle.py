"""The bottle, peg of the ring toss: dark green glass with a label and a foil capsule, lit by the room."""

from __future__ import annotations

import numpy as np

from assets.asset import Asset
from core.spherical_harmonics import C0
from studio.baked_light import RAY_OFFSET, BakedLight
from studio.detail import Detail
from studio.dining_room.furniture import TABLE_TOP
from studio.finish import (
    fit_view_dependence,
    sample_albedo,
    sharpened,
    smoothed,
    to_gaussians,
    tone_map,
    view_directions,
)
from studio.shapes import Mesh, Surface, grid_mesh, lathe, smooth_curve
from studio.solids import revolved, sample_distance_grid
from studio.surface_sampling import Surfels, join_surfels, sample_surfaces
from studio.textures import mix, plain, smoothstep, srgb

BOTTLE_AT = (0.0, TABLE_TOP, -0.15)  # [m] centre of its base in the room
BOTTLE_HEIGHT = 0.30  # [m]
BODY_RADIUS, NECK_RADIUS = 0.0368, 0.0138  # [m]
REFRACTIVE_INDEX = 1.45  # between glass and wine
TRANSMITTANCE = np.array([0.10, 0.30, 0.07])  # along the diameter of the body, linear RGB
LABEL_Y, LABEL_HALF_ANGLE = (0.058, 0.148), np.radians(78)  # [m], [rad] to either side of +z
LETTERS = np.array(  # "VR-GS"
    [
        [dot == "#" for dot in row]
        for row in (
            "#...#.####.........###...####",
            "#...#.#...#.......#...#.#....",
            "#...#.#...#.......#.....#....",
            "#...#.####..#####.#.###..###.",
            "#...#.#.#.........#...#.....#",
            ".#.#..#..#........#...#.....#",
            "..#...#...#........###..####.",
        )
    ]
)
LETTER_DOT = 0.0019  # [m]
PRINT_SPACING = 0.0014  # [m] of the label's surfels
FOIL_Y = 0.238  # [m] lower end of the foil
REFLECTION_LIFT = np.array([0.0, 0.5, 0.0])  # bends reflections up to the windows


def profile() -> np.ndarray:
    """Outline (K, 2) as (radius, y) [m], from the axis at the bottom to the axis at the top."""
    body, neck = BODY_RADIUS, NECK_RADIUS
    side = smooth_curve(
        [(body - 0.004, 0.0), (body - 0.0008, 0.0035), (body, 0.010), (body, 0.100), (body, 0.175), (0.0350, 0.192),
         (0.0285, 0.208), (0.0205, 0.222), (0.0162, 0.236), (neck + 0.0004, 0.255), (neck, 0.285)],
        90,
    )  # fmt: skip
    lip = [(neck + 0.0016, 0.2855), (neck + 0.0016, 0.2965), (neck + 0.0002, BOTTLE_HEIGHT)]
    return np.concatenate([[(0.0, 0.0)], side, lip, [(0.0, BOTTLE_HEIGHT)]])


def bottle_surfaces() -> list[Surface]:
    """Glass, foil and label, placed in the room."""
    curve = profile()
    cut = int(np.searchsorted(curve[1:-4, 1], FOIL_Y)) + 1
    foil = curve[cut:] + np.where(curve[cut:, :1] > 0, (0.0004, 0.0), (0.0, 0.0))
    surfaces = [
        Surface("glass", lathe(curve[: cut + 2], 64), plain(TRANSMITTANCE * 0.12), 0.0038, uniform=True),
        Surface("foil", lathe(foil, 48), plain("5c0f16", 0.04), 0.0034, uniform=True),
        Surface("label", _label_mesh(), label, 0.0019, uniform=True),
    ]
    return [p.placed(position=BOTTLE_AT) for p in surfaces]


def bottle(rng: np.random.Generator, detail: Detail, report) -> Asset:
    """The asset `bottle`; its highlights reflect the room from where the bottle stands."""
    from studio.dining_room.room_model import lit_dining_room

    lit = lit_dining_room(Detail(min(detail.gaussians, 1.0), rays=detail.rays), report)  # a denser room shines no other
    light, surfaces = lit.light, bottle_surfaces()
    label_spacing = detail.spacing(PRINT_SPACING)
    c = join_surfels([sample_surfaces(surfaces[:2], rng, detail), _label_surfels(label_spacing)])
    behind = np.abs(np.arctan2(*(c.points - BOTTLE_AT)[:, [0, 2]].T)) < LABEL_HALF_ANGLE - 0.06
    height = c.points[:, 1] - BOTTLE_AT[1]
    c = c.select(~((c.surface == 0) & behind & (height > LABEL_Y[0] + 0.002) & (height < LABEL_Y[1] - 0.002)))
    irradiance, _ = light.irradiance(c, surfaces, detail.ray_count(160), rng)
    irradiance = smoothed(c, irradiance.sum(0), 4.0, 60, rounds=2)
    diffuse = sample_albedo(c, surfaces, rng) * irradiance / np.pi
    views = view_directions(np.asarray(BOTTLE_AT) + (0.0, 0.5 * BOTTLE_HEIGHT, 0.0), lit.room.viewer)
    specular = _specular(c, light, views[0])
    sh = fit_view_dependence(c.normals, lambda cosine: tone_map(diffuse[:, None] + specular), 2, views)
    paper = c.surface == 2
    sh[paper] = 0
    sh[paper, 0] = (sharpened(c.select(paper), tone_map(diffuse[paper])) - 0.5) / C0
    c = Surfels(c.points - BOTTLE_AT, c.normals, c.tangents, c.sigma, c.surface)
    half = BODY_RADIUS + 0.02
    low, high = (-half, -0.016, -half), (half, BOTTLE_HEIGHT + 0.016, half)
    sdf = sample_distance_grid([revolved(profile())], low, high, 0.004)
    provenance = {"made_by": "vrgs build", "name": "bottle"}
    return Asset(to_gaussians(c, sh, np.ones(len(c))), sdf=sdf, provenance=provenance)


def label(p, n):
    """Albedo (N, 3) of the label: cream paper with a red foot, gold lines and an emblem of three rings."""
    u = np.arctan2(p[:, 0], p[:, 2]) * BODY_RADIUS  # [m] along the paper, 0 in the middle
    v = p[:, 1] - LABEL_Y[0]
    height = LABEL_Y[1] - LABEL_Y[0]
    gold, red = srgb("b08a3c"), srgb("8e2420")
    c = np.broadcast_to(srgb("f3ead2"), p.shape)
    c = np.where((v < 0.022)[:, None], red, c)
    for y, half in ((0.0245, 0.0012), (height - 0.006, 0.0012)):
        c = np.where((np.abs(v - y) < half)[:, None], gold, c)
    for x, y, colour in ((-0.0095, 0.0575, "c8321f"), (0.0095, 0.0575, "1c5fae"), (0.0, 0.068, "e0a416")):
        ring = np.abs(np.hypot(u - x, v - y) - 0.0085)
        c = mix(c, srgb(colour), 1 - smoothstep(0.0013, 0.0021, ring))
    row, column = np.floor((0.0415 - v) / LETTER_DOT).astype(int), np.floor(u / LETTER_DOT + 14.5).astype(int)
    inside = (row >= 0) & (row < 7) & (column >= 0) & (column < 29)
    letters = inside & LETTERS[row.clip(0, 6), column.clip(0, 28)]
    return mix(c, srgb("3a2a26"), 0.95 * letters)


def _label_mesh() -> Mesh:
    """Sheet of paper around the body."""
    a = np.linspace(-LABEL_HALF_ANGLE, LABEL_HALF_ANGLE, 60)
    y = np.linspace(*LABEL_Y, 12)
    r = BODY_RADIUS + 0.0004
    points = np.stack(np.broadcast_arrays(r * np.sin(a)[:, None], y[None], r * np.cos(a)[:, None]), -1)
    return grid_mesh(points)


def _label_surfels(spacing: float) -> Surfels:
    """The label's surfels on a regular grid, which keeps fine print straight."""
    u = np.arange(-LABEL_HALF_ANGLE, LABEL_HALF_ANGLE, spacing / BODY_RADIUS)
    u, y = (x.ravel() for x in np.meshgrid(u, np.arange(LABEL_Y[0] + spacing / 2, LABEL_Y[1], spacing)))
    normals = np.stack([np.sin(u), 0 * u, np.cos(u)], 1)
    points = (BODY_RADIUS + 0.0004) * normals + np.stack([0 * u, y, 0 * u], 1) + BOTTLE_AT
    return Surfels(
        points,
        normals,
        np.tile((0.0, 1.0, 0.0), (len(u), 1)),
        np.full((len(u), 2), 0.72 * spacing),
        np.full(len(u), 2),
    )


def _specular(c: Surfels, light: BakedLight, views: np.ndarray) -> np.ndarray:
    """Radiance (N, M, 3) seen along `views` (M, 3): reflected by glass and foil, and transmitted by the glass."""
    result = np.zeros((len(c), len(views), 3))
    axis = np.asarray(BOTTLE_AT) * (1, 0, 1)
    radius = np.linalg.norm((c.points - axis) * (1, 0, 1), axis=1)
    for m, d in enumerate(views):
        cosine = -(c.normals @ d)
        front = np.flatnonzero((cosine > 0.02) & (c.surface != 2))
        p, n, k = c.points[front], c.normals[front], cosine[front][:, None]
        mirror = d + 2 * k * n
        fresnel = np.where(c.surface[front] == 1, 0.16, 0.075)[:, None]
        fresnel = fresnel + (1 - fresnel) * (1 - k) ** 5
        glass = c.surface[front] == 0
        mirror[glass] += REFLECTION_LIFT  # seen from above, upright glass would reflect the table only
        mirror /= np.linalg.norm(mirror, axis=1, keepdims=True)
        radiance = fresnel * light.radiance(p + RAY_OFFSET * n, mirror)
        inner = _refract(np.broadcast_to(d, n.shape), n, 1 / REFRACTIVE_INDEX)
        chord = -2 * radius[front][:, None] * (inner * n).sum(1, keepdims=True)
        leave = p + chord * inner
        outward = (leave - p) / np.maximum(radius[front][:, None], 1e-4) + n
        outward /= np.linalg.norm(outward, axis=1, keepdims=True)
        out = _refract(inner, -outward, REFRACTIVE_INDEX)
        depth = np.exp(np.log(TRANSMITTANCE) * (0.35 + 0.65 * chord / (2 * BODY_RADIUS)))
        beyond = light.radiance(leave + 2 * RAY_OFFSET * outward, out)
        radiance += glass[:, None] * (1 - fresnel) * depth * beyond
        result[front, m] = radiance
    return result


def _refract(d: np.ndarray, n: np.ndarray, ratio: float) -> np.ndarray:
    """Refracted directions (N, 3) of rays `d` at normals `n`; total reflection continues along the surface."""
    cosine = -(d * n).sum(1, keepdims=True)
    t = ratio * d + (ratio * cosine - np.sqrt(np.maximum(1 - ratio**2 * (1 - cosine**2), 0))) * n
    return t / np.maximum(np.linalg.norm(t, axis=1, keepdims=True), 1e-9)
