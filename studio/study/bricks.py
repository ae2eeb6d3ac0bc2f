"""Wooden toy bricks: planks of bare and painted wood, and cubes with a letter on each face."""

from __future__ import annotations

import numpy as np

from assets.asset import Asset
from core.material import Material
from studio.detail import Detail
from studio.glyphs import glyph, sampled
from studio.handled import box_cage, handled
from studio.shapes import Colour, Surface, beveled_box
from studio.textures import WALNUT, fbm, mix, noise, plain, smoothstep, srgb, wood

PLANK = (0.15, 0.032, 0.049)  # [m]; three side by side, a millimetre apart, are as wide as one is long
CUBE = (0.049, 0.049, 0.049)  # [m]
BEVEL = 0.0026  # [m]
MAPLE = ((0.70, 0.43, 0.19), (0.50, 0.27, 0.10))  # light and dark tones, linear RGB
MATERIAL = Material.named("wood", friction=0.55, kinetic_friction=0.35)
PAINTS = {"brick_red": "c2332a", "brick_blue": "2b6cb0", "brick_yellow": "e9b02c", "brick_green": "4b8b3b"}
LETTERS = {"brick_letters": ("VRGSVR", ("b8322a", "2a67a8", "3f7f38"))}
PAPER_TONE = "efe3c8"  # of the painted ground of a letter


def brick(name: str, rng: np.random.Generator, detail: Detail, report) -> Asset:
    """The asset of this name: `brick_maple`, `brick_walnut`, one of PAINTS or LETTERS. Taichi must be running."""
    size = CUBE if name in LETTERS else PLANK
    spacing = 0.0024 if name in LETTERS else 0.0030
    if name in LETTERS:
        colour = lettered(*LETTERS[name])
        grain = {}
    else:
        tones = WALNUT if name == "brick_walnut" else MAPLE
        colour = plank_colour(wood(tones, axis=0, across=2, seed=grain_seed(name), ring=0.006), PAINTS.get(name))
        grain = {"grain": (1, 0, 0), "stretch": 3.0}
    surface = Surface(name, beveled_box(size, BEVEL), colour, spacing, uniform=True, **grain)
    return handled(name, [surface], box_cage(size, detail.cage_vertices(8)), MATERIAL, rng, detail, gleam=0.025)


def grain_seed(name: str) -> int:
    """Seed of a brick's grain."""
    return sum(map(ord, name))


def plank_colour(timber: Colour, paint: str | None) -> Colour:
    """Wood, or paint that lets the grain shine through and is worn off at the edges."""
    half = 0.5 * np.array(PLANK)

    def colour_at(p, n):
        bare = timber(p, n)
        end = np.abs(n[:, 0]) > 0.7
        rings = 0.5 + 0.5 * np.sin(900 * np.hypot(p[:, 1] + 0.05, p[:, 2] + 0.01) + 3 * fbm(p * 60, 2, 3))
        bare = np.where(end[:, None], bare * (0.72 + 0.18 * rings)[:, None], bare)
        to_edge = np.sort(half - np.abs(p), axis=1)[:, 1]  # the smallest is the face itself
        seam = (1 - 0.55 * smoothstep(0.0030, 0.0008, to_edge))[:, None]  # little light gets between two bricks
        if paint is None:
            return bare * seam
        worn = smoothstep(0.0050, 0.0020, to_edge + 0.002 * fbm(p * 120, 3, 5))
        coat = srgb(paint) * (1 + 0.10 * noise(p * (12, 160, 160), 6) + 0.05 * fbm(p * 30, 2, 7))[:, None]
        return mix(coat, bare, 0.8 * worn) * seam

    return colour_at


def lettered(letters: str, colours: tuple[str, ...]) -> Colour:
    """A letter in a coloured frame on each of the six faces of a cube: x, -x, y, -y, z, -z."""
    pictures = [glyph(c) for c in letters]
    ground = plain(PAPER_TONE, 0.05, 0.02, 4)
    bare = wood(MAPLE, axis=1, across=2, seed=17, ring=0.006)
    half = 0.5 * CUBE[0]

    def colour_at(p, n):
        c = ground(p, n)
        axis = np.abs(n).argmax(1)
        for k in range(6):
            face = (axis == k // 2) & ((n[np.arange(len(n)), axis] < 0) == (k % 2 == 1))
            sign = -1.0 if k % 2 else 1.0
            # right and up on the face as one looks at it
            right, up = {0: ((0, 0, -sign), (0, 1, 0)), 1: ((1, 0, 0), (0, 0, -sign)), 2: ((sign, 0, 0), (0, 1, 0))}[
                k // 2
            ]
            u, v = p[face] @ np.array(right) / half, p[face] @ np.array(up) / half
            tint = srgb(colours[k // 2])
            ink = sampled(pictures[k], u / 0.62, v / 0.62)
            edge = np.maximum(np.abs(u), np.abs(v))
            frame = smoothstep(0.70, 0.73, edge) * smoothstep(0.88, 0.85, edge)
            wear = smoothstep(-0.62, -0.30, fbm(p[face] * 90, 3, 40 + k))
            c[face] = mix(c[face], tint, np.maximum(ink, frame) * wear * 0.95)
            c[face] = mix(c[face], bare(p[face], n[face]), 0.9 * smoothstep(0.90, 0.94, edge))
        return c

    return colour_at
