"""Swinging parts: a skirt and a ponytail, sheets and rods of soft material that the skeleton holds at one end.

Each has a cage of its own beside the body's. Vertices at the waist, or at the head, are driven by that joint; all
others are simulated, and legs, rings, balls and hands push them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from assets.asset import Asset, Cage, CageEmbedding
from assets.gaussians import concatenate
from core.distance_grid import DistanceGrid
from studio.dancer.body import GOLD, HAIR, surface
from studio.dancer.skeleton import HEIGHT
from studio.shapes import Surface, grid_mesh, join, smooth_curve, superellipsoid, tube
from studio.solids import Solid
from studio.swept_cages import rod_cage, sheet_cage
from studio.textures import Colour, cloth, fbm, mix, smoothstep, srgb

# In units of the height: the skirt's sections (y, half width inside, depth over width), the ponytail's (y, z, radius).
SKIRT = np.array([(0.612, 0.071, 0.76), (0.585, 0.086, 0.76), (0.550, 0.108, 0.80), (0.500, 0.132, 0.86),
                  (0.400, 0.170, 0.94), (0.300, 0.208, 1.0), (0.235, 0.236, 1.0)])  # fmt: skip
SKIRT_THICKNESS = 0.015  # [heights]
FOLDS, FOLD_DEPTH = 8, 0.060  # around the skirt; of its radius at the hem
BELT = 0.12  # of the skirt's length is held by the pelvis
PONYTAIL = np.array([(0.950, -0.082, 0.016), (0.935, -0.104, 0.023), (0.890, -0.122, 0.031), (0.820, -0.124, 0.033),
                     (0.750, -0.116, 0.029), (0.690, -0.108, 0.020), (0.655, -0.106, 0.007)])  # fmt: skip
HAIR_ROOT = 0.20  # of the ponytail's length is held by the head


@dataclass(frozen=True)
class Garment:
    """A swinging part: its surfaces, cage and solid [m], the joint that holds it, and which vertices that drives."""

    surfaces: list[Surface]
    cage: Cage
    solid: Solid
    joint: str
    driven: np.ndarray


def skirt(vertices: int) -> Garment:
    """A wide skirt with folds, of about so many vertices."""
    rows = max(int(np.sqrt(vertices / 2 / 5.0)), 5)
    around = max(round(vertices / 2 / rows / FOLDS), 3) * FOLDS
    a = 2 * np.pi * np.arange(around) / around
    v = np.linspace(0, 1, rows)
    margin = 0.003  # Gaussians lie inside
    cage = sheet_cage(_skirt_points(a, v, -margin), _skirt_points(a, v, SKIRT_THICKNESS + margin))
    held = np.tile(v <= BELT + 1e-9 if (v <= BELT + 1e-9).sum() > 1 else np.arange(rows) < 2, 2 * around)

    fine, down = 2 * np.pi * np.arange(180) / 180, np.linspace(0, 1, 50)
    outside = grid_mesh(_skirt_points(fine, down, SKIRT_THICKNESS)[:, ::-1], close_u=True)
    inside = grid_mesh(_skirt_points(fine, down, 0.0), close_u=True)
    rim = np.stack([_skirt_points(fine, np.ones(1), t)[:, 0] for t in np.linspace(0, SKIRT_THICKNESS, 4)], 1)
    hem = grid_mesh(rim[:, ::-1], close_u=True)
    petticoat = cloth("efe4d2", 0.006, 0.12, 0.05, 531)
    surfaces = [
        surface("skirt", outside, _skirt_colour(), 0.0060),
        surface("petticoat", inside, petticoat, 0.0120),
        surface("hem", hem, petticoat, 0.0066),
    ]
    return Garment(surfaces, cage, _skirt_solid, "pelvis", held)


def ponytail(vertices: int) -> Garment:
    """A ponytail with a gold ribbon, of about so many vertices."""
    sides = 6 if vertices < 200 else 10
    count = max(vertices // (sides + 1), 8)
    line = HEIGHT * smooth_curve(PONYTAIL, count)
    axis = np.stack([0 * line[:, 0], line[:, 0], line[:, 1]], 1)
    tangent = np.gradient(axis, axis=0)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    side = np.array([1.0, 0.0, 0.0])
    over = np.cross(side, tangent)
    b = 2 * np.pi * (np.arange(sides) + 0.5) / sides
    # the cage does not follow the hair to its tip, where thin tets would shorten the substeps of the whole play
    radius = np.maximum(line[:, 2] * 1.06 + 0.002 * HEIGHT, 0.02 * HEIGHT) / np.cos(np.pi / sides)
    around = np.cos(b)[None, :, None] * side + np.sin(b)[None, :, None] * over[:, None]
    cage = rod_cage(axis[:, None] + radius[:, None, None] * around, axis)
    held = np.repeat(np.linspace(0, 1, count) <= max(HAIR_ROOT, 1.5 / (count - 1)), sides + 1)

    fine = HEIGHT * smooth_curve(PONYTAIL, 40)
    path = np.stack([0 * fine[:, 0], fine[:, 0], fine[:, 1]], 1)
    tail = tube(path, fine[:, 2], 24, up=(0.0, 0.0, 1.0))
    knot = superellipsoid(HEIGHT * np.array([0.062, 0.034, 0.050]), 0.9, 14)
    knot = knot.moved(None, HEIGHT * np.array([0.0, 0.938, -0.096]))
    loops = []
    for s in (-1, 1):
        t = np.linspace(0, 2 * np.pi, 18)
        loop = np.stack(
            [s * (0.012 + 0.040 * np.sin(t / 2) ** 2), 0.940 + 0.016 * np.sin(t), -0.108 - 0.010 * np.sin(t / 2)], 1
        )
        loops.append(tube(HEIGHT * loop, 0.0075 * HEIGHT, 10))
    surfaces = [
        surface("ponytail", tail, _hair_colour(), 0.0050),
        surface("ribbon", join(knot, *loops), cloth(GOLD, 0.005, 0.10, 0.05, 541), 0.0042),
    ]
    points, thickness = path[::3], fine[::3, 2]

    def solid(p):
        a, b = points[:-1], points[1:]
        t = (((p[:, None] - a) * (b - a)).sum(2) / ((b - a) ** 2).sum(1)).clip(0, 1)
        near = np.linalg.norm(p[:, None] - a - t[..., None] * (b - a), axis=2)
        return (near - thickness[:-1] - t * np.diff(thickness)).min(1)

    return Garment(surfaces, cage, solid, "head", held)


def with_garment(asset: Asset, garment: Garment, gaussians, embedding: CageEmbedding) -> Asset:
    """The animated asset with a garment, given in its frame; its Gaussians are embedded in the garment's cage."""
    cage, a = asset.cage, asset.animation
    V, T = len(cage.vertices), len(cage.tets)
    n = len(garment.cage.vertices)
    joined = Cage(
        np.concatenate([cage.vertices, garment.cage.vertices]),
        np.concatenate([cage.tets, garment.cage.tets + V]).astype(np.int32),
        np.concatenate([cage.surface, garment.cage.surface + V]).astype(np.int32),
    )
    hosts = CageEmbedding(
        np.concatenate([asset.embedding.host, embedding.host + T]).astype(np.int32),
        np.concatenate([asset.embedding.weights, embedding.weights]),
    )
    alone = np.tile(np.array([1, 0, 0, 0], np.float32), (n, 1))
    motion = replace(
        a,
        vertices=np.concatenate([a.vertices, V + np.arange(n)]).astype(np.int32),
        joints=np.concatenate([a.joints, a.names.index(garment.joint) * alone.astype(np.int32)]).astype(np.int32),
        weights=np.concatenate([a.weights, alone]).astype(np.float32),
        driven=np.concatenate([a.driven, garment.driven]),
    )
    parts = concatenate([asset.gaussians, gaussians])
    return replace(asset, gaussians=parts, cage=joined, embedding=hosts, animation=motion)


