"""The file of a recording, HDF5, and the journal that it is made of while it is recorded.

Root attributes: `format` "vrgs-recording", `version`, and `about` (JSON: the scene, the options, where kernels ran).

| dataset | shape, type | |
| --- | --- | --- |
| frames/dt, time, step | (F,) float64 | seconds; step 0: the whole dt at once |
| frames/hands, frames/cameras | (F,) int32 | number of each in a frame |
| hands/touches | (H,) int32 | finger capsules of the hands of all frames, concatenated; -1: a hand without a pose |
| hands/numbers | (N,) float64 | of each hand: position, rotation, grip, reach, then a, b and radius of its capsules |
| cameras/values | (C, 22) float64 | width, height, fx, fy, cx, cy, world_to_camera row by row |
| commands/text | (B,) uint8 | JSON lines, each with its frame: {"frame": 12, "pause": true} |
| states/frame, states/count | (S,) int64, int32 | frame and number of bodies of each state, about every second |
| states/centroids | (M, 3) float64 | [m] |

The journal, FILE.part, only grows: JOURNAL, then blocks of the same columns, about one a second. A block is a line of
JSON with the number of bytes of each column, and these bytes. The journal of a session that ended abnormally is a
recording up to its last whole block: `--replay FILE.part` plays it.
"""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np

from assets.file_access import atomic_write, file_size, open_input
from assets.hdf5 import Hdf5Reader, new_hdf5, open_hdf5, write_dataset, write_text
from core.camera import Camera
from core.errors import BadInput
from core.typed import Range, Size, field_types, from_json, from_plain
from core.vocabulary import Hand, Touch
from display.protocol import Frame
from display.user_commands import Command, commands_from_text
from render import SORTS

FORMAT, VERSION = "vrgs-recording", 4
# 1: bodies were not of their own material; 2: there was one body at most; 3: `layouts` told what hands consist of
JOURNAL = b"vrgs-journal 4\n"
HEADER_MAX = 4096  # [bytes] of the line before a block
CAMERA_SIZE = 22  # numbers of a camera
MAX_FRAME_DT = 10.0  # [s]
HANDS_MAX, CAMERAS_MAX, SIDE_MAX = 16, 2, 16384  # of a frame; [px]
TOUCHES_MAX = 1000  # finger capsules of a hand
Text = Annotated[str, Size(4096)]
Vertices = Annotated[int, Range(1, 1e9)]
Interaction, Embedding = Literal["physics", "transform"], Literal["two-level", "one-level"]
DATASETS: dict[str, tuple[tuple[int, ...], type]] = {
    "frames/dt": ((), np.float64),
    "frames/time": ((), np.float64),
    "frames/step": ((), np.float64),
    "frames/hands": ((), np.int32),
    "frames/cameras": ((), np.int32),
    "hands/touches": ((), np.int32),
    "hands/numbers": ((), np.float64),
    "cameras/values": ((CAMERA_SIZE,), np.float64),
    "commands/text": ((), np.uint8),
    "states/frame": ((), np.int64),
    "states/count": ((), np.int32),
    "states/centroids": ((3,), np.float64),
}
COLUMNS = {**DATASETS, "about": ((), np.uint8)}  # of the journal
Header = dict[Literal[*COLUMNS], Annotated[int, Range(0, 2**53)]]


class Journal:
    """A new file to which blocks of columns are appended, each whole or not at all.

    It is locked while it is open. Raises FileExistsError if there is one of that name, OSError if there can be none.
    """

    def __init__(self, path: Path):
        self.path = path
        self._file = open(path, "xb", buffering=0)  # noqa: SIM115 -- closed by `close`
        if sys.platform != "win32":
            import fcntl

            with suppress(OSError):  # a disk without locks
                fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        self._size = 0  # [bytes] of whole blocks
        try:
            self._write(JOURNAL)
        except OSError:
            self.close()
            path.unlink()
            raise

    def append(self, columns: Mapping[str, np.ndarray]) -> None:
        """Append a block. Raises OSError, and the file stays as it was."""
        parts = {name: np.ascontiguousarray(rows, COLUMNS[name][1]).tobytes() for name, rows in columns.items()}
        header = json.dumps({name: len(part) for name, part in parts.items()})
        self._write(b"".join([header.encode(), b"\n", *parts.values()]))

    def _write(self, data: bytes) -> None:
        left = memoryview(data)
        try:
            while left:
                left = left[self._file.write(left) :]
        except OSError:
            self._file.truncate(self._size)
            self._file.seek(self._size)
            raise
        self._size += len(data)

    def close(self) -> None:
        """Close the file and give its lock back."""
        self._file.close()


