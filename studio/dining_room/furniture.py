"""Furniture: table, chairs, sideboard, rug."""

from __future__ import annotations

import numpy as np

from studio.dining_room.shell import Z0
from studio.shapes import Surface, beveled_box, box, grid_mesh, join, rotation_about, smooth_curve, superellipsoid, tube
from studio.textures import BEECH, HONEY, WALNUT, cloth, plain, srgb, wood

TABLE_TOP = 0.75  # [m] height; scenes repeat the table for their analytic colliders
TABLE_SIZE = (1.6, 0.9)  # [m] along x and z, centred on the origin
TABLE_THICKNESS = 0.035  # [m]


def furniture() -> list[Surface]:
    """Table, four chairs, sideboard and rug."""
    chairs = [
        *chair(rotation_about("y", 4), (-0.42, 0.0, -0.74)),
        *chair(rotation_about("y", -7), (0.44, 0.0, -0.72)),
        *chair(rotation_about("y", 84), (-1.12, 0.0, 0.06)),
        *chair(rotation_about("y", -98), (1.14, 0.0, -0.04)),
    ]
    return [*table(), *chairs, *sideboard(), rug()]


def table() -> list[Surface]:
    """Solid table: glued boards, an apron set back, tapered legs."""
    w, d = TABLE_SIZE
    top = beveled_box((w, TABLE_THICKNESS, d), 0.003).moved(translation=(0, TABLE_TOP - TABLE_THICKNESS / 2, 0))
    boards = wood(HONEY, axis=0, board=0.15, across=2, seed=31)
    y1 = TABLE_TOP - TABLE_THICKNESS
    y0, x, z = y1 - 0.085, w / 2 - 0.075, d / 2 - 0.06
    apron = join(
        box((-x, y0, z - 0.022), (x, y1, z)),
        box((-x, y0, -z), (x, y1, -z + 0.022)),
        box((-x, y0, -z), (-x + 0.022, y1, z)),
        box((x - 0.022, y0, -z), (x, y1, z)),
    )
    legs = []
    for sx in (-1, 1):
        for sz in (-1, 1):
            heights = np.array([0.0, 0.35, y0, y1 - 0.001])
            half = np.array([0.019, 0.027, 0.034, 0.034])
            corner = half[:, None, None] * np.array([(-1, -1), (-1, 1), (1, 1), (1, -1)])[None]
            ring = np.stack([corner[..., 0], np.broadcast_to(heights[:, None], (4, 4)), corner[..., 1]], -1)
            ring += np.array([sx * (x - 0.012), 0, sz * (z - 0.012)])
            legs.append(grid_mesh(ring.transpose(1, 0, 2), close_u=True))
    upright = wood(HONEY, axis=1, across=0, seed=33)
    return [
        Surface(
            "table top", top, boards, 0.0036, grain=(1, 0, 0), stretch=5.0, gloss=0.045, roughness=0.13, object_id=1
        ),
        Surface("apron", apron, boards, 0.012, grain=(1, 0, 0), stretch=2.5, object_id=1),
        Surface("legs", join(*legs), upright, 0.009, grain=(0, 1, 0), stretch=2.5, gloss=0.03, object_id=1),
    ]


def chair(rotation, position) -> list[Surface]:
    """Light wooden chair with an upholstered seat, facing +z."""
    timber = {"gloss": 0.03, "roughness": 0.25, "object_id": 2}
    upright, level = wood(BEECH, axis=1, across=0, seed=41), wood(BEECH, axis=0, across=1, seed=43)
    legs = []
    for s in (-1, 1):
        legs.append(
            tube([(s * 0.205, 0.0, 0.205), (s * 0.19, 0.25, 0.19), (s * 0.18, 0.44, 0.18)], [0.011, 0.015, 0.018], 12)
        )
        back = [
            (0.20, 0, -0.225),
            (0.185, 0.25, -0.195),
            (0.18, 0.46, -0.19),
            (0.185, 0.70, -0.225),
            (0.19, 0.875, -0.275),
        ]
        legs.append(tube(smooth_curve(np.array(back) * (s, 1, 1), 12), [0.012] + [0.017] * 9 + [0.013, 0.009], 12))
    rails = [
        tube([(-0.185, 0.20, 0.19), (0.185, 0.20, 0.19)], 0.008, 10),
        tube([(-0.185, 0.24, -0.19), (0.185, 0.24, -0.19)], 0.008, 10),
    ]
    u = np.linspace(-1, 1, 14)
    slats = []
    for y, z, h in ((0.80, -0.252, 0.036), (0.655, -0.215, 0.022)):
        path = np.stack([0.188 * u, 0 * u + y, z - 0.035 * (1 - u * u)], 1)
        slats.append(tube(path, h, 14, flat=0.28, up=(0, 0, 1)))
    frame = beveled_box((0.40, 0.045, 0.40), 0.008).moved(translation=(0, 0.425, 0))
    seat = superellipsoid((0.425, 0.062, 0.42), 0.34).moved(translation=(0, 0.462, 0.005))
    surfaces = [
        Surface("chair legs", join(*legs), upright, 0.0095, grain=(0, 1, 0), stretch=3.0, **timber),
        Surface("chair back", join(*slats), level, 0.0085, grain=(1, 0, 0), stretch=2.2, **timber),
        Surface("chair rails", join(*rails, frame), level, 0.0110, grain=(1, 0, 0), stretch=2.5, **timber),
        Surface("chair seat", seat, cloth("7189a0", 0.012, 0.08, 0.03), 0.0125, object_id=2),
    ]
    return [p.placed(rotation, position) for p in surfaces]


