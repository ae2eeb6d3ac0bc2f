"""Commands: requests of the user between two frames, which displays send and a world, its editor or session obey.

This module declares them: their fields, their names in recordings and in messages of pages, and their order.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import MISSING, dataclass, field, fields
from typing import Annotated, Any, ClassVar, Literal, TypeVar, dataclass_transform

from core.errors import BadInput
from core.material import Material
from core.typed import Range, Size, field_types, from_plain, to_plain
from core.vocabulary import Light

MIN_TIME_SCALE = 0.05  # slower, a frame moves nothing that can be seen
KINDS: list[type[Command]] = []  # of commands; those of one frame are carried out in this order, that of the module
BodyIndex = Annotated[int, Range(0, 1_000_000)]
FilePath = Annotated[str, Size(4096)]


@dataclass_transform(frozen_default=True)
class Command:
    """Base of all commands, each of which becomes a frozen dataclass.

    Those of a subclass are carried out as it says, the others by the world, or the viewer of files. Keys are bound to
    commands in display/window/key_bindings.py, rows of the panel in display/panel.py.

    A body is named by its index; None is the selected body, the one last held or pointed at. A command of a drag is
    `continued` if it goes on with the last one: undo takes back the whole drag.

    key  its name in recordings; "": it does not change the world, and is not recorded
    """

    key: ClassVar[str] = ""

    def __init_subclass__(cls, key: str = ""):
        cls.key = key
        KINDS.append(dataclass(frozen=True)(cls))


class PlayDemo(Command, key="demo"):
    """Let the scene's scripted hand play from the start, or stop it."""

    on: bool


class Reset(Command, key="reset"):
    """Put the scene's own bodies back to their start and restart the game."""


class LoadState(Command, key="load"):
    """Continue from a saved state; "": from the last one of this scene."""

    path: FilePath = ""


class SetLight(Command, key="light"):
    """Replace the light."""

    light: Light


class SetInteraction(Command, key="interaction"):
    """Choose what a grip does: deform and throw bodies, or move them rigidly while time stands still."""

    mode: Literal["physics", "transform"]


class SetGravity(Command, key="gravity"):
    """Let bodies fall with another acceleration [m/s^2]."""

    gravity: tuple[float, float, float]
    continued: bool = False


class SetTimeScale(Command, key="time_scale"):
    """Let time pass more slowly: seconds of the world in a second of real time, MIN_TIME_SCALE to 1."""

    scale: float
    continued: bool = False


class EditCommand(Command):
    """A command about bodies or the room, which the editor carries out (display/edit/editor.py)."""


class Select(EditCommand, key="select"):
    """Select a body, or none."""

    body: BodyIndex | None


class Remove(EditCommand, key="remove"):
    """Remove a body."""

    body: BodyIndex | None = None


class Duplicate(EditCommand, key="duplicate"):
    """Put a copy of a body above it, or beside it if it is animated."""

    body: BodyIndex | None = None


class Rescale(EditCommand, key="rescale"):
    """Scale a body by a factor."""

    body: BodyIndex | None
    factor: float


class Rotate(EditCommand, key="rotate"):
    """Rotate a body about its centre by a quaternion (wxyz)."""

    body: BodyIndex | None
    rotation: tuple[float, float, float, float]


class Place(EditCommand, key="place"):
    """Move a body by an offset [m], and turn it by a quaternion (wxyz) about its centre; it comes to rest there."""

    body: BodyIndex | None
    offset: tuple[float, float, float]
    rotation: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0)
    continued: bool = False


class TurnRoom(EditCommand, key="turn_room"):
    """Turn the user's room and all that is in it by a quaternion (wxyz) about the point that the scene looks at."""

    rotation: tuple[float, float, float, float]
    continued: bool = False


class SetMaterial(EditCommand, key="material"):
    """Make a body of another material, given or named (core/material.py)."""

    body: BodyIndex | None
    material: Material | str
    continued: bool = False


class Undo(EditCommand, key="undo"):
    """Undo the last edit, grasp or change of light."""


class Redo(EditCommand, key="redo"):
    """Redo the edit that was undone last."""


class Pause(Command, key="pause"):
    """Stop the simulation, or let it run."""

    on: bool


class SingleStep(Command, key="step"):
    """Simulate this one frame although the world is paused."""


class Settle(Command, key="settle"):
    """After this frame, continue as from a saved state, without what a state does not hold: impulses of contacts."""


# Commands that write files and do not change the world (display/keep/).


class PictureCommand(Command):
    """A command about the whole picture, `size` [px]; None: as it is drawn, which a window may shrink in motion."""


class TakePicture(PictureCommand):
    """Write the picture as a PNG."""

    size: tuple[int, int] | None = None


class Film(PictureCommand):
    """Begin to write a film of the picture, or finish it."""

    on: bool
    size: tuple[int, int] | None = None


class WriteCamera(PictureCommand):
    """Write the camera as a CAM.json, for `vrgs.py render`."""

    size: tuple[int, int] | None = None


class Export(Command):
    """Write the scene, or one body, for other programs (display/keep/scene_export.py).

    kind     ending of a splat file, "html": a page, "usdz": OpenUSD, "vtu": the cages, "obj": their surfaces
    body     None: all, and where Gaussians are written the room too
    shadows  of Gaussians: whether the colours are as dark as they are shown
    """

    kind: Literal["ply", "compressed.ply", "spz", "splat", "sog", "glb", "html", "usdz", "vtu", "obj"] = "ply"
    body: BodyIndex | None = None
    shadows: bool = True


class SaveState(Command):
    """Settle, and write the state of the scene (display/keep/state_file.py).

    view  eye and target [m]; None: those of the picture
    """

    view: tuple[tuple[float, float, float], tuple[float, float, float]] | None = None


