"""Progress of a preparation: shown on the screen, and kept on the disk so that a stopped run can resume.

Results of finished steps stay in the cache folder until the asset is written. Only arrays of numbers are kept, nothing
is unpickled. An entry that is damaged, or was made for another file, other options or another version of the
pipeline, is ignored.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import shutil
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import TextIO

import numpy as np

from assets.file_access import atomic_write
from assets.gaussians import ROWS, Gaussians
from core.errors import BadInput
from core.program import cache_folder

MAX_AGE = 14 * 86400.0  # [s]; older entries of abandoned runs are removed


class Checkpoints:
    """Steps of one run. Without a source file nothing is kept.

    folder   of the entries, None if nothing is kept
    resumed  steps whose results were read from there
    """

    def __init__(self, source: Path | None = None, options: dict | None = None, version: int = 0) -> None:
        self.folder, self.resumed = None, []
        if source is None:
            return
        digest = hashlib.sha256(json.dumps([version, sorted((options or {}).items())]).encode())
        with open(source, "rb") as file:
            while block := file.read(1 << 20):
                digest.update(block)
        entries = cache_folder() / "stages"
        self.folder = entries / digest.hexdigest()[:32]
        remove_old(entries, keep=self.folder)

    def step(self, name: str, make: Callable[[], dict[str, np.ndarray]]) -> dict[str, np.ndarray]:
        """Arrays of step `name`: read if they were kept, else made and kept."""
        kept = self._read(name)
        if kept is not None:
            self.resumed.append(name)
            return kept
        made = make()
        if self.folder:
            with contextlib.suppress(OSError, BadInput):  # a full disk is no reason to stop
                self.folder.mkdir(parents=True, exist_ok=True)
                with atomic_write(self.folder / f"{name}.npz") as beside, open(beside, "wb") as file:
                    np.savez(file, **made)
        return made

    def _read(self, name: str) -> dict[str, np.ndarray] | None:
        path = self.folder / f"{name}.npz" if self.folder else None
        if path is None or not os.path.isfile(path):  # Path.is_file may raise
            return None
        try:
            with np.errstate(all="ignore"), open(path, "rb") as opened, np.load(opened, allow_pickle=False) as file:
                found = {key: file[key] for key in file.files}  # the zip's checksums are verified
        except Exception:  # zipfile, zlib, tokenize and ast each have their own for a damaged file
            return None
        return found if all(isinstance(values, np.ndarray) for values in found.values()) else None

    def clear(self) -> None:
        """Remove the entries of this run: its asset is written, or none can be made of its splat."""
        self.resumed.clear()
        if self.folder:
            shutil.rmtree(self.folder, ignore_errors=True)


def remove_old(entries: Path, *, keep: Path) -> None:
    """Remove the folders of runs that were not touched for MAX_AGE."""
    with contextlib.suppress(OSError):
        for folder in entries.iterdir():
            if folder != keep and time.time() - folder.stat().st_mtime > MAX_AGE:
                shutil.rmtree(folder, ignore_errors=True)


def arrays_of(gaussians: Gaussians, **others) -> dict[str, np.ndarray]:
    """Gaussians as arrays by name; other keywords become JSON text in bytes."""
    text = np.frombuffer(json.dumps([gaussians.objects, gaussians.sort, others]).encode(), np.uint8)
    return {name: vars(gaussians)[name] for name in ROWS} | {"json": text}


def gaussians_of(arrays: dict[str, np.ndarray]) -> tuple[Gaussians, dict]:
    """Inverse of `arrays_of`."""
    objects, sort, others = json.loads(arrays["json"].tobytes())
    return Gaussians(*(arrays[name] for name in ROWS), tuple(objects), sort), others


Progress = Callable[[str, float], None]  # (step, fraction of it that is done)

BAR_WIDTH = 28  # [characters]
MIN_INTERVAL = 0.1  # [s] between two updates of the bar
FULL, EMPTY = "█", "░"


def no_progress(step: str, done: float) -> None:
    """Show nothing."""


class ProgressLines:
    """Prints a line on stderr when a step ends, with the time it took."""

    def __init__(self, steps: tuple[str, ...], out: TextIO | None = None) -> None:
        self.steps, self.out = steps, out or sys.stderr
        self.step, self.since = None, time.perf_counter()

    def __call__(self, step: str, done: float) -> None:
        if step != self.step:
            self._end()
            self.step, self.since = step, time.perf_counter()
        if done >= 1 and step == self.steps[-1]:
            self._end()

    def _end(self) -> None:
        if self.step is not None:
            number = self.steps.index(self.step) + 1
            seconds = time.perf_counter() - self.since
            print(f"  {number}/{len(self.steps)} {self.step:<8} {seconds:5.1f} s", file=self.out, flush=True)
        self.step = None

    def close(self) -> None:
        """Nothing to clear: a step that did not end has no line."""


class ProgressBar:
    """One line that is overwritten: how much is done, the step's name and the time so far.

    Each step takes an equal part of the bar; the fractions within it are the step's own.
    """

    def __init__(self, steps: tuple[str, ...], out: TextIO | None = None) -> None:
        self.steps, self.out = steps, out or sys.stderr
        self.since, self.shown, self.step = time.perf_counter(), 0.0, None

    def __call__(self, step: str, done: float) -> None:
        now = time.perf_counter()
        if step == self.step and now - self.shown < MIN_INTERVAL and done < 1:
            return
        self.step, self.shown = step, now
        fraction = (self.steps.index(step) + min(max(done, 0.0), 1.0)) / len(self.steps)
        full = round(fraction * BAR_WIDTH)
        text = f"  {FULL * full}{EMPTY * (BAR_WIDTH - full)} {fraction:4.0%}  {step:<8} {now - self.since:4.0f} s"
        columns = shutil.get_terminal_size().columns
        print(f"\r{text[: columns - 1]}\x1b[K", end="", file=self.out, flush=True)
        if fraction >= 1:
            self.close()

    def close(self) -> None:
        """Clear the line, so that the next output stands alone."""
        if self.step is not None:
            print("\r\x1b[K", end="", file=self.out, flush=True)
        self.step = None


def progress_on(out: TextIO, steps: tuple[str, ...]) -> ProgressLines | ProgressBar:
    """A bar where `out` is a terminal that can draw one, else lines."""
    encoding = (out.encoding or "").lower().replace("-", "")
    return (ProgressBar if out.isatty() and encoding == "utf8" else ProgressLines)(steps, out)
