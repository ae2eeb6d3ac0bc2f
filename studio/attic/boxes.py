"""Boxes that are moved in the attic: of cardboard, a parcel, a crate, a biscuit tin; and their pallet."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from assets.asset import Asset
from core.material import Material
from core.mesh_sampling import Mesh, face_normals
from studio.attic.attic_shell import PINE, old_boards
from studio.detail import Detail
from studio.finish import to_gaussians
from studio.glyphs import glyph, sampled
from studio.handled import box_cage, handled, shaded
from studio.shapes import Surface, beveled_box, box, join, tube
from studio.surface_sampling import sample_surfaces
from studio.textures import BEECH, fbm, mix, noise, smoothstep, srgb, wood

SIZES = {  # [m]; scenes/box_moving.py repeats them
    "box_cardboard": (0.46, 0.36, 0.38),
    "box_parcel": (0.30, 0.17, 0.22),
    "box_crate": (0.40, 0.30, 0.30),
    "box_tin": (0.22, 0.12, 0.22),
}
MATERIALS = {  # of what they are as a whole, full of this and that; the crate and the tin are rigid
    "box_cardboard": Material(young=5e4, poisson=0.2, density=45.0, friction=0.6, damping=20.0),
    "box_parcel": Material(young=4e4, poisson=0.2, density=140.0, friction=0.6, damping=20.0),
    "box_crate": Material.named("wood", density=90.0),
    "box_tin": Material.named("wood", density=180.0, friction=0.4, kinetic_friction=0.3),
}
CAGE_VERTICES = {"box_cardboard": 120, "box_parcel": 80, "box_crate": 8, "box_tin": 8}
PALLET_AT, PALLET_SIZE = (0.90, 0.0, 0.02), (1.04, 0.12, 0.78)  # [m] scenes/box_moving.py repeats them
KRAFT, TAPE, INK = "b98a58", "cfae78", "4a2f1c"


def moving_box(name: str, rng: np.random.Generator, detail: Detail, report) -> Asset:
    """The asset of this name, its origin at its centre. Taichi must be running."""
    surfaces = {"box_cardboard": cardboard, "box_parcel": parcel, "box_crate": crate, "box_tin": tin}[name]()
    cage = box_cage(SIZES[name], detail.cage_vertices(CAGE_VERTICES[name]))
    gleam = 0.14 if name == "box_tin" else 0.015
    return handled(name, surfaces, cage, MATERIALS[name], rng, detail, gleam=gleam)


def face_coordinates(p: np.ndarray, n: np.ndarray, size) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The axis (N,) of each point's face, and its place to the right and up on the face [m], (N,) each."""
    axis = np.abs(n).argmax(1)
    sign = np.where(n[np.arange(len(n)), axis] < 0, -1.0, 1.0)
    right = np.choose(axis, [-sign * p[:, 2], p[:, 0], sign * p[:, 0]])
    up = np.choose(axis, [p[:, 1], -sign * p[:, 2], p[:, 1]])
    return axis, right, up


def text_at(text: str, right, up, at, height: float, step: float) -> np.ndarray:
    """Ink (N,) of a text whose middle stands at `at` [m] on a face, its letters `height` high and `step` apart [m]."""
    ink = np.zeros(len(right))
    for k, letter in enumerate(text):
        centre = at[0] + (k - 0.5 * (len(text) - 1)) * step
        ink = np.maximum(
            ink, sampled(glyph(letter), 0.82 * (right - centre) / (0.5 * step), (up - at[1]) / (0.5 * height))
        )
    return ink


