"""Objects put together from ellipsoids, boxes, cylinders, cones and rings at random, standing on y = 0, +y up."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from bench.synthetic_room import box_surface
from core.rotation import matrices_from_quaternions


@dataclass(frozen=True)
class Solid:
    """A solid of `size` (3,), its axis along its own y, turned by `turn` (3, 3) and moved to `centre` (3,) [m].

    kind    "ball", "box", "tube" (a cylinder or cone; `top` is the radius above over that below), "ring" (the radii of
            its circle and of its section are the first two numbers of the size)
    colour  grey, 0 to 1
    hollow  open above, with a wall: a tube alone
    """

    kind: str
    size: np.ndarray
    centre: np.ndarray
    turn: np.ndarray = None
    top: float = 1.0
    colour: float = 0.5
    hollow: bool = False

    @property
    def rotation(self) -> np.ndarray:
        """Its turn (3, 3); none: the identity."""
        return np.eye(3) if self.turn is None else self.turn

    @property
    def area(self) -> float:
        """About its surface."""
        x, y, z = self.size
        if self.kind == "ring":
            return 4 * np.pi**2 * x * y
        box = 2 * (x * y + y * z + z * x)
        return {"box": 1.0, "ball": 0.55, "tube": 0.8}[self.kind] * box * (1.8 if self.hollow else 1.0)

    def sample(self, rng, count: int) -> tuple[np.ndarray, np.ndarray]:
        """Points on the surface and unit normals, (count, 3) each."""
        points, normals = getattr(self, f"_{self.kind}")(rng, count)
        normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
        return points @ self.rotation.T + self.centre, normals @ self.rotation.T

    def holds(self, points: np.ndarray) -> np.ndarray:
        """True for the points (N, 3) well within the solid, (N,)."""
        x = (points - self.centre) @ self.rotation
        if self.kind == "ring":
            return np.hypot(np.hypot(x[:, 0], x[:, 2]) - self.size[0], x[:, 1]) < 0.95 * self.size[1]
        u = x / (0.5 * self.size)
        if self.kind == "ball":
            return (u**2).sum(1) < 0.95
        if self.kind == "box":
            return (np.abs(u) < 0.97).all(1)
        r = np.hypot(u[:, 0], u[:, 2]) / (1 + (self.top - 1) * 0.5 * (u[:, 1] + 1)).clip(1e-6)
        within = (r < 0.97) & (np.abs(u[:, 1]) < 0.97)
        return within & ~((r < 0.85) & (u[:, 1] > -0.85)) if self.hollow else within

    def _ball(self, rng, count: int):
        d = rng.normal(size=(count, 3))
        d /= np.linalg.norm(d, axis=1, keepdims=True)
        return 0.5 * d * self.size, d / self.size

    def _box(self, rng, count: int):
        return box_surface(rng, count, -0.5 * self.size, self.size)

    def _tube(self, rng, count: int):
        rx, height, rz = 0.5 * self.size[0], self.size[1], 0.5 * self.size[2]
        side, below, above = 2.8 * (rx + rz) * height, np.pi * rx * rz, np.pi * rx * rz * self.top**2
        where = rng.choice(4, count, p=np.array([side, below, above, side * self.hollow]) / (side * (1 + self.hollow) + below + above))  # fmt: skip  # noqa: E501
        t, a = rng.uniform(-0.5, 0.5, count), rng.uniform(0, 2 * np.pi, count)
        t = np.where(where == 1, -0.5, np.where(where == 2, -0.42 if self.hollow else 0.5, t))
        width = (1 + (self.top - 1) * (t + 0.5)) * np.where(where == 3, 0.86, 1.0)
        cap = (where == 1) | (where == 2)
        width = np.where(cap, width * np.sqrt(rng.random(count)), width)
        points = np.stack([rx * width * np.cos(a), t * height, rz * width * np.sin(a)], 1)
        normals = np.stack([np.cos(a) / rx, (1 - self.top) / height + 0 * a, np.sin(a) / rz], 1)
        normals[cap] = [0, 1, 0]
        normals[where == 1] *= -1
        normals[where == 3] *= -1
        return points, normals

    def _ring(self, rng, count: int):
        a, b = rng.uniform(0, 2 * np.pi, (2, count))
        out = np.stack([np.cos(a), 0 * a, np.sin(a)], 1)
        normals = np.cos(b)[:, None] * out + np.sin(b)[:, None] * [0, 1, 0]
        return self.size[0] * out + self.size[1] * normals, normals


def sampled(rng, solids: list[Solid], count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points (N, 3), normals (N, 3) and greys (N,) of the surface of the solids' union, N about `count`."""
    areas = np.array([s.area for s in solids])
    shares = np.maximum(12, np.round(1.2 * count * areas / areas.sum())).astype(int)
    points, normals, colours = [], [], []
    for k, (solid, n) in enumerate(zip(solids, shares, strict=True)):
        x, d = solid.sample(rng, n)
        out = ~np.any([s.holds(x) for i, s in enumerate(solids) if i != k] or [np.zeros(n, bool)], axis=0)
        points.append(x[out])
        normals.append(d[out])
        colours.append(np.full(out.sum(), solid.colour))
    return np.concatenate(points), np.concatenate(normals), np.concatenate(colours)


