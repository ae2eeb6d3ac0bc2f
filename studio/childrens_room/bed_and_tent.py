"""Furniture of the children's room: a bed under a patchwork quilt, a low shelf under the window, a play tent."""

from __future__ import annotations

import numpy as np

from studio.childrens_room.painted_shell import X0, Z0
from studio.shapes import Surface, beveled_box, box, grid_mesh, join, rotation_about, superellipsoid, tube
from studio.solids import Solid
from studio.textures import BEECH, cloth, hash_uniform, plain, smoothstep, srgb, wood

BED_X, BED_Z, BED_TOP = (X0 + 0.02, -0.98), (Z0 + 0.02, 0.16), 0.46  # [m] scenes repeat bed and shelf as colliders
SHELF_X, SHELF_DEPTH, SHELF_TOP = (-0.86, 0.48), 0.34, 0.64  # [m] against the far wall
SHELF_BOARD, SHELF_COLUMNS = 0.022, 3
SHELF_LEVEL = 0.345  # [m] top of its middle board
TENT_AT, TENT_HALF, TENT_HEIGHT, TENT_TURN = (1.27, -1.02), 0.50, 1.42, -48.0  # [m], [m], [m], [degrees]
TENT_DOOR = 0.34  # [m] half width of the door at the ground
QUILT = ("e9967a", "f3e3c3", "8fb7a8", "f0c777", "a9b9d6", "f2b8ae")
PATCH = 0.165  # [m]


def furniture() -> list[Surface]:
    """Bed, shelf and tent."""
    return [*bed(), *shelf(), *tent()]


def bed() -> list[Surface]:
    """Child's bed along the left wall, its head at the far end."""
    (x0, x1), (z0, z1), top = BED_X, BED_Z, BED_TOP
    middle = 0.5 * (x0 + x1)
    white = plain("f3eee2", 0.015)
    posts = [
        tube([(x, 0.0, z), (x, h, z)], [0.028, 0.028], 14)
        for z, h in ((z0 + 0.03, 0.86), (z1 - 0.03, 0.62))
        for x in (x0 + 0.03, x1 - 0.03)
    ]
    knobs = [
        superellipsoid((0.075, 0.075, 0.075), 1.0, 12).moved(translation=(x, h + 0.03, z))
        for z, h in ((z0 + 0.03, 0.86), (z1 - 0.03, 0.62))
        for x in (x0 + 0.03, x1 - 0.03)
    ]
    ends = []
    for z, low, high in ((z0 + 0.03, 0.30, 0.80), (z1 - 0.03, 0.22, 0.56)):
        panel = beveled_box((x1 - x0 - 0.09, high - low, 0.026), 0.006)
        ends.append(panel.moved(translation=(middle, 0.5 * (low + high), z)))
    rail = box((x1 - 0.045, 0.18, z0 + 0.05), (x1 - 0.015, 0.32, z1 - 0.05))
    mattress = superellipsoid((x1 - x0 - 0.06, 0.20, z1 - z0 - 0.10), 0.16)
    mattress = mattress.moved(translation=(middle, 0.34, 0.5 * (z0 + z1)))
    pillow = superellipsoid((0.66, 0.15, 0.40), 0.55).moved(rotation_about("x", 14), (middle, top + 0.055, z0 + 0.30))
    stripes = cloth("f6efe0", 0.010, 0.06, 0.02, 243)

    def case(p, n):
        band = smoothstep(0.42, 0.5, np.abs((p[:, 0] / 0.11) % 1 - 0.5) * 2)
        return stripes(p, n) * (1 - band[:, None] * (1 - srgb("b9cbe2")))

    return [
        Surface("bed frame", join(*posts, *ends, rail), white, 0.0165, gloss=0.03),
        Surface("bed knobs", join(*knobs), plain("e9967a", 0.02), 0.0125, gloss=0.04),
        Surface("mattress", mattress, cloth("f4efe4", 0.012, 0.05, 0.02, 241), 0.020),
        Surface("pillow", pillow, case, 0.0145),
        quilt(),
    ]


def quilt() -> Surface:
    """Patchwork over the bed and its side, in soft folds."""
    (_, x1), (z0, z1), top = BED_X, BED_Z, BED_TOP
    s = np.linspace(0, 1.28, 50)[:, None]  # [m] from the wall over the edge and down
    t = np.linspace(z1 - 0.07, z0 + 0.52, 60)[None]
    flat = x1 - BED_X[0] - 0.02
    over = np.clip(s - flat, 0, None)
    bend = np.clip(over / 0.06, 0, 1)
    x = BED_X[0] + 0.015 + np.minimum(s, flat) + 0.030 * np.sin(0.5 * np.pi * bend) + 0.012 * bend * np.sin(17 * t)
    y = top + 0.018 - over + 0.006 * np.sin(9 * s + 2) * np.sin(7 * t) * (over == 0)
    mesh = grid_mesh(np.stack(np.broadcast_arrays(x, y, t + 0 * s), -1))
    weave, tones = cloth((1.0, 1.0, 1.0), 0.012, 0.09, 0.04, 245), np.array([srgb(c) for c in QUILT])

    def colour_at(p, n):
        u = np.where(p[:, 1] < top, flat + top - p[:, 1], p[:, 0] - BED_X[0]) / PATCH
        v = p[:, 2] / PATCH
        column, row = np.floor(u).astype(int), np.floor(v).astype(int)
        c = tones[(column * 2 + row * 5 + (hash_uniform(column * 31 + row, 246) * 2).astype(int)) % len(tones)]
        dots = (np.hypot((u * 3) % 1 - 0.5, (v * 3) % 1 - 0.5) < 0.2) & ((column + row) % 3 == 0)
        c = np.where(dots[:, None], srgb("fbf3e2"), c)
        seam = np.minimum(np.abs(u - np.round(u)), np.abs(v - np.round(v))) * PATCH
        return c * weave(p, n) * (0.80 + 0.20 * smoothstep(0.002, 0.009, seam))[:, None]

    return Surface("quilt", mesh, colour_at, 0.0125, translucency=0.0)


