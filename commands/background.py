"""Preparation of a splat file or mesh by another process, while the play goes on; it can be cancelled at any moment."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path
from threading import Thread
from time import monotonic

from core.errors import BadInput

STEP = re.compile(r"\s*(\d+)/(\d+) ")  # as display of steps prints it (prepare/progress.py)
ENDING_PATIENCE = 5.0  # [s] for a process that is asked to end


class BackgroundPreparation:
    """A process that prepares a file into the cache, as a body or as a `room`. `poll` it until it is done."""

    def __init__(self, path: Path, *, room: bool):
        self.path, self._begin = path, monotonic()
        self._steps, self._last_line = "", ""
        options = ["--cache", *device_options(), *(["--static"] if room else [])]
        pipes = {"stdin": subprocess.DEVNULL, "stdout": subprocess.DEVNULL, "stderr": subprocess.PIPE}
        command = [*program(), "prepare", str(path.absolute()), *options]
        self._process = subprocess.Popen(command, **pipes, text=True, encoding="utf-8", errors="replace")
        self._reader = Thread(target=self._read, daemon=True)
        self._reader.start()

    @property
    def text(self) -> str:
        """Progress, one line."""
        return f"Preparing {self.path.name}: {self._steps}{monotonic() - self._begin:.0f} s"

    def poll(self) -> bool:
        """True once the file is prepared. Raises BadInput if it cannot be."""
        status = self._process.poll()
        if status is None:
            return False
        self._reader.join()
        if status:
            raise BadInput(self._last_line.removeprefix("vrgs: ") or f"{self.path}: the preparation ended abnormally")
        return True

    def close(self) -> None:
        """End the process if it runs. Its finished steps are kept for another time. Further calls do nothing."""
        if self._process.poll() is None:
            self._process.terminate()
            try:
                self._process.wait(ENDING_PATIENCE)
            except subprocess.TimeoutExpired:
                self._process.kill()
                self._process.wait()

    def _read(self) -> None:
        """Follow what the process says, to its end."""
        with self._process.stderr as lines:
            for line in lines:
                if step := STEP.match(line):
                    self._steps = f"step {step[1]} of {step[2]}, "
                elif line.strip():
                    self._last_line = line.strip()


def device_options() -> list[str]:
    """The options by which the process uses the device that the play uses."""
    import taichi as ti

    return ["--arch", "cuda" if ti.cfg.arch == ti.cuda else "cpu"]


def program() -> list[str]:
    """The command that starts this program once more."""
    if getattr(sys, "frozen", False):  # a single executable
        return [sys.executable]
    return [sys.executable, str(Path(__file__).resolve().parents[1] / "vrgs.py")]
