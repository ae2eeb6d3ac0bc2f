"""The border between files and the program: what every reader and writer of a file must do."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import numpy as np

from assets.gaussians import Gaussians
from core.errors import BadInput

Report = Callable[[str], None]

LOG_SCALE_MAX = 40.0  # exp(2 * 40) = 5.5e34: the largest variance still fits float32 with room for a sum
MAGNITUDE_MAX = 1e15  # [m]; squared distances between such points still fit float32
ALPHA_EPSILON = 1e-6  # opacities read from 8 bits stay this far from 0 and 1, so that the logit is finite

UNPACK_BASE = 64 << 20  # [bytes] that even the smallest file may unpack to
UNPACK_RATIO = 200  # and as many times its own size: splats deflate 1.1-20 times, constant grids about 1,000


def unpack_bound(size: int) -> int:
    """How much a compressed file of `size` bytes may unpack to [bytes]; more is a bomb or a damaged header."""
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
    """The file opened for reading as bytes; the system's refusals become BadInput."""
    file_size(path)
    try:
        with open(path, "rb") as file:
            yield file
    except OSError as e:
        raise BadInput(f"{path}: cannot be read ({e.strerror or e})") from e


@contextmanager
def atomic_write(path: str | Path) -> Iterator[Path]:
    """A name beside `path` to write to; it takes the place of `path` only if the block succeeds."""
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
    """As `replacing`, for several files: none takes its place before all are written."""
    with ExitStack() as stack:
        besides = [stack.enter_context(atomic_write(path)) for path in paths]
        try:
            yield besides
        except BadInput as e:  # of a writer, which knows only the name it was given
            text = str(e)
            for beside, path in zip(besides, paths, strict=True):
                text = text.replace(str(beside), str(path))
            raise BadInput(text) from e


def logit_of_byte(alpha: np.ndarray) -> np.ndarray:
    """Logits of 8-bit opacities."""
    a = np.clip(alpha / 255.0, ALPHA_EPSILON, 1 - ALPHA_EPSILON)
    return np.log(a / (1 - a)).astype(np.float32)


def byte_of_logit(logits: np.ndarray) -> np.ndarray:
    """8-bit opacities of logits, float64 and rounded."""
    return np.round(255.0 / (1.0 + np.exp(-np.clip(logits.astype(np.float64), -80, 80))))


def usable(means, quats, log_scales, logit_opacities, sh) -> np.ndarray:
    """Mask (N,) of the Gaussians that can be drawn: finite, with a rotation, and finite still when squared."""
    n = len(means)
    with np.errstate(invalid="ignore", over="ignore"):
        rows = np.concatenate([means, sh.reshape(n, -1), logit_opacities.reshape(n, 1)], axis=1)
        mask = (np.abs(rows) < MAGNITUDE_MAX).all(1)  # NaN compares false
        mask &= (log_scales <= LOG_SCALE_MAX).all(1) & np.isfinite(log_scales).all(1)
        norm = np.linalg.norm(np.asarray(quats, np.float64), axis=1)
        return mask & (norm > 1e-6) & np.isfinite(norm)


def usable_gaussians(path: Path, means, quats, log_scales, logit_opacities, sh, report: Report) -> Gaussians:
    """Gaussians of the rows that can be drawn; says in one line how many were dropped. Raises BadInput if none is."""
    n = len(means)
    if n == 0:
        raise BadInput(f"{path}: holds no Gaussians")
    with np.errstate(invalid="ignore"):  # a signalling NaN
        quats = np.asarray(quats, np.float64)  # the norm of 1e30 overflows in float32
    keep = usable(means, quats, log_scales, logit_opacities, sh)
    dropped = n - int(keep.sum())
    if dropped == n:
        raise BadInput(f"{path}: none of its {n} Gaussians is finite and has a rotation")
    columns = [means, quats, log_scales, logit_opacities, sh]
    if dropped:
        report(f"{path}: dropped {dropped} of {n} Gaussians that are not finite or have no rotation")
        columns = [c[keep] for c in columns]
    columns[1] = columns[1] / np.linalg.norm(columns[1], axis=1, keepdims=True)
    return Gaussians.of(*columns)
