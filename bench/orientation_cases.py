"""Objects and scenes of known up axis: procedural ones in endless variety, and cuts of the shipped assets.

What a capture does to them is varied as widely as their kinds: a floor's remnant under the object, or its underside
missing; one side unseen; light from above or from a side; larger and more opaque Gaussians where few photographs
looked, or none of that; floaters; a frame that leans.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from assets.asset import Asset
from assets.gaussians import Gaussians, concatenate
from assets.level_planes import AXES
from assets.library import SHIPPED_FOLDER
from assets.up_axis import rotation_to_up
from bench.random_solids import KINDS, Solid, about, sampled, solid, turned
from bench.synthetic_room import turns_to
from core.spherical_harmonics import C0

COUNT = 2500, 6000  # Gaussians of a case, least and most
ROOMS = ("attic", "childrens_room", "dining_room", "garden", "stage", "study")  # of the shipped assets
NO_UP = ("ball", "rubber_ball", "ring_red", "ring_blue", "ring_yellow")  # of the shipped bodies: as good either way up
# Shipped bodies that have a front, in their files towards +z.
FRONTED = ("bear", "dancer", "fox", "horse", "jelly_bear", "rabbit", "sheep", "toy_cat", "toy_dinosaur", "toy_duck")
FRONTED += ("toy_elephant", "toy_frog", "toy_ladybird", "toy_octopus", "toy_penguin", "toy_rabbit", "toy_teddy")
FRONTED += ("toy_whale",)
NEAR_DUPLICATES = ("brick_", "box_")  # of these kinds of shipped bodies one each
SQUARE = 0.3  # of the files: their axes are those of the walls
LEAN = np.radians(8.0), np.radians(16.0)  # standard deviation of a frame's lean: most frames', and others'


@dataclass(frozen=True)
class OrientationCase:
    """Gaussians in the frame of a file whose axis `up` points up; `family` is what they show, of `kind` "body" or
    "scene"."""

    family: str
    gaussians: Gaussians
    up: str

    @property
    def kind(self) -> str:
        """The kind that the user names."""
        return "scene" if self.family in (*ROOMS, *SCENES) else "body"


def procedural_cases(count: int, seed: int) -> Iterator[OrientationCase]:
    """`count` cases: one in three is a scene."""
    for k in range(count):
        rng = np.random.default_rng([seed, k])
        if k % 3 == 0:
            family = list(SCENES)[k // 3 % len(SCENES)]
            yield in_file(rng, family, SCENES[family](rng))
        else:
            family = list(KINDS)[k % len(KINDS)]
            yield in_file(rng, family, captured(rng, standing(rng, family)))


def shipped_cases(count: int, seed: int) -> Iterator[OrientationCase]:
    """`count` cases of the shipped assets: parts of rooms, and bodies with what a capture does to them."""
    bodies = sorted(p.stem for p in SHIPPED_FOLDER.glob("*.h5") if p.stem not in (*ROOMS, *NO_UP))
    bodies = [b for b in bodies if not b.startswith(NEAR_DUPLICATES)] + ["brick_letters", "box_cardboard"]
    loaded: dict[str, Gaussians] = {}
    for k in range(count):
        rng = np.random.default_rng([seed, k, 1])
        name = str(rng.choice(ROOMS)) if k % 3 == 0 else str(rng.choice(bodies))
        if name not in loaded:
            loaded[name] = Asset.load(SHIPPED_FOLDER / f"{name}.h5").gaussians.with_sh_degree(0)
        g = part_of_room(rng, loaded[name]) if name in ROOMS else worn(rng, fewer(rng, loaded[name]))
        yield in_file(rng, name, g)


def front_cases(count: int, seed: int) -> Iterator[tuple[str, Gaussians, float]]:
    """`count` upright bodies with what a capture does to them: name, Gaussians, and the front's angle [rad] from +z."""
    for k in range(count):
        rng = np.random.default_rng([seed, k, 2])
        name, angle = FRONTED[k % len(FRONTED)], float(rng.uniform(0.0, 2.0 * np.pi))
        g = worn(rng, fewer(rng, Asset.load(SHIPPED_FOLDER / f"{name}.h5").gaussians.with_sh_degree(0)))
        yield name, g.transformed(about(1, angle)), angle


