"""A room as an asset: surfaces sampled with surfels, lit by ray casting and coloured as the player sees them.

To model a room, describe it as a `Room` and return `room_asset(name, lit_room(room, rng, detail, report), ...)`; the
models in this package do so (dining_room/room_model.py).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from assets.asset import Asset
from core.distance_grid import DistanceGrid
from studio.baked_light import BakedLight
from studio.detail import Detail
from studio.finish import EXPOSURE, flat_sh, sample_albedo, sharpened, smoothed, to_gaussians, tone_map
from studio.light_sources import LightSources
from studio.shapes import Surface
from studio.solids import Solid, sample_distance_grid
from studio.surface_sampling import Surfels, Viewer, sample_surfaces

GATHER_RAYS = 112  # for each Gaussian
ROUNDS = 3  # in which light is smoothed
WIDE_SIGMA = 0.022  # [m] above it a Gaussian's light is smoothed further
RADIOSITY_SPACING = 0.03  # [m] approximate distance of the surfels that exchange light
MIN_COARSE_FRACTION = 0.06  # of small surfels that exchange light


@dataclass(frozen=True)
class Room:
    """Contents of a room. World frame, metres, +y up.

    surfaces   all that is seen
    sources    what lights it; None for `sources.openings` outdoors
    viewer     where the player's eyes are
    bodies     surfaces of things that shade the room but are assets of their own
    solids     signed distances of what hands and bodies touch, besides what the scene gives as analytic colliders
    grid       bounds and node spacing (low, high, spacing) of the grid that samples the solids
    exposure   factor on radiance before tone mapping; raise it for a dark place
    """

    surfaces: list[Surface]
    sources: LightSources
    viewer: Viewer
    bodies: tuple[Surface, ...] | list[Surface] = ()
    solids: tuple[Solid, ...] | list[Solid] = ()
    grid: tuple | None = None
    exposure: float = EXPOSURE

    @property
    def all_surfaces(self) -> list[Surface]:
        """The room's own surfaces, then the bodies'."""
        return [*self.surfaces, *self.bodies]

    def distances(self) -> DistanceGrid | None:
        """The distance grid of the solids; None if there are none."""
        return sample_distance_grid(list(self.solids), *self.grid) if self.solids else None


@dataclass(frozen=True)
class LitRoom:
    """A room's surfels, of all its surfaces and bodies, and the solved light."""

    room: Room
    detail: Detail
    surfels: Surfels
    light: BakedLight


def lit_room(room: Room, rng: np.random.Generator, detail: Detail, report) -> LitRoom:
    """Sample all surfaces of a room and solve the interreflection of light between them."""
    surfaces = room.all_surfaces
    report(f"room: sampling {len(surfaces)} surfaces")
    surfels = sample_surfaces(surfaces, rng, detail, room.viewer)
    report(f"room: {len(surfels):,} surfels")
    blocks_light = np.array([s.blocks_light for s in surfaces])[surfels.surface]
    least = min(MIN_COARSE_FRACTION / detail.gaussians, 1.0)  # finer surfels do not mean more of them
    fraction = (surfels.sigma.prod(1) / RADIOSITY_SPACING**2).clip(least, 1) * blocks_light
    coarse = surfels.select(rng.random(len(surfels)) < fraction)
    light = BakedLight(surfaces, room.sources, room.viewer, coarse, sample_albedo(coarse, surfaces, rng), rng)
    report(f"room: solved the radiosity of {len(coarse):,} surfels")
    return LitRoom(room, detail, surfels, light)


def room_asset(name: str, lit: LitRoom, rng: np.random.Generator, report) -> Asset:
    """The asset `name` of a lit room: its Gaussians with baked colours and object ids, and its distance grid."""
    surfels, irradiance = visible_surfels(lit, rng, tenths(f"{name}: light", report))
    report(f"{name}: lit {len(surfels):,} visible surfels")
    colours = sharpened(surfels, tone_map(_radiance(lit, surfels, irradiance, rng), lit.room.exposure))
    object_id = np.array([s.object_id for s in lit.room.surfaces])[surfels.surface]
    gaussians = to_gaussians(surfels, flat_sh(colours), object_id)
    return Asset(gaussians, sdf=lit.room.distances(), provenance={"made_by": "vrgs build", "name": name})


