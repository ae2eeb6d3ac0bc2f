"""Files inside a ZIP archive, without trust in what it claims."""

from __future__ import annotations

import struct
import zipfile
import zlib
from pathlib import Path

from core.errors import BadInput

METHODS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
ENCRYPTED = 1  # flag of an entry
# What zipfile raises on damaged archives; RuntimeError includes NotImplementedError.
DAMAGE = (zipfile.BadZipFile, zlib.error, struct.error, EOFError, ValueError, RuntimeError, OverflowError)


class Archive:
    """A ZIP archive opened for reading, as a context; every defect is BadInput and names `path`."""

    def __init__(self, path: Path, file) -> None:
        self.path = path
        try:
            self._zip = zipfile.ZipFile(file)
        except DAMAGE as e:
            raise BadInput(f"{path}: not a ZIP archive, or a truncated one") from e

    def __enter__(self) -> Archive:
        return self

    def __exit__(self, *_) -> None:
        self._zip.close()

    def names(self) -> list[str]:
        """All entries."""
        return self._zip.namelist()

    def read(self, name: str, *, most: int) -> bytes:
        """The content of an entry of at most `most` bytes, asked before anything is unpacked. Raises BadInput."""
        try:
            entry = self._zip.getinfo(name)
        except KeyError as e:
            raise BadInput(f"{self.path}: holds no {name[:60]!r}") from e
        if entry.compress_type not in METHODS or entry.flag_bits & ENCRYPTED:
            raise BadInput(f"{self.path}: {name[:60]!r} is encrypted or of a method of compression that is not read")
        if entry.file_size > most:
            raise BadInput(f"{self.path}: {name[:60]!r} claims {entry.file_size} bytes, more than {most}")
        try:
            with self._zip.open(entry) as content:
                data = content.read(entry.file_size)
                if len(data) < entry.file_size or content.read(1):
                    raise BadInput(f"{self.path}: {name[:60]!r} is not of the size that the archive claims")
        except DAMAGE as e:
            raise BadInput(f"{self.path}: {name[:60]!r} is damaged") from e
        return data
