"""What a scene file is made of. Data only: no Taichi, no files are read here."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal, Protocol

import numpy as np

from core.material import Material

Vec3 = tuple[float, float, float]
Quat = tuple[float, float, float, float]
IDENTITY: Quat = (1.0, 0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Body:
    """An asset placed in the world: x_world = scale * R(rotation) x_asset + position.

    `asset` is a name under assets/ or a path. With a material it is simulated; without one it
    is static and its signed distance grid collides. `velocity` [m/s] is the initial one. `kind` is "soft", "rigid", or
    "kinematic": rigid, and moved by nothing but the program.
    """

    asset: str
    material: Material | None = None
    position: Vec3 = (0.0, 0.0, 0.0)
    rotation: Quat = IDENTITY
    scale: float = 1.0
    velocity: Vec3 = (0.0, 0.0, 0.0)
    kind: str = "soft"


@dataclass(frozen=True)
class Plane:
    """Static half space: solid where (x - point) . normal < 0."""

    point: Vec3
    normal: Vec3
    friction: float = 0.5


@dataclass(frozen=True)
class Capsule:
    """Static capsule: all points within `radius` [m] of the segment a-b."""

    a: Vec3
    b: Vec3
    radius: float
    friction: float = 0.5


@dataclass(frozen=True)
class Box:
    """Static box, axis-aligned: |x - center| <= half_size on each axis."""

    center: Vec3
    half_size: Vec3
    friction: float = 0.5


@dataclass(frozen=True)
class Light:
    """The light that casts shadows. `kind` is "point" or "directional" (position gives the direction).

    `strength` is the share of a Gaussian's colour that is lost in full shadow, `softness` [m] the
    width of the shadow's edge.
    """

    position: Vec3
    target: Vec3 = (0.0, 0.0, 0.0)
    kind: Literal["point", "directional"] = "point"
    strength: float = 0.55
    softness: float = 0.02


@dataclass(frozen=True)
class Touch:
    """A piece of a hand that pushes: all points within `radius` [m] of the segment a-b [m], in the world."""

    a: Vec3
    b: Vec3
    radius: float


@dataclass
class Hand:
    """A hand as a device or a script gives it: pose in the world, and whether it grips.

    On the rising edge of `grip` the solver takes the vertices within `reach` [m]. What the hand pushes with is `touch`,
    always in the same order: each piece moves from where it was in the frame before. A hand passes through what it
    holds. Only a solver that was made for it (`fingers`) feels them.
    """

    position: Vec3 = (0.0, 0.0, 0.0)
    rotation: Quat = IDENTITY
    grip: bool = False
    reach: float = 0.04
    touch: tuple[Touch, ...] = ()


@dataclass(frozen=True)
class BodyState:
    """What a game may see of a simulated body after a frame: SI units, world frame."""

    name: str
    centroid: np.ndarray
    velocity: np.ndarray
    low: np.ndarray  # corners of the bounding box
    high: np.ndarray
    axis: np.ndarray  # unit normal of the body's flattest direction at rest, carried along
    held: bool
    driven: bool = False  # some of it is led by the program, and no hand carries it away


class Game(Protocol):
    """A scene's small game. `hands` is its scripted player; it starts anew with `reset`.

    `verify` raises AssertionError if the scripted play did not end as it should.
    """

    duration: float  # [s] that the scripted player needs

    def reset(self) -> None: ...
    def update(self, time: float, bodies: list[BodyState]) -> None: ...
    def hands(self, time: float, bodies: list[BodyState]) -> list[Hand]: ...
    @property
    def score(self) -> int: ...
    @property
    def message(self) -> str: ...
    def verify(self, bodies: list[BodyState]) -> None: ...


@dataclass(frozen=True)
class Scene:
    """A demo: what is there, how it is lit and seen, how exactly it is simulated."""

    bodies: list[Body]
    light: Light | None  # None: nothing casts a shadow, nothing can be lit
    eye: Vec3
    target: Vec3
    colliders: list[Plane | Capsule | Box] = field(default_factory=list)
    fov_y: float = 0.9  # [rad]
    gravity: Vec3 = (0.0, -9.81, 0.0)
    iterations: int | None = None  # sweeps a substep; None: what suits the path that the solver chooses
    collision_passes: int = 1
    substep: float | None = None  # [s]; None: from the stability rule
    background: Vec3 = (0.0, 0.0, 0.0)
    game: Game | None = None
