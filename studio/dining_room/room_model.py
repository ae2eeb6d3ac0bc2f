"""The dining room: all parts covered, lit and coloured."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from assets.asset import Asset
from studio.baked_light import Room
from studio.bottle import bottle_parts
from studio.dining_room.decor import decor, lamps
from studio.dining_room.furniture import furniture
from studio.dining_room.garden import garden
from studio.dining_room.layout import EYE, EYES, GRID_HIGH, GRID_LOW, GRID_SPACING
from studio.dining_room.shell import openings, shell
from studio.dining_room.tableware import tableware
from studio.finish import albedo, flat_sh, gaussians, sharpened, smoothed, tone
from studio.shapes import Part
from studio.solids import grid_of
from studio.surface_sampling import Cover, cover, join_covers

RAYS = 112  # gathered for each Gaussian
WIDE = 0.022  # [m]
EXCHANGE = 0.03  # [m] rough distance of the points that exchange light


@dataclass(frozen=True)
class LitRoom:
    """Parts and their cover, the solids on the table, and the solved light. The bottle's parts come last:
    it shades the table, though it is an asset of its own."""

    parts: list[Part]
    cover: Cover
    own: int  # parts before the bottle's
    solids: list
    light: Room


def lit_room(rng: np.random.Generator, report) -> LitRoom:
    """Model and cover all parts, and solve the exchange of light between them."""
    on_table, solids = tableware()
    parts = [*shell(), *garden(), *furniture(), *decor(), *on_table]
    own = len(parts)
    parts += bottle_parts()
    points = join_covers([cover(p, i, rng) for i, p in enumerate(parts)])
    report(f"room: {len(parts)} parts, covered by {len(points):,} points")
    light = Room(parts, openings(), lamps(), rng)
    share = (points.sigma.prod(1) / EXCHANGE**2).clip(0.06, 1) * np.array([p.casts for p in parts])[points.part]
    some = points.select(rng.random(len(points)) < share)
    light.solve(some, parts, albedo(some, parts, rng))
    report(f"room: solved the exchange of light between {len(some):,} points")
    return LitRoom(parts, points, own, solids, light)


def dining_room(room: LitRoom, rng: np.random.Generator, report) -> Asset:
    """The asset `dining_room`."""
    points, irradiance = lit_cover(room)
    report(f"dining_room: lit, {len(points):,} points can be seen")
    colours = sharpened(points, tone(_radiance(room, points, irradiance, rng)))
    object_id = np.array([p.object_id for p in room.parts])[points.part]
    return Asset(
        gaussians(points, flat_sh(colours), object_id),
        sdf=grid_of(room.solids, GRID_LOW, GRID_HIGH, GRID_SPACING),
        provenance={"made_by": "vrgs build", "name": "dining_room"},
    )


def lit_cover(room: LitRoom) -> tuple[Cover, np.ndarray]:
    """The points of the dining room that can be seen, and their irradiance (N, 3)."""
    points = room.cover.select(room.cover.part < room.own)
    # The underside of a thin shell would shine through the seen one, as Gaussians are sorted by their centres.
    seen = np.max([((np.asarray(e) - points.points) * points.normals).sum(1) for e in EYES], axis=0) > 0
    sheet = np.array([p.through is not None or not p.casts for p in room.parts])[points.part]
    thin = room.light.thin(points.points, points.normals, np.maximum(0.012, points.sigma.max(1)))
    points = points.select(seen | sheet | ~thin | (points.normals[:, 1] > -0.2))
    irradiance, hidden = room.light.irradiance(points, room.parts, RAYS)
    keep = ~hidden | np.array([not p.casts for p in room.parts])[points.part]
    points, irradiance = points.select(keep), irradiance[keep]
    for _ in range(3):  # the rays' noise; what is left of a contact shadow is two Gaussians wide
        irradiance = smoothed(points, irradiance, 1.3, 16)
    wide = points.sigma.max(1) > WIDE
    for _ in range(4):  # walls: few, wide Gaussians show noise as clouds
        irradiance[wide] = smoothed(points, irradiance, 1.5, 20)[wide]
    return points, irradiance


def _radiance(room: LitRoom, points: Cover, irradiance: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Linear radiance (N, 3) towards the player: matt, mirrored, given off."""
    parts = room.parts
    colour = albedo(points, parts, rng)
    matt = np.array([p.casts for p in parts])[points.part, None]
    radiance = matt * colour * irradiance / np.pi
    glow = np.array([p.emission or (0.0, 0.0, 0.0) for p in parts])[points.part]
    radiance += glow * colour
    gloss = np.array([p.gloss for p in parts])[points.part]
    shiny = np.flatnonzero(gloss > 0)
    own = points.select(shiny)
    view = np.asarray(EYE) - own.points
    view /= np.linalg.norm(view, axis=1, keepdims=True)
    cosine = (view * own.normals).sum(1)
    fresnel = gloss[shiny] + (1 - gloss[shiny]) * (1 - np.clip(cosine, 0, 1)) ** 5 * 0.5
    spread = np.array([p.roughness for p in parts])[own.part]
    mirrored = smoothed(own, smoothed(own, room.light.mirrored(own.points, own.normals, EYE, spread, 16)))
    metal = gloss[shiny] > 0.2
    tint = np.where(metal[:, None], colour[shiny] / colour[shiny].max(1, keepdims=True), 1.0)
    radiance[shiny] += (fresnel * (cosine > 0.02))[:, None] * tint * mirrored
    return radiance