def turned(solids: list[Solid], turn: np.ndarray, scale: float = 1.0, shift=(0.0, 0.0, 0.0)) -> list[Solid]:
    """The solids turned about the origin, scaled and moved."""
    return [
        replace(s, centre=scale * turn @ s.centre + shift, size=scale * s.size, turn=turn @ s.rotation) for s in solids
    ]


def about(axis: int, angle: float) -> np.ndarray:
    """Rotation (3, 3) about a coordinate axis by an angle [rad]."""
    half = np.zeros(4)
    half[0], half[1 + axis] = np.cos(angle / 2), np.sin(angle / 2)
    return matrices_from_quaternions(half)


def solid(kind: str, size, centre, rng, **more) -> Solid:
    """A solid of a random grey."""
    return Solid(kind, np.asarray(size, float), np.asarray(centre, float), colour=rng.uniform(0.1, 0.9), **more)


# Kinds of objects. Each makes solids of about 1 in height or width.


def vessel(rng) -> list[Solid]:
    """A mug, bowl, vase or bucket."""
    w, h, top = rng.uniform(0.4, 1.2), rng.uniform(0.3, 1.2), rng.uniform(0.7, 1.8)
    parts = [solid("tube", (w, h, w), (0, h / 2, 0), rng, top=top, hollow=rng.random() < 0.8)]
    if rng.random() < 0.5:
        at = (0.5 * w * (1 + top) / 2, h / 2, 0)
        parts.append(solid("ring", (0.25 * h, 0.06 * h, 1), at, rng, turn=about(0, np.pi / 2)))
    return parts


def furniture(rng) -> list[Solid]:
    """A table, a stool, a chair, or a shelf."""
    w, d, h, t = rng.uniform(0.5, 1.6), rng.uniform(0.4, 1.0), rng.uniform(0.4, 1.0), rng.uniform(0.03, 0.08)
    parts = [solid("box", (w, t, d), (0, h, 0), rng)]
    if rng.random() < 0.2:
        parts.append(solid("tube", (0.1, h, 0.1), (0, h / 2, 0), rng))
        parts.append(solid("tube", (0.6 * d, t, 0.6 * d), (0, t / 2, 0), rng))
    else:
        size = (rng.uniform(0.03, 0.1), h, rng.uniform(0.03, 0.1))
        parts += [solid("box", size, (x * 0.44 * w, h / 2, z * 0.42 * d), rng) for x in (-1, 1) for z in (-1, 1)]
    if rng.random() < 0.5:
        parts.append(solid("box", (w, rng.uniform(0.3, 0.8) * h, t), (0, 1.3 * h, -0.5 * d), rng))
    if rng.random() < 0.3:
        parts.append(solid("box", (0.9 * w, t, 0.9 * d), (0, 0.3 * h, 0), rng))
    return parts


