"""Progress of a preparation on the screen: a bar on a terminal, else a line a step."""

from __future__ import annotations

import shutil
import sys
import time
from collections.abc import Callable
from typing import TextIO

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
