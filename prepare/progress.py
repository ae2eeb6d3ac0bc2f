"""What a preparation shows while it works: a bar on a terminal, else a line a stage."""

from __future__ import annotations

import shutil
import sys
import time
from collections.abc import Callable
from typing import TextIO

Progress = Callable[[str, float], None]

WIDTH = 28  # [characters] of the bar
SHOWN_EVERY = 0.1  # [s]
FULL, EMPTY = "█", "░"


class ProgressLines:
    """Prints a line a stage on stderr when it ends, with the time it took."""

    def __init__(self, stages: tuple[str, ...], out: TextIO | None = None) -> None:
        self.stages, self.out = stages, out or sys.stderr
        self.stage, self.since = None, time.perf_counter()

    def __call__(self, stage: str, done: float) -> None:
        if stage != self.stage:
            self._end()
            self.stage, self.since = stage, time.perf_counter()
        if done >= 1 and stage == self.stages[-1]:
            self._end()

    def _end(self) -> None:
        if self.stage is not None:
            number = self.stages.index(self.stage) + 1
            seconds = time.perf_counter() - self.since
            print(f"  {number}/{len(self.stages)} {self.stage:<8} {seconds:5.1f} s", file=self.out, flush=True)
        self.stage = None

    def close(self) -> None:
        """Nothing to clear away: a stage that did not end has no line."""


class ProgressBar:
    """One line that is written over: how much is done, the stage's name and the time so far.

    Each stage takes an equal part of the bar, the shares within it are the stage's own.
    """

    def __init__(self, stages: tuple[str, ...], out: TextIO | None = None) -> None:
        self.stages, self.out = stages, out or sys.stderr
        self.since, self.shown, self.stage = time.perf_counter(), 0.0, None

    def __call__(self, stage: str, done: float) -> None:
        now = time.perf_counter()
        if stage == self.stage and now - self.shown < SHOWN_EVERY and done < 1:
            return
        self.stage, self.shown = stage, now
        share = (self.stages.index(stage) + min(max(done, 0.0), 1.0)) / len(self.stages)
        full = round(share * WIDTH)
        text = f"  {FULL * full}{EMPTY * (WIDTH - full)} {share:4.0%}  {stage:<8} {now - self.since:4.0f} s"
        columns = shutil.get_terminal_size().columns
        print(f"\r{text[: columns - 1]}\x1b[K", end="", file=self.out, flush=True)
        if share >= 1:
            self.close()

    def close(self) -> None:
        """Clear the line, so that what is said next stands alone."""
        if self.stage is not None:
            print("\r\x1b[K", end="", file=self.out, flush=True)
        self.stage = None


def progress_on(out: TextIO, stages: tuple[str, ...]) -> ProgressLines | ProgressBar:
    """A bar where `out` is a terminal that can draw one, else lines."""
    encoding = (getattr(out, "encoding", None) or "").lower().replace("-", "")
    return (ProgressBar if out.isatty() and encoding == "utf8" else ProgressLines)(stages, out)
