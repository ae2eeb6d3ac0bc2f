"""What a scene file declares: the scene, its game, roles and room. Data only: no Taichi, no files."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Protocol

# Scene files take all their words from here.
from core.vocabulary import IDENTITY, Body, BodyState, Box, Capsule, Hand, Light, Plane, Quat, Touch, Vec3  # noqa: F401


class Game(Protocol):
    """Game of a scene. `hands` is its scripted player; `reset` starts it again.

    `verify` raises AssertionError if the scripted play did not end as it should. A game with a task to be done has an
    attribute `goal`: the score with which it is. A game may have `interaction(time)`: the mode, "physics" or
    "transform", in which its scripted player's hands grip.
    """

    duration: float  # [s] of the scripted play

    def reset(self) -> None: ...
    def update(self, time: float, bodies: list[BodyState]) -> None: ...
    def hands(self, time: float, bodies: list[BodyState]) -> list[Hand]: ...
    @property
    def score(self) -> int: ...
    @property
    def message(self) -> str: ...
    def verify(self, bodies: list[BodyState]) -> None: ...


@dataclass(frozen=True)
class Role:
    """A part in a scene that bodies of the user's may play in place of its own (scenes/roles.py).

    name      as it is told: "dancer"; several bodies are numbered: "toy 3"
    assets    those of the scene's bodies that play it, in the scene's order
    resize    whether what plays it becomes as large as what it replaces, or keeps its size
    animated  whether what plays it must move by itself; None: it may
    """

    name: str
    assets: tuple[str, ...]
    resize: bool = True
    animated: bool | None = False


@dataclass(frozen=True)
class Spot:
    """Ground in a room for a station of a play (scenes/free_ground.py).

    at      (x, z) of its middle [m]
    ground  its usual height [m]
    top     its highest [m]: nothing that stands there begins in the ground
    over    the highest ground [m] on the straight way from the play's largest station
    """

    at: tuple[float, float]
    ground: float
    top: float
    over: float


@dataclass(frozen=True)
class Room:
    """The part of a scene that is its room, which one of the user's may replace (scenes/roles.py).

    assets     of the static bodies that go with it
    colliders  that go with it
    spot       middle of the play [m], which comes to lie on a table or the floor of the user's room
    radius     [m] of level, free space that the play takes around it
    on_floor   the spot belongs on the floor, where a table may be higher
    stations   discs of ground (x, z, radius) [m], each with what stands there: where the radius is not free they are
               laid out one by one, all of them smaller if they must be; none: the play takes the ground that there is
    game_at    makes the game of a play that was laid out so, from the spots of the stations and its size (1: as it is)
    marks      static bodies that mark places in another room, as this one does by itself
    """

    assets: tuple[str, ...]
    colliders: tuple[Plane | Capsule | Box, ...]
    spot: Vec3
    radius: float
    on_floor: bool = False
    stations: tuple[Vec3, ...] = ()
    game_at: Callable[[Sequence[Spot], float], Game] | None = None
    marks: tuple[Body, ...] = ()


@dataclass(frozen=True)
class Scene:
    """A demo: its bodies, light and view, and the accuracy of the simulation."""

    bodies: list[Body]
    light: Light | None  # None: nothing casts a shadow, nothing can be lit
    eye: Vec3
    target: Vec3
    colliders: list[Plane | Capsule | Box] = field(default_factory=list)
    fov_y: float = 0.9  # [rad]
    gravity: Vec3 = (0.0, -9.81, 0.0)
    iterations: int | None = None  # sweeps a substep; None: chosen with the integrator
    collision_passes: int = 1
    substep: float | None = None  # [s]; None: from the stability rule
    background: Vec3 = (0.0, 0.0, 0.0)
    game: Game | None = None
    floor: float = 0.0  # [m] on which the player stands
    roles: tuple[Role, ...] = ()  # for bodies of the user's
    room: Room | None = None  # that one of the user's may replace
    cast: tuple[tuple[str, str], ...] = ()  # what the user has brought, and what it is: ("cat.h5", "toy 3")