def animal(rng) -> list[Solid]:
    """A body on four legs, with a head, ears and a tail."""
    long, wide, leg = rng.uniform(0.6, 1.2), rng.uniform(0.25, 0.5), rng.uniform(0.15, 0.7)
    high = wide * rng.uniform(0.9, 1.3)
    parts = [solid("ball", (long, high, wide), (0, leg + high / 2, 0), rng)]
    thick = rng.uniform(0.08, 0.2)
    for x in (-0.3, 0.3):
        for z in (-0.3, 0.3):
            parts.append(solid("tube", (thick, leg + 0.4 * high, thick), (x * long, leg / 2, z * wide), rng))
    head = rng.uniform(0.2, 0.45)
    at = np.array([0.5 * long, leg + high * rng.uniform(0.6, 1.5), 0])
    parts.append(solid("ball", (head * rng.uniform(1, 1.6), head, head), at, rng))
    parts += [solid("ball", (0.06, head * rng.uniform(0.3, 1), 0.1), at + [0, head / 2, s * head / 3], rng) for s in (-1, 1)]  # fmt: skip  # noqa: E501
    tail = about(2, rng.uniform(-0.5, 1.5))
    parts.append(solid("ball", (0.08, long * 0.4, 0.08), (-0.5 * long, leg + high * 0.6, 0), rng, turn=tail))
    return parts


def figure(rng) -> list[Solid]:
    """A person or statue that stands, sits or reaches out; some lean, some have a pedestal."""
    leg, torso, wide = rng.uniform(0.3, 0.9), rng.uniform(0.5, 0.8), rng.uniform(0.3, 0.5)
    spread = rng.uniform(0.08, 0.25)
    parts = [solid("tube", (0.18, leg, 0.2), (s * spread, leg / 2, 0), rng, top=1.2) for s in (-1, 1)]
    parts += [solid("box", (0.14, 0.08, 0.28), (s * spread, 0.04, 0.06), rng) for s in (-1, 1)]
    parts.append(solid("ball", (wide, torso * 1.1, 0.6 * wide), (0, leg + torso / 2, 0), rng))
    for s in (-1, 1):
        lift = s * rng.uniform(0, 2.6)
        arm = 0.4 * torso * np.array([np.sin(lift), -np.cos(lift), 0])
        at = np.array([s * wide / 2, leg + 0.85 * torso, 0]) + arm
        parts.append(solid("tube", (0.12, 0.8 * torso, 0.12), at, rng, turn=about(2, lift)))
    head = rng.uniform(0.2, 0.35)
    parts.append(solid("ball", (head, 1.2 * head, head), (0, leg + torso + 0.5 * head, 0), rng))
    lean = about(int(rng.choice([0, 2])), rng.uniform(-0.3, 0.3) * (rng.random() < 0.4))
    return turned(parts, lean)


def plant(rng) -> list[Solid]:
    """A stem on a foot or in a pot, with a crown or a shade: heavy above."""
    foot, stem, crown = rng.uniform(0.2, 0.5), rng.uniform(0.3, 1.0), rng.uniform(0.3, 1.0)
    pot = rng.uniform(0.03, 0.4)
    parts = [solid("tube", (foot, pot, foot), (0, pot / 2, 0), rng, top=rng.uniform(0.8, 1.5), hollow=pot > 0.15)]
    parts.append(solid("tube", (0.05, stem, 0.05), (0, pot + stem / 2, 0), rng))
    if rng.random() < 0.5:
        parts.append(solid("tube", (crown, 0.6 * crown, crown), (0, pot + stem, 0), rng, top=rng.uniform(0.3, 0.9)))
        return parts
    for _ in range(int(rng.integers(1, 8))):
        size = crown * rng.uniform(0.3, 0.7, 3)
        parts.append(solid("ball", size, rng.normal(0, 0.25 * crown, 3) + [0, pot + stem, 0], rng))
    return parts