def shelf() -> list[Surface]:
    """Low open shelf of birch, in two rows."""
    (x0, x1), t, z1 = SHELF_X, SHELF_BOARD, Z0 + 0.02 + SHELF_DEPTH
    level = [(0.05, 0.05 + t), (SHELF_LEVEL - t, SHELF_LEVEL), (SHELF_TOP - t, SHELF_TOP)]
    boards = [box((x0, low, Z0 + 0.02), (x1, high, z1)) for low, high in level]
    uprights = []
    for k in range(SHELF_COLUMNS + 1):
        x = x0 + (x1 - x0 - t) * k / SHELF_COLUMNS
        uprights.append(
            box((x, 0.0 if k in (0, SHELF_COLUMNS) else 0.06, Z0 + 0.03), (x + t, SHELF_TOP - t, z1 - 0.004))
        )
    back = quad_back((x0, 0.06), (x1, SHELF_TOP - t), Z0 + 0.028)
    options = {"gloss": 0.03, "roughness": 0.25}
    return [
        Surface(
            "shelf boards", join(*boards), wood(BEECH, axis=0, across=2, seed=251), 0.0105, (1, 0, 0), 2.6, **options
        ),
        Surface(
            "uprights", join(*uprights), wood(BEECH, axis=1, across=2, seed=253), 0.0115, (0, 1, 0), 2.4, **options
        ),
        Surface("shelf back", back, plain("d9c6a2", 0.02), 0.022),
    ]


def quad_back(low, high, z: float):
    """Upright rectangle that faces the room."""
    return box((low[0], low[1], z - 0.004), (high[0], high[1], z))


def tent() -> list[Surface]:
    """Tepee of dotted canvas on four crossed poles, its door tied back."""
    a, apex = TENT_HALF, np.array([0.0, TENT_HEIGHT, 0.0])
    corners = [np.array([x, 0.0, z]) for x, z in ((-a, a), (a, a), (a, -a), (-a, -a))]
    panels = []
    for k in range(4):
        p, q = corners[k], corners[(k + 1) % 4]
        v = np.linspace(0.02, 0.96, 24)[None, :, None]  # from the ground to below the crossing
        spans = [(0.0, 1.0)]
        if k == 0:  # the flaps of the door, tied back at the side
            spans = [(0.0, "door"), ("door", 1.0)]
        for begin, end in spans:
            w = 0.5 * (1 - TENT_DOOR / a * np.clip(1 - v / 0.72, 0, 1) ** 0.8)
            low = 1 - w if begin == "door" else np.full_like(v, begin)
            high = w if end == "door" else np.full_like(v, end)
            s = np.linspace(0, 1, 20)[:, None, None]
            u = low + (high - low) * s
            points = (1 - v) * ((1 - u) * p + u * q) + v * apex
            inward = -np.cross(q - p, apex - p) / np.linalg.norm(np.cross(q - p, apex - p))
            sag = 0.035 * np.sin(np.pi * u) * np.sin(np.pi * v) if len(spans) == 1 else 0.02 * np.sin(3 * np.pi * s)
            panels.append(grid_mesh(points + sag * inward * (1 - v)))
    poles = []
    for c in corners:
        direction = apex - c
        poles.append(tube([c, c + 0.55 * direction, c + 1.17 * direction], 0.0115, 12))
    cushion = superellipsoid((0.62, 0.14, 0.62), 0.6).moved(translation=(0.0, 0.07, -0.02))
    canvas = cloth("f5ebd7", 0.010, 0.05, 0.02, 261)

    def dotted(p, n):
        angle, height = np.arctan2(p[:, 0], p[:, 2]) * 5.1, p[:, 1]
        row = np.floor(height / 0.12)
        around = (p[:, 0] + 0.6 * p[:, 2]) / 0.13 + 0.5 * (row % 2)
        d = np.hypot((around % 1 - 0.5) * 0.13, height - (row + 0.5) * 0.12) + 0 * angle
        tone = np.where(
            (row % 3 == 0)[:, None], srgb("e9967a"), np.where((row % 3 == 1)[:, None], srgb("f0c777"), srgb("8fb7a8"))
        )
        return np.where((d < 0.021)[:, None], tone, canvas(p, n))

    surfaces = [
        Surface("tent", join(*panels), dotted, 0.0145, translucency=0.4, width=1.1),
        Surface("tent poles", join(*poles), wood(BEECH, axis=1, across=0, seed=263), 0.010, (0, 1, 0), 3.0),
        Surface("cushion", cushion, cloth("8fb7a8", 0.012, 0.07, 0.03, 265), 0.017),
    ]
    return [s.placed(rotation_about("y", TENT_TURN), (TENT_AT[0], 0.0, TENT_AT[1])) for s in surfaces]


def tent_solid() -> Solid:
    """The tent as a solid pyramid, door and all: what is thrown at it slides off."""
    turn = rotation_about("y", TENT_TURN)
    slope = np.array([TENT_HEIGHT, TENT_HALF]) / np.hypot(TENT_HEIGHT, TENT_HALF)  # outward normal of a side

    def distance(p):
        q = np.abs((p - np.array([TENT_AT[0], 0.0, TENT_AT[1]])) @ turn)
        across = np.maximum(q[:, 0], q[:, 2])
        return slope[0] * (across - TENT_HALF) + slope[1] * (p[:, 1])

    return distance
