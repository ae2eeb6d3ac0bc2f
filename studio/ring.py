"""The elastic ring: a striped rubber torus in the x-z plane, and its cage."""

from __future__ import annotations

import numpy as np

from assets.asset import Asset, Cage
from core.material import Material
from studio.detail import Detail
from studio.finish import (
    all_directions,
    fit_view_dependence,
    sample_albedo,
    sharpened,
    to_gaussians,
    tone_map,
)
from studio.revolved_cage import revolved_cage
from studio.shapes import Surface, grid_mesh
from studio.solids import sample_distance_grid, torus
from studio.surface_sampling import Surfels, sample_surfaces
from studio.textures import plain

RING_MAJOR, RING_TUBE = 0.08, 0.015  # [m] radii of the torus
CAGE_VERTICES, CAGE_SIDES = 270, 8  # 30 segments: prisms about as long as they are wide
MATERIAL = Material.named("silicone")
TINTS = {  # rubber, stripe
    "ring_red": ("e0301e", "f4d9c4"),
    "ring_blue": ("1567c8", "d4e6f2"),
    "ring_yellow": ("f4b21a", "fbf0d2"),
}
STRIPES = 6  # light bands around the tube
STRIPE_WIDTH = 0.009  # [m] along the ring


def ring(name: str, rng: np.random.Generator, detail: Detail, report) -> Asset:
    """The asset `ring_red`, `ring_blue` or `ring_yellow`. Taichi must be running."""
    from prepare.cage.embedding_hosts import embed

    surfaces = torus_surfaces(name)
    c = sample_surfaces(surfaces, rng, detail)
    sh = _rubber_sheen(c, surfaces, rng)
    g = to_gaussians(c, sh, np.ones(len(c)))
    cage = torus_cage(detail.cage_vertices(CAGE_VERTICES))
    embedded = embed(g.means, g.quats, np.exp(g.log_scales), cage.vertices, cage.tets)
    half = RING_MAJOR + RING_TUBE + 0.0105
    sdf = sample_distance_grid([torus(RING_MAJOR, RING_TUBE)], (-half, -0.0255, -half), (half, 0.0255, half), 0.003)
    return Asset(g, cage, embedded, sdf, MATERIAL, {"made_by": "vrgs build", "name": name})


def torus_surfaces(name: str, sides: int = 28) -> list[Surface]:
    """Surfaces of the ring: arcs of rubber with narrow light stripes between them, each with clean edges."""
    b = 2 * np.pi * np.arange(sides) / sides
    r = RING_MAJOR + RING_TUBE * np.cos(b)
    y = RING_TUBE * np.sin(b)
    half = 0.5 * STRIPE_WIDTH / RING_MAJOR
    arc = 2 * np.pi / STRIPES
    surfaces = []
    for k in range(STRIPES):
        spans = ((k * arc - half, k * arc + half, 4, 1), (k * arc + half, (k + 1) * arc - half, 16, 0))
        for start, end, steps, which in spans:
            a = np.linspace(start, end, steps)
            points = np.stack([np.outer(np.cos(a), r), np.broadcast_to(y, (steps, sides)), -np.outer(np.sin(a), r)], -1)
            colour = plain(TINTS[name][which], 0.02, 0.03, seed=k)
            surfaces.append(Surface(f"{name} {k}", grid_mesh(points, close_v=True), colour, 0.0034, uniform=True))
    return surfaces


def torus_cage(wanted: int = CAGE_VERTICES) -> Cage:
    """Cage of about `wanted` vertices swept from a polygon: prisms of three tets each, with matching diagonals.

    The polygon has a centre and, from more vertices on, several rings; it circumscribes the tube, so that the
    Gaussians lie inside.
    """
    finer = (wanted / CAGE_VERTICES) ** (1 / 3)
    sides, layers = round(CAGE_SIDES * finer), max(round(finer), 1)
    b = 2 * np.pi * (np.arange(sides) + 0.5) / sides
    radius = 1.02 * RING_TUBE / np.cos(np.pi / sides) * np.arange(1, layers + 1)[:, None] / layers
    r = np.concatenate([[RING_MAJOR], (RING_MAJOR + radius * np.cos(b)).ravel()])
    y = np.concatenate([[0.0], (radius * np.sin(b)).ravel()])
    triangles = []  # of a section
    for k in range(sides):
        one, two = 1 + k, 1 + (k + 1) % sides
        triangles.append((0, one, two))
        for out in range(sides, sides * layers, sides):
            triangles += [(one + out - sides, one + out, two + out), (one + out - sides, two + out, two + out - sides)]
    return revolved_cage(np.stack([r, y], 1), triangles, round(wanted / (1 + sides * layers)))


def _rubber_sheen(c: Surfels, surfaces: list[Surface], rng: np.random.Generator) -> np.ndarray:
    """Spherical harmonics (N, K, 3) with shading that suits any pose, as the ring turns in flight.

    Top and bottom are lit alike, the hole is darker; the silhouette shines like matt rubber.
    """
    base = sample_albedo(c, surfaces, rng)
    outward = c.points * (1, 0, 1)
    outward /= np.linalg.norm(outward, axis=1, keepdims=True)
    lit = 0.58 + 0.45 * np.abs(c.normals[:, 1]) + 0.17 * (c.normals * outward).sum(1)
    base = sharpened(c, tone_map(1.12 * base * lit[:, None]))

    def colour(cosine):
        grazing = (1 - cosine) ** 3
        gleam = np.exp(-(((1 - cosine) / 0.10) ** 2))
        return (
            base[:, None] * (0.94 + 0.10 * cosine - 0.10 * grazing)[..., None]
            + (0.13 * grazing + 0.10 * gleam)[..., None]
        )

    return fit_view_dependence(c.normals, colour, 2, all_directions())
