"""The table in the middle of the study with what lies on it, and its chair."""

from __future__ import annotations

import numpy as np

from studio.light_sources import Lamp
from studio.shapes import (
    Surface,
    beveled_box,
    box,
    grid_mesh,
    join,
    lathe,
    rotation_about,
    smooth_curve,
    superellipsoid,
    tube,
)
from studio.solids import Solid, cuboid, placed, revolved
from studio.study.bookcases import closed_book
from studio.textures import HONEY, noise, plain, srgb, wood

TABLE_TOP, TABLE_HALF, THICKNESS = 0.76, (0.75, 0.40), 0.036  # [m] scenes/table_brick_game.py repeats them
BALL_RING = ((0.40, TABLE_TOP, 0.14), 0.030, 0.007)  # centre, radius and radius of the rod [m]: so does it these
LAMP_AT = (-0.52, TABLE_TOP, -0.24)  # [m] foot of the desk lamp
LAMP_COLOUR = np.array([1.0, 0.74, 0.45])  # linear RGB
BOOKS_AT = (0.56, TABLE_TOP, -0.22)  # [m]


def writing_table() -> list[Surface]:
    """Table, chair, and what lies on the table."""
    return [*table(), *chair(), *desk_lamp(), *writing_things(), ball_ring()]


def table_solids() -> list[Solid]:
    """Signed distances of the things on the table, besides its top and the ball's ring."""
    lamp = revolved([(0.085, 0.0), (0.085, 0.02), (0.014, 0.03), (0.014, 0.34)])
    ink = cuboid((-0.035, 0, -0.035), (0.035, 0.06, 0.035))
    stack = cuboid((-0.13, 0, -0.095), (0.13, 0.112, 0.095))
    return [
        placed(lamp, None, LAMP_AT),
        placed(cuboid((-0.15, 0.30, -0.06), (0.15, 0.39, 0.06)), None, LAMP_AT),
        placed(ink, None, (-0.30, TABLE_TOP, -0.30)),
        placed(stack, rotation_about("y", -12), BOOKS_AT),
    ]


def lamps() -> list[Lamp]:
    """The bulb of the desk lamp."""
    x, y, z = LAMP_AT
    return [Lamp(np.array([x, y + 0.335, z + 0.02]), 0.02, 0.55 * LAMP_COLOUR)]


def table() -> list[Surface]:
    """Oak library table: a top of glued boards, a panelled frieze with drawers, turned legs."""
    w, d = 2 * TABLE_HALF[0], 2 * TABLE_HALF[1]
    top = beveled_box((w, THICKNESS, d), 0.005).moved(translation=(0, TABLE_TOP - THICKNESS / 2, 0))
    y1, x, z = TABLE_TOP - THICKNESS, w / 2 - 0.09, d / 2 - 0.07
    y0 = y1 - 0.11
    frieze = box((-x, y0, -z), (x, y1, z))
    drawers = [
        beveled_box((0.40, 0.075, 0.014), 0.003).moved(translation=(c, y0 + 0.055, z + 0.006)) for c in (-0.43, 0, 0.43)
    ]
    knobs = [
        superellipsoid((0.026,) * 3, 1.0, 10).moved(translation=(c, y0 + 0.055, z + 0.024)) for c in (-0.43, 0, 0.43)
    ]
    profile = smooth_curve(
        [
            (0.0, 0.0),
            (0.028, 0.0),
            (0.034, 0.03),
            (0.022, 0.06),
            (0.020, 0.10),
            (0.034, 0.18),
            (0.038, 0.36),
            (0.026, 0.50),
            (0.036, 0.53),
            (0.030, 0.56),
        ],
        60,
    )
    legs = [
        lathe(profile, 24).moved(translation=(sx * (x - 0.035), 0, sz * (z - 0.035)))
        for sx in (-1, 1)
        for sz in (-1, 1)
    ]
    blocks = [
        box(
            (sx * (x - 0.035) - 0.042, 0.555, sz * (z - 0.035) - 0.042),
            (sx * (x - 0.035) + 0.042, y0, sz * (z - 0.035) + 0.042),
        )
        for sx in (-1, 1)
        for sz in (-1, 1)
    ]
    level = wood(HONEY, axis=0, board=0.134, across=2, seed=131)
    return [
        Surface(
            "table top", top, level, 0.0046, grain=(1, 0, 0), stretch=4.5, gloss=0.045, roughness=0.13, object_id=1
        ),
        Surface(
            "frieze", frieze, wood(HONEY, axis=0, across=1, seed=133), 0.013, grain=(1, 0, 0), stretch=2.5, object_id=1
        ),
        Surface(
            "drawers",
            join(*drawers),
            wood(HONEY, axis=0, across=1, seed=135),
            0.0085,
            grain=(1, 0, 0),
            stretch=2.5,
            gloss=0.03,
            object_id=1,
        ),
        Surface("drawer knobs", join(*knobs), plain("a5834a", 0.05), 0.006, gloss=0.25, object_id=1),
        Surface(
            "table legs",
            join(*legs, *blocks),
            wood(HONEY, axis=1, across=0, seed=137),
            0.011,
            grain=(0, 1, 0),
            stretch=2.0,
            gloss=0.03,
            object_id=1,
        ),
    ]


