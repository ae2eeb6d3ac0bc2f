"""Types of a scene file: the scene, its game, roles and room. Data only: no Taichi, no files."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Protocol

# Scene files take all their words from here.
from core.vocabulary import IDENTITY, Body, BodyState, Box, Capsule, Hand, Light, Plane, Quat, Screen, Touch, Vec3  # noqa: F401


class Game(Protocol):
    """Game of a scene. `hands` is its scripted player; `reset` starts it again.

    `verify` raises AssertionError if the scripted play did not end as it should. A game with a task has an attribute
    `goal`, the score at which it is done. A game may have `interaction(time)`: the mode, "physics" or "transform", in
    which its scripted player's hands grip.
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
    """A part that bodies of the user may play in place of the scene's own (scenes/roles.py).

    name      as it is shown: "dancer"; several bodies are numbered: "toy 3"
    assets    those of the scene's bodies that play it, in the scene's order
    resize    whether what plays it becomes as large as what it replaces, or keeps its size
    animated  whether what plays it must move by itself; None: it may
    """

    name: str
    assets: tuple[str, ...]
    resize: bool = True
    animated: bool | None = False


@dataclass(frozen=True)
class Room:
    """The part of a scene that is its room, which a room of the user may replace (scenes/roles.py).

    assets     of the static bodies that leave with it
    colliders  that leave with it
    spot       middle of the play [m], which comes to lie on a table or the floor of the other room
    radius     [m] of level, free space that the play takes around the spot
    on_floor   the play belongs on the floor, even where there is a table
    must_fit   a room with less free space is refused; otherwise the play goes where most is free
    game       that is played there, where it is not the scene's own
    marks      static bodies that mark places there which this room shows by itself
    """

    assets: tuple[str, ...]
    colliders: tuple[Plane | Capsule | Box, ...]
    spot: Vec3
    radius: float
    on_floor: bool = False
    must_fit: bool = False
    game: Game | None = None
    marks: tuple[Body, ...] = ()


def floor_and_walls(
    x: tuple[float, float], z: tuple[float, float], *, floor: float = 0.0, friction: float = 0.5
) -> list[Plane]:
    """A floor at a height, with its friction, and four walls that face each other along x and z [m]."""
    sides = [Plane((x[0], 0, 0), (1, 0, 0)), Plane((x[1], 0, 0), (-1, 0, 0))]
    ends = [Plane((0, 0, z[0]), (0, 0, 1)), Plane((0, 0, z[1]), (0, 0, -1))]
    return [Plane((0, floor, 0), (0, 1, 0), friction=friction), *sides, *ends]


@dataclass(frozen=True)
class Scene:
    """A demo: its bodies, colliders, light and view, and its game."""

    bodies: list[Body]
    light: Light | None  # None: nothing casts a shadow, nothing can be lit
    eye: Vec3
    target: Vec3
    colliders: list[Plane | Capsule | Box] = field(default_factory=list)
    fov_y: float = 0.9  # [rad]
    gravity: Vec3 = (0.0, -9.81, 0.0)
    background: Vec3 = (0.0, 0.0, 0.0)
    game: Game | None = None
    floor: float = 0.0  # [m] on which the player stands
    roles: tuple[Role, ...] = ()  # that bodies of the user may play
    room: Room | None = None  # that a room of the user may replace
    screens: tuple[Screen, ...] = ()
    cast: tuple[tuple[str, str], ...] = ()  # what the user has brought, and what it is: ("cat.h5", "toy 3")
