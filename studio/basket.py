"""The basket for the toys: willow, woven round stakes, with two handles; a rigid body that can be carried."""

from __future__ import annotations

import numpy as np

from assets.asset import Asset
from core.material import Material
from studio.detail import Detail
from studio.finish import flat_sh, sample_albedo, sharpened, to_gaussians, tone_map
from studio.revolved_cage import revolved_cage
from studio.shapes import Surface, grid_mesh, lathe, tube
from studio.solids import Solid, revolved, sample_distance_grid
from studio.surface_sampling import Surfels, sample_surfaces
from studio.textures import hash_uniform, mix, noise, smoothstep, srgb

FOOT_RADIUS, RIM_RADIUS, HEIGHT = 0.275, 0.335, 0.264  # [m] outside; scenes repeat them to tell what lies in it
WALL, FLOOR = 0.016, 0.018  # [m] thickness
STAKES, ROW = 32, 0.024  # stakes round the basket; height of a row of weaving [m]
BULGE = 0.007  # [m] by which a strand goes before and behind the stakes
SEGMENTS = 24  # of the cage
WILLOW, DARK, BAND = "d9ad70", "5e3c1c", "a06a35"
MATERIAL = Material(young=1e7, poisson=0.3, density=60.0, friction=0.7, kinetic_friction=0.6)  # 1 kg as a whole


def basket(rng: np.random.Generator, detail: Detail, report) -> Asset:
    """The asset `basket`. Taichi must be running."""
    from prepare.cage.embedding_hosts import embed

    surfaces = basket_surfaces()
    surfels = sample_surfaces(surfaces, rng, detail)
    colours = sharpened(surfels, tone_map(sample_albedo(surfels, surfaces, rng) * _light(surfels)))
    g = to_gaussians(surfels, flat_sh(colours), np.ones(len(surfels)))
    cage = basket_cage()
    reach = RIM_RADIUS + 0.03
    sdf = sample_distance_grid([basket_solid()], (-reach, -0.03, -reach), (reach, HEIGHT + 0.03, reach), 0.006)
    embedded = embed(g.means, g.quats, np.exp(g.log_scales), cage.vertices, cage.tets)
    return Asset(g, cage, embedded, sdf, MATERIAL, {"made_by": "vrgs build", "name": "basket"})


def radius_at(height) -> np.ndarray:
    """Outer radius of the wall [m] at a height [m]."""
    t = np.asarray(height) / HEIGHT
    return FOOT_RADIUS + (RIM_RADIUS - FOOT_RADIUS) * t + 0.012 * np.sin(np.pi * t)


def basket_surfaces() -> list[Surface]:
    """Woven wall, inside and outside, floor, braided rim and foot, handles."""
    surfaces = [
        Surface("outside", _woven(0.0, 1), _willow, 0.0092, uniform=True),
        Surface("inside", _woven(-WALL, -1), _willow, 0.0128, uniform=True),
        Surface("floor", lathe([(radius_at(0) - WALL, FLOOR), (0.0, FLOOR)], 64), _coiled, 0.0095, uniform=True),
        Surface("underside", lathe([(0.0, 0.0), (radius_at(0), 0.0)], 64), _coiled, 0.014, uniform=True),
    ]
    for name, radius, y, thick in (("rim", RIM_RADIUS - WALL / 2, HEIGHT, 0.0125), ("foot", FOOT_RADIUS, 0.008, 0.009)):
        surfaces.append(Surface(name, _braid(radius, y, thick), _braided, 0.0085, uniform=True))
    a = np.linspace(-0.27, 0.27, 24)
    for side in (0.0, np.pi):
        lift = 0.075 * np.cos(a / 0.27 * np.pi / 2) ** 0.6
        r = RIM_RADIUS - WALL / 2 + 0.12 * lift
        path = np.stack([r * np.cos(a + side), HEIGHT + lift, -r * np.sin(a + side)], 1)
        surfaces.append(Surface("handle", tube(path, 0.0095, 14), _wound(side), 0.0065, uniform=True))
    return surfaces


def basket_solid() -> Solid:
    """Wall and floor: a solid of revolution."""
    y = np.linspace(0.0, HEIGHT, 8)
    outer = np.stack([radius_at(y), y], 1)
    inner = np.stack([radius_at(y) - WALL, y], 1)[::-1]
    inner[-1] = (radius_at(FLOOR) - WALL, FLOOR)
    return revolved([*outer, *inner, (0.0, FLOOR)])


