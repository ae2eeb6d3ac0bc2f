"""Protocol between a world and the displays that show it: frames, commands, and the world's public view.

The loop of every display:

    for frame in display.frames(world):
        world.step(frame)
        display.present(world)
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, Protocol, TypeVar

import numpy as np

from core.camera import Camera
from core.material import Material
from display.timing import Timings
from scenes.scene import BodyState, Hand, Light, Scene

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
OPENING = (OpenScene, SwapRoom, AddBody, CancelOpening)  # carried out by the session (commands/play.py), not the world
ORDER = Command.__args__  # in which the commands of one frame are carried out
C = TypeVar("C", bound=Command)


def in_order(commands: Iterable[Command]) -> list[Command]:
    """The commands of one frame in the order in which they are carried out; of several of a kind the last one."""
    return sorted({type(c): c for c in commands}.values(), key=lambda c: ORDER.index(type(c)))


def last_of(kind: type[C], commands: Iterable[Command]) -> C | None:
    """The last command of a kind, or None."""
    return next((c for c in reversed(list(commands)) if isinstance(c, kind)), None)


@dataclass
class Frame:
    """One frame: the world applies `commands`, advances by `dt`, and is drawn for `cameras`, one an eye."""

    dt: float
    """Time to simulate [s]."""

    time: float
    """Sum of all dt so far [s]."""

    cameras: Sequence[Camera] | Callable[[], Sequence[Camera]]
    """Cameras, or a function that gives them, called after the world has moved. Nothing is drawn without a camera."""

    hands: list[Hand] = field(default_factory=list)
    """Poses of the hands at the end of the frame."""

    commands: list[Command] = field(default_factory=list)
    """Commands, carried out before the step as `in_order` sorts them."""

    max_step: float | None = None
    """Longest step of the simulation [s]; None: one step of dt."""

    prop_poses: np.ndarray | None = None
    """world_from_part of the world's skinned props, (P, 3, 4), see render/skinned_props.py; None: unchanged."""


@dataclass(frozen=True)
class Line:
    """A line over the picture: its ends [m], its colour (R, G, B, each 0..1), and a text at its end."""

    start: np.ndarray
    end: np.ndarray
    colour: tuple[float, float, float]
    text: str = ""


class WorldView(Protocol):
    """A world as a display sees it. All attributes are read-only.

    A class that inherits gets the defaults of a world without bodies, light and game.
    """

    scene: Scene
    timings: Timings
    """Durations of the frame's stages; the display adds its own and marks the end of each frame."""

    picture_size: tuple[int, int]
    """(width, height) of one view's picture [px]."""

    light: Light | None = None
    """The light now; None if the scene has none, and then it cannot get one."""

    paused: bool = False
    demo: bool = False
    """True while the scene's scripted hand plays."""

    moving: bool = False
    """True if anything moved in the last frame."""

    interaction: str = "physics"
    """"physics" or "transform"."""

    editable: bool = False
    """True if there are bodies that commands can change."""

    selected: int | None = None
    """Index of the body that was last held or pointed at."""

    recently_selected: bool = False
    """True if it was selected or changed within the last seconds."""

    gravity: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Acceleration of what falls [m/s^2]."""

    time_scale: float = 1.0
    """Seconds of the world in a second of the user's."""

    notice: str = ""
    """Message about the last command, for some seconds."""

    film_seconds: float | None = None
    """Length of the film that is being written [s]; None: there is none."""

    wanted_view: tuple[tuple[float, float, float], tuple[float, float, float]] | None = None
    """Eye and target [m] of a state that was loaded, to which a display goes once; another object each time."""

    time: float = 0.0
    """Seconds of the world since the last reset."""
    file: Any = None
    """The splat file that is shown, a ViewedFile (display/viewed_file.py); None: a scene is."""

    file_number: tuple[int, int] = (0, 0)
    """Number of the file that is shown, from 1, and how many there are."""

    facts: Sequence[tuple[str, str]] = ()
    """Statistics of the file, (name, value)."""

    axes: bool = False
    """True if the axes are shown."""

    up_choices: Sequence[tuple[str, float, np.ndarray]] = ()
    """Alternatives where the up axis is not sure: axes of the file, their probabilities, pictures (H, W, 3) uint8."""

    sound: bool | None = None
    """True if impacts are heard; None: there is nothing to hear them with."""

    opening: str = ""
    """Progress of what is being opened (`OpenScene` and the like), "" while nothing is."""

    score: int = 0
    message: str = ""
    """Score and message of the scene's game."""

    simulation_cost: float | None = None
    """Seconds of computing for a second of simulation; None before it is known."""

    picture: Any
    """The finished picture, ti.ndarray u32 (views * H, W): R | G<<8 | B<<16 | A<<24, row 0 on top."""

    pictures: int = 0
    """Number of pictures drawn so far: `picture` has changed when it has."""

    def lines(self) -> Sequence[Line]:
        """Lines to be drawn over the picture."""
        return ()

    def resize(self, width: int, height: int) -> None:
        """Draw pictures of another size [px] from now on."""
        ...

    def bodies(self) -> list[BodyState]:
        """The simulated bodies after the last frame."""
        return []

    def material(self, body: int) -> tuple[Material, str]:
        """Material of a body, and its name: "rubber", "rubber, changed"; of a rigid body, "rigid"."""
        raise IndexError(body)

    def pick(self, origin: np.ndarray, direction: np.ndarray) -> tuple[float, int] | None:
        """Distance [m] along a ray to the nearest simulated body, and its index; None if the room hides it."""
        return None

    def ground(self, point: np.ndarray) -> float | None:
        """Height [m] of table or floor below a point; None if there is none near."""
        return None

    def tell(self, text: str) -> None:
        """Let `notice` be this text."""

    def hand_forces(self) -> list[np.ndarray]:
        """Force of each hand of the last frame on the body that it holds [N], (3,)."""
        return []

    def touch_forces(self) -> list[np.ndarray]:
        """Contact force of each hand's finger capsules on bodies it does not hold [N], (3,); [] without fingers."""
        return []

    def scripted_hands(self, time: float) -> list[Hand]:
        """Hands of the scene's scripted player at `time` [s]."""
        return []

    def stats(self) -> dict:
        """Counts and state for panels and `--stats`."""
        ...


class Display(Protocol):
    """A window, a headset, or files: asks a world for frames and shows them. Used in a `with`, which closes it."""

    @property
    def size(self) -> tuple[int, int]:
        """(width, height) of one view's picture [px] that suits the display now."""
        ...

    def loading(self, text: str, picture=None) -> None:
        """Show a line of text while the world is made, over a picture as `WorldView.picture` once there is one.

        Raises Cancelled if the user does not want to wait.
        """
        ...

    def show_scene(self, scene: Scene, title: str, name: str) -> None:
        """Show this scene from now on, from where it begins; `frames` is then called again, with its world."""
        ...

    def frames(self, world: WorldView) -> Iterator[Frame]:
        """Frames until the user quits or the planned number is reached."""
        ...

    def present(self, world: WorldView) -> None:
        """Show the world's picture after its step."""
        ...

    def close(self) -> None:
        """Give the screen or files back. Further calls do nothing."""
        ...

    def __enter__(self) -> Display: ...

    def __exit__(self, *error) -> None: ...
