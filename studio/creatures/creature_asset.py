"""From a creature to an asset: coat, cage, embedding, distance grid."""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module

import numpy as np

from assets.asset import Asset, Cage
from core.distance_grid import DistanceGrid
from studio.creatures.body_cage import body_cage, solid_grid
from studio.creatures.coat import coat
from studio.creatures.creature import surface_of
from studio.detail import Detail

FIRM_HAIR = 0.35  # of the length of the hair: what touches the body presses the rest flat


def creature(
    where: str, gaussians: int, vertices: int, rng: np.random.Generator, detail: Detail, report: Callable[[str], None]
) -> Asset:
    """The asset of a creature, centred in x and z, its cage standing on y = 0. Taichi must be running.

    where                "module:function" in this package that gives its Creature
    gaussians, vertices  about how many at the shipped detail
    """
    from prepare.cage.embedding_hosts import embed
    from prepare.cage.level_set import contact_grid

    module, function = where.split(":")
    made = getattr(import_module(f"studio.creatures.{module}"), function)()
    g = coat(made, round(gaussians * detail.gaussians), rng)

    firm = FIRM_HAIR * made.hair

    def skin(points):
        distance, normal = surface_of(made.body, points, made.sole)
        return distance - firm, normal

    count = detail.cage_vertices(vertices)
    solid = solid_grid(skin, made.low, made.high, count)
    cage = body_cage(skin, solid, made.sole - firm, count)
    low, high = cage.vertices.min(0), cage.vertices.max(0)
    foot = -np.array([0.5 * (low[0] + high[0]), low[1], 0.5 * (low[2] + high[2])])
    cage = Cage(cage.vertices + foot.astype(np.float32), cage.tets, cage.surface)
    g = g.transformed(np.eye(3), foot)
    contact = contact_grid([solid])
    contact = DistanceGrid(contact.values, contact.origin + foot, contact.spacing)
    embedding = embed(g.means, g.quats, np.exp(g.log_scales), cage.vertices, cage.tets)
    provenance = {"made_by": "vrgs build", "name": function}
    report(f"{function}: {len(g):,} Gaussians, {len(cage.vertices):,} cage vertices, {len(cage.tets):,} tets")
    return Asset(g, cage, embedding, contact, made.material, provenance)
