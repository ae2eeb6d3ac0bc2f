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
from pathlib import Path
from typing import Annotated, Literal

import numpy as np

from assets.file_access import atomic_write, file_size, open_input
from assets.hdf5 import Hdf5Reader, new_hdf5, open_hdf5, write_dataset, write_text
from core.errors import BadInput
from core.typed import Range, from_json

FORMAT, VERSION = "vrgs-recording", 4
# 1: bodies were not of their own material; 2: there was one body at most; 3: `layouts` told what hands consist of
JOURNAL = b"vrgs-journal 4\n"
HEADER_MAX = 4096  # [bytes] of the line before a block
CAMERA_SIZE = 22  # numbers of a camera
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