def joint_grid(body: DistanceGrid, garments: list[Garment], size: np.ndarray) -> DistanceGrid:
    """Signed distances to the body, whose own grid is given, and to the garments; `size` = low and high corners."""
    spacing = float(body.spacing)
    count = np.ceil((size[1] - size[0]) / spacing).astype(int) + 1
    nodes = size[0] + spacing * np.stack(np.meshgrid(*(np.arange(k) for k in count), indexing="ij"), -1).reshape(-1, 3)
    inside = body.sample_extended(nodes)
    values = np.minimum(inside, np.min([g.solid(nodes) for g in garments], axis=0)).reshape(count)
    return DistanceGrid(values.astype(np.float16), size[0], spacing)


def _skirt_points(angle: np.ndarray, v: np.ndarray, out: float) -> np.ndarray:
    """Points (A, V, 3) [m] of the skirt at angles about y and fractions `v` of its length, `out` [heights] outwards."""
    y, r, depth = (x[None] for x in _skirt_section(v).T)
    wave = 1 + FOLD_DEPTH * smoothstep(0.1, 1.0, v[None]) * np.cos(FOLDS * angle[:, None])
    r = r * wave + out
    x, z = r * np.cos(angle)[:, None], -(r * depth) * np.sin(angle)[:, None]
    return HEIGHT * np.stack(np.broadcast_arrays(x, y, z), -1)