def in_file(rng, family: str, g: Gaussians) -> OrientationCase:
    """The Gaussians, +y up, in the frame of a file: any axis up, turned about the vertical and leaning a little, or, as
    an editor leaves them, square to the axes."""
    up = str(rng.choice(list(AXES)))
    if rng.random() < SQUARE:
        level = about(1, 0.5 * np.pi * rng.integers(4))
    else:
        lean = LEAN[0] if rng.random() < 0.6 else LEAN[1]
        level = about(0, rng.normal(0, lean)) @ about(2, rng.normal(0, lean)) @ about(1, rng.uniform(0, 2 * np.pi))
    return OrientationCase(family, g.transformed(rotation_to_up(up).T @ level, scale=float(rng.uniform(0.3, 3))), up)


def standing(rng, family: str) -> list[Solid]:
    """An object of a family: some on a pedestal, some on a remnant of the floor, some beside another object."""
    parts = KINDS[family](rng)
    if rng.random() < 0.15:
        high, wide = rng.uniform(0.1, 0.8), rng.uniform(0.4, 1.0)
        kind = str(rng.choice(["box", "tube"]))
        parts = turned(parts, np.eye(3), shift=[0, high, 0]) + [solid(kind, (wide, high, wide), (0, high / 2, 0), rng)]
    if rng.random() < 0.35:  # the floor that the object stood on
        wide, kind = rng.uniform(0.3, 2.0, 2), str(rng.choice(["box", "tube"]))
        parts.append(solid(kind, (wide[0], 0.02, wide[1]), (rng.normal(0, 0.2), -0.01, rng.normal(0, 0.2)), rng))
    if rng.random() < 0.1:
        parts += turned(KINDS[str(rng.choice(list(KINDS)))](rng), np.eye(3), rng.uniform(0.3, 0.7), [0.8, 0, 0])
    return parts


def captured(rng, parts: list[Solid]) -> Gaussians:
    """Gaussians on the surface of solids, with what a capture does to them."""
    points, normals, grey = sampled(rng, parts, int(rng.integers(*COUNT)))
    return worn(rng, discs(rng, points, normals, shaded(rng, points, normals, grey)))


def shaded(rng, points: np.ndarray, normals: np.ndarray, grey: np.ndarray) -> np.ndarray:
    """Greys (N,) under a light from mostly above, some shade near the floor, and a pattern."""
    light = rng.normal(0, 0.5, 3) + [0, 0.7, 0]
    lit = 0.5 + 0.5 * normals @ light / np.linalg.norm(light)
    height = (points[:, 1] - points[:, 1].min()) / max(np.ptp(points[:, 1]), 1e-9)
    pattern = 0.2 * rng.random() * np.sin(points @ rng.normal(0, 6, 3) + rng.uniform(0, 6))
    fall = rng.uniform(-0.3, 0.3) * height  # of colours that get lighter or darker upwards
    return (
        grey * (1 - rng.uniform(0, 0.7) * (1 - lit)) * (1 - rng.uniform(0, 0.4) * np.exp(-8 * height)) + pattern + fall
    )


def discs(rng, points: np.ndarray, normals: np.ndarray, grey: np.ndarray) -> Gaussians:
    """Flat Gaussians across noisy normals, as large as their spacing."""
    n = len(points)
    step = np.ptp(points, axis=0).max() * 1.3 / np.sqrt(n)
    scales = step * np.exp(rng.normal(-0.3, rng.uniform(0.2, 0.6), (n, 3)))
    scales[:, 2] *= rng.uniform(0.05, 0.5)
    quats = turns_to(normals + rng.normal(0, rng.uniform(0.02, 0.3), (n, 3)), rng.uniform(0, np.pi, n))
    logits = rng.normal(rng.uniform(0.5, 3), rng.uniform(0.5, 2), n)
    x = points + normals * rng.normal(0, 0.1 * step, (n, 1))
    return Gaussians.of(x, quats, np.log(scales), logits, np.repeat((grey - 0.5)[:, None, None] / C0, 3, 2))