def cardboard() -> list[Surface]:
    """Large corrugated box: taped flaps, stencilled words, arrows that show which way is up, scuffed edges."""
    size = np.array(SIZES["box_cardboard"])

    def colour_at(p, n):
        axis, right, up = face_coordinates(p, n, size)
        flutes = 0.035 * np.sin(2 * np.pi * np.where(axis == 1, p[:, 2], right) / 0.009)
        c = srgb(KRAFT) * (1 + flutes + 0.07 * fbm(p * 6, 3, 1))[:, None]
        seam = (axis == 1) & (np.abs(p[:, 2]) < 0.0025)
        c = np.where(seam[:, None], c * 0.35, c)
        tape = (np.abs(p[:, 2]) < 0.03) & ((axis == 1) | (axis == 0) & (np.abs(p[:, 1]) > 0.5 * size[1] - 0.07))
        shine = 1 + 0.08 * noise(p * (60, 60, 12), 5)
        c = np.where(tape[:, None], srgb(TAPE) * shine[:, None], c)
        front = axis == 2
        ink = text_at("FRAGILE", right, up, (0.0, -0.070), 0.098, 0.059) * front
        for x in (-0.15, -0.10):
            stem = (np.abs(right - x) < 0.007) & (up > 0.045) & (up < 0.10)
            head = (np.abs(right - x) < 0.9 * (0.128 - up)) & (up > 0.098) & (up < 0.128)
            base = (np.abs(right + 0.125) < 0.05) & (np.abs(up - 0.034) < 0.004)
            ink = np.maximum(ink, (stem | head | base) * front)
        ink = np.maximum(ink, text_at("ATTIC", right, up, (0.083, 0.080), 0.090, 0.052) * front)
        ink = np.maximum(ink, text_at("BOOKS", right, up, (0.0, 0.0), 0.105, 0.060) * (axis == 0))
        worn = smoothstep(-0.9, -0.6, fbm(p * 40, 3, 7))
        c = mix(c, srgb(INK), 0.85 * ink * worn)
        return scuffed(c, p, size, "d8bd92")

    mesh = beveled_box(size, 0.004)
    up = np.abs(face_normals(mesh)[:, 1]) > 0.9
    flaps, sides = (Mesh(mesh.vertices, mesh.faces[which]) for which in (up, ~up))
    return [
        Surface("cardboard sides", sides, colour_at, 0.0056, uniform=True),  # fine enough for letters
        Surface("cardboard flaps", flaps, colour_at, 0.0096, uniform=True),
    ]


def scuffed(c: np.ndarray, p: np.ndarray, size, bare: str, width: float = 0.009) -> np.ndarray:
    """Colours with edges and corners worn down to the colour `bare`."""
    to_edge = np.sort(0.5 * np.asarray(size) - np.abs(p), axis=1)[:, 1]
    return mix(c, srgb(bare), 0.7 * smoothstep(width, 0.3 * width, to_edge + 0.6 * width * fbm(p * 45, 3, 9)))


