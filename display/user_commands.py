"""Commands: requests of the user between two frames, which displays send and a world, its editor or session obey."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, TypeVar

from core.material import Material
from core.vocabulary import Light

MIN_TIME_SCALE = 0.05  # slower, a frame moves nothing that can be seen

# Commands: requests of the user between two frames. A body is named by its index; None is the selected body, the one
# last held or pointed at. A command of a drag is `continued` if it goes on with the last one: undo takes back the drag.


@dataclass(frozen=True)
class PlayDemo:
    """Let the scene's scripted hand play from the start, or stop it."""

    on: bool


@dataclass(frozen=True)
class Reset:
    """Put the scene's own bodies back to their start and restart the game."""


@dataclass(frozen=True)
class LoadState:
    """Go on from a state that was saved; "": the one of this scene that was saved last."""

    path: str = ""


@dataclass(frozen=True)
class SetLight:
    """Replace the light."""

    light: Light


@dataclass(frozen=True)
class SetInteraction:
    """Choose what a grip does: deform and throw bodies, or move them rigidly while time stands still."""

    mode: Literal["physics", "transform"]


@dataclass(frozen=True)
class SetGravity:
    """Let bodies fall with another acceleration [m/s^2]."""

    gravity: tuple[float, float, float]
    continued: bool = False


@dataclass(frozen=True)
class SetTimeScale:
    """Let time pass more slowly: seconds of the world in a second of the user's, MIN_TIME_SCALE to 1."""

    scale: float
    continued: bool = False


@dataclass(frozen=True)
class Select:
    """Select a body, or none."""

    body: int | None


@dataclass(frozen=True)
class Remove:
    """Remove a body."""

    body: int | None = None


@dataclass(frozen=True)
class Duplicate:
    """Put a copy of a body above it, or beside it if it is animated."""

    body: int | None = None


@dataclass(frozen=True)
class Rescale:
    """Scale a body by a factor."""

    body: int | None
    factor: float


@dataclass(frozen=True)
class Rotate:
    """Rotate a body about its centre by a quaternion (wxyz)."""

    body: int | None
    rotation: tuple[float, float, float, float]


@dataclass(frozen=True)
class Place:
    """Move a body by an offset [m], and turn it by a quaternion (wxyz) about its centre; it comes to rest there."""

    body: int | None
    offset: tuple[float, float, float]
    rotation: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0)
    continued: bool = False


@dataclass(frozen=True)
class TurnRoom:
    """Turn the user's room by a quaternion (wxyz) about what the scene looks at, with all that is in it."""

    rotation: tuple[float, float, float, float]
    continued: bool = False


@dataclass(frozen=True)
class SetMaterial:
    """Make a body of another material, given or named (core/material.py)."""

    body: int | None
    material: Material | str
    continued: bool = False


@dataclass(frozen=True)
class Undo:
    """Undo the last edit, grasp or change of light."""


@dataclass(frozen=True)
class Redo:
    """Redo the edit that was undone last."""


@dataclass(frozen=True)
class Pause:
    """Stop the simulation, or let it run."""

    on: bool


@dataclass(frozen=True)
class SingleStep:
    """Simulate this one frame although the world is paused."""


@dataclass(frozen=True)
class Settle:
    """After this frame, go on as from a saved state: forget what that does not hold, the impulses of contacts."""


# Commands that write files, beside the frame and without changing the world (display/keep/). `size` is that of the
# picture [px]; None: as large as it is drawn, which a window may shrink while things move.


@dataclass(frozen=True)
class TakePicture:
    """Write the picture as a PNG."""

    size: tuple[int, int] | None = None


@dataclass(frozen=True)
class Film:
    """Begin to write a film of the picture, or finish it."""

    on: bool
    size: tuple[int, int] | None = None


@dataclass(frozen=True)
class WriteCamera:
    """Write the camera as a CAM.json, for `vrgs.py render`."""

    size: tuple[int, int] | None = None


@dataclass(frozen=True)
class Export:
    """Write the scene, or one body, for other programs (display/keep/scene_export.py).

    kind     ending of a splat file, or "vtu": the cages, "obj": their surfaces
    body     None: all, and of a splat file the room too
    shadows  of a splat file: whether the colours are as dark as they are shown
    """

    kind: Literal["ply", "compressed.ply", "spz", "splat", "vtu", "obj"] = "ply"
    body: int | None = None
    shadows: bool = True