def is_locked(path: Path) -> bool:
    """True if another program has this journal open, as far as the system says so."""
    if sys.platform == "win32":
        return False
    import fcntl

    with open(path, "rb") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            return True
    return False


class JournalReader:
    """A journal, read like the HDF5 file that is made of it. Raises BadInput."""

    def __init__(self, path: Path):
        self.path = path
        self._blocks: list[tuple[int, dict[str, int]]] = []  # where the bytes of each begin, how many each column has
        size = file_size(path)
        with open_input(path) as file:
            file.seek(len(JOURNAL))
            while (header := file.readline(HEADER_MAX)).endswith(b"\n"):
                lengths = from_json(Header, header, f"{path}: block {len(self._blocks)}")
                if file.tell() + sum(lengths.values()) > size:
                    break  # the program ended while it wrote this one
                self._blocks.append((file.tell(), lengths))
                file.seek(sum(lengths.values()), os.SEEK_CUR)

    def error(self, defect: str) -> BadInput:
        """The error to raise."""
        return BadInput(f"{self.path}: {defect}")

    def number(self, name: str, key: str) -> float:
        """The version, which is the only number."""
        return VERSION

    def text(self, name: str, key: str) -> str:
        """The text `about` or `format`."""
        return FORMAT if key == "format" else self.column(key).tobytes().decode(errors="replace")

    def column(self, name: str) -> np.ndarray:
        """All rows of a column."""
        shape, dtype = COLUMNS[name]
        parts = []
        with open(self.path, "rb") as file:
            for at, lengths in self._blocks:
                keys = list(lengths)
                if name in keys:
                    file.seek(at + sum(lengths[key] for key in keys[: keys.index(name)]))
                    parts.append(file.read(lengths[name]))
        content = b"".join(parts)
        if len(content) % (np.dtype(dtype).itemsize * int(np.prod(shape))):
            raise self.error(f"{name} ends within a row")
        return np.frombuffer(content, dtype).reshape(-1, *shape)

    def array(self, name: str, kind: str, shape: tuple[int | None, ...]) -> np.ndarray:
        """A column of `kind` "f" or "iu", of a shape in which None stands for any length."""
        rows = self.column(name)
        if any(side not in (None, n) for side, n in zip(shape, rows.shape, strict=True)):
            raise self.error(f"{name} has shape {rows.shape}, expected {shape}")
        return rows


@contextmanager
def open_recording(path: Path) -> Iterator[Hdf5Reader | JournalReader]:
    """Open a recording or a journal for reading. Raises BadInput."""
    with open_input(path) as file:
        is_journal = file.read(len(JOURNAL)) == JOURNAL
    if is_journal:
        yield JournalReader(path)
    else:
        with open_hdf5(path) as reader:
            yield reader


def write_recording(path: Path, journal: Path) -> None:
    """Make the recording of a journal, whole or not at all. Raises BadInput."""
    reader = JournalReader(journal)
    with atomic_write(path) as beside, new_hdf5(beside) as file:
        write_text(file, "format", FORMAT)
        write_text(file, "about", reader.text("", "about"))
        file.attrs["version"] = VERSION
        for name, (shape, dtype) in DATASETS.items():
            rows = reader.column(name)
            if len(rows):
                write_dataset(file, name, rows, dtype)
            else:
                file.create_dataset(name, (0, *shape), dtype)


Reader = Hdf5Reader | JournalReader


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
