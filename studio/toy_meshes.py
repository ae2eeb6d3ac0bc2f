"""Creatures as meshes with colours at their vertices, for rays: the coat's hair is left away."""

from __future__ import annotations

import numpy as np

from core.distance_grid import DistanceGrid, marching_cubes
from core.mesh_sampling import Mesh
from studio.creatures.coat import box_of
from studio.creatures.creature import Creature, look_at_surface, surface_of
from studio.shapes import Surface
from studio.textures import fbm, srgb

FLEECE_SIZE, FLEECE_DEPTH = 0.006, 0.16  # [m] and relative: tufts of short fleece
BEAD_NODES = 0.4  # nodes of an eye or a nose on its longest side, over those of the body
BLOCK = 4  # nodes of a block along each side; those far from the surface are not looked into
MARGIN = 0.004  # [m] round a body or bead


def creature_surfaces(creature: Creature, nodes: int) -> list[tuple[Surface, np.ndarray | None]]:
    """Surfaces of a creature, each with albedos (V, 3) of its vertices or None; `nodes` on the body's longest side.

    The lowest point is at y = 0.
    """

    def body(points):
        return surface_of(creature.body, points, creature.sole)

    mesh = _mesh(lambda p: body(p)[0], creature.low, creature.high, nodes)
    normals = body(mesh.vertices)[1]
    albedo = look_at_surface(creature, mesh.vertices, normals).albedo
    foot = -np.array([0.0, mesh.vertices[:, 1].min(), 0.0])
    tufts = {"spacing": 0.02, "uniform": True, "position": tuple(foot)}
    surfaces = [(Surface("coat", mesh, _fleece, **tufts), albedo)]
    for bead in creature.beads:
        low, high = box_of(lambda p, bead=bead: bead.shape(p)[:2], creature.low, creature.high)
        part = _mesh(lambda p, bead=bead: bead.shape(p)[0], low, high, max(round(BEAD_NODES * nodes), 12))
        if part is not None:
            color = np.tile(srgb(bead.colour), (len(part.vertices), 1))
            surfaces.append((Surface("bead", part, _smooth, **tufts), color))
    return surfaces


def _mesh(distance, low, high, nodes: int) -> Mesh | None:
    """The surface of a distance field within a box; None where a part is thinner than the grid."""
    low, high = np.asarray(low, float) - MARGIN, np.asarray(high, float) + MARGIN
    spacing = float((high - low).max()) / (nodes - 1)
    blocks = np.ceil(((high - low) / spacing + 1) / BLOCK).astype(int)
    grid = DistanceGrid(np.zeros(BLOCK * blocks, np.float32), low, spacing)
    points = grid.nodes().reshape(*BLOCK * blocks, 3)
    middles = points[BLOCK // 2 :: BLOCK, BLOCK // 2 :: BLOCK, BLOCK // 2 :: BLOCK]
    coarse = distance(middles.reshape(-1, 3)).reshape(blocks)
    values = coarse.repeat(BLOCK, 0).repeat(BLOCK, 1).repeat(BLOCK, 2)
    near = np.abs(values) < 1.5 * BLOCK * spacing  # half a block's diagonal is 0.87, fields are not quite distances
    values[near] = distance(points[near])
    if not values.min() < 0.0:
        return None
    return Mesh(*marching_cubes(DistanceGrid(values.astype(np.float32), low, spacing)))


def _fleece(p, n):
    """Factor (N, 3) on the vertices' albedo."""
    return np.repeat((1.0 + FLEECE_DEPTH * 2 * fbm(p / FLEECE_SIZE, 2, 77))[:, None], 3, axis=1)


def _smooth(p, n):
    return np.ones((len(p), 3))