def tenths(what: str, report: Callable[[str], None]) -> Callable[[float], None]:
    """A function of a growing fraction that reports each tenth below 1 once."""
    told = 0

    def progress(fraction: float) -> None:
        nonlocal told
        if told < int(10 * fraction) < 10:
            told = int(10 * fraction)
            report(f"{what} {10 * told} %")

    return progress


def visible_surfels(lit: LitRoom, rng: np.random.Generator, progress) -> tuple[Surfels, np.ndarray]:
    """The surfels of the room (not of the bodies) that can be seen, and their irradiance (N, 3)."""
    surfaces = lit.room.surfaces
    surfels = lit.surfels.select(lit.surfels.surface < len(surfaces))
    # The underside of a thin shell would show through its upper side, as Gaussians are sorted by their centres.
    seen = lit.room.viewer.sees(surfels.points, surfels.normals)
    sheet = np.array([s.translucency is not None or not s.blocks_light for s in surfaces])[surfels.surface]
    depth = np.maximum(0.012, surfels.sigma.max(1))
    thin = lit.light.has_surface_behind(surfels.points, surfels.normals, depth)
    surfels = surfels.select(seen | sheet | ~thin | (surfels.normals[:, 1] > -0.2))
    irradiance, covered = lit.light.irradiance(surfels, surfaces, lit.detail.ray_count(GATHER_RAYS), rng, progress)
    keep = ~covered | np.array([not s.blocks_light for s in surfaces])[surfels.surface]
    surfels = surfels.select(keep)
    # Against the noise of the rays; contact shadows stay two Gaussians wide. On walls, few wide ones would show clouds.
    direct, gathered = irradiance[:, keep]
    gathered = smoothed(surfels, gathered, 1.3, 16, rounds=more_rounds(lit.detail))
    irradiance = smoothed(surfels, direct + gathered, 1.3, 16, rounds=ROUNDS)
    wide = surfels.sigma.max(1) > lit.detail.spacing(WIDE_SIGMA)
    return surfels, smoothed(surfels, irradiance, 1.5, 20, rounds=4, which=wide)


def more_rounds(detail: Detail) -> int:
    """Rounds of smoothing of gathered light, besides ROUNDS, with which it spreads over as many metres at any detail.

    A round spreads light by a variance of a Gaussian's squared width, which f times as many Gaussians divide by f.
    With ROUNDS alone they would share the rays of fewer neighbours, and the rays' noise would show as blotches.
    """
    return max(round(ROUNDS * (detail.gaussians - 1)), 0)


def _radiance(lit: LitRoom, surfels: Surfels, irradiance: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Linear radiance (N, 3) towards the player: diffuse, emitted and reflected."""
    surfaces, index, eye = lit.room.all_surfaces, surfels.surface, lit.room.viewer.eye
    albedo = sample_albedo(surfels, surfaces, rng)
    radiance = np.array([s.blocks_light for s in surfaces])[index, None] * albedo * irradiance / np.pi
    radiance += np.array([s.emission or (0.0, 0.0, 0.0) for s in surfaces])[index] * albedo
    gloss = np.array([s.gloss for s in surfaces])[index]
    glossy = np.flatnonzero(gloss > 0)
    own, gloss, albedo = surfels.select(glossy), gloss[glossy], albedo[glossy]
    if not len(own):
        return radiance
    view = np.asarray(eye) - own.points
    view /= np.linalg.norm(view, axis=1, keepdims=True)
    cosine = (view * own.normals).sum(1)
    fresnel = gloss + (1 - gloss) * (1 - np.clip(cosine, 0, 1)) ** 5 * 0.5
    spread = np.array([s.roughness for s in surfaces])[own.surface]
    reflected = smoothed(own, lit.light.reflected(own.points, own.normals, eye, spread, 16, rng), rounds=2)
    metal = gloss > 0.2
    tint = np.where(metal[:, None], albedo / albedo.max(1, keepdims=True), 1.0)
    radiance[glossy] += (fresnel * (cosine > 0.02))[:, None] * tint * reflected
    return radiance
