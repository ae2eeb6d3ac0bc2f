"""The bottle that is the peg: dark green glass with a label and a foil capsule, lit by the room."""

from __future__ import annotations

import numpy as np

from assets.asset import Asset
from studio.baked_light import LIFT, Room
from studio.dining_room.layout import BOTTLE_AT, BOTTLE_HEIGHT
from studio.finish import albedo, gaussians, sharpened, smoothed, tone
from studio.shapes import Part, lathe, smooth, surface
from studio.solids import grid_of, turned
from studio.surface_sampling import Cover, cover, join_covers
from studio.textures import mix, plain, ramp, srgb
from studio.view_dependence import directions, view_dependent

BODY = 0.0368  # [m] radii
NECK = 0.0138
GLASS = 1.45  # refractive index, between glass and wine
TINT = np.array([0.10, 0.30, 0.07])  # share of light that crosses the bottle
LABEL_Y, LABEL_HALF = (0.058, 0.148), np.radians(78)  # [m], [rad] to either side of +z
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
DOT = 0.0019  # [m] of a letter
PRINT = 0.0014  # [m] distance of the label's points
FOIL_Y = 0.238
LIFTED = np.array([0.0, 0.5, 0.0])  # bends mirrored directions up to where the windows are


def profile() -> np.ndarray:
    """(radius, y) of the outside [m], from the axis at the bottom to the axis at the top."""
    side = smooth(
        [(BODY - 0.004, 0.0), (BODY - 0.0008, 0.0035), (BODY, 0.010), (BODY, 0.100), (BODY, 0.175), (0.0350, 0.192),
         (0.0285, 0.208), (0.0205, 0.222), (0.0162, 0.236), (NECK + 0.0004, 0.255), (NECK, 0.285)],
        90,
    )  # fmt: skip
    lip = [(NECK + 0.0016, 0.2855), (NECK + 0.0016, 0.2965), (NECK + 0.0002, BOTTLE_HEIGHT)]
    return np.concatenate([[(0.0, 0.0)], side, lip, [(0.0, BOTTLE_HEIGHT)]])


def bottle_parts() -> list[Part]:
    """Glass, foil and label where the bottle stands in the room."""
    curve = profile()
    cut = int(np.searchsorted(curve[1:-4, 1], FOIL_Y)) + 1
    foil = curve[cut:] + np.where(curve[cut:, :1] > 0, (0.0004, 0.0), (0.0, 0.0))
    parts = [
        Part("glass", lathe(curve[: cut + 2], 64), plain(TINT * 0.12), 0.0038, fixed=True),
        Part("foil", lathe(foil, 48), plain("5c0f16", 0.04), 0.0034, fixed=True),
        Part("label", _label_mesh(), label, 0.0019, fixed=True),
    ]
    return [p.placed(position=BOTTLE_AT) for p in parts]


def bottle(light: Room, rng: np.random.Generator) -> Asset:
    """The asset `bottle`; its highlights mirror the room from where the bottle stands."""
    parts = bottle_parts()
    c = join_covers([cover(parts[0], 0, rng), cover(parts[1], 1, rng), _label_cover()])
    behind = np.abs(np.arctan2(*(c.points - BOTTLE_AT)[:, [0, 2]].T)) < LABEL_HALF - 0.06
    height = c.points[:, 1] - BOTTLE_AT[1]
    c = c.select(~((c.part == 0) & behind & (height > LABEL_Y[0] + 0.002) & (height < LABEL_Y[1] - 0.002)))
    irradiance, _ = light.irradiance(c, parts, 160)
    for _ in range(2):
        irradiance = smoothed(c, irradiance, 4.0, 60)
    matt = albedo(c, parts, rng) * irradiance / np.pi
    views = directions(np.asarray(BOTTLE_AT) + (0.0, 0.5 * BOTTLE_HEIGHT, 0.0))
    shine = _shine(c, light, views[0])
    sh = view_dependent(c.normals, lambda cosine: tone(matt[:, None] + shine), 2, views)
    paper = c.part == 2
    own = c.select(paper)
    sh[paper] = 0
    sh[paper, 0] = (sharpened(own, tone(matt[paper])) - 0.5) / 0.28209479177387814
    c = Cover(c.points - BOTTLE_AT, c.normals, c.tangents, c.sigma, c.part)
    reach = BODY + 0.02
    sdf = grid_of([turned(profile())], (-reach, -0.016, -reach), (reach, BOTTLE_HEIGHT + 0.016, reach), 0.004)
    provenance = {"made_by": "vrgs build", "name": "bottle"}
    return Asset(gaussians(c, sh, np.ones(len(c))), sdf=sdf, provenance=provenance)


