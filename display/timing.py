"""Timings of frames, the progress of a start, and the statistics of a run, as `--stats` writes them."""

from __future__ import annotations

import sys
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from itertools import islice
from time import perf_counter
from typing import TextIO

import numpy as np

from core.runtime import watch_compilation

HISTORY_LENGTH = 36_000  # samples kept per stage: ten minutes at 60 Hz, a few MB in all
RECENT_SAMPLES = 60  # samples behind the panel's numbers: steady, and still current
FIRST_START = "the first time on this machine about a minute"  # 20 to 80 s, by scene and device
SHOW_INTERVAL = 0.2  # [s] between two lines on the display, and on a terminal, which renews its line
LOG_INTERVAL = 5.0  # [s] between two lines in a file


class Timings:
    """Durations of the stages of a frame, and of whole frames [s].

    A launch on a GPU returns before the work is done. With `exact` each stage waits for the device at its end, so that
    the time is counted where it is spent; without, only the whole frame is right.

    budget   of a frame
    missed   frames that took more than 1.5 budgets, or as many as a headset reports
    dropped  time that has passed and was never simulated
    photon   from reading the head's pose to the light of its picture
    worst    the longest frame;   worst_stages  {stage: [s]} in it;   in_frame  the same since the last frame's end
    """

    def __init__(self, *, exact: bool = False, budget: float = 1 / 60):
        self.exact, self.budget, self.missed, self.dropped = exact, budget, 0, 0.0
        self.photon: deque[float] = deque(maxlen=HISTORY_LENGTH)
        self._first: dict[str, float] = {}
        self._samples: dict[str, deque[float]] = {}
        self._frames: deque[float] = deque(maxlen=HISTORY_LENGTH)
        self._mark: float | None = None
        self.worst, self.worst_stages, self.in_frame = 0.0, dict[str, float](), dict[str, float]()

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Time the body of a `with`. Stages may recur in a frame; each run is a sample."""
        begin = perf_counter()
        yield
        if self.exact:
            import taichi as ti

            ti.sync()
        self.add(name, perf_counter() - begin)

    def add(self, name: str, seconds: float) -> None:
        """Record one duration [s] of a stage; the first, which compiles its kernels, is kept apart."""
        self.in_frame[name] = self.in_frame.get(name, 0.0) + seconds
        if name not in self._first:
            self._first[name], self._samples[name] = seconds, deque(maxlen=HISTORY_LENGTH)
        else:
            self._samples[name].append(seconds)

    def frame(self, missed: int | None = None, *, budget: float | None = None, dropped: float = 0.0) -> None:
        """Mark the end of a frame. The first one only starts the clock: it holds the compilation.

        missed  frames before this one, as a display reports them; None: told by the time
        budget  the display's period [s];   dropped  so far [s]
        """
        now = perf_counter()
        self.budget, self.dropped = self.budget if budget is None else budget, max(self.dropped, dropped)
        if self._mark is not None:
            self._frames.append(now - self._mark)
            self.missed += now - self._mark > 1.5 * self.budget if missed is None else missed
            if now - self._mark > self.worst:
                self.worst, self.worst_stages = now - self._mark, self.in_frame
        self._mark, self.in_frame = now, {}

    def rest(self) -> None:
        """The display sleeps (say, is minimised): the next frame's interval does not count."""
        self._mark, self.in_frame = None, {}

    @property
    def fps(self) -> float:
        """Mean frames per second over the history, 0 before the second frame."""
        return len(self._frames) / sum(self._frames) if self._frames else 0.0

    @property
    def to_light(self) -> float | None:
        """Median of `photon` [s]; None where the display cannot tell."""
        return float(np.median(self.photon)) if self.photon else None

    def recent_fps(self) -> float:
        """Mean frames per second over the last second, or the last frame if that took longer."""
        count, total = 0, 0.0
        for interval in reversed(self._frames):
            count, total = count + 1, total + interval
            if total >= 1.0:
                break
        return count / total if count else 0.0

    def recent(self) -> list[tuple[str, float, float]]:
        """(stage, median, worst) [ms] of the last samples, in the order in which stages first ran."""
        return [(name, *self._median_and_worst(name, RECENT_SAMPLES)) for name in self._first]

    def latest(self, *names: str) -> float:
        """Sum of the last durations of these stages [s]."""
        return sum((self._samples[name] or [self._first[name]])[-1] for name in names if name in self._samples)

    def as_dict(self) -> dict[str, dict[str, float]]:
        """{stage: {"median_ms", "worst_ms", "first_ms"}} over the history."""
        stages = {}
        for name, first in self._first.items():
            median, worst = self._median_and_worst(name, HISTORY_LENGTH)
            stages[name] = {"median_ms": median, "worst_ms": worst, "first_ms": first * 1e3}
        return stages

    def _median_and_worst(self, name: str, count: int) -> tuple[float, float]:
        """Median and maximum [ms] of the last samples of a stage, of its first run if it is the only one."""
        values = np.array(list(islice(reversed(self._samples[name]), count)) or [self._first[name]]) * 1e3
        return float(np.median(values)), float(values.max())