def ball_ring() -> Surface:
    """The brass ring that keeps the ball from rolling; of wood it looked like a stain on the table."""
    (x, y, z), radius, rod = BALL_RING
    a = np.linspace(0, 2 * np.pi, 48, endpoint=False)
    b = np.linspace(0, 2 * np.pi, 14, endpoint=False)
    away = radius + rod * np.cos(b)
    points = np.stack(
        [np.outer(np.cos(a), away), np.broadcast_to(rod + rod * np.sin(b), (48, 14)), -np.outer(np.sin(a), away)], -1
    )
    mesh = grid_mesh(points, close_u=True, close_v=True).moved(translation=(x, y, z))
    return Surface("ball ring", mesh, plain("d9a94a", 0.06, 0.02), 0.003, gloss=0.3, object_id=2)


def chair() -> list[Surface]:
    """Round-backed chair of dark wood with a green leather seat, pushed back from the table's far side."""
    dark = plain("4f2f1a", 0.14, 0.05)
    legs = [
        tube([(0.21 * sx, 0, 0.2 * sz), (0.19 * sx, 0.44, 0.18 * sz)], [0.013, 0.021], 10)
        for sx in (-1, 1)
        for sz in (-1, 1)
    ]
    seat = superellipsoid((0.50, 0.085, 0.48), 0.4, 20).moved(translation=(0, 0.475, 0))
    apron = beveled_box((0.46, 0.05, 0.44), 0.01).moved(translation=(0, 0.425, 0))
    a = np.radians(np.linspace(-20, 200, 30))
    arm = np.stack([0.27 * np.cos(a), 0.70 + 0.10 * np.sin(a).clip(0) ** 2, -0.25 * np.sin(a) + 0.02], 1)
    spindles = [
        tube(
            [
                (0.23 * np.cos(t), 0.47, -0.21 * np.sin(t)),
                (0.27 * np.cos(t), 0.69 + 0.10 * max(np.sin(t), 0) ** 2, -0.25 * np.sin(t) + 0.02),
            ],
            [0.012, 0.010],
            8,
        )
        for t in np.radians(np.linspace(0, 180, 11))
    ]
    surfaces = [
        Surface("chair wood", join(*legs, apron, tube(arm, 0.022, 12, flat=0.7), *spindles), dark, 0.013, gloss=0.04),
        Surface("chair seat", seat, plain("2f5a41", 0.12, 0.06), 0.013, gloss=0.03),
    ]
    return [s.placed(rotation_about("y", 14), (-0.10, 0.0, -0.72)) for s in surfaces]