def parcel() -> list[Surface]:
    """Parcel in brown paper, tied with string, with stamps, a label and a postmark."""
    w, h, d = SIZES["box_parcel"]

    def colour_at(p, n):
        axis, right, up = face_coordinates(p, n, (w, h, d))
        crease = smoothstep(0.03, 0.0, np.abs(fbm(p * 11, 3, 11)))
        c = srgb("a9794a") * (1 + 0.10 * fbm(p * 9, 3, 12) - 0.10 * crease)[:, None]
        top = (axis == 1) & (p[:, 1] > 0)
        label = top & (np.abs(right + 0.055) < 0.062) & (np.abs(up) < 0.045)
        c = np.where(label[:, None], srgb("ece2c8"), c)
        line = (np.abs((up / 0.018) % 1 - 0.5) < 0.16) & (
            noise(np.stack([right * 120, np.floor(up / 0.018), 0 * up], 1), 13) > -0.25
        )
        c = np.where(
            (label & line & (np.abs(right + 0.055) < 0.050) & (np.abs(up) < 0.034))[:, None], srgb("3a3a48"), c
        )
        for x, tint in ((0.075, "a8332c"), (0.112, "2f6a4a")):
            stamp = top & (np.abs(right - x) < 0.016) & (np.abs(up - 0.062) < 0.020)
            inside = stamp & (np.abs(right - x) < 0.0125) & (np.abs(up - 0.062) < 0.0165)
            c = np.where(stamp[:, None], srgb("efe8d6"), c)
            c = np.where(inside[:, None], srgb(tint), c)
        mark = np.hypot(right - 0.072, up - 0.048)
        ring = top & ((np.abs(mark - 0.024) < 0.0016) | (np.abs(mark - 0.016) < 0.0012))
        return np.where(ring[:, None], c * 0.35, c)

    a, b, r = w / 2 - 0.002, h / 2 - 0.002, 0.0026
    z = d / 2 - 0.002
    strings = []
    for offset in (-0.062, 0.050):
        loop = [(offset, -b, -z), (offset, b, -z), (offset, b, z), (offset, -b, z), (offset, -b, -z)]
        strings += [tube([p, q], r, 8, up=(1, 0, 0)) for p, q in pairwise(loop)]
    loop = [(-a, -b, 0.02), (a, -b, 0.02), (a, b, 0.02), (-a, b, 0.02), (-a, -b, 0.02)]
    strings += [tube([p, q], r, 8, up=(0, 0, 1)) for p, q in pairwise(loop)]

    def twine(p, n):
        return srgb("d9c79a") * (1 + 0.25 * np.sin(p.sum(1) * 1500))[:, None]

    # The paper lies a string's thickness inside of the box that one touches.
    return [
        Surface("paper", beveled_box((w - 0.005, h - 0.005, d - 0.005), 0.005), colour_at, 0.0068, uniform=True),
        Surface("string", join(*strings), twine, 0.0075, uniform=True),
    ]


def crate() -> list[Surface]:
    """Wooden crate of slats on corner posts, with a stencil on the front."""
    w, h, d = SIZES["box_crate"]
    t, slat = 0.011, 0.085
    slats_x, slats_z = [], []
    for y in np.linspace(-h / 2 + slat / 2, h / 2 - slat / 2, 3):
        for s in (-1, 1):
            slats_x.append(
                box(
                    (-w / 2, y - slat / 2, s * (d / 2 - t / 2) - t / 2),
                    (w / 2, y + slat / 2, s * (d / 2 - t / 2) + t / 2),
                )
            )
            slats_z.append(
                box(
                    (s * (w / 2 - t / 2) - t / 2, y - slat / 2, -d / 2 + t),
                    (s * (w / 2 - t / 2) + t / 2, y + slat / 2, d / 2 - t),
                )
            )
    for x in np.linspace(-w / 2 + 0.05, w / 2 - 0.05, 4):
        slats_z += [
            box(
                (x - 0.045, s * (h / 2 - t / 2) - t / 2, -d / 2 + t),
                (x + 0.045, s * (h / 2 - t / 2) + t / 2, d / 2 - t),
            )
            for s in (-1, 1)
        ]
    inside = box((-w / 2 + 0.02, -h / 2 + 0.02, -d / 2 + 0.02), (w / 2 - 0.02, h / 2 - 0.02, d / 2 - 0.02))
    tones = ((0.46, 0.30, 0.155), (0.30, 0.18, 0.085))
    along = wood(tones, axis=0, board=0.11, across=1, seed=21)

    def stencilled(p, n):
        ink = text_at("TOYS", p[:, 0] * np.sign(n[:, 2]), p[:, 1], (0.0, 0.0), 0.120, 0.085) * (np.abs(n[:, 2]) > 0.7)
        c = along(p, n)
        nail = (np.abs(np.abs(p[:, 0]) - (w / 2 - 0.016)) < 0.0035) & (np.abs((p[:, 1] / 0.05) % 1 - 0.5) < 0.07)
        c = np.where(nail[:, None], srgb("3a3632"), c)
        return mix(c, srgb("2b2622"), 0.85 * ink * smoothstep(-0.9, -0.6, fbm(p * 60, 3, 23)))

    return [
        Surface("crate front", join(*slats_x), stencilled, 0.0062, grain=(1, 0, 0), stretch=1.2, uniform=True),
        Surface(
            "crate sides",
            join(*slats_z),
            wood(tones, axis=2, across=1, seed=25),
            0.0105,
            grain=(0, 0, 1),
            stretch=2.0,
            uniform=True,
        ),
        Surface("crate inside", inside, wood(BEECH, axis=0, across=1, seed=27), 0.035, uniform=True),
    ]