def sideboard() -> list[Surface]:
    """Low walnut sideboard by the far wall: two doors, three drawers, thin legs."""
    x0, x1, z1 = 0.38, 1.78, Z0 + 0.43
    body = beveled_box((x1 - x0, 0.60, 0.40), 0.004).moved(translation=((x0 + x1) / 2, 0.50, Z0 + 0.225))
    fronts, knobs = [], []
    for a, b in ((x0 + 0.02, x0 + 0.46), (x1 - 0.46, x1 - 0.02)):
        fronts.append(box((a, 0.225, z1 - 0.006), (b, 0.775, z1 + 0.012)))
        knob_x = b - 0.04 if a < 1.0 else a + 0.04
        knobs.append(superellipsoid((0.022, 0.022, 0.022), 1.0, 10).moved(translation=(knob_x, 0.52, z1 + 0.024)))
    for k in range(3):
        low = 0.225 + 0.185 * k
        fronts.append(box((x0 + 0.468, low, z1 - 0.006), (x1 - 0.468, low + 0.178, z1 + 0.012)))
        knobs.append(
            superellipsoid((0.022, 0.022, 0.022), 1.0, 10).moved(translation=((x0 + x1) / 2, low + 0.09, z1 + 0.024))
        )
    legs = [
        tube([(x, 0.0, z), (x * 0.98 + 0.0216, 0.21, z)], [0.011, 0.019], 10)
        for x in (x0 + 0.08, x1 - 0.08)
        for z in (Z0 + 0.07, z1 - 0.07)
    ]
    long = {"grain": (1, 0, 0), "stretch": 2.4, "gloss": 0.04, "roughness": 0.18, "object_id": 3}
    return [
        Surface("sideboard", body, wood(WALNUT, axis=0, across=2, seed=51), 0.0085, **long),
        Surface("fronts", join(*fronts), wood(WALNUT, axis=0, across=1, seed=53), 0.0075, **long),
        Surface("sideboard legs", join(*legs), plain("3a2a1c"), 0.010, object_id=3),
        Surface("knobs", join(*knobs), plain("a5834a", 0.05), 0.0050, gloss=0.25, object_id=3),
    ]


def rug() -> Surface:
    """Flat-woven rug: bands with stepped edges in rust and indigo on cream."""
    half = np.array([1.28, 0.93])
    mesh = beveled_box((2 * half[0], 0.012, 2 * half[1]), 0.004).moved(translation=(0, 0.006, -0.10))
    weave = cloth((1.0, 1.0, 1.0), 0.016, 0.10, 0.05, 61)
    rust, cream, indigo = srgb("b5583f"), srgb("e6dcc4"), srgb("4a6078")

    def colour_at(p, n):
        x, z = np.abs(p[:, 0]), p[:, 2] + 0.10
        step = 0.03 * np.floor(np.abs((z / 0.36) % 1 - 0.5) * 4)  # woven steps of the stripes' edges
        at = (x - step) % 0.32
        c = np.where(((at > 0.08) & (at < 0.14))[:, None], rust, cream)
        c = np.where(((at > 0.165) & (at < 0.20))[:, None], indigo, c)
        c = np.where((x > 1.02)[:, None], rust, c)
        c = np.where(((x > 1.06) & (x < 1.10))[:, None] | (x > 1.20)[:, None], cream, c)
        return c * weave(p, n)

    return Surface("rug", mesh, colour_at, 0.0110, grain=(0, 0, 1), stretch=2.0)
