"""The coat of a creature as Gaussians: an opaque skin of flat ones, thin long ones as hair, beads and seams."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.spatial.transform import Rotation

from assets.gaussians import Gaussians, concatenate
from core.mesh_sampling import blue_noise
from studio.baked_light import tangent_frame
from studio.creatures.creature import Creature, Part, Seam, look_at_surface, surface_of
from studio.creatures.implicit import unit
from studio.creatures.sky_light import KEY, distance_grid, irradiance
from studio.finish import flat_sh, tone_map
from studio.textures import fbm, mix, srgb

CELLS, HALVINGS = 56, 2  # of the search for the surface, on the longest side; larger cells are searched first
CANDIDATES = 5.0  # random points per squared spacing
PACKING = 0.54  # points per squared spacing that blue noise leaves of these
PROJECTIONS = 3  # Newton steps to the surface; fewer suffice where the distance is exact to first order
HAIRS = 3  # a point of the skin
BEAD_POINTS = 110  # of an eye or nose, at USUAL_COUNT Gaussians in all
USUAL_COUNT = 16_000
SKIN_SIGMA, HAIR_SIGMA = 0.8, 0.26  # standard deviations across, over the skin's spacing
SKIN_SHADE = 0.72  # hair hides light from the skin
HUE = 0.25  # variation of the colour from hair to hair, over that of the brightness
EXPOSURE = 1.3  # so that white hair comes out as white
OPACITY = 0.96
THIN = 0.12  # thickness over width of skin and hair
GLINT_COSINE = 0.9  # of the angle to the brightest sky within which a bead shines
STITCH = 0.0045  # [m] length of a stitch
STITCH_WIDTH, STITCH_SHADE = 0.0008, 0.45  # [m] standard deviation; colour over that of the fabric

Surface = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]  # points -> distances, unit gradients
Light = Callable[[np.ndarray, np.ndarray], np.ndarray]  # points, normals -> irradiance


def coat(creature: Creature, count: int, rng: np.random.Generator) -> Gaussians:
    """About `count` Gaussians of the creature."""

    def body(points):
        return surface_of(creature.body, points, creature.sole)

    def light(points, normals):
        return irradiance(grid, points, normals, creature.from_below)

    grid = distance_grid(lambda p: body(p)[0], creature.low, creature.high)

    fineness = np.sqrt(count / USUAL_COUNT)
    sewn = [bead_discs(bead, creature, fineness, light, rng) for bead in creature.beads]
    sewn += [stitches(seam, creature, body, STITCH / fineness, light, rng) for seam in creature.seams]
    left = max(count - sum(map(len, sewn)), count // 2)
    area = surface_area(body, creature.low, creature.high, rng)
    spacing = float(np.sqrt(PACKING * area * (1 + HAIRS) / left))
    return concatenate([*furry_skin(creature, body, spacing, light, rng), *sewn])


def furry_skin(creature: Creature, body: Surface, spacing: float, light: Light, rng) -> list[Gaussians]:
    """Skin with points about `spacing` [m] apart, and the hair on it."""
    points, normals = surface_points(body, creature.low, creature.high, spacing, rng)
    free = np.min([bead.shape(points)[0] for bead in creature.beads], axis=0)  # distance to the nearest bead
    points, normals, free = points[free > 0], normals[free > 0], free[free > 0]  # but for what a bead covers
    look = look_at_surface(creature, points, normals)
    clumps = np.exp(creature.mottle * fbm(points / 0.05, 3, 5))[:, None]
    lit = light(points, normals)[:, None]
    furry = (look.hair > 0.3 * spacing)[:, None]
    tangents, _ = tangent_frame(normals)
    sigma = np.tile([SKIN_SIGMA * spacing, SKIN_SIGMA * spacing, THIN * SKIN_SIGMA * spacing], (len(points), 1))
    skin = oriented(points, tangents, normals, sigma, look.albedo * clumps * lit * np.where(furry, SKIN_SHADE, 1.0))

    root = np.repeat(np.flatnonzero(furry), HAIRS)
    p = points[root] + spacing * rng.uniform(-0.6, 0.6, (len(root), 3))
    for _ in range(PROJECTIONS):
        distance, n = body(p)
        p = p - distance[:, None] * n
    look = look_at_surface(creature, p, n)
    own = creature.curl * unit(rng.normal(size=p.shape)) + (1 - creature.curl) * unit(look.comb)
    flow = own + 0.2 * rng.normal(size=p.shape)
    flow = unit(flow - (flow * n).sum(1, keepdims=True) * n)
    angle = (creature.lift * rng.uniform(0.5, 1.5, len(root))).clip(0, 1)[:, None] * np.pi / 2
    along = np.cos(angle) * flow + np.sin(angle) * n
    room = (free[root] / look.hair.clip(1e-4)).clip(0.2, 1.0)  # short round the eyes
    length = room * look.hair * rng.uniform(0.7, 1.25, len(root))
    sigma = np.stack([0.33 * length, np.full(len(root), HAIR_SIGMA * spacing)], 1)
    sigma = np.column_stack([np.maximum(sigma[:, 0], sigma[:, 1]), sigma[:, 1], 0.5 * sigma[:, 1]])
    tone = np.exp(creature.mottle * (rng.normal(size=(len(root), 1)) + HUE * rng.normal(size=p.shape)))
    hair = oriented(p + 0.4 * length[:, None] * along, along, n, sigma, look.albedo * (clumps * lit)[root] * tone)
    return [skin, hair]


def bead_discs(bead: Part, creature: Creature, fineness: float, light: Light, rng) -> Gaussians:
    """A bead as smooth discs; `fineness` is the density along a line over the usual one."""

    def surface(points):
        return bead.shape(points)[:2]

    low, high = box_of(surface, creature.low, creature.high)
    spacing = np.sqrt(PACKING * surface_area(surface, low, high, rng) / BEAD_POINTS) / fineness
    points, normals = surface_points(surface, low, high, spacing, rng)
    seen = surface_of(creature.body, points)[0] > -spacing
    points, normals = points[seen], normals[seen]
    colour = srgb(bead.colour) * light(points, normals)[:, None]
    if bead.glint:
        shine = (normals @ unit(np.array(KEY) + [0.0, 0.0, 0.6])) > GLINT_COSINE
        colour = mix(colour, (0.9, 0.9, 0.9), 0.9 * shine)
    sigma = np.tile([0.65 * spacing, 0.65 * spacing, THIN * spacing], (len(points), 1))
    return oriented(points, tangent_frame(normals)[0], normals, sigma, colour)


def stitches(seam: Seam, creature: Creature, body: Surface, length: float, light: Light, rng) -> Gaussians:
    """Dark threads along a seam, `length` [m] each."""
    across = unit(np.asarray(seam.normal, float))

    def beside(p):
        return (p - np.asarray(seam.point)) @ across

    p, _ = surface_points(body, creature.low, creature.high, length, rng, beside)
    for _ in range(2 * PROJECTIONS):
        p = p - beside(p)[:, None] * across
        distance, n = body(p)
        p = p - distance[:, None] * n
    meets = (np.abs(n @ across) < 0.8) & (np.abs(beside(p)) < STITCH_WIDTH) & seam.keep(p)
    p, n = p[meets], n[meets]
    chosen = blue_noise(p, n, length, None)
    p, n = p[chosen], n[chosen]
    look = look_at_surface(creature, p, n)
    sigma = np.tile([0.6 * length, STITCH_WIDTH, 0.5 * STITCH_WIDTH], (len(p), 1))
    colour = STITCH_SHADE * look.albedo * light(p, n)[:, None]
    return oriented(p + 0.6 * look.hair[:, None] * n, unit(np.cross(n, across)), n, sigma, colour)


def oriented(points, along, up, sigma, radiance) -> Gaussians:
    """Gaussians with standard deviations (N, 3) along `along`, across it, and along the part of `up` normal to it."""
    across = unit(np.cross(up, along))
    rotation = np.stack([along, across, np.cross(along, across)], 2)
    quats = Rotation.from_matrix(rotation).as_quat(canonical=True, scalar_first=True)
    logit = np.full(len(points), np.log(OPACITY / (1 - OPACITY)))
    sh = flat_sh(tone_map(EXPOSURE * radiance))
    return Gaussians.of(points, quats, np.log(sigma), logit, sh, np.ones(len(points)))


def shell_cells(surface: Surface, low, high, beside=None) -> tuple[np.ndarray, float]:
    """Centres (C, 3) of cells that the surface passes through, and their width [m].

    beside  distance to another surface (N,), which must pass through them too
    """
    low, high = np.asarray(low, float), np.asarray(high, float)
    width = float((high - low).max()) / CELLS
    halves = 0.5 * np.array([[i & 1, i >> 1 & 1, i >> 2 & 1] for i in range(8)]) - 0.25
    width *= 2**HALVINGS
    shape = np.ceil((high - low) / width).astype(int)
    centres = low + width * (np.stack(np.meshgrid(*map(np.arange, shape), indexing="ij"), -1).reshape(-1, 3) + 0.5)
    for level in range(HALVINGS + 1):
        if level:
            centres = (centres[:, None] + width * halves).reshape(-1, 3)
            width *= 0.5
        if beside is not None:
            centres = centres[np.abs(beside(centres)) < width]
        centres = centres[np.abs(surface(centres)[0]) < 1.5 * width]
    return centres, width


def box_of(surface: Surface, low, high) -> tuple[np.ndarray, np.ndarray]:
    """Corners of a box around a small surface within a large box."""
    centres, width = shell_cells(surface, low, high)
    return centres.min(0) - width, centres.max(0) + width


def surface_area(surface: Surface, low, high, rng: np.random.Generator) -> float:
    """Area [m^2]: the volume of a thin shell on both sides, by random points, over its thickness."""
    centres, width = shell_cells(surface, low, high)
    p = centres[rng.integers(0, len(centres), 40_000)] + width * rng.uniform(-0.5, 0.5, (40_000, 3))
    return float((np.abs(surface(p)[0]) < 0.5 * width).mean() * len(centres) * width**2)


def surface_points(surface: Surface, low, high, spacing: float, rng, beside=None) -> tuple[np.ndarray, np.ndarray]:
    """Points (N, 3) about `spacing` [m] apart on a surface, and its normals there: blue noise.

    beside  distance to another surface (N,); only points near that are wanted
    """
    centres, width = shell_cells(surface, low, high, beside)
    count = int(CANDIDATES * len(centres) * (width / spacing) ** 2)  # in a shell of one cell's thickness
    p = centres[rng.integers(0, len(centres), count)] + width * rng.uniform(-0.5, 0.5, (count, 3))
    near = np.abs(surface(p)[0]) < 0.5 * width
    p = p[near]
    for _ in range(PROJECTIONS):
        distance, n = surface(p)
        p = p - distance[:, None] * n
    on = np.abs(distance) < 0.1 * spacing
    p, n = p[on], n[on]
    chosen = blue_noise(p, n, spacing, None)
    return p[chosen], n[chosen]