def basket_cage():
    """Three levels of wall round a floor in two layers."""
    levels = [0.0, FLOOR, 0.5 * (FLOOR + HEIGHT), HEIGHT + 0.006]
    section = [(0.0, -0.002), (0.0, FLOOR)]  # axis: below, above
    for y in levels:
        section += [(float(radius_at(y)) - WALL - 0.004, y), (float(radius_at(y)) + 0.006, y)]
    triangles = [(0, 2, 4), (0, 4, 1)]
    for k in range(len(levels) - 1):
        i = 2 + 2 * k
        triangles += [(i, i + 1, i + 3), (i, i + 3, i + 2)]
    return revolved_cage(section, triangles, SEGMENTS)


def _woven(offset: float, side: int):
    """Wall whose strands pass before and behind the stakes by turns; `side` -1 faces inwards."""
    a = np.linspace(0, 2 * np.pi, 6 * STAKES, endpoint=False)[:, None]
    y = np.linspace(FLOOR if side < 0 else 0.0, HEIGHT, 70)[None]
    over = np.cos(a * STAKES / 2 + np.pi * np.floor(y / ROW))  # a period is two stakes
    round_ = np.sin(np.pi * y / ROW) ** 2
    r = radius_at(y) + offset + side * BULGE * (0.5 * side * over + 0.5) * round_
    points = np.stack(np.broadcast_arrays(r * np.cos(a), y, -r * np.sin(a)), -1)
    return grid_mesh(points[::side], close_u=True)


def _willow(p, n):
    """Peeled willow: each strand of its own tone, dark in the gaps; a darker band below the rim."""
    angle, row = np.arctan2(-p[:, 2], p[:, 0]), np.floor(p[:, 1] / ROW)
    stake = np.floor(angle / (2 * np.pi) * STAKES + 0.5 * row)
    tone = 0.80 + 0.30 * hash_uniform((row * 131 + np.floor(stake / 5)).astype(int), 401)
    strand = np.sin(np.pi * p[:, 1] / ROW) ** 2
    over = 0.5 + 0.5 * np.cos(angle * STAKES / 2 + np.pi * row) * np.where((n * p)[:, [0, 2]].sum(1) > 0, 1, -1)
    c = np.where(((row >= 7) & (row <= 8))[:, None], srgb(BAND), srgb(WILLOW))
    c = mix(srgb(DARK), c, 0.15 + 0.85 * smoothstep(0.0, 0.6, strand) * (0.25 + 0.75 * over))
    return c * (tone * (1 + 0.12 * noise(p * (60, 260, 60), 402)))[:, None]


def _coiled(p, n):
    """Coils round the middle."""
    r = np.hypot(p[:, 0], p[:, 2])
    coil = np.abs((r / 0.014) % 1 - 0.5)
    tone = 0.85 + 0.25 * hash_uniform(np.floor(r / 0.014).astype(int), 403)
    return mix(srgb(DARK), srgb(WILLOW), smoothstep(0.5, 0.25, coil)) * tone[:, None]


def _wound(side: float):
    """A handle wound with split willow."""

    def colour_at(p, n):
        turns = (np.arctan2(-p[:, 2], p[:, 0]) - side) / 0.028 + p[:, 1] / 0.02
        return mix(srgb(DARK), srgb(WILLOW), smoothstep(0.5, 0.30, np.abs(turns % 1 - 0.5)))

    return colour_at


def _braid(radius: float, y: float, thick: float):
    """Thick circle."""
    a = np.linspace(0, 2 * np.pi, 14, endpoint=False)
    return lathe(np.stack([radius + thick * np.cos(a), y + thick * np.sin(a)], 1), 96, closed=True)


def _braided(p, n):
    """Rods that wind round each other."""
    turns = np.arctan2(-p[:, 2], p[:, 0]) * 40 / (2 * np.pi) + 0.9 * n[:, 1] + 0.4 * p[:, 1] / 0.02
    rod = smoothstep(0.5, 0.22, np.abs(turns % 1 - 0.5))
    tone = 0.85 + 0.25 * hash_uniform(np.floor(turns).astype(int) % 40, 404)
    return mix(srgb(DARK), srgb(WILLOW), 0.2 + 0.8 * rod) * tone[:, None]


def _light(c: Surfels) -> np.ndarray:
    """Light (N, 1) that suits any attitude of a body that is carried: little reaches the inside's depth."""
    inward = (c.points * (1, 0, 1) * c.normals).sum(1) < -1e-3
    inside = (inward | ((c.normals[:, 1] > 0.9) & (c.points[:, 1] < 1.5 * FLOOR))) & (c.points[:, 1] < HEIGHT)
    depth = np.clip(1 - c.points[:, 1] / HEIGHT, 0, 1)
    light = np.where(inside, 0.95 - 0.45 * depth, 0.80 + 0.22 * c.normals[:, 1])
    return light[:, None]
