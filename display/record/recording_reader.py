"""Reader of recordings, which are untrusted: everything is checked before it is used."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated, Any, Literal

import numpy as np

from assets.hdf5 import Hdf5Reader
from core.camera import Camera
from core.typed import Range, Size, field_types, from_json, from_plain
from core.vocabulary import Hand, Touch
from display.protocol import Frame
from display.record.recording_file import CAMERA_SIZE, JournalReader
from display.user_commands import Command, commands_from_text
from render import SORTS

MAX_FRAME_DT = 10.0  # [s]
HANDS_MAX, CAMERAS_MAX, SIDE_MAX = 16, 2, 16384  # of a frame; [px]
TOUCHES_MAX = 1000  # finger capsules of a hand
Reader = Hdf5Reader | JournalReader
Text = Annotated[str, Size(4096)]
Vertices = Annotated[int, Range(1, 1e9)]
Interaction, Embedding = Literal["physics", "transform"], Literal["two-level", "one-level"]


@dataclass(frozen=True)
class WorldOptions:
    """Options of a world in a recording."""

    interaction: Interaction | None = None
    embedding: Embedding | None = None
    sort: Literal[*SORTS] | None = None
    fingers: bool | None = None


@dataclass(frozen=True)
class About:
    """Options of the command in a recording, which make the world what it is; None: not given."""

    scene: Text
    body: Annotated[list[Text], Size(64)] | Text | None = None
    stage: Text | None = None
    material: Text | None = None
    interaction: Interaction | None = None
    embedding: Embedding | None = None
    sort: Literal[*SORTS] | None = None
    seed: int | None = None
    up: Literal["+x", "-x", "+y", "-y", "+z", "-z"] | None = None
    scale: Annotated[float, Range(1e-9, 1e9)] | None = None
    vertices: Annotated[list[Vertices], Size(64)] | Vertices | None = None
    cells: Literal["adaptive", "uniform"] | None = None
    pieces: bool | None = None
    options: dict[str, bool | int | float | Text] | None = None
    detail: Literal["shipped", "paper"] | None = None
    state: Text | None = None
    arch: Literal["cpu", "cuda"] | None = None
    world: WorldOptions = field(default_factory=WorldOptions)


OPTIONS = tuple(name for name in field_types(About) if name not in ("arch", "world"))


def checked_about(text: str, where: str) -> dict:
    """The known entries of the text `about`, checked. Raises BadInput."""
    given = from_json(dict[str, Any], text, where)
    about = {key: value for key, value in given.items() if key in field_types(About)}
    if isinstance(about.get("world"), dict):
        about["world"] = {key: value for key, value in about["world"].items() if key in field_types(WorldOptions)}
    from_plain(About, about, f"{where}: about")
    return about


def finite(
    file: Reader, name: str, shape: tuple = (None,), *, low: float = -np.inf, high: float = np.inf
) -> np.ndarray:
    """A dataset of floats within bounds."""
    values = file.array(name, "f", shape).astype(np.float64)
    with np.errstate(invalid="ignore"):
        if not (np.isfinite(values) & (values >= low) & (values <= high)).all():
            raise file.error(f"{name} holds values out of range")
    return values


def counts(file: Reader, name: str, most: int, length: int | None = None, *, least: int = 0) -> np.ndarray:
    """A dataset of integers, `least` to `most`."""
    values = file.array(name, "iu", (length,)).astype(np.int64)
    if len(values) and (values.min() < least or values.max() > most):
        raise file.error(f"{name} holds values out of range")
    return values


def read_frames(file: Reader) -> list[Frame]:
    """All frames, checked."""
    dt = finite(file, "frames/dt", low=0.0, high=MAX_FRAME_DT)
    count = len(dt)
    time = finite(file, "frames/time", (count,), low=0.0)
    step = finite(file, "frames/step", (count,), low=0.0, high=MAX_FRAME_DT)
    hands = read_hands(file, counts(file, "frames/hands", HANDS_MAX, count))
    cameras = read_cameras(file, counts(file, "frames/cameras", CAMERAS_MAX, count))
    commands = read_commands(file, count)
    return [
        Frame(float(dt[k]), float(time[k]), cameras[k], hands[k], commands.get(k, []), max_step=float(step[k]) or None)
        for k in range(count)
    ]


def read_hands(file: Reader, per_frame: np.ndarray) -> list[list]:
    """The hands of each frame."""
    count = int(per_frame.sum())
    if file.number("", "version") < 4:
        touches = touches_by_layouts(file, count)
    else:
        touches = counts(file, "hands/touches", TOUCHES_MAX, count, least=-1)
    sizes = np.where(touches < 0, 0, 9 + 7 * touches)
    numbers = finite(file, "hands/numbers", (int(sizes.sum()),))
    firsts = np.cumsum(sizes) - sizes
    hands = [hand_of(int(n), numbers[k : k + size]) for n, k, size in zip(touches, firsts, sizes, strict=True)]
    ends = np.cumsum(per_frame)
    return [hands[end - n : end] for end, n in zip(ends, per_frame, strict=True)]


def hand_of(touches: int, x: np.ndarray) -> Hand | None:
    """The hand of its numbers, None for -1 finger capsules."""
    if touches < 0:
        return None
    x = x.tolist()
    capsules = tuple(Touch(tuple(c[:3]), tuple(c[3:6]), c[6]) for c in (x[i : i + 7] for i in range(9, len(x), 7)))
    return Hand(tuple(x[:3]), tuple(x[3:7]), bool(x[7]), x[8], capsules)


def touches_by_layouts(file: Reader, count: int) -> np.ndarray:
    """Finger capsules of each hand until version 3, where a hand names one of the layouts of the file: "n", no hand, or
    {"c": "Hand", "f": {..., "touch": ["t", number of capsules, ...]}}."""
    touches = []
    for layout in from_json(list[Any], file.text("", "layouts"), f"{file.path}: layouts"):
        try:
            touch = [] if layout == "n" else layout["f"]["touch"]
            number = -1 if layout == "n" else touch[1] if len(touch) > 1 else 0
        except (LookupError, TypeError):
            number = None
        if type(number) is not int or not -1 <= number <= TOUCHES_MAX:
            raise file.error("a layout is not that of a hand")
        touches.append(number)
    which = counts(file, "hands/layout", max(len(touches) - 1, 0), count)
    if len(which) and not touches:
        raise file.error("its layouts are missing")
    return np.array(touches, np.int64)[which] if touches else which


def read_cameras(file: Reader, per_frame: np.ndarray) -> list[list[Camera]]:
    """The cameras of each frame."""
    values = finite(file, "cameras/values", (int(per_frame.sum()), CAMERA_SIZE), low=-1e9, high=1e9)
    sides, focal = values[:, :2], values[:, 2:4]
    if len(values) and not (sides.min() >= 1 and sides.max() <= SIDE_MAX and focal.min() > 0):
        raise file.error("cameras/values holds a camera out of range")
    cameras = [Camera(int(v[0]), int(v[1]), *v[2:6].tolist(), v[6:].reshape(4, 4)) for v in values]
    ends = np.cumsum(per_frame)
    return [cameras[end - n : end] for end, n in zip(ends, per_frame, strict=True)]


def read_commands(file: Reader, count: int) -> dict[int, list[Command]]:
    """The commands of the frames that have some."""
    commands = {}
    text = file.array("commands/text", "iu", (None,)).astype(np.uint8).tobytes()
    try:
        lines = text.decode().splitlines()
    except UnicodeDecodeError as e:
        raise file.error("commands/text is no text") from e
    for line in lines:
        frame, given = commands_from_text(line, str(file.path))
        if not 0 <= frame < count:
            raise file.error("commands/text names a frame beyond the last")
        commands[frame] = given
    return commands


def read_states(file: Reader, frames: int) -> dict[int, np.ndarray]:
    """Centroids (B, 3) of the bodies, by the frame after which they were recorded."""
    where = counts(file, "states/frame", max(frames - 1, 0))
    per_state = counts(file, "states/count", 1_000_000, len(where))
    centroids = file.array("states/centroids", "f", (int(per_state.sum()), 3)).astype(np.float64)
    ends = np.cumsum(per_state)
    return {int(k): centroids[end - n : end] for k, end, n in zip(where, ends, per_state, strict=True)}
