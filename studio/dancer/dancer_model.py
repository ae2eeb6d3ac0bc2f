"""Assembly of the dancer: body, cage, skeleton and dance, then what swings."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from assets.asset import Asset, Cage
from assets.gaussians import Gaussians
from core.distance_grid import DistanceGrid
from prepare.rig.landmarks import NAMES, SIDES, Landmarks
from prepare.rig.retargeting import BONES
from studio.dancer.body import body_surfaces
from studio.dancer.choreography import dance_rig
from studio.dancer.garments import Garment, joint_grid, ponytail, skirt, with_garment
from studio.dancer.skeleton import HEIGHT, joint_positions
from studio.detail import Detail
from studio.finish import flat_sh, sample_albedo, sharpened, to_gaussians, tone_map
from studio.shapes import Surface
from studio.surface_sampling import sample_surfaces

VERTICES, SKIRT_VERTICES, PONYTAIL_VERTICES = 500, 384, 63  # of the cages of the body and of what swings
TOTAL = VERTICES + SKIRT_VERTICES + PONYTAIL_VERTICES
BRIGHTNESS = 1.15
FEET = 0.12 * HEIGHT  # [m] up to which the cage is flattened onto the soles


def dancer(rng: np.random.Generator, detail: Detail, report) -> Asset:
    """The asset `dancer`. Taichi must be running."""
    from prepare.cage.embedding_hosts import embed
    from prepare.pipeline import Options, prepare
    from prepare.rig.rigging import animate_person

    at = joint_positions()
    solids = []
    share = detail.cage_vertices(TOTAL) / TOTAL
    options = Options(vertices=round(share * VERTICES), scale=HEIGHT, up="+y", material="flesh")
    asset = prepare(painted(body_surfaces(at), rng, detail), options, look=solids.append)
    scale, moved = asset.provenance["metres_per_unit"], np.array(asset.provenance["moved"])  # as `prepare` placed it
    sole = np.array([0.0, asset.gaussians.means[:, 1].min(), 0.0])
    asset, solid, moved = on_its_soles(asset, sole), lowered(solids[0].distance, sole), moved - sole
    points = {n: scale * at[n] + moved for n in NAMES}
    landmarks = Landmarks(points, dict.fromkeys(points, "given"), [], {n: n for n in BONES})
    asset = led_below_the_knees(animate_person(asset, dance_rig(at), landmarks, solid))
    report(f"dancer: {len(asset.cage.vertices)} vertices, {asset.animation.driven.sum()} driven")
    garments = [skirt(round(share * SKIRT_VERTICES)), ponytail(round(share * PONYTAIL_VERTICES))]
    body = asset.sdf
    for garment in garments:
        g = painted(garment.surfaces, rng, detail).transformed(np.eye(3), moved, scale)
        vertices = (scale * garment.cage.vertices + moved).astype(np.float32)
        placed = replace(garment, cage=Cage(vertices, garment.cage.tets, garment.cage.surface))
        asset = with_garment(
            asset, placed, g, embed(g.means, g.quats, np.exp(g.log_scales), vertices, placed.cage.tets)
        )
    margin = 4 * float(body.spacing)
    x = asset.cage.vertices.astype(np.float64)
    placed = [_placed(garment, scale, moved) for garment in garments]
    return replace(asset, sdf=joint_grid(body, placed, np.array([x.min(0) - margin, x.max(0) + margin])))


def on_its_soles(asset: Asset, sole: np.ndarray) -> Asset:
    """The asset with its soles, not the cage around them, at y = 0: else it would float over its shadow. Not embedded.

    sole  lowest drawn point (3,) [m], which is lowered to the cage's lowest; the cage's feet are flattened for that
    """
    x = asset.cage.vertices - sole
    feet = x[:, 1] < FEET
    x[feet, 1] = FEET * (x[feet, 1] + sole[1]) / (FEET + sole[1])
    cage = Cage(x.astype(np.float32), asset.cage.tets, asset.cage.surface)
    return replace(
        asset, gaussians=asset.gaussians.transformed(np.eye(3), -sole), cage=cage, sdf=lowered(asset.sdf, sole)
    )


def lowered(grid: DistanceGrid, by: np.ndarray) -> DistanceGrid:
    """The grid, lower by a vector (3,) [m]."""
    return DistanceGrid(grid.values, np.asarray(grid.origin) - by, grid.spacing)


def led_below_the_knees(asset: Asset) -> Asset:
    """The asset, its shins and feet led by their bones alone: the cage is not symmetrical, and they would differ."""
    motion = asset.animation
    below = [motion.names.index(f"{side}_{joint}") for side in SIDES for joint in ("knee", "ankle")]
    return replace(asset, animation=replace(motion, driven=motion.driven | np.isin(motion.joints[:, 0], below)))


def painted(surfaces: list[Surface], rng: np.random.Generator, detail: Detail) -> Gaussians:
    """Gaussians of the surfaces, shaded softly from above as suits a body that turns."""
    c = sample_surfaces(surfaces, rng, detail)
    lit = 0.78 + 0.24 * c.normals[:, 1] + 0.05 * c.normals[:, 2]
    colour = sharpened(c, tone_map(BRIGHTNESS * sample_albedo(c, surfaces, rng) * lit.clip(0.4)[:, None]))
    return to_gaussians(c, flat_sh(colour), np.ones(len(c)))


def _placed(garment: Garment, scale: float, moved: np.ndarray) -> Garment:
    """The garment with its solid where `prepare` has the body."""
    return replace(garment, solid=lambda p: scale * garment.solid((p - moved) / scale))
