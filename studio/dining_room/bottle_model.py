"""The asset `bottle`: its surfels, lit by the dining room, and what glass, wine and foil reflect of that."""

from __future__ import annotations

import numpy as np

from assets.asset import Asset
from core.spherical_harmonics import C0
from studio.baked_light import RAY_OFFSET, BakedLight
from studio.detail import Detail
from studio.dining_room.bottle import (
    BODY_RADIUS,
    BOTTLE_AT,
    BOTTLE_HEIGHT,
    LABEL_HALF_ANGLE,
    LABEL_Y,
    TRANSMITTANCE,
    bottle_surfaces,
    profile,
)
from studio.dining_room.room_model import lit_dining_room
from studio.finish import (
    fit_view_dependence,
    sample_albedo,
    sharpened,
    smoothed,
    to_gaussians,
    tone_map,
    view_directions,
)
from studio.solids import revolved, sample_distance_grid
from studio.surface_sampling import Surfels, join_surfels, sample_surfaces

REFRACTIVE_INDEX = 1.45  # between glass and wine
PRINT_SPACING = 0.0014  # [m] of the label's surfels
REFLECTION_LIFT = np.array([0.0, 0.5, 0.0])  # bends reflections up to the windows


def bottle(rng: np.random.Generator, detail: Detail, report) -> Asset:
    """The asset `bottle`; its highlights reflect the room from where the bottle stands."""
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
