#!/usr/bin/env python
"""The command line and the frame loop; for a Python program, what docs/python.md says."""

from __future__ import annotations

import _thread
import errno
import os
import signal
import sys
import threading
from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from commands.play_options import PlayOptions

START = "`make play` installs all; then start the program with .venv/bin/python, or activate .venv (README.md)"


def main(argv: list[str] | None = None) -> int:
    """Run one command; returns the exit status: 0 done, 1 a check failed, 2 bad input, 130 interrupted."""
    report = sys.unraisablehook
    sys.unraisablehook = partial(repeat_interrupt, report)
    main_thread = threading.current_thread() is threading.main_thread()
    before = signal.signal(signal.SIGTERM, interrupt) if main_thread else None
    try:
        return run(sys.argv[1:] if argv is None else argv)
    except KeyboardInterrupt:
        print("vrgs: interrupted", file=sys.stderr)
        return 130
    finally:
        sys.unraisablehook = report
        if main_thread:
            signal.signal(signal.SIGTERM, before)


def interrupt(number: int, frame) -> None:
    """End as by Ctrl-C, so that all files are finished."""
    handler = signal.getsignal(signal.SIGINT)
    (handler if callable(handler) else signal.default_int_handler)(signal.SIGINT, frame)


def repeat_interrupt(report: Callable, unraisable) -> None:
    """Repeat a Ctrl-C that came while an object was freed, where it is ignored; `report` all else that is."""
    if issubclass(unraisable.exc_type, KeyboardInterrupt):
        threading.Timer(0.02, _thread.interrupt_main).start()  # at once, it would come in here, and be lost as well
    else:
        report(unraisable)


def __getattr__(name: str):
    """Attributes for `import vrgs`, imported at their first use."""
    if not name.startswith("_"):
        from commands import simulation

        if name in simulation.__all__:
            return getattr(simulation, name)
    raise AttributeError(f"module 'vrgs' has no attribute {name!r}")


def run(argv: list[str]) -> int:
    """Run one command. What it imports is imported here, where an interrupt is told in a line."""
    os.environ.setdefault("ENABLE_TAICHI_HEADER_PRINT", "False")  # before anything imports Taichi
    from core.errors import BadInput, Cancelled
    from core.program import as_called, check_backend, find_home

    try:
        find_home()
        try:
            from commands.parser import parse

            command, options = parse(argv)
        except ModuleNotFoundError as e:
            print(f"vrgs: {sys.executable} has no package {e.name}: {START}", file=sys.stderr)
            return 2
        check_backend()
        return (command or play)(options) or 0
    except BadInput as e:
        from assets.library import with_sources

        print(f"vrgs: {as_called(with_sources(' '.join(str(e).split())))}", file=sys.stderr)
        return 2
    except (MemoryError, RuntimeError) as e:
        from core.runtime import failure_line

        if not (line := failure_line(e)):
            raise
        print(f"vrgs: {as_called(line)}", file=sys.stderr)
        return 2
    except BrokenPipeError:  # `vrgs.py scenes | head`
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except OSError as e:
        if e.errno != errno.ENAMETOOLONG:
            raise
        print(f"vrgs: a name of more than 255 bytes is too long for a file: {str(e.filename)[:60]}...", file=sys.stderr)
        return 2
    except Cancelled:
        return 0


def play(options: PlayOptions) -> None:
    """Play a scene: in a window, in a headset, or headless with its scripted hand."""
    from commands.play import open_session
    from scenes.registry import faults_told

    with faults_told(options.scene), open_session(options) as session:
        try:
            for frame in session.frames():  # time, cameras, hands, commands
                session.step(frame)  # simulate, deform, shade, draw; show, film, record
        except KeyboardInterrupt:  # in a headset, the only way to end
            session.report()
            raise
        session.report()


if __name__ == "__main__":
    if getattr(sys, "frozen", False):  # the one-file program also starts as a process of its own, for `check`
        from multiprocessing import freeze_support

        freeze_support()
    sys.exit(main())