def desk_lamp() -> list[Surface]:
    """Brass desk lamp with a green glass shade."""
    foot = smooth_curve([(0.0, 0.0), (0.083, 0.001), (0.085, 0.012), (0.040, 0.022), (0.013, 0.034), (0.010, 0.06)], 30)
    stem = tube([(0, 0.055, 0), (0, 0.25, 0), (0, 0.335, 0.0), (0, 0.375, 0.01)], 0.009, 12)
    u = np.sin(np.linspace(-0.5 * np.pi, 0.5 * np.pi, 40))[:, None]
    v = np.radians(np.linspace(-15, 195, 20))[None]
    dome = np.sqrt(1 - u**4)  # the ends are closed
    shape = np.broadcast_arrays(0.145 * u, 0.325 + 0.062 * np.sin(v) * dome, 0.02 + 0.068 * np.cos(v) * dome)
    shell = grid_mesh(np.stack(shape, -1))
    bulb = superellipsoid((0.16, 0.026, 0.026), 0.8, 12).moved(translation=(0, 0.345, 0.02))
    chain = tube([(0.10, 0.33, 0.06), (0.10, 0.25, 0.06)], 0.0018, 8)
    brass = plain("b08a3c", 0.04)
    surfaces = [
        Surface("lamp foot", join(lathe(foot, 40), stem, chain), brass, 0.0062, gloss=0.28, roughness=0.2, object_id=3),
        Surface(
            "lamp shade",
            shell,
            plain("1f6b45", 0.05, 0.04),
            0.0062,
            translucency=0.35,
            gloss=0.05,
            emission=(0.10, 0.20, 0.13),
            object_id=3,
        ),
        Surface("lamp bulb", bulb, plain("ffffff", 0.0), 0.008, emission=tuple(9 * LAMP_COLOUR), blocks_light=False),
    ]
    return [s.placed(None, LAMP_AT) for s in surfaces]


def writing_things() -> list[Surface]:
    """A stack of books, letters, an inkwell with a quill, and spectacles."""
    surfaces = []
    y = 0.0
    for k, (w, h, d, colour) in enumerate(
        ((0.25, 0.040, 0.18, "5c2f26"), (0.23, 0.034, 0.165, "2f4a3c"), (0.20, 0.030, 0.15, "b08a4a"))
    ):
        surfaces += closed_book(w, h, d, colour, (0, y, 0), (-12, -4, -19)[k], f"table book {k}", BOOKS_AT, 0.008)
        y += h

    def script(p, n):
        line = (p[:, 2] / 0.011) % 1
        word = noise(np.stack([p[:, 0] * 90, np.floor(p[:, 2] / 0.011) * 3.7, 0 * line], 1), 5)
        inside = (np.abs(p[:, 0]) < 0.085) & (np.abs(p[:, 2]) < 0.115)
        ink = (np.abs(line - 0.5) < 0.22) & (word > -0.18) & inside
        return np.where(ink[:, None], srgb("4a4a5a"), srgb("efe6cf"))

    for k, (at, yaw) in enumerate((((-0.42, 0.06), 12), ((-0.36, 0.09), -9))):
        sheet = box((-0.105, 0, -0.148), (0.105, 0.0016, 0.148))
        surfaces.append(
            Surface("letter", sheet, script, 0.0066).placed(
                rotation_about("y", yaw), (at[0], TABLE_TOP + 0.0002 + 0.0018 * k, at[1])
            )
        )
    glass = smooth_curve(
        [(0.0, 0.0), (0.032, 0.0), (0.034, 0.02), (0.030, 0.036), (0.014, 0.044), (0.015, 0.054), (0.0, 0.054)], 30
    )
    quill = tube([(0.0, 0.03, 0.0), (0.02, 0.10, -0.01), (0.06, 0.19, -0.03)], [0.0016, 0.0018, 0.001], 8)
    t, s = np.linspace(0, 1, 14)[:, None], np.linspace(-1, 1, 7)[None]
    rib = np.array([0.012, 0.075, -0.006]) + t[..., None] * np.array([0.055, 0.125, -0.026])
    vane = rib + (s * 0.017 * np.sin(np.pi * t**0.7))[..., None] * np.array([0.85, -0.45, 0.2])
    surfaces += [
        p.placed(None, (-0.30, TABLE_TOP, -0.30))
        for p in (
            Surface("inkwell", lathe(glass, 32), plain("27324a", 0.08, 0.02), 0.0048, gloss=0.08),
            Surface("quill", quill, plain("e8dfc8", 0.05), 0.004),
            Surface("feather", grid_mesh(vane), plain("e9e4da", 0.08, 0.02), 0.0052, translucency=0.4),
        )
    ]
    return surfaces