@dataclass(frozen=True)
class SaveState:
    """Settle, and write the state of the scene (display/keep/state_file.py).

    path  "": a new name;   view  eye and target [m]; None: those of the picture
    """

    path: str = ""
    view: tuple[tuple[float, float, float], tuple[float, float, float]] | None = None


@dataclass(frozen=True)
class KeepFrame:
    """Write a body's up, front and size as they are into its asset file (display/keep/kept_frame.py)."""

    body: int | None = None


@dataclass(frozen=True)
class SetSound:
    """Let impacts be heard, or not."""

    on: bool


@dataclass(frozen=True)
class OpenScene:
    """Play another scene: named, with its options, and files of the user's as bodies and room."""

    name: str
    options: Mapping[str, Any] = field(default_factory=dict)
    bodies: Sequence[str] = ()
    stage: str | None = None


@dataclass(frozen=True)
class SwapRoom:
    """Play the same scene in another room, a file; None: in its own."""

    path: str | None


@dataclass(frozen=True)
class Measure:
    """Let two points (3,) [m] of what is seen be a length [m] apart: the size of the body that has both is set by that,
    else that of the user's room, or of the file that is looked at."""

    start: tuple[float, float, float]
    end: tuple[float, float, float]
    length: float


@dataclass(frozen=True)
class AddBody:
    """Put a body made from a file over the play."""

    path: str


@dataclass(frozen=True)
class CancelOpening:
    """Give up what is being opened."""


# Commands of a viewer of splat files (display/viewer.py), which has no bodies.


@dataclass(frozen=True)
class ViewFiles:
    """Show these files, too; the first of them now."""

    paths: tuple[str, ...]


@dataclass(frozen=True)
class NextFile:
    """Show the next file, or that many files on."""

    step: int = 1


@dataclass(frozen=True)
class TurnUp:
    """Let an axis of the file point up, "+x" to "-z"; "": the next one."""

    up: str = ""


@dataclass(frozen=True)
class ShowAxes:
    """Show the axes, or not."""

    on: bool


@dataclass(frozen=True)
class NextBackground:
    """Show the next colour of background."""


@dataclass(frozen=True)
class Crop:
    """Show only what lies between two corners [m]."""

    low: tuple[float, float, float]
    high: tuple[float, float, float]


@dataclass(frozen=True)
class WriteSplats:
    """Write what is shown of the file as a splat file of its own."""


Command = (
    PlayDemo
    | Reset
    | LoadState
    | SetLight
    | SetInteraction
    | SetGravity
    | SetTimeScale
    | Select
    | Remove
    | Duplicate
    | Rescale
    | Rotate
    | Place
    | TurnRoom
    | SetMaterial
    | Undo
    | Redo
    | Pause
    | SingleStep
    | Settle
    | TakePicture
    | Film
    | WriteCamera
    | Export
    | SaveState
    | KeepFrame
    | SetSound
    | OpenScene
    | SwapRoom
    | AddBody
    | Measure
    | CancelOpening
    | ViewFiles
    | NextFile
    | TurnUp
    | ShowAxes
    | NextBackground
    | Crop
    | WriteSplats
)
SIZED = (TakePicture, Film, WriteCamera)  # about the whole picture, however small it is drawn at the moment
OPENING = (
    OpenScene,
    SwapRoom,
    AddBody,
    Measure,
    CancelOpening,
)  # carried out by the session (commands/play.py), not the world
ORDER = Command.__args__  # in which the commands of one frame are carried out
C = TypeVar("C", bound=Command)


def in_order(commands: Iterable[Command]) -> list[Command]:
    """The commands of one frame in the order in which they are carried out; of several of a kind the last one."""
    return sorted({type(c): c for c in commands}.values(), key=lambda c: ORDER.index(type(c)))


def last_of(kind: type[C], commands: Iterable[Command]) -> C | None:
    """The last command of a kind, or None."""
    return next((c for c in reversed(list(commands)) if isinstance(c, kind)), None)
