"""A file of HDF5 that grows in steps, each of which is written whole or, where the disk is full, not at all.

`h5py.File(GrowingFile(path), "w")` writes to it, and `commit` writes to the disk. HDF5 itself, after it fails to write,
tries again whenever the process ends, and crashes it; it never learns of a failure here.
"""

from __future__ import annotations

import os
import sys
from contextlib import suppress
from pathlib import Path


class GrowingFile:
    """A new file with the methods that h5py asks for; what they write is kept in memory until `commit`.

    The file is locked as HDF5 locks those that it writes. Raises FileExistsError if there is one of that name, OSError
    if there can be none.
    """

    def __init__(self, path: Path):
        self._file = open(path, "xb+", buffering=0)  # noqa: SIM115 -- closed by `close`
        if sys.platform != "win32":
            import fcntl

            with suppress(OSError):  # a disk without locks; HDF5 takes that, too
                fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        self._pending: list[tuple[int, bytes]] = []  # since the last commit: where [bytes], and what
        self._at = 0  # [bytes] position
        self._size = 0  # [bytes] as HDF5 has it
        self._written = 0  # [bytes] on the disk
        self._valid = 0  # [bytes] of these that have not been cut off since the last commit

    def seek(self, offset: int, whence: int = os.SEEK_SET) -> int:
        """Set the position."""
        self._at = offset + {os.SEEK_SET: 0, os.SEEK_CUR: self._at, os.SEEK_END: self._size}[whence]
        return self._at

    def tell(self) -> int:
        """The position [bytes]."""
        return self._at

    def write(self, data) -> int:
        """Keep bytes to be written at the position."""
        self._pending.append((self._at, bytes(data)))
        self._at += len(data)
        self._size = max(self._size, self._at)
        return len(data)

    def truncate(self, size: int) -> int:
        """Set the size [bytes]."""
        self._pending = [(at, data[: size - at]) for at, data in self._pending if at < size]
        self._valid, self._size = min(self._valid, size), size
        return size

    def readinto(self, buffer) -> int:
        """Fill the buffer from the position on, with zeros beyond the end."""
        buffer[:] = self._content(self._at, self._at + len(buffer))
        self._at += len(buffer)
        return len(buffer)

    def read(self, count: int) -> bytes:
        """`count` bytes from the position on, zeros beyond the end."""
        found = self._content(self._at, self._at + count)
        self._at += count
        return bytes(found)

    def flush(self) -> None:
        """Of HDF5 at any time: nothing is written before `commit`."""

    def _content(self, start: int, stop: int) -> bytearray:
        """Bytes start ... stop of the file as HDF5 has it."""
        content = bytearray(stop - start)
        if start < self._valid:
            self._file.seek(start)
            found = self._file.read(min(stop, self._valid) - start)
            content[: len(found)] = found
        for at, data in self._pending:
            low, high = max(at, start), min(at + len(data), stop)
            if low < high:
                content[low - start : high - start] = data[low - at : high - at]
        return content

    def commit(self) -> None:
        """Write what is pending to the disk: first what makes the file longer, since nothing else needs space.

        Raises OSError, and the file on the disk stays as it was.
        """
        try:
            self._put(self._written, self._content(self._written, self._size) if self._size > self._written else b"")
        except OSError:
            os.truncate(self._file.fileno(), self._written)
            raise
        if self._valid < self._written:
            self._put(self._valid, self._content(self._valid, min(self._written, self._size)))
        for at, data in self._pending:
            if at < self._valid:
                self._put(at, data[: self._valid - at])
        if self._size < self._written:
            os.truncate(self._file.fileno(), self._size)
        self._pending, self._written, self._valid = [], self._size, self._size

    def _put(self, at: int, data: bytes) -> None:
        """Write all of the bytes."""
        self._file.seek(at)
        left = memoryview(data)
        while left:
            left = left[self._file.write(left) :]

    def close(self) -> None:
        """Close the file; what was not committed is lost."""
        self._file.close()
