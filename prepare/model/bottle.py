"""The bottle that is the peg: dark green glass with a label and a foil capsule, lit by the room."""

from __future__ import annotations

import numpy as np

from assets.asset import Asset
from prepare.model.cover import Cover, cover, join_covers
from prepare.model.finish import albedo, gaussians, sharpened, smoothed, tone
from prepare.model.layout import BOTTLE_AT, BOTTLE_HEIGHT
from prepare.model.light import LIFT, Room
from prepare.model.looks import DIRECTIONS, view_dependent
from prepare.model.shapes import Part, lathe, smooth, surface
from prepare.model.solids import grid_of, turned
from prepare.model.textures import fbm, mix, plain, ramp, srgb

BODY = 0.0368  # [m] radii
NECK = 0.0138
GLASS = 1.45  # refractive index, between glass and wine
TINT = np.array([0.10, 0.30, 0.07])  # share of light that crosses the bottle
LABEL_Y, LABEL_HALF = (0.058, 0.148), np.radians(78)  # [m], [rad] to either side of +z
FOIL_Y = 0.238


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
        Part("glass", lathe(curve[: cut + 2], 64), plain(TINT * 0.12), 0.0048, fixed=True, gloss=0.045),
        Part("foil", lathe(foil, 48), plain("5c0f16", 0.04), 0.0034, fixed=True, gloss=0.20),
        Part("label", _label_mesh(), label, 0.0029, fixed=True),
    ]
    return [p.placed(position=BOTTLE_AT) for p in parts]


def bottle(light: Room, rng: np.random.Generator) -> Asset:
    """The asset `bottle`; its highlights mirror the room from where the bottle stands."""
    parts = bottle_parts()
    c = join_covers([cover(p, i, rng) for i, p in enumerate(parts)])
    behind = np.abs(np.arctan2(*(c.points - BOTTLE_AT)[:, [0, 2]].T)) < LABEL_HALF - 0.06
    height = c.points[:, 1] - BOTTLE_AT[1]
    c = c.select(~((c.part == 0) & behind & (height > LABEL_Y[0] + 0.002) & (height < LABEL_Y[1] - 0.002)))
    irradiance, _ = light.irradiance(c, parts, 160)
    irradiance = smoothed(c, irradiance)
    matt = albedo(c, parts, rng) * irradiance / np.pi
    shine = _shine(c, light)

    def look(directions, cosine):
        return tone(matt[:, None] + shine)

    sh = view_dependent(c.normals, look, degree=2)
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
    """Cream paper: border lines, a landscape vignette, lettering hinted at by dark strokes."""
    u = np.arctan2(p[:, 0], p[:, 2]) * BODY  # [m] along the paper, 0 in the middle
    v = p[:, 1] - LABEL_Y[0]
    w, h = LABEL_HALF * BODY, LABEL_Y[1] - LABEL_Y[0]
    c = srgb("efe4c8") * (1 + 0.06 * fbm(p * 90, 3, 4))[:, None]
    inset = np.minimum(w - np.abs(u), np.minimum(v, h - v))
    c = mix(c, srgb("a07a2c"), (np.abs(inset - 0.0048) < 0.0009) * 1.0)
    hills = 0.054 + 0.006 * np.sin(u * 190) + 0.004 * np.sin(u * 77 + 1)
    picture = (np.abs(u) < 0.030) & (v > 0.046) & (v < 0.078)
    sun = np.hypot(u - 0.012, v - 0.068) < 0.0055
    scene = mix(srgb("e9b872"), srgb("f6dfae"), ramp(0.05, 0.08, v))
    scene = np.where(sun[:, None], srgb("c8452a"), scene)
    scene = np.where((v < hills)[:, None], srgb("55693a"), scene)
    scene = np.where((v < hills - 0.006)[:, None], srgb("37482a"), scene)
    c = np.where(picture[:, None], scene, c)
    for y, height, half, stroke in (
        (0.033, 0.0075, 0.034, 340.0),
        (0.0215, 0.0036, 0.026, 620.0),
        (0.0135, 0.003, 0.020, 700.0),
    ):
        letters = (
            (np.abs(v - y) < 0.5 * height) & (np.abs(u) < half) & (np.sin(u * stroke + 2 * np.sin(u * 91)) > -0.25)
        )
        c = mix(c, srgb("4a1a18") if height > 0.005 else srgb("3c3630"), 0.9 * letters)
    return c


def _label_mesh():
    a = np.linspace(-LABEL_HALF, LABEL_HALF, 60)
    y = np.linspace(*LABEL_Y, 12)
    r = BODY + 0.0004
    points = np.stack(np.broadcast_arrays(r * np.sin(a)[:, None], y[None], r * np.cos(a)[:, None]), -1)
    return surface(points)


def _shine(c: Cover, room: Room) -> np.ndarray:
    """Radiance (N, M, 3) over the directions of `looks`: mirrored by glass and foil, and let through by the glass."""
    i = np.arange(DIRECTIONS) + 0.5
    z, a = 1 - 2 * i / DIRECTIONS, np.pi * (1 + 5**0.5) * i
    directions = np.stack([np.sqrt(1 - z * z) * np.cos(a), np.sqrt(1 - z * z) * np.sin(a), z], 1)
    result = np.zeros((len(c), DIRECTIONS, 3))
    axis = np.asarray(BOTTLE_AT) * (1, 0, 1)
    radius = np.linalg.norm((c.points - axis) * (1, 0, 1), axis=1)
    for m, d in enumerate(directions):
        cosine = -(c.normals @ d)
        front = np.flatnonzero((cosine > 0.02) & (c.part != 2))
        p, n, k = c.points[front], c.normals[front], cosine[front][:, None]
        mirror = d + 2 * k * n
        fresnel = np.where(c.part[front] == 1, 0.16, 0.04)[:, None]
        fresnel = fresnel + (1 - fresnel) * (1 - k) ** 5
        light = fresnel * room.radiance(p + LIFT * n, mirror)
        glass = c.part[front] == 0
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
