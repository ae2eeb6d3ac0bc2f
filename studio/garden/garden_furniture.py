"""Furniture of the garden: a picket fence with a gate, a bench, a bird house, pots."""

from __future__ import annotations

import numpy as np

from studio.garden.ground import HIGH, LOW, path_x
from studio.garden.plants import TREE_AT
from studio.shapes import Mesh, Surface, beveled_box, box, join, lathe, leaf_mesh, quad, rotation_about, smooth_curve
from studio.solids import Solid, cuboid, placed, revolved
from studio.textures import HONEY, plain, srgb, wood

FENCE_Z, FENCE_HEIGHT = LOW[1], 0.95  # [m]
BENCH_AT, BENCH_TURN = (1.05, -2.75), -14.0  # [m] x, z; [degrees]
SEAT, BENCH_WIDTH = 0.43, 1.30  # [m]
POTS = [((2.95, 2.25), 0.20), ((2.75, 1.72), 0.15), ((-2.9, 2.3), 0.19)]  # [m] x, z; radius


def furniture() -> list[Surface]:
    """All of it."""
    return [*fence(), *bench(), *pots(), *bird_house()]


def fence() -> list[Surface]:
    """White pickets between the hedges; the gate stands where the path leads out."""
    pickets, width, gap = [], 0.085, 0.125
    gate = float(path_x(FENCE_Z))
    for x in np.arange(LOW[0] + 0.06, HIGH[0], gap):
        h = FENCE_HEIGHT + (0.10 * np.cos(np.clip((x - gate) / 0.5, -1, 1) * np.pi / 2) if abs(x - gate) < 0.5 else 0.0)
        w, z = width / 2, FENCE_Z
        outline = [(x - w, 0.06), (x + w, 0.06), (x + w, h - 0.06), (x, h), (x - w, h - 0.06)]
        vertices = np.array([(a, b, z) for a, b in outline])
        pickets.append(Mesh(vertices, np.array([(0, 1, 2), (0, 2, 4), (2, 3, 4)])))
    rails = [box((LOW[0], y, FENCE_Z - 0.045), (HIGH[0], y + 0.07, FENCE_Z - 0.015)) for y in (0.24, 0.64)]
    posts = [box((x - 0.05, 0, FENCE_Z - 0.12), (x + 0.05, 1.08, FENCE_Z - 0.02)) for x in (gate - 0.5, gate + 0.5)]
    white = plain("f4f2ea", 0.03)
    return [
        Surface("pickets", join(*pickets), white, 0.022, grain=(0, 1, 0), stretch=2.2, translucency=0.0),
        Surface("fence rails", join(*rails, *posts), white, 0.026, grain=(1, 0, 0), stretch=2.2),
    ]


def bench() -> list[Surface]:
    """Wooden bench that looks at the lawn."""
    half, parts = BENCH_WIDTH / 2, []
    for k in range(4):
        parts.append(beveled_box((BENCH_WIDTH, 0.026, 0.092), 0.005).moved(translation=(0, SEAT, -0.16 + 0.105 * k)))
    lean = rotation_about("x", -12)
    for k in range(3):
        slat = beveled_box((BENCH_WIDTH, 0.092, 0.024), 0.005)
        parts.append(slat.moved(lean, (0, SEAT + 0.14 + 0.115 * k, -0.245 - 0.024 * k)))
    frame = []
    for s in (-1, 1):
        x = s * (half - 0.10)
        frame += [
            box((x - 0.025, 0, 0.12), (x + 0.025, SEAT + 0.20, 0.17)),
            box((x - 0.025, 0, -0.26), (x + 0.025, SEAT, -0.21)),
        ]
        frame.append(box((x - 0.02, SEAT - 0.07, -0.21), (x + 0.02, SEAT - 0.013, 0.12)))
        frame.append(beveled_box((0.065, 0.028, 0.46), 0.006).moved(translation=(x, SEAT + 0.214, -0.03)))
        post = box((-0.025, 0, -0.02), (0.025, 0.46, 0.02)).moved(lean, (x, SEAT - 0.02, -0.232))
        frame.append(post)
    turn, at = rotation_about("y", BENCH_TURN), (BENCH_AT[0], 0.0, BENCH_AT[1])
    slats = Surface("bench", join(*parts), wood(HONEY, axis=0, across=2, seed=701), 0.012, (1, 0, 0), 2.0)
    return [p.placed(turn, at) for p in (slats, Surface("bench frame", join(*frame), plain("5b4634", 0.06), 0.016))]