def vehicle(rng) -> list[Solid]:
    """A box with a cabin on wheels."""
    long, wide, high, wheel = rng.uniform(0.7, 1.4), rng.uniform(0.35, 0.6), rng.uniform(0.15, 0.4), rng.uniform(0.15, 0.35)  # fmt: skip  # noqa: E501
    parts = [solid("box", (long, high, wide), (0, wheel / 2 + high / 2, 0), rng)]
    parts.append(solid("box", (long * rng.uniform(0.3, 0.6), high, wide * 0.9), (rng.uniform(-0.2, 0.2) * long, wheel / 2 + 1.4 * high, 0), rng))  # fmt: skip  # noqa: E501
    parts += [solid("tube", (wheel, 0.1, wheel), (x * 0.33 * long, wheel / 2, z * wide / 2), rng, turn=about(0, np.pi / 2)) for x in (-1, 1) for z in (-1, 1)]  # fmt: skip  # noqa: E501
    return parts


def plush(rng) -> list[Solid]:
    """A sitting toy: a body, a head with ears, arms and legs stretched out."""
    body, head = rng.uniform(0.4, 0.7), rng.uniform(0.3, 0.6)
    parts = [solid("ball", (body, body * rng.uniform(0.9, 1.4), body), (0, body / 2, 0), rng)]
    at = np.array([0, 1.05 * body + 0.35 * head, 0.05])
    parts.append(solid("ball", head * rng.uniform(0.9, 1.2, 3), at, rng))
    ear = head * rng.uniform(0.2, 0.9)
    parts += [solid("ball", (0.3 * head, ear, 0.2 * head), at + [s * 0.35 * head, 0.5 * head, 0], rng) for s in (-1, 1)]
    limb = rng.uniform(0.15, 0.25)
    for s in (-1, 1):
        parts.append(solid("ball", (limb, limb, 0.5), (s * 0.2, limb / 2, 0.5 * body), rng))
        parts.append(solid("ball", (limb, 0.4, limb), (s * 0.55 * body, 0.6 * body, 0.1), rng, turn=about(2, s * 0.6)))
    return parts


def block(rng) -> list[Solid]:
    """A box, a bottle, a book, a stack of boxes: as good as symmetrical."""
    if rng.random() < 0.4:
        w, h = rng.uniform(0.2, 0.5), rng.uniform(0.5, 1.0)
        neck = solid("tube", (0.3 * w, 0.4 * h, 0.3 * w), (0, 1.2 * h, 0), rng)
        return [solid("tube", (w, h, w), (0, h / 2, 0), rng), neck]
    parts, at = [], 0.0
    for _ in range(int(rng.integers(1, 4))):
        size = rng.uniform(0.2, 1.0, 3) * [1, 0.6, 1]
        parts.append(solid("box", size, (*rng.normal(0, 0.05, 1), at + size[1] / 2, rng.normal(0, 0.05)), rng))
        at += size[1]
    return parts


def house(rng) -> list[Solid]:
    """Walls with a pointed roof, a tower, a tent."""
    w, d, h = rng.uniform(0.5, 1.2), rng.uniform(0.5, 1.2), rng.uniform(0.1, 1.0)
    parts = [solid("box", (w, h, d), (0, h / 2, 0), rng)]
    roof = rng.uniform(0.3, 0.8)
    parts.append(solid("tube", (1.2 * w, roof, 1.2 * d), (0, h + roof / 2, 0), rng, top=rng.uniform(0.02, 0.5)))
    if rng.random() < 0.5:
        parts.append(solid("box", (0.1, 0.4, 0.1), (0.3 * w, h + 0.5 * roof, 0.2 * d), rng))
    return parts


def lying(rng) -> list[Solid]:
    """Something that lies: a shoe, a stick, a fish, a pile of cushions."""
    parts = []
    for _ in range(int(rng.integers(1, 4))):
        size = np.array([rng.uniform(0.4, 1.2), rng.uniform(0.08, 0.3), rng.uniform(0.15, 0.5)])
        turn = about(1, rng.uniform(0, 2 * np.pi))
        kind = str(rng.choice(["ball", "box"]))
        parts.append(solid(kind, size, (*rng.normal(0, 0.1, 1), size[1] / 2, rng.normal(0, 0.1)), rng, turn=turn))
    return parts


KINDS: dict[str, Callable] = {f.__name__: f for f in (vessel, furniture, animal, figure, plant, vehicle, plush, block, house, lying)}  # fmt: skip  # noqa: E501
