"""The program run by tests/support/watched_play.py, and the log it leaves: a JSON line a frame."""

import json
import subprocess
import sys
import time
from pathlib import Path

SCRIPT = Path(__file__).resolve().parent / "watched_play.py"


class Watched:
    """The running ring toss; `stats` is the file that it writes at its end."""

    def __init__(self, folder: Path, *options: str, env: dict, stderr=None):
        self.log, self.stats = folder / "log.jsonl", folder / "stats.json"
        command = [sys.executable, SCRIPT, self.log, "--scene", "ring_toss", "--arch", "cpu", "--stats", self.stats]
        self.process = subprocess.Popen([str(c) for c in (*command, *options)], env=env, stderr=stderr)

    def frames(self) -> list[dict]:
        """All frames so far; a line that is still being written is left out."""
        lines = self.log.read_text().split("\n")[:-1] if self.log.exists() else []
        return [json.loads(line) for line in lines]

    def until(self, condition, *, seconds: float = 60.0) -> dict:
        """The first frame from now on that meets the condition."""
        begin, end = len(self.frames()), time.monotonic() + seconds
        while time.monotonic() < end:
            for frame in self.frames()[begin:]:
                if condition(frame):
                    return frame
            assert self.process.poll() is None, f"the program ended with status {self.process.returncode}"
            time.sleep(0.1)
        raise AssertionError(f"not within {seconds:.0f} s; the last frame is {self.frames()[-1:]}")