def worn(rng, g: Gaussians) -> Gaussians:
    """Part that a capture leaves of an object that stands with +y up."""
    low, high = g.means.min(0).astype(float), g.means.max(0).astype(float)
    size, height = (high - low).max(), (g.means[:, 1] - low[1]) / max(high[1] - low[1], 1e-9)
    normals = axes_of_discs(g)
    under = (np.abs(normals[:, 1]) > 0.7) & (height < 0.25)
    seldom = np.zeros(len(g))  # 1: in hardly any photograph
    fate = rng.random()
    if fate < 0.6:  # it stood on its underside, of which little or nothing is left
        g_under = under & (rng.random(len(g)) < rng.uniform(0.5, 1.0))
        seldom[under] = 1.0
    else:
        g_under = np.zeros(len(g), bool)
    keep = ~g_under
    if rng.random() < 0.25:  # photographed from one side
        side = np.append(rng.normal(size=2), 0)[[0, 2, 1]]
        along = (g.means - (low + high) / 2) @ side / np.linalg.norm(side) / size
        keep &= along > rng.uniform(-0.4, 0.0)
        seldom = np.maximum(seldom, np.clip(0.3 - 2 * along, 0, 1))
    if rng.random() < 0.15:  # cut by a careless hand
        way = rng.normal(size=3)
        along = (g.means - (low + high) / 2) @ way / np.linalg.norm(way) / size
        keep &= along > np.quantile(along, rng.uniform(0, 0.25))
    if rng.random() < 0.2:  # seen from below, hung or held up
        seldom = np.maximum(seldom, rng.random() * (height > 0.8))
    grow, dark, firm = rng.normal(0.4, 0.4), rng.normal(0.1, 0.12), rng.normal(0.5, 1.0)
    log_scales = g.log_scales + (grow * seldom)[:, None]
    sh = g.sh.copy()
    sh[:, 0] -= (dark * seldom / C0)[:, None].astype(np.float32)
    whole = Gaussians.of(g.means, g.quats, log_scales, g.logit_opacities + firm * seldom, sh).select(keep)
    return concatenate(
        [whole, floaters(rng, int(len(whole) * rng.uniform(0, 0.05)), low - 0.1 * size, high + 0.1 * size)]
    )


def axes_of_discs(g: Gaussians) -> np.ndarray:
    """Shortest axis of each Gaussian, (N, 3)."""
    from assets.level_planes import normals_and_areas

    return normals_and_areas(g)[0]


def floaters(rng, count: int, low, high) -> Gaussians:
    """Blobs in mid-air."""
    size = float(np.max(np.asarray(high) - low))
    logits, colours = rng.normal(-2, 2, count), rng.normal(0, 0.6, (count, 1, 3))
    scales = np.log(size * rng.uniform(0.003, 0.03, (count, 3)))
    return Gaussians.of(rng.uniform(low, high, (count, 3)), rng.normal(size=(count, 4)), scales, logits, colours)


def fewer(rng, g: Gaussians) -> Gaussians:
    """A random part of many Gaussians."""
    n = int(rng.integers(*COUNT))
    return g if len(g) <= n else g.select(np.sort(rng.choice(len(g), n, replace=False)))


def part_of_room(rng, g: Gaussians) -> Gaussians:
    """Part of a room that a visitor photographed: a box of it around a place, floaters in it."""
    low, high = np.percentile(g.means, [2, 98], axis=0)
    size = (high - low) * rng.uniform(0.4, 1.1, 3)
    size[1] = high[1] - low[1] if rng.random() < 0.7 else size[1]
    corner = low + (high - low - size) * rng.random(3)
    corner[1] = low[1] - 0.05 if rng.random() < 0.8 else corner[1]
    inside = ((g.means > corner) & (g.means < corner + size)).all(1)
    if inside.sum() < 2000:
        inside[:] = True
    part = fewer(rng, g.select(inside))
    noise = 0.1 * np.exp(part.log_scales.mean(1, keepdims=True)) * rng.normal(size=(len(part), 3))
    part = Gaussians.of(part.means + noise, part.quats, part.log_scales + 0.4, part.logit_opacities, part.sh)
    return concatenate([part, floaters(rng, int(len(part) * rng.uniform(0, 0.08)), corner, corner + size)])


# Scenes


