"""A program that is played from outside, and the log that it leaves: a JSON line a frame."""

import json
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

SUPPORT = Path(__file__).resolve().parent


class Watched:
    """A running program of this folder, which takes its log's path and then `options`."""

    def __init__(self, script: str, folder: Path, *options, env: dict, patience: float = 60.0, **streams):
        self.log, self.patience = folder / "log.jsonl", patience
        command = [sys.executable, SUPPORT / script, self.log, *options]
        self.process = subprocess.Popen([str(c) for c in command], env=env, cwd=folder, **streams)
        self._frames: list[dict] = []
        self._read = 0  # bytes of the log

    def frames(self) -> list[dict]:
        """All frames so far; a line that is still being written is left out."""
        if self.log.exists():
            with open(self.log, "rb") as file:
                file.seek(self._read)
                whole = file.read().rpartition(b"\n")[0]
            lines = whole.splitlines()
            self._frames += [json.loads(line) for line in lines]
            self._read += len(whole) + bool(lines)
        return self._frames

    def until(self, condition: Callable[[dict], bool], *, seconds: float | None = None) -> dict:
        """The first frame from now on that meets the condition."""
        done, end = len(self.frames()), time.monotonic() + (seconds or self.patience)
        while time.monotonic() < end:
            for frame in self.frames()[done:]:
                done += 1
                if condition(frame):
                    return frame
            assert self.process.poll() is None, f"the program ended with status {self.process.returncode}"
            time.sleep(0.05)
        raise AssertionError(f"not in time; the last frame is {self.frames()[-1:]}")

    def after(self, count: int = 3) -> dict:
        """The state once some more frames are there."""
        number = len(self.frames()) + count
        return self.until(lambda _: len(self.frames()) >= number)

    def eventually(self, condition: Callable[[], bool]) -> None:
        """Wait until something else than the log meets a condition, as the screen."""
        end = time.monotonic() + self.patience
        while not condition():
            assert time.monotonic() < end and self.process.poll() is None
            self.after(1)

    def close(self) -> None:
        """End the program if it still runs."""
        if self.process.poll() is None:
            self.process.kill()
        self.process.wait(10)