class KeepFrame(Command):
    """Write a body's present up, front and size into its asset file (display/keep/kept_frame.py)."""

    body: BodyIndex | None = None


class SetSound(Command):
    """Let impacts be heard, or not."""

    on: bool


class OpeningCommand(Command):
    """A command that the session carries out (commands/play.py), not the world."""


class OpenScene(OpeningCommand):
    """Play another scene by its name, with its options and the user's files as bodies and room."""

    name: str
    options: Mapping[str, Any] = field(default_factory=dict)
    bodies: Sequence[str] = ()
    stage: str | None = None


class SwapRoom(OpeningCommand):
    """Play the same scene in the room of a file; None: in its own."""

    path: str | None


class AddBody(OpeningCommand):
    """Drop a body made from a file into the play."""

    path: str


class Measure(OpeningCommand):
    """Set a size by the length [m] between two visible points (3,) [m]: of the body that has both, else of the user's
    room, or of the file that is viewed."""

    start: tuple[float, float, float]
    end: tuple[float, float, float]
    length: float


class CancelOpening(OpeningCommand):
    """Cancel what is being opened."""


# Commands of a viewer of splat files (display/viewer.py), which has no bodies.


class ViewFiles(Command):
    """Add these files to those that are viewed, and show the first of them."""

    paths: tuple[str, ...]


class NextFile(Command):
    """Show the file that many steps on."""

    step: int = 1


class TurnUp(Command):
    """Turn the file so that its axis "+x" to "-z" points up; "": the next axis."""

    up: str = ""


class ShowAxes(Command):
    """Show the axes, or not."""

    on: bool


class NextBackground(Command):
    """Show the next colour of background."""


class Crop(Command):
    """Show only what lies between two corners [m]."""

    low: tuple[float, float, float]
    high: tuple[float, float, float]


class WriteSplats(Command):
    """Write the shown part of the file as a new splat file."""


C = TypeVar("C", bound=Command)
SCALE_STEP = 1.25
TURN_STEP = math.pi / 12  # [rad]
ROOM_STEP = math.radians(3.0)  # of a whole room: it leans a little more often than it lies on its side


def rotation_step(axis=(0.0, 1.0, 0.0), sign: float = 1.0, *, step: float = TURN_STEP) -> tuple[float, ...]:
    """Quaternion wxyz of a step about a unit axis (3,), the vertical one unless told otherwise."""
    half = sign * step / 2
    return (math.cos(half), *(math.sin(half) * c for c in axis))


EDITS: dict[str, Command] = {  # of the selected body by one step, by the names of keys and buttons
    "undo": Undo(),
    "redo": Redo(),
    "copy": Duplicate(),
    "remove": Remove(),
    "smaller": Rescale(None, 1 / SCALE_STEP),
    "larger": Rescale(None, SCALE_STEP),
    "turn": Rotate(None, rotation_step(sign=-1.0)),
    "turn room": TurnRoom(rotation_step(sign=-1.0, step=ROOM_STEP)),
    "turn room back": TurnRoom(rotation_step(step=ROOM_STEP)),
    "turn back": Rotate(None, rotation_step()),
}


def in_order(commands: Iterable[Command]) -> list[Command]:
    """The commands of one frame in the order in which they are carried out; of several of a kind the last one."""
    return sorted({type(c): c for c in commands}.values(), key=lambda c: KINDS.index(type(c)))


def last_of(kind: type[C], commands: Iterable[Command]) -> C | None:
    """The last command of a kind, or None."""
    return next((c for c in reversed(list(commands)) if isinstance(c, kind)), None)


def commands_to_text(frame: int, commands: Iterable[Command]) -> str:
    """The recorded commands of a frame as one line of JSON, by their keys: {"frame": 12, "rescale": [3, 1.25]}.

    A command without fields is true, one with one field is its value, one with more a list without the last ones that
    have their default values. A state that is saved is recorded as `Settle`, which is how it changes the world.
    """
    plain = {"frame": frame}
    for command in (Settle() if isinstance(c, SaveState) else c for c in commands):
        if command.key:
            given = [getattr(command, f.name) for f in fields(command)]
            while len(given) > 1 and given[-1] == fields(command)[len(given) - 1].default:
                given.pop()
            plain[command.key] = True if not given else to_plain(given[0] if len(fields(command)) == 1 else given)
    return json.dumps(plain)


def commands_from_text(text: str, where: str) -> tuple[int, list[Command]]:
    """The frame's index and its commands; a command without fields that is false is none. Raises BadInput."""
    try:
        plain = json.loads(text, object_hook=unnamed)
        frame = from_plain(int, plain.pop("frame"), where)
    except (ValueError, RecursionError, AttributeError, KeyError, TypeError) as e:
        raise BadInput(f"{where}: a line of commands is not JSON with a frame") from e
    kinds, commands = {kind.key: kind for kind in KINDS if kind.key}, []
    for key, value in plain.items():
        if key not in kinds:
            raise BadInput(f"{where}: the command {key[:60]!r} is unknown")
        kind, at = kinds[key], f"{where}: the command {key!r}"
        types = list(field_types(kind).values())
        if not types:
            commands += [kind()] if from_plain(bool, value, at) else []
            continue
        needed = sum(f.default is MISSING for f in fields(kind))
        values = [value] if len(types) == 1 else value
        given = min(max(len(values), needed), len(types)) if isinstance(values, list) else needed
        commands.append(kind(*from_plain(tuple[tuple(types[:given])], values, at)))
    return frame, commands


def unnamed(plain: dict[str, Any]) -> Any:
    """A Light or Material of a recording of version 3 or before, {"Light": {...}}, as its fields: a hook for JSON."""
    return next(iter(plain.values())) if plain.keys() in ({"Light"}, {"Material"}) else plain