def label(p, n):
    """Cream paper with a red foot, gold lines and an emblem of three rings."""
    u = np.arctan2(p[:, 0], p[:, 2]) * BODY  # [m] along the paper, 0 in the middle
    v = p[:, 1] - LABEL_Y[0]
    height = LABEL_Y[1] - LABEL_Y[0]
    gold, red = srgb("b08a3c"), srgb("8e2420")
    c = np.broadcast_to(srgb("f3ead2"), p.shape)
    c = np.where((v < 0.022)[:, None], red, c)
    for y, half in ((0.0245, 0.0012), (height - 0.006, 0.0012)):
        c = np.where((np.abs(v - y) < half)[:, None], gold, c)
    for x, y, colour in ((-0.0095, 0.0575, "c8321f"), (0.0095, 0.0575, "1c5fae"), (0.0, 0.068, "e0a416")):
        ring = np.abs(np.hypot(u - x, v - y) - 0.0085)
        c = mix(c, srgb(colour), 1 - ramp(0.0013, 0.0021, ring))
    row, column = np.floor((0.0415 - v) / DOT).astype(int), np.floor(u / DOT + 14.5).astype(int)
    inside = (row >= 0) & (row < 7) & (column >= 0) & (column < 29)
    letters = inside & LETTERS[row.clip(0, 6), column.clip(0, 28)]
    return mix(c, srgb("3a2a26"), 0.95 * letters)


def _label_mesh():
    a = np.linspace(-LABEL_HALF, LABEL_HALF, 60)
    y = np.linspace(*LABEL_Y, 12)
    r = BODY + 0.0004
    points = np.stack(np.broadcast_arrays(r * np.sin(a)[:, None], y[None], r * np.cos(a)[:, None]), -1)
    return surface(points)


def _label_cover() -> Cover:
    """The label's points: a regular grid, on which fine print stays straight."""
    u = np.arange(-LABEL_HALF, LABEL_HALF, PRINT / BODY)
    u, y = (x.ravel() for x in np.meshgrid(u, np.arange(LABEL_Y[0] + PRINT / 2, LABEL_Y[1], PRINT)))
    normals = np.stack([np.sin(u), 0 * u, np.cos(u)], 1)
    points = (BODY + 0.0004) * normals + np.stack([0 * u, y, 0 * u], 1) + BOTTLE_AT
    return Cover(
        points, normals, np.tile((0.0, 1.0, 0.0), (len(u), 1)), np.full((len(u), 2), 0.72 * PRINT), np.full(len(u), 2)
    )


def _shine(c: Cover, room: Room, views: np.ndarray) -> np.ndarray:
    """Radiance (N, M, 3) seen along `views` (M, 3): mirrored by glass and foil, and let through by the glass."""
    result = np.zeros((len(c), len(views), 3))
    axis = np.asarray(BOTTLE_AT) * (1, 0, 1)
    radius = np.linalg.norm((c.points - axis) * (1, 0, 1), axis=1)
    for m, d in enumerate(views):
        cosine = -(c.normals @ d)
        front = np.flatnonzero((cosine > 0.02) & (c.part != 2))
        p, n, k = c.points[front], c.normals[front], cosine[front][:, None]
        mirror = d + 2 * k * n
        fresnel = np.where(c.part[front] == 1, 0.16, 0.075)[:, None]
        fresnel = fresnel + (1 - fresnel) * (1 - k) ** 5
        glass = c.part[front] == 0
        mirror[glass] += LIFTED  # else, seen from above, upright glass mirrors the table only
        mirror /= np.linalg.norm(mirror, axis=1, keepdims=True)
        light = fresnel * room.radiance(p + LIFT * n, mirror)
        inner = _refract(np.broadcast_to(d, n.shape), n, 1 / GLASS)
        chord = -2 * radius[front][:, None] * (inner * n).sum(1, keepdims=True)
        leave = p + chord * inner
        outward = (leave - p) / np.maximum(radius[front][:, None], 1e-4) + n
        outward /= np.linalg.norm(outward, axis=1, keepdims=True)
        out = _refract(inner, -outward, GLASS)
        depth = np.exp(np.log(TINT) * (0.35 + 0.65 * chord / (2 * BODY)))
        beyond = room.radiance(leave + 2 * LIFT * outward, out)
        light += glass[:, None] * (1 - fresnel) * depth * beyond
        result[front, m] = light
    return result


def _refract(d: np.ndarray, n: np.ndarray, ratio: float) -> np.ndarray:
    """Direction after refraction at normal `n` against `d`; total reflection slides along the surface."""
    cosine = -(d * n).sum(1, keepdims=True)
    t = ratio * d + (ratio * cosine - np.sqrt(np.maximum(1 - ratio**2 * (1 - cosine**2), 0))) * n
    return t / np.maximum(np.linalg.norm(t, axis=1, keepdims=True), 1e-9)
