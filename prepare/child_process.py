"""A process of its own for what reads strangers' files by libraries that a damaged one can crash."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from multiprocessing import get_context


class ChildProcess:
    """A process that runs `target(pipe, *arguments)`, a function of a module; it answers by bytes through the pipe.

    patience  [s] for an answer
    library   whose crash it is if there is none
    """

    def __init__(self, target: Callable, *arguments, patience: float, library: str):
        self._patience, self._library = patience, library
        context = get_context("spawn")  # Taichi, which this process may run, survives no fork
        self._pipe, far = context.Pipe()
        self.process = context.Process(target=target, args=(far, *arguments), daemon=True)
        self.process.start()
        far.close()  # else its end would not be seen here

    def send(self, message) -> None:
        """Send a message; if the process has ended, `answer` tells."""
        with suppress(OSError):
            self._pipe.send(message)

    def answer(self) -> bytes:
        """The next message of the process, or the reason why none comes any more."""
        try:
            if self._pipe.poll(self._patience):
                return self._pipe.recv_bytes()
            self.process.kill()
            return b"it took more than %d s" % self._patience
        except (EOFError, OSError):
            return f"{self._library} crashed".encode()
