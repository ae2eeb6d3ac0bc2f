"""The file of a recording, HDF5 (docs/formats.md, Recordings), and the journal that it is made of while it is recorded.

The journal, FILE.part, only grows: JOURNAL, then blocks of the columns of DATASETS, about one a second. A block is a
line of JSON with the number of bytes of each column, and these bytes. The journal of a session that ended abnormally is
a recording up to its last whole block: `--replay FILE.part` plays it.
"""

from __future__ import annotations

import io
import json
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal

import h5py
import numpy as np

from assets.file_access import atomic_write, file_size, open_input
from assets.hdf5 import Hdf5Reader, new_hdf5, open_hdf5, runs, write_dataset, write_text
from core.camera import Camera
from core.errors import BadInput
from core.typed import Range, Size, field_types, from_json, from_plain
from core.vocabulary import Hand, Touch
from display.protocol import Frame
from display.user_commands import Command, commands_from_text
from render import SORTS

FORMAT, VERSION = "vrgs-recording", 6
# 1: bodies were not of their own material; 2: there was one body at most; 3: `layouts` told what hands consist of
JOURNAL = b"vrgs-journal 4\n"
HEADER_MAX = 4096  # [bytes] of the line before a block
CAMERA_SIZE = 22  # numbers of a camera
MAX_FRAME_DT = 10.0  # [s]
HANDS_MAX, CAMERAS_MAX, SIDE_MAX = 16, 2, 16384  # of a frame; [px]
TOUCHES_MAX, BODIES_MAX = 1000, 1_000_000  # finger capsules of a hand; bodies of a state
NUMBER_MAX = sys.float_info.max  # finite
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


def read_journal(path: Path) -> dict[str, np.ndarray]:
    """The columns of a journal up to its last whole block. Raises BadInput."""
    parts: dict[str, list[bytes]] = {name: [] for name in COLUMNS}
    size, blocks = file_size(path), 0
    with open_input(path) as file:
        file.seek(len(JOURNAL))
        while (header := file.readline(HEADER_MAX)).endswith(b"\n"):
            lengths = from_json(Header, header, f"{path}: block {blocks}")
            if file.tell() + sum(lengths.values()) > size:
                break  # the program ended while it wrote this one
            for name, length in lengths.items():
                parts[name].append(file.read(length))
            blocks += 1
    columns = {}
    for name, (shape, dtype) in COLUMNS.items():
        content = b"".join(parts.pop(name))
        if len(content) % (np.dtype(dtype).itemsize * int(np.prod(shape))):
            raise BadInput(f"{path}: {name} ends within a row")
        columns[name] = np.frombuffer(content, dtype).reshape(-1, *shape)
    return columns


def fill_recording(file: h5py.File, columns: Mapping[str, np.ndarray]) -> None:
    """Out: the file of the columns of a journal."""
    write_text(file, "format", FORMAT)
    write_text(file, "about", columns["about"].tobytes().decode(errors="replace"))
    file.attrs["version"] = VERSION
    for name, (shape, dtype) in DATASETS.items():
        if len(columns[name]):
            write_dataset(file, name, columns[name], dtype)
        else:
            file.create_dataset(name, (0, *shape), dtype)


def write_recording(path: Path, journal: Path) -> None:
    """Make the recording of a journal, whole or not at all. Raises BadInput."""
    columns = read_journal(journal)
    with atomic_write(path) as beside, new_hdf5(beside) as file:
        fill_recording(file, columns)


@contextmanager
def open_recording(path: Path) -> Iterator[Hdf5Reader]:
    """Open a recording for reading, or the one that is made of a journal, in memory. Raises BadInput."""
    with open_input(path) as file:
        is_journal = file.read(len(JOURNAL)) == JOURNAL
    if not is_journal:
        with open_hdf5(path) as reader:
            yield reader
        return
    image = io.BytesIO()
    with h5py.File(image, "w") as file:
        fill_recording(file, read_journal(path))
    with h5py.File(image, "r") as file:
        yield Hdf5Reader(path, file, image.getbuffer().nbytes)


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


