"""Progress of a start, which is the compilation of kernels: a line in the terminal, and one on the display."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from time import perf_counter
from typing import TextIO

from core.runtime import watch_compilation

KERNELS = 91  # of the sandbox; other scenes have about as many
SHOW_INTERVAL = 0.2  # [s] between two lines on the display, and on a terminal, which renews its line
LOG_INTERVAL = 5.0  # [s] between two lines in a file


@contextmanager
def start_progress(show: Callable[[str], None], out: TextIO | None = None) -> Iterator[None]:
    """While active, tell `show` and the terminal which kernel is being compiled, or read from the cache."""
    out = out or sys.stderr
    begin = perf_counter()
    interval = SHOW_INTERVAL if out.isatty() else LOG_INTERVAL
    shown, written = begin, begin

    def note(count: int) -> None:
        nonlocal shown, written
        now = perf_counter()
        text = f"Preparing kernel {count} of about {max(KERNELS, count)}, {now - begin:.0f} s"
        if now - shown >= SHOW_INTERVAL:
            shown = now
            show(text)
        if now - written >= interval:
            written = now
            print(f"\r{text}\033[K" if out.isatty() else text, end="" if out.isatty() else "\n", file=out, flush=True)

    try:
        with watch_compilation(note):
            yield
    finally:
        if out.isatty() and written > begin:
            print("\r\033[K", end="", file=out, flush=True)
