"""Safe access to files: system errors become BadInput, sizes are bounded, and writing is atomic and exclusive."""

from __future__ import annotations

import json
import os
import re
import secrets
import shutil
import sys
import tempfile
import time
from collections.abc import Container, Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

from core.errors import BadInput
from core.typed import to_json

PICTURES = (".png", ".jpg", ".jpeg", ".webp")  # suffixes of pictures that are written
UNPACK_BASE = 64 << 20  # [bytes] that even the smallest file may unpack to
UNPACK_RATIO = 200  # and this many times its own size: splats deflate 1.1 to 20 times, constant grids about 1,000
LOCK_PATIENCE = 10.0  # [s] for which other programs that write the same file are waited for: a fraction of one is usual
LOCK_PERIOD = 0.02  # [s] between two tries
LOCKED_BYTE = 1 << 20  # on Windows: it cannot be read by others, those before it can
FOLDER_LOCK = ".vrgs.lock"  # in a folder that is being written
STALE_AGE = 600.0  # [s] since a temporary file was last written to; its program was killed


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


def read_json(path: Path, size_max: int):
    """Content of a JSON file of at most `size_max` bytes. Raises BadInput."""
    with open_input(path) as file:
        data = file.read(size_max + 1)
    if len(data) > size_max:
        raise BadInput(f"{path}: larger than {size_max >> 20} MiB")
    try:
        return json.loads(data.decode("utf-8"))
    except (ValueError, RecursionError) as e:
        raise BadInput(f"{path}: not a JSON file ({e})") from e


def write_json(path: str | Path, value) -> None:
    """Write a value as a JSON file (core/typed.py), whole or not at all. Raises BadInput."""
    with atomic_write(path) as beside:
        beside.write_text(to_json(value, indent=1) + "\n", encoding="utf-8")


def check_writable(path: Path, part: Path | None = None, *, bytes_needed: float = 0.0) -> None:
    """Check, before any time is spent, that a file can be written by way of `part` beside it. Raises BadInput."""
    part = part or part_beside(path)
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


def part_beside(path: Path, suffix: str = "") -> Path:
    """Name for a file beside `path` to be written first: another one each time, hidden on most systems."""
    return path.with_name(f".{path.name}.{secrets.token_hex(4)}.part{suffix}")


def remove_stale_parts(path: Path) -> None:
    """Remove what killed programs have left beside `path` of `part_beside`."""
    pattern = re.compile(rf"\.{re.escape(path.name)}\.[0-9a-f]{{8}}\.part(\.\w+)?")
    with suppress(OSError):
        for found in os.scandir(path.parent):
            if pattern.fullmatch(found.name) and time.time() - found.stat().st_mtime > STALE_AGE:
                Path(found.path).unlink(missing_ok=True)


def reason_of(error: Exception) -> str:
    """The system's reason for a failed call, in a few words; HDF5 hides it in a long text."""
    number = re.search(r"errno = (\d+)", str(error))
    if number:
        return os.strerror(int(number[1]))
    return getattr(error, "strerror", None) or " ".join(str(error).split())[:100]


@contextmanager
def atomic_write(path: str | Path) -> Iterator[Path]:
    """Yield a name beside `path` to write to; that file replaces `path` only if the block succeeds."""
    path = Path(path)
    if path.is_dir():
        raise BadInput(f"{path}: is a folder, not a file")
    if not path.parent.is_dir():
        raise BadInput(f"{path}: the folder {path.parent} does not exist")
    remove_stale_parts(path)
    beside = part_beside(path)
    try:
        yield beside
        os.replace(beside, path)
    except OSError as e:
        raise BadInput(f"{path}: cannot be written ({reason_of(e)})") from e
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

    The system holds the lock, and gives it back if the program is killed. Raises BadInput.
    """
    lock, waited = path.with_name(f".{path.name}.lock"), 0.0
    patience = LOCK_PATIENCE if patience is None else patience
    while (held := _try_lock(path, lock)) is None:
        if waited >= patience:
            raise BadInput(f"{path}: another program{_holder(lock)} has been writing it for {patience:g} s")
        time.sleep(LOCK_PERIOD)
        waited += LOCK_PERIOD
    try:
        yield
    finally:
        _unlock(lock, held)


@contextmanager
def locked_folder(folder: Path) -> Iterator[None]:
    """Make the folder and keep other runs of the program from writing to it meanwhile: a lock as in `locked`, without
    waiting. A new folder that stays empty is removed. Raises BadInput.
    """
    new = [f for f in (folder, *folder.parents) if not f.exists()]
    make_folder(folder)
    lock = folder / FOLDER_LOCK
    held = _try_lock(folder, lock)
    if held is None:
        raise BadInput(f"{folder} is being written by another run of vrgs{_holder(lock)}")
    try:
        yield
    finally:
        _unlock(lock, held)
        with suppress(OSError):
            for made in new:
                made.rmdir()


def _try_lock(path: Path, lock: Path) -> int | None:
    """Descriptor of the lock's file, None if another program has it. Raises BadInput."""
    try:
        descriptor = os.open(lock, os.O_CREAT | os.O_RDWR)
    except OSError as e:
        if sys.platform == "win32" and isinstance(e, PermissionError) and lock.exists():  # it is being removed
            return None
        raise BadInput(f"{path}: cannot write here ({e.strerror})") from e
    try:
        if sys.platform == "win32":
            import msvcrt

            os.lseek(descriptor, LOCKED_BYTE, os.SEEK_SET)
            msvcrt.locking(descriptor, msvcrt.LK_NBLCK, 1)
            os.lseek(descriptor, 0, os.SEEK_SET)
        else:
            import fcntl

            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            if os.stat(lock).st_ino != os.fstat(descriptor).st_ino:
                raise FileNotFoundError  # its last holder has removed it; there is another one by that name
    except OSError as e:
        os.close(descriptor)
        if isinstance(e, (BlockingIOError, PermissionError, FileNotFoundError)):
            return None
        raise BadInput(f"{path}: cannot be locked ({e.strerror})") from e
    with suppress(OSError):  # only to be told to others; the disk may be full
        os.ftruncate(descriptor, 0)
        os.write(descriptor, str(os.getpid()).encode())
    return descriptor


def _unlock(lock: Path, held: int) -> None:
    if sys.platform == "win32":  # where an open file cannot be removed
        os.close(held)
        with suppress(OSError):
            lock.unlink()
    else:
        lock.unlink(missing_ok=True)
        os.close(held)


def _holder(lock: Path) -> str:
    """ " (process 1234)" of the program that holds a lock; "" if it is not known."""
    try:
        number = lock.read_bytes()[:20]
    except OSError:
        return ""
    return f" (process {number.decode()})" if number.isdigit() else ""


def unused_name(path: Path, taken: Container[Path] = ()) -> Path:
    """The path if nothing has that name and it is not taken, else the first such of `NAME_2.END`, `NAME_3.END`, ..."""
    number, free = 2, path
    while os.path.lexists(free) or free in taken:
        free, number = path.with_name(f"{path.stem}_{number}{path.suffix}"), number + 1
    return free
