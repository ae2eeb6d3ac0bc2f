"""The vocabulary that scenes, solver, renderer and displays share: shapes, light, bodies, hands. Data only."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np

from core.material import Material
from core.typed import Range

Vec3 = tuple[float, float, float]
Coordinate = Annotated[float, Range(-1e6, 1e6)]  # [m] in a file
Point = tuple[Coordinate, Coordinate, Coordinate]
Quat = tuple[float, float, float, float]
IDENTITY: Quat = (1.0, 0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Body:
    """An asset placed in the world: x_world = scale * R(rotation) x_asset + position.

    `asset` is a name under assets/ or a path. With a material it is simulated; without one it
    is static and its signed distance grid collides. `velocity` [m/s] is the initial one. `kind` is "soft", "rigid", or
    "kinematic": rigid, and moved by nothing but the program. What of a soft body lies below `fixed_below` [m] in the
    asset's frame stays where it is. A body that starts `asleep` is not simulated until something reaches it. The
    colours of a `captured` one hold the shadows on it at the start: they are not drawn a second time. A `filmed` one is
    held and sets off as in the clip that its asset was fitted to, and begins again with the film on a screen.
    """

    asset: str
    material: Material | None = None
    position: Vec3 = (0.0, 0.0, 0.0)
    rotation: Quat = IDENTITY
    scale: float = 1.0
    velocity: Vec3 = (0.0, 0.0, 0.0)
    kind: str = "soft"
    fixed_below: float | None = None
    asleep: bool = False
    captured: bool = False
    filmed: bool = False


@dataclass(frozen=True, eq=False)
class Screen:
    """A flat picture in the world on which a film plays, again and again.

    corner       its top left corner [m];   right, down  its sides from there [m]
    pictures     (F, H, W, 3) uint8, at `times` (F,) [s] from 0 on;   period  [s] of the film, inf: it does not repeat
    """

    corner: Vec3
    right: Vec3
    down: Vec3
    pictures: np.ndarray
    times: np.ndarray
    period: float


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

    `strength` is the fraction of a Gaussian's colour that is lost in full shadow, `softness` [m] the
    width of the shadow's edge.
    """

    position: Point
    target: Point = (0.0, 0.0, 0.0)
    kind: Literal["point", "directional"] = "point"
    strength: Annotated[float, Range(0, 1)] = 0.55
    softness: Annotated[float, Range(0, 1)] = 0.02


@dataclass(frozen=True)
class Touch:
    """Finger capsule of a hand: all points within `radius` [m] of the segment a-b [m], in the world."""

    a: Vec3
    b: Vec3
    radius: float


@dataclass
class Hand:
    """Input of a hand from a device or script: pose in the world, and grip.

    On the rising edge of `grip` the solver takes the vertices within `reach` [m]. `touch` holds the finger capsules
    that push bodies, always in the same order: each sweeps from its place in the last frame. A hand passes through the
    bodies that it holds. Finger capsules need a solver with `fingers`.
    """

    position: Vec3 = (0.0, 0.0, 0.0)
    rotation: Quat = IDENTITY
    grip: bool = False
    reach: float = 0.04
    touch: tuple[Touch, ...] = ()


@dataclass(frozen=True)
class BodyState:
    """State of a simulated body after a frame, as a game sees it: SI units, world frame."""

    name: str
    centroid: np.ndarray
    velocity: np.ndarray
    low: np.ndarray  # corners of the bounding box
    high: np.ndarray
    axis: np.ndarray  # unit normal of the body's flattest direction at rest, carried along
    held: bool
    driven: bool = False  # partly moved by the program: no hand carries it away