def room(rng) -> Gaussians:
    """One to four walls, a whole or partial floor, perhaps a ceiling, furniture and clutter."""
    w, h, d = rng.uniform(2.5, 7), rng.uniform(2.2, 3), rng.uniform(2.5, 6)
    cover = rng.uniform(0.4, 1.0)  # of the floor
    thin = 0.06
    parts = [solid("box", (w * cover, thin, d * cover), (0, -thin / 2, 0), rng)]
    if rng.random() < 0.4:
        parts.append(solid("box", (w, thin, d), (0, h, 0), rng))
    walls = [((w, h, thin), (0, h / 2, s * d / 2)) for s in (-1, 1)] + [((thin, h, d), (s * w / 2, h / 2, 0)) for s in (-1, 1)]  # fmt: skip  # noqa: E501
    for k in rng.permutation(4)[: rng.integers(1, 5)]:
        parts.append(solid("box", *walls[k], rng))
        for _ in range(int(rng.integers(0, 4))):  # pictures, shelves, windows
            size, at = (np.array(v) for v in walls[k])
            across = int(np.argmin(size))
            across_at = (
                at * [1, 0, 1] * 0.96 + [0, rng.uniform(0.8, h - 0.4), 0] + rng.uniform(-0.4, 0.4, 3) * [w, 0, d]
            )
            across_at[across] = 0.96 * at[across]
            parts.append(solid("box", np.where(np.arange(3) == across, rng.uniform(0.03, 0.3), rng.uniform(0.1, 1, 3)), across_at, rng))  # fmt: skip  # noqa: E501
    parts += clutter(rng, int(rng.integers(2, 14)), 0.42 * w, 0.42 * d, 0.5, 1.3)
    return scene_of(rng, parts)


def interior(rng) -> Gaussians:
    """A furnished room: most things stand along the walls, some on tables or shelves; rugs, lamps, pictures."""
    w, h, d, thin = rng.uniform(2.5, 7), rng.uniform(2.2, 3.2), rng.uniform(2.5, 6), 0.06
    parts = [solid("box", (w, thin, d), (0, -thin / 2, 0), rng)]
    ceiling = rng.random() < 0.5
    if ceiling:
        parts.append(solid("box", (w, thin, d), (0, h, 0), rng))
    shown = rng.permutation(4)[: rng.integers(1, 5)]
    for k in shown:
        way, wide, deep = about(1, 0.5 * np.pi * k), *((w, d) if k % 2 == 0 else (d, w))
        parts += turned([solid("box", (wide, h, thin), (0, h / 2, -deep / 2), rng)], way)
        for _ in range(int(rng.integers(0, 6))):
            at = rng.uniform(-0.4, 0.4) * wide
            if rng.random() < 0.3:  # a picture or a window
                own = [solid("box", (*rng.uniform(0.3, 1.2, 2), 0.05), (at, rng.uniform(0.9, h - 0.5), 0.03), rng)]
            elif rng.random() < 0.3:  # a board with things on it
                high = rng.uniform(0.9, 1.8)
                own = [solid("box", (rng.uniform(0.5, 1.4), 0.04, 0.3), (at, high, 0.15), rng)]
                own += turned(clutter(rng, 2, 0.3, 0.02, 0.1, 0.3), np.eye(3), shift=[at, high + 0.02, 0.15])
            else:  # a cupboard, a bed, a sofa
                size = np.array([rng.uniform(0.4, 2.0), rng.uniform(0.3, 2.1), rng.uniform(0.3, 0.9)])
                own = [solid("box", size, (at, size[1] / 2, size[2] / 2), rng)]
                if rng.random() < 0.5:
                    high = size[1] + 0.3 * rng.random() * size[1]
                    own.append(solid("box", (size[0], high, 0.2 * size[2]), (at, high / 2, 0.1 * size[2]), rng))
            parts += turned(own, way, shift=way @ [0, 0, -deep / 2])
    for _ in range(int(rng.integers(0, 3))):  # tables, with things on them
        high, size = rng.uniform(0.4, 0.9), rng.uniform(0.5, 1.6, 2)
        own = [solid("box", (size[0], 0.04, size[1]), (0, high, 0), rng)]
        own += [solid("tube", (0.06, high, 0.06), (x * 0.42 * size[0], high / 2, z * 0.42 * size[1]), rng) for x in (-1, 1) for z in (-1, 1)]  # fmt: skip  # noqa: E501
        own += turned(clutter(rng, int(rng.integers(0, 6)), 0.4 * size[0], 0.4 * size[1], 0.1, 0.4), np.eye(3), shift=[0, high + 0.02, 0])  # fmt: skip  # noqa: E501
        turn = about(1, rng.uniform(0, np.pi) if rng.random() < 0.5 else 0.0)
        parts += turned(own, turn, shift=[rng.uniform(-0.3, 0.3) * w, 0, rng.uniform(-0.3, 0.3) * d])
    if ceiling and rng.random() < 0.5:
        drop, wide = rng.uniform(0.2, 1.0), rng.uniform(0.2, 0.6)
        at = rng.uniform(-0.2, 0.2, 2) * [w, d]
        parts.append(solid("tube", (0.02, drop, 0.02), (at[0], h - drop / 2, at[1]), rng))
        parts.append(solid("tube", (wide, 0.6 * wide, wide), (at[0], h - drop, at[1]), rng, top=rng.uniform(0.2, 1)))
    parts += clutter(rng, int(rng.integers(0, 6)), 0.4 * w, 0.4 * d, 0.3, 1.3)
    return scene_of(rng, parts)


