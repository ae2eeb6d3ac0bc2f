"""Stages of a long pipeline: results are kept in a folder, so that an interrupted run resumes; progress on stderr.

A stage is identified by its inputs and by the program's source that makes it, so that no version number has to be
remembered. Its folder holds stage.json with the digest of these, and sizes of its files: one that is damaged is made
again. It is called NAME.part until it is complete.
"""

from __future__ import annotations

import ast
import hashlib
import json
import shutil
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path

from assets.file_access import make_folder, reason_of, write_json
from core.errors import BadInput

ABOUT = "stage.json"
LINE_SECONDS = 0.3  # [s] between two progress lines of a terminal; elsewhere twenty times as long
LEAST_DONE, LEAST_SECONDS = 0.05, 1.0  # of a step, and [s] of it, before it is said how long it will take
WIDTH = 110  # [characters] of a progress line, to cover the last one


class Stages:
    """Runs stages one after the other, or takes their results from an earlier run.

    folder   of all results
    names    of the stages, in the order in which they come
    seconds  that each took, in this run or in the one that made it, by name
    """

    def __init__(self, folder: Path, names: tuple[str, ...]):
        self.folder, self.names, self.seconds = folder, names, {}
        self._digest = ""  # of all inputs so far
        self._now, self._begin, self._told = "", 0.0, 0.0
        self._step, self._since = ("", ""), (0.0, 0.0)  # which is being done; when it began [s], and at which fraction

    def run(self, name: str, inputs: dict, make: Callable[[Path], None], source: str = "") -> Path:
        """The folder with the result of a stage: kept, or made now by `make`, which writes into a folder.

        inputs  all that the result depends on, besides the stages before; JSON
        source  digest of the program's source that makes it: after an update of the program it is made again
        """
        text = json.dumps([self._digest, name, inputs, source], sort_keys=True)
        self._digest = hashlib.sha256(text.encode()).hexdigest()
        done, part = self.folder / name, self.folder / f"{name}.part"
        self._now, self._begin, self._told = name, time.perf_counter(), 0.0
        self._step = ("", "")
        kept = about_of(done)
        if kept.get("digest") == self._digest and kept.get("files") == file_sizes(done):
            self.seconds[name] = float(kept.get("seconds", 0.0))
            self._print(f"kept from an earlier run ({self.seconds[name]:.0f} s)", end=True)
            return done
        if about_of(part).get("digest") != self._digest:
            shutil.rmtree(part, ignore_errors=True)
        make_folder(part)
        spent = float(about_of(part).get("seconds", 0.0))
        about = {"digest": self._digest, "seconds": spent}
        write_json(part / ABOUT, about)
        try:
            make(part)
        except OSError as e:  # of what has no error of its own
            raise BadInput(f"{e.filename or part}: cannot be written ({reason_of(e)})") from e
        finally:  # what was spent counts, also if it was cut
            spent = about["seconds"] = spent + time.perf_counter() - self._begin
            with suppress(BadInput):  # the disk may be full
                write_json(part / ABOUT, about)
        write_json(part / ABOUT, about | {"files": file_sizes(part)})
        shutil.rmtree(done, ignore_errors=True)
        part.rename(done)
        self.seconds[name] = spent
        self._print(f"{spent:.1f} s", end=True)
        return done

    def progress(self, step: str, done: float) -> None:
        """Report the progress of a step of the current stage, a fraction, and the time left of that step."""
        self._tell(step, done, "")

    def part(self, label: str, k: int, count: int) -> Callable[[str, float], None]:
        """`progress` for the k-th of `count` like parts of the current stage: those done tell how long all take."""
        begin = time.perf_counter()
        passed = begin - self._begin

        def progress(step: str, done: float) -> None:
            left = passed / k * (count - k) - (time.perf_counter() - begin) if k else 0.0
            rest = f"{label}, {k + 1} of {count}{f', all in {left:.0f} s' if left > 0.5 else ''}: " if count > 1 else ""
            self._tell(step, done, rest or f"{label}: ")

        return progress

    def _tell(self, step: str, done: float, of: str) -> None:
        now = time.perf_counter()
        if (of.split(",")[0], step) != self._step:
            self._step, self._since = (of.split(",")[0], step), (now, done)
        if now - self._told < LINE_SECONDS * (1 if sys.stderr.isatty() else 20):
            return
        self._told, (since, from_) = now, self._since
        sure = done - from_ > LEAST_DONE and now - since > LEAST_SECONDS
        left = f", {(now - since) * (1 - done) / (done - from_):.0f} s left" if sure and done < 1 else ""
        self._print(f"{now - self._begin:.0f} s; {of}{step} {done:.0%}{left}", end=False)

    def _print(self, text: str, *, end: bool) -> None:
        line = f"[{self.names.index(self._now) + 1}/{len(self.names)}] {self._now}: {text}"
        over = sys.stderr.isatty()
        print(f"\r{line:<{WIDTH}}" if over else line, end="\n" if end or not over else "", file=sys.stderr, flush=True)


def about_of(folder: Path) -> dict:
    """Content of a stage's stage.json; {} if it cannot be read."""
    try:
        found = json.loads((folder / ABOUT).read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):
        return {}
    return found if isinstance(found, dict) and isinstance(found.get("seconds", 0.0), (int, float)) else {}


def file_sizes(folder: Path) -> dict[str, int]:
    """Size [bytes] of each file of a stage but its stage.json, by path within its folder."""
    found = (p for p in sorted(folder.rglob("*")) if p.is_file() and p.name != ABOUT)
    return {p.relative_to(folder).as_posix(): p.stat().st_size for p in found}


def file_key(path: Path) -> list:
    """A file's name, size and time of change: enough to detect that it was replaced."""
    try:
        found = path.stat()
    except OSError as e:
        raise BadInput(f"{path}: cannot be read ({e.strerror})") from e
    return [path.name, found.st_size, found.st_mtime_ns]


ROOT = Path(__file__).resolve().parents[2]  # the binary holds the sources too: Taichi compiles kernels from them
LAYERS = ("core", "assets", "render", "prepare")  # that make results; those above show them


def source_digest(module: str, root: Path = ROOT) -> str:
    """Digest of the source of a module, "prepare.train.trainer", and of all of ours that it imports from LAYERS.

    Raises FileNotFoundError if there is no such module.
    """
    found, left = {}, [module]
    while left:
        name = left.pop()
        if name not in found:
            path = file_of(name, root)
            if path is None:
                raise FileNotFoundError(f"{name} under {root}")
            found[name] = path.read_bytes()
            left += [n for n in imported(found[name]) if n.split(".")[0] in LAYERS and file_of(n, root) is not None]
    digest = hashlib.sha256()
    for name, source in sorted(found.items()):
        digest.update(f"{name}\0{len(source)}\0".encode() + source)
    return digest.hexdigest()


def file_of(name: str, root: Path) -> Path | None:
    """The source file of a module or package; None if the name is something else, as of a function in a module."""
    path = root / name.replace(".", "/")
    return next((p for p in (path.with_suffix(".py"), path / "__init__.py") if p.is_file()), None)


def imported(source: bytes) -> Iterator[str]:
    """Names that a source imports, with those of what it takes from them: some of these are modules."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module:
            yield from (node.module, *(f"{node.module}.{alias.name}" for alias in node.names))