class ProgressLine:
    """A line of progress, renewed in place on a terminal; in a file there is a line every LOG_INTERVAL."""

    def __init__(self, out: TextIO | None = None):
        self._out = out or sys.stderr
        self._terminal = self._out.isatty()
        self._interval = SHOW_INTERVAL if self._terminal else LOG_INTERVAL
        self.begin = self._written = perf_counter()

    def show(self, text: str, now: float | None = None) -> None:
        """Show a text, unless it is too soon after the last one."""
        now = perf_counter() if now is None else now
        if now - self._written >= self._interval:
            self._written = now
            print(f"\r{text}\033[K" if self._terminal else f"{text}\n", end="", file=self._out, flush=True)

    def end(self) -> None:
        """Clear the line."""
        if self._terminal and self._written > self.begin:
            print("\r\033[K", end="", file=self._out, flush=True)


@contextmanager
def start_progress(show: Callable[[str], None], out: TextIO | None = None) -> Iterator[None]:
    """While active, tell `show` and the terminal for how long kernels have been compiled, or read from the cache."""
    line = ProgressLine(out)
    shown = line.begin

    def note(kernel: str) -> None:
        nonlocal shown
        now = perf_counter()
        text = f"Preparing, {now - line.begin:.0f} s ({FIRST_START})"
        if now - shown >= SHOW_INTERVAL:
            shown = now
            show(text)
        line.show(text, now)

    try:
        with watch_compilation(note):
            yield
    finally:
        line.end()


def run_stats(world, frames: int) -> dict:
    """Statistics of a run of `frames` frames: the world's own, its timings and the process's memory."""
    timings = world.timings
    light = {} if timings.to_light is None else {"motion_to_photon_ms": 1e3 * timings.to_light}
    return {
        "frames": frames,
        "fps": timings.fps,
        "stages": timings.as_dict(),
        **world.stats(),
        "missed_frames": timings.missed,
        "worst_frame_ms": 1e3 * timings.worst,
        "worst_frame_stages_ms": {name: 1e3 * t for name, t in timings.worst_stages.items()},
        "dropped_seconds": timings.dropped,
        **light,
        "peak_memory_mb": peak_memory_mb(),
    }


def peak_memory_mb() -> float:
    """Largest resident memory of this process so far [MB = 1e6 bytes]."""
    if sys.platform == "win32":
        return _peak_memory_windows() / 1e6
    import resource

    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / 1e6 if sys.platform == "darwin" else peak * 1024 / 1e6  # bytes on macOS, KiB elsewhere


def _peak_memory_windows() -> int:
    """PeakWorkingSetSize [bytes] of GetProcessMemoryInfo (psapi): Windows has no getrusage."""
    import ctypes
    from ctypes import wintypes

    counters = (ctypes.c_size_t * 9)()  # PROCESS_MEMORY_COUNTERS: two DWORDs in one, the peak, and seven others
    size = counters[0] = ctypes.sizeof(counters)
    process = ctypes.windll.kernel32.GetCurrentProcess
    process.restype = wintypes.HANDLE
    read = ctypes.windll.psapi.GetProcessMemoryInfo
    read.argtypes = [wintypes.HANDLE, ctypes.c_void_p, wintypes.DWORD]
    if not read(process(), counters, size):
        raise ctypes.WinError()
    return counters[1]
