"""Results of finished steps, kept in the cache folder until the asset is written, so that a stopped run can resume.

Only arrays of numbers are kept, and nothing is unpickled. An entry that is damaged, or was made for another file, other
options or another version of the pipeline, is ignored.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import shutil
import time
from collections.abc import Callable
from pathlib import Path

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
