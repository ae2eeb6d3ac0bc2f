"""Protocol between a world and the displays that show it: frames, and the world's public view.

The loop of every display:

    for frame in display.frames(world):
        world.step(frame)
        display.present(world)
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from time import monotonic
from typing import Any, Protocol, Self

import numpy as np

from core.camera import Camera
from core.material import Material
from core.vocabulary import BodyState, Hand, Light, Vec3
from display.timing import Timings
from display.user_commands import Command
from scenes.scene import Scene

NOTICE_SECONDS = 6.0  # [s]


@dataclass
class Frame:
    """One frame: the world applies `commands`, advances by `dt`, and is drawn for `cameras`, one an eye.

    dt          [s] to simulate;   time  [s], sum of all dt so far
    cameras     or a function that gives them, called after the world has moved; nothing is drawn without a camera
    hands       poses at the end of the frame
    commands    carried out before the step, as `in_order` sorts them
    max_step    longest step of the simulation [s]; None: one step of dt
    prop_poses  world_from_part of the skinned props (render/skinned_props.py), (P, 3, 4); None: unchanged
    """

    dt: float
    time: float
    cameras: Sequence[Camera] | Callable[[], Sequence[Camera]]
    hands: list[Hand] = field(default_factory=list)
    commands: list[Command] = field(default_factory=list)
    max_step: float | None = None
    prop_poses: np.ndarray | None = None


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
    timings: Timings  # of the frame's stages; the display adds its own and marks the end of each frame
    time: float = 0.0  # [s] of the world since the last reset

    # The picture
    picture: Any  # finished: ti.ndarray u32 (views * H, W), R | G<<8 | B<<16 | A<<24, row 0 on top
    picture_size: tuple[int, int]  # (width, height) [px] of one view's picture
    pictures: int = 0  # number drawn so far: `picture` has changed when it has
    moving: bool = False  # whether anything moved in the last frame
    simulation_cost: float | None = None  # [s] of computing for a second of simulation; None: not known yet
    wanted_view: tuple[Vec3, Vec3] | None = None  # eye and target [m] of a loaded state; a new object each

    # The play
    paused: bool = False
    demo: bool = False  # whether the scene's scripted hand plays
    interaction: str = "physics"  # or "transform"
    light: Light | None = None  # None: the scene has none and cannot get one
    gravity: Vec3 = (0.0, 0.0, 0.0)  # [m/s^2]
    time_scale: float = 1.0  # seconds of the world in a second of the user's
    score: int = 0  # of the scene's game
    message: str = ""  # of the scene's game
    notice: str = ""  # about the last command, for some seconds
    opening: str = ""  # progress of what is being opened (`OpenScene` and the like), "" while nothing is
    film_seconds: float | None = None  # length of the film that is being written; None: there is none
    sound: bool | None = None  # whether impacts are heard; None: there is nothing to hear them with

    # Bodies and room
    editable: bool = False  # whether there are bodies that commands can change
    selected: int | None = None  # index of the body that was last held or pointed at
    recently_selected: bool = False  # whether that was, or was changed, within the last seconds
    softened: Sequence[tuple[str, float, float]] = ()  # bodies simulated softer than asked: name, Young's moduli [Pa]
    room_middle: np.ndarray | None = None  # (3,) [m], about which a room of the user is turned; None: there is none

    # A viewer of splat files
    file: Any = None  # that is shown, a ViewedFile (display/viewed_file.py)
    file_number: tuple[int, int] = (0, 0)  # its number, from 1, and how many there are
    axes: bool = False  # whether the axes are shown
    up_choices: Sequence[tuple[str, float, np.ndarray]] = ()  # that may point up, probabilities, pictures

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

    def surface(self, camera: Camera, u: float, v: float) -> np.ndarray | None:
        """Point (3,) [m] of what a camera sees at a pixel; None: nothing opaque."""
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


class Closing(Protocol):
    """Base of what is used in a `with`, which closes it."""

    def close(self) -> None: ...

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error) -> None:
        self.close()


class Display(Closing, Protocol):
    """A window, a headset, or no screen: makes frames for a world and shows it. `close` gives the screen back; further
    calls do nothing."""

    size: tuple[int, int]  # (width, height) of one view's picture [px] that suits the display now

    def loading(self, text: str, picture=None) -> None:
        """Show a line of text while the world is made, over a picture as `WorldView.picture` once there is one.

        Raises Cancelled if the user does not want to wait.
        """

    def show_scene(self, scene: Scene, title: str, name: str) -> None:
        """Show this scene from now on, from where it begins; `frames` is then called again, with its world."""
        ...

    def frames(self, world: WorldView) -> Iterator[Frame]:
        """Frames until the user quits or the planned number is reached."""
        ...

    def present(self, world: WorldView) -> None:
        """Show the world's picture after its step."""
        ...


class Notice:
    """The last message; `shown` is empty once its time is over."""

    def __init__(self):
        self._text, self._until = "", 0.0

    @property
    def shown(self) -> str:
        """The message while it is to be seen."""
        return self._text if monotonic() < self._until else ""

    def tell(self, text: str) -> None:
        """Show a message from now on."""
        self._text, self._until = text, monotonic() + NOTICE_SECONDS

    def clear(self) -> None:
        """Show nothing."""
        self._until = 0.0