def _skirt_section(v: np.ndarray) -> np.ndarray:
    """(y, r, depth) at fractions of the length, (V, 3)."""
    curve = smooth_curve(SKIRT, 80)
    return np.stack([np.interp(v, np.linspace(0, 1, 80), curve[:, k]) for k in range(3)], 1)


def _skirt_solid(p: np.ndarray) -> np.ndarray:
    """Signed distance [m] to the skirt, exact up to its slope: half the thickness less the distance to its middle."""
    q = p / HEIGHT
    curve = smooth_curve(SKIRT, 80)
    y = q[:, 1].clip(curve[-1, 0], curve[0, 0])
    order = np.argsort(curve[:, 0])
    r, depth = (np.interp(y, curve[order, 0], curve[order, k]) for k in (1, 2))
    v = np.interp(y, curve[order, 0], np.linspace(0, 1, 80)[order])
    angle = np.arctan2(-q[:, 2] / depth, q[:, 0])
    wave = 1 + FOLD_DEPTH * smoothstep(0.1, 1.0, v) * np.cos(FOLDS * angle)
    slope = 0.80  # cosine of the skirt's slope to the vertical
    across = slope * (np.hypot(q[:, 0], q[:, 2] / depth) - r * wave - 0.5 * SKIRT_THICKNESS)
    beyond = np.abs(q[:, 1] - y)
    thick = np.abs(across) - 0.5 * slope * SKIRT_THICKNESS
    return HEIGHT * np.where(beyond > 0, np.hypot(thick.clip(0), beyond), thick)


def _skirt_colour() -> Colour:
    """Turquoise silk with gold bands and a white lace edge, dark in the folds."""
    silk, lace = cloth("18808c", 0.006, 0.10, 0.05, 533), cloth("f4ead8", 0.004, 0.25, 0.04, 535)
    gold, deep = srgb(GOLD), srgb("0e4e5c")

    def colour_at(p, n):
        v = np.interp(p[:, 1] / HEIGHT, SKIRT[::-1, 0], np.linspace(1, 0, len(SKIRT)))
        angle = np.arctan2(-p[:, 2], p[:, 0])
        fold = 0.5 + 0.5 * np.cos(FOLDS * angle)
        c = mix(silk(p, n) * 0.72, silk(p, n) * 1.18, fold)
        y = p[:, 1] / HEIGHT
        for low, high, tone in ((0.300, 0.330, deep), (0.338, 0.345, gold), (0.285, 0.292, gold)):
            c = np.where(((y > low) & (y < high))[:, None], tone * (0.7 + 0.4 * fold)[:, None], c)
        diamond = np.abs((angle * 24 / (2 * np.pi)) % 1.0 - 0.5) * 2 + np.abs(y - 0.315) / 0.013 < 0.75
        c = mix(c, gold, 0.9 * diamond)
        edge = 0.250 + 0.006 * np.abs(np.sin(24 * angle))
        c = np.where((y < edge)[:, None], lace(p, n) * (0.82 + 0.2 * fold)[:, None], c)
        return np.where((v < 0.05)[:, None], gold, c)

    return colour_at


def _hair_colour() -> Colour:
    base, shine = srgb(HAIR), srgb("96562a")

    def colour_at(p, n):
        angle = np.arctan2(p[:, 0], n[:, 2] * 0.03)
        along = np.stack([angle * 5, p[:, 1] * 9, p[:, 0] * 140], 1)
        return mix(base, shine, (0.3 + 0.6 * fbm(along, 3, 543)).clip(0, 1))

    return colour_at