def read_frames(file: Hdf5Reader) -> list[Frame]:
    """All frames, checked."""
    dt = file.floats("frames/dt", (None,), np.float64, within=(0.0, MAX_FRAME_DT))
    count = len(dt)
    time = file.floats("frames/time", (count,), np.float64, within=(0.0, NUMBER_MAX))
    step = file.floats("frames/step", (count,), np.float64, within=(0.0, MAX_FRAME_DT))
    hands = read_hands(file, file.indices("frames/hands", (count,), np.int64, high=HANDS_MAX))
    cameras = read_cameras(file, file.indices("frames/cameras", (count,), np.int64, high=CAMERAS_MAX))
    commands = read_commands(file, count)
    return [
        Frame(float(dt[k]), float(time[k]), cameras[k], hands[k], commands.get(k, []), max_step=float(step[k]) or None)
        for k in range(count)
    ]


def read_hands(file: Hdf5Reader, per_frame: np.ndarray) -> list[list[Hand | None]]:
    """The hands of each frame."""
    count = int(per_frame.sum())
    if file.number("", "version") < 4:
        touches = touches_by_layouts(file, count)
    else:
        touches = file.indices("hands/touches", (count,), np.int64, low=-1, high=TOUCHES_MAX)
    sizes = np.where(touches < 0, 0, 9 + 7 * touches)
    numbers = file.floats("hands/numbers", (int(sizes.sum()),), np.float64, within=(-NUMBER_MAX, NUMBER_MAX))
    hands = [hand_of(int(n), numbers[run]) for n, run in zip(touches, runs(sizes), strict=True)]
    return [hands[run] for run in runs(per_frame)]


def hand_of(touches: int, x: np.ndarray) -> Hand | None:
    """The hand of its numbers, None for -1 finger capsules."""
    if touches < 0:
        return None
    x = x.tolist()
    capsules = tuple(Touch(tuple(c[:3]), tuple(c[3:6]), c[6]) for c in (x[i : i + 7] for i in range(9, len(x), 7)))
    return Hand(tuple(x[:3]), tuple(x[3:7]), bool(x[7]), x[8], capsules)


def touches_by_layouts(file: Hdf5Reader, count: int) -> np.ndarray:
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
    which = file.indices("hands/layout", (count,), np.int64, high=max(len(touches) - 1, 0))
    if len(which) and not touches:
        raise file.error("its layouts are missing")
    return np.array(touches, np.int64)[which] if touches else which


def read_cameras(file: Hdf5Reader, per_frame: np.ndarray) -> list[list[Camera]]:
    """The cameras of each frame."""
    values = file.floats("cameras/values", (int(per_frame.sum()), CAMERA_SIZE), np.float64, within=(-1e9, 1e9))
    sides, focal = values[:, :2], values[:, 2:4]
    if len(values) and not (sides.min() >= 1 and sides.max() <= SIDE_MAX and focal.min() > 0):
        raise file.error("cameras/values holds a camera out of range")
    cameras = [Camera(int(v[0]), int(v[1]), *v[2:6].tolist(), v[6:].reshape(4, 4)) for v in values]
    return [cameras[run] for run in runs(per_frame)]


def read_commands(file: Hdf5Reader, count: int) -> dict[int, list[Command]]:
    """The commands of the frames that have some."""
    commands = {}
    try:
        lines = file.indices("commands/text", (None,), np.uint8).tobytes().decode().splitlines()
    except UnicodeDecodeError as e:
        raise file.error("commands/text is no text") from e
    for line in lines:
        frame, given = commands_from_text(line, str(file.path))
        if not 0 <= frame < count:
            raise file.error("commands/text names a frame beyond the last")
        commands[frame] = given
    return commands


def read_states(file: Hdf5Reader, frames: int) -> dict[int, np.ndarray]:
    """Centroids (B, 3) of the bodies, by the frame after which they were recorded."""
    where = file.indices("states/frame", (None,), np.int64, high=max(frames - 1, 0))
    per_state = file.indices("states/count", (len(where),), np.int64, high=BODIES_MAX)
    centroids = file.floats("states/centroids", (int(per_state.sum()), 3), np.float64)
    return {int(k): centroids[run] for k, run in zip(where, runs(per_state), strict=True)}
