"""The shell of the hall: papered walls with gilt panelling, and the double door behind the seats."""

from __future__ import annotations

import numpy as np

from studio.doors import casing, panelled_leaf
from studio.shapes import Mesh, Surface, box, join
from studio.textures import WALNUT, fbm, mix, plain, smoothstep, srgb, wood
from studio.walls import wall_sheet, within

HALL_LOW, HALL_HIGH = (-2.9, 0.0, 0.30), (2.9, 3.7, 5.2)  # [m] the far wall is the stage's
(X0, Y0, Z0), (X1, Y1, Z1) = HALL_LOW, HALL_HIGH
DADO_HEIGHT, RAIL = 0.95, 0.06  # [m] height of the panelling, and of the rail above it
DOOR, CASING = (-0.88, 0.88, 0.0, 2.18), 0.09  # [m] x from, to, y from, to in the far wall; the boards around it
OUTSIDE = (-9.0, -9.0, -9.0)  # [m] below all there is
GILT = "b8892f"
PANELLING = tuple(1.5 * np.array(tone) for tone in WALNUT)


def wallpaper(seed: int):
    """Colour of wallpaper with a woven ornament in two reds."""
    low, high = srgb("6e1d24"), srgb("8f3030")

    def colour_at(p, n):
        along = np.where(np.abs(n[:, 0]) > 0.5, p[:, 2], p[:, 0])
        u, v = along / 0.42, p[:, 1] / 0.56
        column = np.floor(u)
        v = v + 0.5 * (column % 2)
        u, v = u - column - 0.5, v - np.floor(v) - 0.5
        r = np.hypot(1.5 * u, v)
        leaf = np.cos(6 * np.arctan2(1.5 * u, v + 0.12)) * smoothstep(0.45, 0.12, r)
        c = mix(low, high, smoothstep(0.05, 0.30, leaf) * (r < 0.45))
        return c * (1 + 0.04 * fbm(p * 3, 2, seed))[:, None]

    return colour_at


def papered(name: str, span, doorways, to_room, seed: int, spacing: float) -> list[Surface]:
    """A wall of walnut panelling, and wallpaper above it, without its `doorways` (along from, to, up from, to)."""
    lower = wall_sheet(span, (0.0, DADO_HEIGHT), doorways, to_room)
    upper = wall_sheet(span, (DADO_HEIGHT + RAIL, Y1), doorways, to_room)
    timber = wood(PANELLING, axis=1, across=0 if "back" in name else 2, seed=seed, ring=0.03)
    return [
        Surface(f"{name} panelling", lower, timber, 0.026, grain=(0, 1, 0), stretch=2.0, width=1.1),
        Surface(f"{name} paper", upper, wallpaper(seed), spacing, width=1.1),
    ]


def walls() -> list[Surface]:
    """Side walls and the wall behind the seats with its door, and what is fixed to them."""
    x0, x1, y0, y1 = DOOR
    doorway = (x0 - CASING, x1 + CASING, y0, y1 + CASING)
    cornice = join(
        box((X0, Y1 - 0.14, Z0), (X0 + 0.12, Y1, Z1)),
        box((X1 - 0.12, Y1 - 0.14, Z0), (X1, Y1, Z1)),
        box((X0, Y1 - 0.14, Z1 - 0.12), (X1, Y1, Z1)),
    )
    return [
        *papered("left wall", (Z1, Z0), [], lambda u, v: (X0, v, u), 311, 0.020),
        *papered("right wall", (Z0, Z1), [], lambda u, v: (X1, v, u), 312, 0.020),
        *papered("back wall", (X1, X0), [doorway], lambda u, v: (u, v, Z1), 313, 0.015),
        Surface("dado", dado(doorway), plain(GILT, 0.06), 0.026, gloss=0.15, roughness=0.3),
        Surface("cornice", cornice, plain("d9c79a", 0.03), 0.045),
        *door(),
    ]


def dado(doorway) -> Mesh:
    """The gilt rail along the three walls, and frames on the panelling below it."""
    runs, frames, depth = [], [], 0.03
    left, right, *_ = doorway
    lows, highs = (X0, DADO_HEIGHT, Z0), (X1, DADO_HEIGHT + RAIL, Z1)
    for x in ((X0, X0 + depth), (X1 - depth, X1)):
        runs.append(box((x[0], lows[1], Z0), (x[1], highs[1], Z1)))
    for x in ((X0, left), (right, X1)):
        runs.append(box((x[0], lows[1], Z1 - depth), (x[1], highs[1], Z1)))
    thick = 0.012

    def framed(start, end, to_box):
        count = round((end - start) / 0.8)
        for k in range(count):
            a, b = (start + (end - start) * (k + e) / count + i for e, i in ((0, 0.08), (1, -0.08)))
            frames.extend(to_box(*bar) for bar in bars((a, b, 0.20, 0.82), 0.022))

    framed(Z0 + 0.2, Z1, lambda a, b, c, d: box((X0, c, a), (X0 + thick, d, b)))
    framed(Z0 + 0.2, Z1, lambda a, b, c, d: box((X1 - thick, c, a), (X1, d, b)))
    for start, end in ((X0, left), (right, X1)):
        framed(start, end, lambda a, b, c, d: box((a, c, Z1 - thick), (b, d, Z1)))
    return within(join(*runs, *frames), HALL_LOW, HALL_HIGH)


def bars(outline, width: float) -> list[tuple[float, float, float, float]]:
    """The four bars of a frame within a rectangle, each as (along from, to, up from, to) [m]."""
    a, b, c, d = outline
    inner = c + width, d - width
    return [(a, b, c, c + width), (a, b, d - width, d), (a, a + width, *inner), (b - width, b, *inner)]


def door() -> list[Surface]:
    """The double door behind the seats, with gilt casing and brass handles."""
    _, x1, y0, y1 = DOOR
    face, back, meshes, frames, handles = Z1 - 0.02, Z1 - 0.006, [], [], []
    for side in (-1, 1):
        a, b = sorted((0.0, side * x1))
        panels = [(a + 0.13, b - 0.13, c, d) for c, d in ((0.20, 0.95), (1.12, 2.02))]
        meshes += panelled_leaf((a, b, y0, y1), panels, face, back - face)
        sides = [bar for panel in panels for bar in bars(panel, 0.02)]
        frames += [box((c, e, face - 0.004), (d, f, back)) for c, d, e, f in sides]
        handles.append(box((side * 0.075 - 0.012, 0.92, face - 0.045), (side * 0.075 + 0.012, 1.22, face - 0.025)))
    strip = within(box((-0.018, y0, face - 0.012), (0.018, y1, face)), OUTSIDE, (9, 9, face))  # covers the joint
    return [
        Surface("door", join(*meshes, strip), wood(PANELLING, axis=1, across=0, seed=317, ring=0.03), 0.016,
                grain=(0, 1, 0), stretch=2.0, gloss=0.03),
        Surface("door casing", within(join(*casing(DOOR, CASING, Z1 - 0.05, Z1)), HALL_LOW, HALL_HIGH),
                plain(GILT, 0.05), 0.018, gloss=0.15, roughness=0.3),
        Surface("door frames", within(join(*frames), OUTSIDE, (9, 9, back)), plain(GILT, 0.05), 0.016, gloss=0.15,
                roughness=0.3),
        Surface("door handles", join(*handles), plain("c09a4a", 0.03), 0.012, gloss=0.3, roughness=0.25),
    ]  # fmt: skip