def tin() -> list[Surface]:
    """Blue biscuit tin with a snowflake on the lid and a gold rim."""
    w, h, d = SIZES["box_tin"]

    def colour_at(p, n):
        axis, right, up = face_coordinates(p, n, (w, h, d))
        c = srgb("24477a") * (1 + 0.05 * fbm(p * 20, 2, 31))[:, None]
        r, a = np.hypot(right, up), np.arctan2(up, right)
        fold = np.abs((a / (np.pi / 3)) % 1 - 0.5) * 2
        arms = (r < 0.075) & (np.abs(np.sin(3 * a)) * r < 0.0045)
        twigs = (np.abs(r - 0.045 - 0.022 * (1 - fold)) < 0.0035) & (fold < 0.72)
        top = axis == 1
        c = np.where((top & (arms | twigs))[:, None], srgb("e9ecf0"), c)
        c = np.where((top & (np.abs(r - 0.088) < 0.0022))[:, None], srgb("d2a94a"), c)
        lid = (axis != 1) & (np.abs(p[:, 1] - 0.028) < 0.003)
        c = np.where(lid[:, None], srgb("d2a94a"), c)
        dots = (axis != 1) & (np.hypot((right / 0.044) % 1 - 0.5, (p[:, 1] + 0.018) / 0.044) < 0.17)
        c = np.where(dots[:, None], srgb("e9ecf0"), c)
        return scuffed(c, p, (w, h, d), "b9bcc0", 0.006)

    return [Surface("tin", beveled_box((w, h, d), 0.006), colour_at, 0.0056, uniform=True)]


def pallet(rng: np.random.Generator, detail: Detail, report) -> Asset:
    """The asset `pallet`, which stays where it is; its origin is at the middle of its foot."""
    surfels = sample_surfaces(pallet_surfaces(), rng, detail)
    g = to_gaussians(surfels, shaded(surfels, pallet_surfaces(), rng, 0.01, 0), np.ones(len(surfels)))
    return Asset(g, provenance={"made_by": "vrgs build", "name": "pallet"})


def pallet_surfaces() -> list[Surface]:
    """Pallet with a chalk cross: here the boxes go."""
    w, h, d = PALLET_SIZE
    step = d / 6
    rows = -d / 2 + step * np.arange(6)
    top = [box((-w / 2, h - 0.02, z + 0.008), (w / 2, h, z + step - 0.008)) for z in rows]
    blocks = [box((a - 0.05, 0.0, -d / 2), (a + 0.05, h - 0.02, d / 2)) for a in (-w / 2 + 0.05, 0.0, w / 2 - 0.05)]
    grain = old_boards(PINE, 0, 2, step, 71)

    def chalked(p, n):
        u, v = p[:, 0] / 0.30, p[:, 2] / 0.22
        cross = (np.minimum(np.abs(u - v), np.abs(u + v)) < 0.10) & (np.abs(u) < 1)
        frame = np.abs(np.maximum(np.abs(p[:, 0]) / (w / 2), np.abs(p[:, 2]) / (d / 2)) - 0.90) < 0.022
        worn = smoothstep(-0.4, 0.0, fbm(p * 40, 3, 73))
        return mix(0.7 * grain(p, n), srgb("e8e6de"), 0.75 * ((cross | frame) & (n[:, 1] > 0.7)) * worn)

    return [
        Surface("pallet", join(*top), chalked, 0.0105, grain=(1, 0, 0), stretch=2.0, uniform=True),
        Surface("pallet blocks", join(*blocks), old_boards(PINE, 2, 0, 4.0, 75), 0.016, uniform=True),
    ]
