"""Safe access to files: system errors become BadInput, sizes are bounded, and writing is atomic and exclusive."""

from __future__ import annotations

import os
import shutil
import tempfile
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

from core.errors import BadInput

PICTURES = (".png", ".jpg", ".jpeg", ".webp")  # suffixes of pictures that are written
UNPACK_BASE = 64 << 20  # [bytes] that even the smallest file may unpack to
UNPACK_RATIO = 200  # and this many times its own size: splats deflate 1.1 to 20 times, constant grids about 1,000
LOCK_PATIENCE = 10.0  # [s] after which a lock was left by a program that was killed: writing takes a fraction of one


def unpack_bound(size: int) -> int:
    """Largest unpacked size [bytes] of a compressed file of `size` bytes; more is a bomb or a damaged header."""
    return UNPACK_BASE + UNPACK_RATIO * size


def file_size(path: Path) -> int:
    """Size of an existing regular file [bytes]. Raises BadInput."""
    try:
        if path.is_dir():
            raise BadInput(f"{path}: is a folder, not a file")
        if path.exists() and not path.is_file():
            raise BadInput(f"{path}: is not a regular file")
        size = path.stat().st_size
    except FileNotFoundError as e:
        raise BadInput(f"{path}: no such file") from e
    except (OSError, ValueError) as e:  # ValueError: a null byte in the name
        raise BadInput(f"{path}: cannot be read ({getattr(e, 'strerror', None) or e})") from e
    if size == 0:
        raise BadInput(f"{path}: is empty")
    return size


@contextmanager
def open_input(path: Path) -> Iterator:
    """Open a file for reading bytes; system errors become BadInput."""
    file_size(path)
    try:
        with open(path, "rb") as file:
            yield file
    except OSError as e:
        raise BadInput(f"{path}: cannot be read ({e.strerror or e})") from e


def check_writable(path: Path, part: Path | None = None, *, bytes_needed: float = 0.0) -> None:
    """Check, before any time is spent, that a file can be written by way of `part` beside it. Raises BadInput."""
    part = part or path.with_name(f".{path.name}.part")
    if path.is_dir():
        raise BadInput(f"{path}: is a folder")
    try:
        with open(part, "wb"):
            pass
    except OSError as e:
        raise BadInput(f"{path}: cannot write here ({e.strerror})") from e
    part.unlink()
    check_space(path, bytes_needed)


def check_space(path: Path, bytes_needed: float) -> None:
    """Raise BadInput if the disk of a file's folder has less left."""
    free = shutil.disk_usage(path.parent).free
    if free < bytes_needed:
        raise BadInput(f"{path}: the disk has {free / 1e6:.0f} MB left, about {bytes_needed / 1e6:.0f} MB are needed")


def make_folder(folder: Path) -> None:
    """Make a folder that can be written to, with those above it, unless it is there. Raises BadInput."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as e:
        raise BadInput(f"{folder}: cannot be written to ({e.strerror})") from e


@contextmanager
def atomic_write(path: str | Path) -> Iterator[Path]:
    """Yield a name beside `path` to write to; that file replaces `path` only if the block succeeds."""
    path = Path(path)
    if path.is_dir():
        raise BadInput(f"{path}: is a folder, not a file")
    if not path.parent.is_dir():
        raise BadInput(f"{path}: the folder {path.parent} does not exist")
    beside = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        yield beside
        os.replace(beside, path)
    except OSError as e:
        raise BadInput(f"{path}: cannot be written ({e.strerror or e})") from e
    finally:
        beside.unlink(missing_ok=True)


@contextmanager
def atomic_write_all(*paths: str | Path) -> Iterator[list[Path]]:
    """As `atomic_write`, for several files: none is replaced before all are written."""
    with ExitStack() as stack:
        besides = [stack.enter_context(atomic_write(path)) for path in paths]
        try:
            yield besides
        except BadInput as e:  # of a writer, which knows only the name it was given
            text = str(e)
            for beside, path in zip(besides, paths, strict=True):
                text = text.replace(str(beside), str(path))
            raise BadInput(text) from e


@contextmanager
def locked(path: Path, *, patience: float | None = None) -> Iterator[None]:
    """Keep other programs from changing the file meanwhile; they are waited for, `patience` [s] at most.

    Raises BadInput.
    """
    patience = LOCK_PATIENCE if patience is None else patience
    lock, waited = path.with_name(f".{path.name}.lock"), 0.0
    while True:
        try:
            os.close(os.open(lock, os.O_CREAT | os.O_EXCL))
            break
        except FileExistsError:
            if waited >= patience:
                lock.unlink(missing_ok=True)
            time.sleep(0.05)
            waited += 0.05
        except OSError as e:
            raise BadInput(f"{path}: cannot write here ({e.strerror})") from e
    try:
        yield
    finally:
        lock.unlink(missing_ok=True)


def unused_name(path: Path) -> Path:
    """The path itself if nothing has that name, else the first of `NAME_2.END`, `NAME_3.END`, ... that is free."""
    number, free = 2, path
    while os.path.lexists(free):
        free, number = path.with_name(f"{path.stem}_{number}{path.suffix}"), number + 1
    return free
