"""The dining room: all parts covered, lit and coloured."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from assets.asset import Asset
from prepare.model.bottle import bottle_parts
from prepare.model.cover import Cover, cover, join_covers
from prepare.model.decor import decor, lamps
from prepare.model.finish import albedo, flat_sh, gaussians, sharpened, smoothed, tone
from prepare.model.furniture import furniture
from prepare.model.layout import EYE, GRID_HIGH, GRID_LOW, GRID_SPACING
from prepare.model.light import Room
from prepare.model.room import openings, shell
from prepare.model.shapes import Part
from prepare.model.solids import grid_of
from prepare.model.tableware import tableware

COARSE = 2.6  # spacing of the look-up points over that of the Gaussians
RAYS = 72  # gathered for each Gaussian


@dataclass(frozen=True)
class LitRoom:
    """Parts, their solids, and the solved light."""

    parts: list[Part]
    solids: list
    light: Room


def lit_room(rng: np.random.Generator, report) -> LitRoom:
    """Model all parts and solve the exchange of light between them."""
    on_table, solids = tableware()
    parts = [*shell(), *furniture(), *decor(), *on_table]
    blockers = [*parts, *(p for p in bottle_parts())]  # the bottle shades the table, though it is an asset of its own
    light = Room(blockers, openings(), lamps(), rng)
    inside = [p for p in blockers if p.casts]
    coarse = [replace(p, spacing=COARSE * max(p.spacing, 0.006), stretch=1.0) for p in inside]
    points = join_covers([cover(p, i, rng) for i, p in enumerate(coarse)])
    report(f"room: {len(parts)} parts, {len(points):,} points that exchange light")
    light.solve(points, inside, albedo(points, inside, rng))
    return LitRoom(parts, solids, light)


def dining_room(room: LitRoom, rng: np.random.Generator, report) -> Asset:
    """The asset `dining_room`."""
    parts = room.parts
    points = join_covers([cover(p, i, rng) for i, p in enumerate(parts)])
    report(f"dining_room: {len(points):,} points cover the parts")
    irradiance, hidden = room.light.irradiance(points, parts, RAYS)
    outside = np.array([not p.casts for p in parts])[points.part]
    keep = ~hidden | outside
    points, irradiance = points.select(keep), smoothed(points.select(keep), irradiance[keep])
    report(f"dining_room: lit, {len(points):,} points can be seen")
    colours = sharpened(points, tone(_radiance(room, points, irradiance, rng)))
    object_id = np.array([p.object_id for p in parts])[points.part]
    asset = Asset(
        gaussians(points, flat_sh(colours), object_id),
        sdf=grid_of(room.solids, GRID_LOW, GRID_HIGH, GRID_SPACING),
        provenance={"made_by": "vrgs build", "name": "dining_room"},
    )
    return asset


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
    mirrored = smoothed(own, room.light.mirrored(own.points, own.normals, EYE, spread, 16))
    metal = gloss[shiny] > 0.2
    tint = np.where(metal[:, None], colour[shiny] / colour[shiny].max(1, keepdims=True), 1.0)
    radiance[shiny] += (fresnel * (cosine > 0.02))[:, None] * tint * mirrored
    return radiance
