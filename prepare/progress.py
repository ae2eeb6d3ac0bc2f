"""Progress of a preparation: shown on the screen, and kept on disk so that a stopped run can resume.

Results of finished steps stay in the cache folder until the asset is written: arrays of numbers, nothing is unpickled.
An entry that is damaged, or belongs to another file, other options or another version of the pipeline, is ignored.
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
        with open(source, "rb") as file:
            content = hashlib.file_digest(file, "sha256").hexdigest()
        key = json.dumps([version, sorted((options or {}).items()), content])
        entries = cache_folder() / "stages"
        self.folder = entries / hashlib.sha256(key.encode()).hexdigest()[:32]
        with contextlib.suppress(OSError):
            for other in entries.iterdir():
                if other != self.folder and time.time() - other.stat().st_mtime > MAX_AGE:
                    shutil.rmtree(other, ignore_errors=True)

    def step(self, name: str, make: Callable[[], dict[str, np.ndarray]]) -> dict[str, np.ndarray]:
        """Arrays of step `name`: read if they were kept, else made and kept."""
        if self.folder is None:
            return make()
        path = self.folder / f"{name}.npz"
        if (kept := read_arrays(path)) is not None:
            self.resumed.append(name)
            return kept
        made = make()
        with contextlib.suppress(OSError, BadInput):  # a full disk is no reason to stop
            self.folder.mkdir(parents=True, exist_ok=True)
            with atomic_write(path) as beside, open(beside, "wb") as file:
                np.savez(file, **made)
        return made

    def clear(self) -> None:
        """Remove the entries of this run: its asset is written, or none can be made of its splat."""
        self.resumed.clear()
        if self.folder:
            shutil.rmtree(self.folder, ignore_errors=True)


def read_arrays(path: Path) -> dict[str, np.ndarray] | None:
    """The arrays of an entry; None if it cannot be read."""
    if not os.path.isfile(path):  # Path.is_file may raise
        return None
    try:
        with np.errstate(all="ignore"), open(path, "rb") as opened, np.load(opened, allow_pickle=False) as file:
            found = {key: file[key] for key in file.files}  # the zip's checksums are verified
    except Exception:  # zipfile, zlib, tokenize and ast each have their own for a damaged file
        return None
    return found if all(isinstance(values, np.ndarray) for values in found.values()) else None


def arrays_of(gaussians: Gaussians, **others) -> dict[str, np.ndarray]:
    """Gaussians as arrays by name; other keywords become JSON text in bytes."""
    text = np.frombuffer(
        json.dumps([gaussians.objects, gaussians.sort, gaussians.antialias, gaussians.view, others]).encode(), np.uint8
    )
    return {name: vars(gaussians)[name] for name in ROWS} | {"json": text}


def gaussians_of(arrays: dict[str, np.ndarray]) -> tuple[Gaussians, dict]:
    """Inverse of `arrays_of`."""
    objects, sort, antialias, *view, others = json.loads(arrays["json"].tobytes())  # older ones have no view
    return Gaussians(*(arrays[name] for name in ROWS), tuple(objects), sort, antialias, *map(tuple, view)), others


Progress = Callable[[str, float], None]  # (step, fraction of it that is done)

BAR_WIDTH = 28  # [characters]
MIN_INTERVAL = 0.1  # [s] between two updates of the bar
FULL, EMPTY = "█", "░"


def no_progress(step: str, done: float) -> None:
    """Show nothing."""


class StepProgress:
    """Progress of a run of known steps: on a terminal one bar that is overwritten, elsewhere a line as each step ends.

    Each step takes an equal part of the bar; the fractions within it are the step's own.
    """

    def __init__(self, steps: tuple[str, ...], out: TextIO | None = None) -> None:
        self.steps, self.out, self.step = steps, out or sys.stderr, None
        self.begin = self.since = self.shown = time.perf_counter()
        encoding = (self.out.encoding or "").lower().replace("-", "")
        self.draws = self.out.isatty() and encoding == "utf8"

    def __call__(self, step: str, done: float) -> None:
        now = time.perf_counter()
        number, begins = self.steps.index(step), step != self.step
        if begins:
            self._end_line(now)
            self.step, self.since = step, now
        if self.draws and (begins or done >= 1 or now - self.shown >= MIN_INTERVAL):
            self.shown = now
            fraction = (number + min(max(done, 0.0), 1.0)) / len(self.steps)
            full = round(fraction * BAR_WIDTH)
            text = f"  {FULL * full}{EMPTY * (BAR_WIDTH - full)} {fraction:4.0%}  {step:<8} {now - self.begin:4.0f} s"
            columns = shutil.get_terminal_size().columns
            print(f"\r{text[: columns - 1]}\x1b[K", end="", file=self.out, flush=True)
        if done >= 1 and number == len(self.steps) - 1:
            self._end_line(now)
            self.close()

    def _end_line(self, now: float) -> None:
        if self.step is not None and not self.draws:
            line = f"  {self.steps.index(self.step) + 1}/{len(self.steps)} {self.step:<8} {now - self.since:5.1f} s"
            print(line, file=self.out, flush=True)

    def close(self) -> None:
        """Clear the bar, so that the next output stands alone; a step that did not end has no line."""
        if self.step is not None and self.draws:
            print("\r\x1b[K", end="", file=self.out, flush=True)
        self.step = None
