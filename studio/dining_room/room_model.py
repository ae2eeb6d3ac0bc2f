"""Assembly of the dining room: all surfaces sampled, lit and coloured."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from assets.asset import Asset
from studio.baked_light import BakedLight
from studio.dining_room.bottle import bottle_surfaces
from studio.dining_room.decor import decor, lamps
from studio.dining_room.furniture import furniture
from studio.dining_room.shell import garden, openings, shell
from studio.dining_room.tableware import tableware
from studio.finish import flat_sh, sample_albedo, sharpened, smoothed, to_gaussians, tone_map
from studio.shapes import Surface
from studio.solids import Solid, sample_distance_grid
from studio.surface_sampling import EYE, EYES, Surfels, join_surfels, sample_surface

GATHER_RAYS = 112  # for each Gaussian
WIDE_SIGMA = 0.022  # [m] above it a Gaussian's light is smoothed further
RADIOSITY_SPACING = 0.03  # [m] approximate distance of the surfels that exchange light
# Bounds of the signed distance grid [m]: the objects on the table, not the table itself.
GRID_LOW, GRID_HIGH, GRID_SPACING = (-0.85, 0.65, -0.5), (0.85, 1.15, 0.5), 0.01


@dataclass(frozen=True)
class LitRoom:
    """The room's surfaces, sampled, with the solved light.

    surfaces         the room's, then the bottle's, which shades the table but is an asset of its own
    surfels          of all surfaces
    room_surfaces    number of the room's own surfaces
    solids           signed distances of the objects on the table
    """

    surfaces: list[Surface]
    surfels: Surfels
    room_surfaces: int
    solids: list[Solid]
    light: BakedLight


def lit_room(rng: np.random.Generator, report) -> LitRoom:
    """Model and sample all surfaces, and solve the interreflection of light between them."""
    on_table, solids = tableware()
    surfaces = [*shell(), *garden(), *furniture(), *decor(), *on_table]
    room_surfaces = len(surfaces)
    surfaces += bottle_surfaces()
    surfels = join_surfels([sample_surface(s, i, rng) for i, s in enumerate(surfaces)])
    report(f"room: {len(surfaces)} surfaces, {len(surfels):,} surfels")
    blocks_light = np.array([s.blocks_light for s in surfaces])[surfels.surface]
    fraction = (surfels.sigma.prod(1) / RADIOSITY_SPACING**2).clip(0.06, 1) * blocks_light
    coarse = surfels.select(rng.random(len(surfels)) < fraction)
    light = BakedLight(surfaces, openings(), lamps(), coarse, sample_albedo(coarse, surfaces, rng), rng)
    report(f"room: solved the radiosity of {len(coarse):,} surfels")
    return LitRoom(surfaces, surfels, room_surfaces, solids, light)


def dining_room(room: LitRoom, rng: np.random.Generator, report) -> Asset:
    """The asset `dining_room`."""
    surfels, irradiance = visible_surfels(room, rng)
    report(f"dining_room: lit {len(surfels):,} visible surfels")
    colours = sharpened(surfels, tone_map(_radiance(room, surfels, irradiance, rng)))
    object_id = np.array([s.object_id for s in room.surfaces])[surfels.surface]
    return Asset(
        to_gaussians(surfels, flat_sh(colours), object_id),
        sdf=sample_distance_grid(room.solids, GRID_LOW, GRID_HIGH, GRID_SPACING),
        provenance={"made_by": "vrgs build", "name": "dining_room"},
    )


def visible_surfels(room: LitRoom, rng: np.random.Generator) -> tuple[Surfels, np.ndarray]:
    """The surfels of the dining room that can be seen, and their irradiance (N, 3)."""
    surfels = room.surfels.select(room.surfels.surface < room.room_surfaces)
    # The underside of a thin shell would show through its upper side, as Gaussians are sorted by their centres.
    seen = np.max([((np.asarray(e) - surfels.points) * surfels.normals).sum(1) for e in EYES], axis=0) > 0
    sheet = np.array([s.translucency is not None or not s.blocks_light for s in room.surfaces])[surfels.surface]
    depth = np.maximum(0.012, surfels.sigma.max(1))
    thin = room.light.has_surface_behind(surfels.points, surfels.normals, depth)
    surfels = surfels.select(seen | sheet | ~thin | (surfels.normals[:, 1] > -0.2))
    irradiance, covered = room.light.irradiance(surfels, room.surfaces, GATHER_RAYS, rng)
    keep = ~covered | np.array([not s.blocks_light for s in room.surfaces])[surfels.surface]
    surfels, irradiance = surfels.select(keep), irradiance[keep]
    for _ in range(3):  # against the noise of the rays; contact shadows stay two Gaussians wide
        irradiance = smoothed(surfels, irradiance, 1.3, 16)
    wide = surfels.sigma.max(1) > WIDE_SIGMA
    for _ in range(4):  # on walls, few wide Gaussians show noise as clouds
        irradiance[wide] = smoothed(surfels, irradiance, 1.5, 20)[wide]
    return surfels, irradiance


def _radiance(room: LitRoom, surfels: Surfels, irradiance: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Linear radiance (N, 3) towards the player: diffuse, emitted and reflected."""
    surfaces, index = room.surfaces, surfels.surface
    albedo = sample_albedo(surfels, surfaces, rng)
    radiance = np.array([s.blocks_light for s in surfaces])[index, None] * albedo * irradiance / np.pi
    radiance += np.array([s.emission or (0.0, 0.0, 0.0) for s in surfaces])[index] * albedo
    gloss = np.array([s.gloss for s in surfaces])[index]
    glossy = np.flatnonzero(gloss > 0)
    own, gloss, albedo = surfels.select(glossy), gloss[glossy], albedo[glossy]
    view = np.asarray(EYE) - own.points
    view /= np.linalg.norm(view, axis=1, keepdims=True)
    cosine = (view * own.normals).sum(1)
    fresnel = gloss + (1 - gloss) * (1 - np.clip(cosine, 0, 1)) ** 5 * 0.5
    spread = np.array([s.roughness for s in surfaces])[own.surface]
    reflected = smoothed(own, smoothed(own, room.light.reflected(own.points, own.normals, EYE, spread, 16, rng)))
    metal = gloss > 0.2
    tint = np.where(metal[:, None], albedo / albedo.max(1, keepdims=True), 1.0)
    radiance[glossy] += (fresnel * (cosine > 0.02))[:, None] * tint * reflected
    return radiance