def corner(rng) -> Gaussians:
    """The part of a furnished room that somebody photographed."""
    return part_of_room(rng, interior(rng))


def tabletop(rng) -> Gaussians:
    """Some of a table or a floor, with several objects on it."""
    w, d = rng.uniform(0.6, 2.0, 2)
    kind = str(rng.choice(["box", "tube"]))
    parts = [solid(kind, (w, 0.04, d), (0, -0.02, 0), rng)]
    if rng.random() < 0.3:
        parts += [solid("box", (0.06, 0.7, 0.06), (x * 0.4 * w, -0.37, z * 0.4 * d), rng) for x in (-1, 1) for z in (-1, 1)]  # fmt: skip  # noqa: E501
    return scene_of(rng, parts + clutter(rng, int(rng.integers(1, 8)), 0.35 * w, 0.35 * d, 0.1, 0.5))


def ground(rng) -> Gaussians:
    """Open ground with hills of noise, objects, and a far backdrop."""
    r = rng.uniform(2, 6)
    parts = [solid("tube", (2 * r, 0.05, 2 * r), (0, -0.03, 0), rng)]
    g = scene_of(rng, parts + clutter(rng, int(rng.integers(1, 9)), 0.5 * r, 0.5 * r, 0.5, 2.5))
    if rng.random() < 0.6:
        d = rng.normal(size=(int(0.15 * len(g)), 3))
        d[:, 1] = np.abs(d[:, 1]) * rng.uniform(0.1, 1)
        d /= np.linalg.norm(d, axis=1, keepdims=True)
        far = discs(rng, 5 * r * d * rng.uniform(0.7, 1.5, (len(d), 1)), -d, rng.random(len(d)))
        g = concatenate([g, far])
    return g


def clutter(rng, count: int, w: float, d: float, least: float, most: float) -> list[Solid]:
    """Objects of every kind, `least` to `most` [m] large, that stand on the floor; some stand on others."""
    parts = []
    for _ in range(count):
        at = [rng.uniform(-w, w), 0.0, rng.uniform(-d, d)]
        own = turned(KINDS[str(rng.choice(list(KINDS)))](rng), about(1, rng.uniform(0, 2 * np.pi)), rng.uniform(least, most), at)  # fmt: skip  # noqa: E501
        parts += own
    return parts


def scene_of(rng, parts: list[Solid]) -> Gaussians:
    """Gaussians on a scene's surfaces that can be seen, with floaters."""
    points, normals, grey = sampled(rng, parts, COUNT[1])
    points = points + normals * rng.normal(0, rng.uniform(0.001, 0.02), (len(points), 1))
    g = discs(rng, points, normals, shaded(rng, points, normals, grey))
    if rng.random() < 0.3:  # a part of it was photographed
        way = np.array([rng.normal(), 0, rng.normal()])
        along = points @ way
        g = g.select(along > np.quantile(along, rng.uniform(0, 0.5)))
    low, high = g.means.min(0), g.means.max(0)
    return concatenate([g, floaters(rng, int(len(g) * rng.uniform(0, 0.08)), low, high)])


SCENES: dict[str, Callable] = {f.__name__: f for f in (room, interior, tabletop, corner, ground)}
