"""Model of an animal or a toy: parts with shape, colour and hair; its surface and colours at any point."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from core.material import Material
from core.program import batches, in_threads
from studio.creatures.implicit import Shape, mirrored, smooth_union, unit
from studio.textures import srgb

# Density of an animal with its fur, and its friction on grass. Living tissue damps far more than rubber: an animal that
# is set down stands still after a second or two.
TISSUE = Material(young=1e5, poisson=0.35, density=180.0, friction=0.8, kinetic_friction=0.6, damping=40.0)
BATCH = 16384  # points at a time in each thread
Pattern = Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]  # points, normals, albedo -> albedo


@dataclass(frozen=True)
class Part:
    """A part of a body, joined smoothly to the others; or a bead sewn on, such as an eye.

    colour  display colour such as "c86432"
    blend   width of the rounded seam to the parts before it [m]; 0: a bead, which stays by itself
    hair    length of the hair [m]; None: the creature's
    comb    direction in which the hair lies; None: the growth of the shape
    glint   a bead that shines: a bright spot towards the sky
    """

    shape: Shape
    colour: str
    blend: float = 0.02
    hair: float | None = None
    comb: tuple[float, float, float] | None = None
    glint: bool = False

    @property
    def bead(self) -> bool:
        """True if the part does not blend with others."""
        return self.blend == 0.0


@dataclass(frozen=True)
class Seam:
    """A seam in the fabric where a plane through `point` with this normal cuts the body, where `keep` says so."""

    point: tuple[float, float, float]
    normal: tuple[float, float, float]
    keep: Callable[[np.ndarray], np.ndarray] = lambda p: np.ones(len(p), bool)


@dataclass(frozen=True)
class Creature:
    """A body to be made, in metres, +y up, facing +z.

    low, high   corners of a box that holds all parts [m]
    sole        height at which the body is cut flat to stand or sit on [m]
    hair        length of the hair [m]
    lift        0: hair lies flat, 1: it stands upright
    border      width over which the colours of parts mix [m]
    pattern     changes the colours of the body (not of beads): points, normals, albedo -> albedo
    curl        0: combed hair, 1: every hair has a direction of its own
    mottle      standard deviation of the logarithm of the brightness from hair to hair
    from_below  light from the ground over that from the sky
    """

    parts: list[Part]
    low: tuple[float, float, float]
    high: tuple[float, float, float]
    material: Material
    hair: float = 0.01
    lift: float = 0.35
    border: float = 0.008
    curl: float = 0.0
    sole: float = 0.0
    mottle: float = 0.12
    from_below: float = 0.45
    pattern: Pattern | None = None
    seams: list[Seam] = field(default_factory=list)

    @property
    def body(self) -> list[Part]:
        """Parts that are joined."""
        return [p for p in self.parts if not p.bead]

    @property
    def beads(self) -> list[Part]:
        """Parts that stay by themselves."""
        return [p for p in self.parts if p.bead]


def tissue(young: float) -> Material:
    """Soft tissue with this Young's modulus [Pa], which decides how far the legs give way."""
    return replace(TISSUE, young=young)


def pair(part: Part) -> list[Part]:
    """The part and its mirror image in the plane x = 0."""
    comb = None if part.comb is None else (-part.comb[0], *part.comb[1:])
    return [part, replace(part, shape=mirrored(part.shape), comb=comb)]


def surface_of(parts: list[Part], points: np.ndarray, sole: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """Signed distance (N,) [m] and its unit gradient (N, 3) of joined parts, cut flat at y = `sole` to stand on."""

    def found(s: slice) -> tuple[np.ndarray, np.ndarray]:
        p = points[s]
        distance, gradient = smooth_union([part.shape(p) for part in parts], [part.blend for part in parts])
        depth = sole - p[:, 1]
        below = depth > distance
        return np.where(below, depth, distance), np.where(below[:, None], (0.0, -1.0, 0.0), gradient)

    pieces = in_threads(found, batches(len(points), BATCH)) or [found(slice(0))]
    return np.concatenate([piece[0] for piece in pieces]), np.concatenate([piece[1] for piece in pieces])


@dataclass(frozen=True)
class Look:
    """Properties at points of the surface: linear albedo (N, 3), hair length [m] (N,), combed direction (N, 3)."""

    albedo: np.ndarray
    hair: np.ndarray
    comb: np.ndarray


def look_at_surface(creature: Creature, points: np.ndarray, normals: np.ndarray) -> Look:
    """Properties of the body at points (N, 3) of its surface, mixed over the borders between parts."""
    fields = [part.shape(points) for part in creature.body]
    distance = np.stack([f[0] for f in fields])
    weight = np.exp(-(distance - distance.min(0)) / creature.border)
    weight /= weight.sum(0)
    albedo = np.stack([srgb(part.colour) for part in creature.body])
    hair = np.array([creature.hair if part.hair is None else part.hair for part in creature.body])
    growth = [
        f[2] if part.comb is None else np.broadcast_to(np.asarray(part.comb), points.shape)
        for part, f in zip(creature.body, fields, strict=True)
    ]
    comb = np.einsum("kn,knc->nc", weight, np.stack([unit(g) for g in growth]))
    colour = weight.T @ albedo
    if creature.pattern is not None:
        colour = np.clip(creature.pattern(points, normals, colour), 0, 1)
    return Look(colour, weight.T @ hair, comb)