def pots() -> list[Surface]:
    """Terracotta pots with lavender, by the hedge."""
    rng, surfaces, stems = np.random.default_rng(711), [], []
    for (x, z), r in POTS:
        curve = smooth_curve(
            [(0.0, 0.0), (0.70 * r, 0.0), (0.95 * r, 1.3 * r), (1.05 * r, 1.32 * r), (1.05 * r, 1.6 * r)], 24
        )
        inside = [(0.93 * r, 1.6 * r), (0.90 * r, 1.4 * r), (0.0, 1.42 * r)]
        pot = lathe(np.concatenate([curve, inside]), 40)
        surfaces.append(Surface("pot", pot, plain("bf6d43", 0.10, 0.05), 0.016).placed(position=(x, 0.0, z)))
        n = 260
        a, s = rng.uniform(0, 2 * np.pi, n), np.sqrt(rng.random(n))
        lean = 0.5 * s[:, None] * np.stack([np.cos(a), 0 * a, np.sin(a)], 1) + (0, 1, 0)
        reach = r * (0.8 + 1.3 * rng.random((n, 1)))
        stems.append((np.array([x, 1.4 * r, z]) + r * 0.7 * s[:, None] * (lean * (1, 0, 1)) + reach * lean, lean))
    p, d = (np.concatenate(part) for part in zip(*stems, strict=True))
    turn = np.cross(d, rng.normal(size=d.shape))
    turn /= np.linalg.norm(turn, axis=1, keepdims=True)
    mesh = leaf_mesh(p, 0.085 * d, 0.026 * turn)

    def lavender(p, n):
        high = p[:, 1] > 0.30
        return np.where(high[:, None], srgb("8f78c2"), srgb("7f9a68"))

    return [*surfaces, Surface("lavender", mesh, lavender, 0.05, translucency=0.35, leaves=True)]


def bird_house() -> list[Surface]:
    """Red bird house on the trunk of the tree."""
    x, z = TREE_AT[0] + 0.02, TREE_AT[1] + 0.19
    body = box((x - 0.075, 0.98, z - 0.06), (x + 0.075, 1.18, z + 0.06))
    roof = [
        quad((x - 0.12, 1.15, z + 0.09), (0.12, 0.11, 0), (0, 0, -0.18)),
        quad((x, 1.26, z + 0.09), (0.12, -0.11, 0), (0, 0, -0.18)),
    ]
    gable = Mesh(
        np.array([(x - 0.075, 1.18, z + 0.06), (x + 0.075, 1.18, z + 0.06), (x, 1.245, z + 0.06)]),
        np.array([(0, 1, 2)]),
    )

    def front(p, n):
        hole = (np.hypot(p[:, 0] - x, p[:, 1] - 1.11) < 0.024) & (n[:, 2] > 0.5)
        return np.where(hole[:, None], srgb("1d1410"), srgb("b8402f"))

    return [
        Surface("bird house", join(body, gable), front, 0.010),
        Surface("bird house roof", join(*roof), plain("efe6d2", 0.04), 0.014, translucency=0.0),
    ]


def solids() -> list[Solid]:
    """Bench and pots, for collisions."""
    turn, at = rotation_about("y", BENCH_TURN), (BENCH_AT[0], 0.0, BENCH_AT[1])
    half = BENCH_WIDTH / 2
    parts = [placed(cuboid((-half, SEAT - 0.07, -0.22), (half, SEAT + 0.013, 0.20)), turn, at)]
    parts.append(placed(cuboid((-half, SEAT, -0.32), (half, SEAT + 0.44, -0.22)), turn, at))
    for s in (-1, 1):
        x = s * (half - 0.10)
        parts.append(placed(cuboid((x - 0.03, -0.05, -0.26), (x + 0.03, SEAT + 0.22, 0.17)), turn, at))
    for (x, z), r in POTS:
        profile = [(0.70 * r, -0.05), (1.05 * r, 1.32 * r), (1.05 * r, 1.6 * r), (0.0, 1.6 * r)]
        parts.append(placed(revolved(profile), position=(x, 0.0, z)))
    return parts
