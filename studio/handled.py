"""Assets of things that are taken in the hand: shading that suits any pose, and cages for boxes and for solids."""

from __future__ import annotations

import contextlib

import numpy as np

from assets.asset import Asset, Cage
from core.distance_grid import DistanceGrid, marching_cubes
from core.material import Material
from core.tetmesh import box_mesh
from studio.detail import Detail
from studio.finish import (
    all_directions,
    fit_view_dependence,
    sample_albedo,
    sharpened,
    to_gaussians,
    tone_map,
)
from studio.shapes import Mesh, Surface
from studio.solids import Solid
from studio.surface_sampling import Surfels, sample_surfaces

FACE_LIGHT = (0.52, 0.78, 0.64)  # light on faces across x, y and z: opposite sides are alike, as the thing may turn
WARMTH = (1.12, 1.0, 0.76)  # of the light indoors
GRID_NODES = 36  # of the signed distance of a solid, on its longest side, for a cage of 200 vertices
CAGE_MARGINS = (0.3, 0.6, 1.0, 1.5)  # grid cells around a solid, tried in turn: faces of few tets would cut into it


def handled(
    name: str,
    surfaces: list[Surface],
    cage: Cage,
    material: Material,
    rng: np.random.Generator,
    detail: Detail,
    *,
    distance: DistanceGrid | None = None,
    gleam: float = 0.05,
    degree: int = 1,
) -> Asset:
    """The asset of a thing that is moved: surfaces sampled, shaded and embedded in its cage. Taichi must be running.

    distance  signed distance of the solid, of which every other node is kept for contacts; None: that of the cage
    gleam     brightness that a surface gains where it is seen head on and at grazing angles
    degree    of the spherical harmonics
    """
    from prepare.cage.embedding_hosts import embed

    surfels = sample_surfaces(surfaces, rng, detail)
    g = to_gaussians(surfels, shaded(surfels, surfaces, rng, gleam, degree), np.ones(len(surfels)))
    embedding = embed(g.means, g.quats, np.exp(g.log_scales), cage.vertices, cage.tets)
    if distance is not None:
        distance = DistanceGrid(
            distance.values[::2, ::2, ::2].astype(np.float16), distance.origin, 2 * distance.spacing
        )
    return Asset(g, cage, embedding, distance, material, {"made_by": "vrgs build", "name": name})


def shaded(
    surfels: Surfels, surfaces: list[Surface], rng: np.random.Generator, gleam: float, degree: int
) -> np.ndarray:
    """Spherical harmonics (N, K, 3) of surfels in even light, with a sheen that follows the eye."""
    lit = (surfels.normals**2 @ np.array(FACE_LIGHT))[:, None] * WARMTH
    base = sharpened(surfels, tone_map(sample_albedo(surfels, surfaces, rng) * lit))

    def colour(cosine):
        sheen = gleam * (np.exp(-(((1 - cosine) / 0.12) ** 2)) + 1.3 * (1 - cosine) ** 3)
        return base[:, None] * (0.97 + 0.05 * cosine)[..., None] + sheen[..., None]

    return fit_view_dependence(surfels.normals, colour, degree, all_directions())


def box_cage(size, vertices: int) -> Cage:
    """Cage of a box of this size [m] about the origin, of at least `vertices` vertices (8 are its corners)."""
    size = np.asarray(size, float)
    cell = size.max()
    while np.prod(np.round(size / cell).clip(1) + 1) < vertices:
        cell *= 0.97
    x, tets, surface = box_mesh(size, np.round(size / cell).clip(1).astype(int))
    return Cage((x - 0.5 * size).astype(np.float32), tets.astype(np.int32), surface.astype(np.int32))


def solid_grid(solid: Solid, low, high, vertices: int) -> DistanceGrid:
    """Signed distance of a solid within the bounds [m], with room around it, fine enough for a cage of `vertices`."""
    low, high = np.asarray(low, float), np.asarray(high, float)
    spacing = float((high - low).max()) / (GRID_NODES * max(vertices / 200, 1.0) ** (1 / 3))
    low = low - 4 * spacing
    count = np.ceil((high + 4 * spacing - low) / spacing).astype(int) + 1
    nodes = low + spacing * np.stack(np.meshgrid(*map(np.arange, count), indexing="ij"), -1).reshape(-1, 3)
    return DistanceGrid(solid(nodes).reshape(count).astype(np.float32), low, spacing)


def solid_mesh(grid: DistanceGrid) -> Mesh:
    """Surface of a solid."""
    return Mesh(*marching_cubes(grid))


def solid_cage(grid: DistanceGrid, vertices: int) -> Cage:
    """Cage of about `vertices` vertices around a solid and its surface, as close as it can be. Raises NoSoundCage."""
    from prepare.cage.cage_generation import NoSoundCage, cage_of

    points = (solid_mesh(grid).vertices - grid.origin) / grid.spacing
    phi = np.asarray(grid.values, np.float64) / grid.spacing

    def placed(cage: Cage) -> Cage:
        return Cage((grid.origin + grid.spacing * cage.vertices).astype(np.float32), cage.tets, cage.surface)

    def silent(fraction: float) -> None:
        """Take no note of the progress."""

    for margin in CAGE_MARGINS[:-1]:
        with contextlib.suppress(NoSoundCage):
            return placed(cage_of(phi - margin, points, vertices, silent, exact=False))
    return placed(cage_of(phi - CAGE_MARGINS[-1], points, vertices, silent, exact=False))
