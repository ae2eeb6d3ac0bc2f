"""Programs that are killed while they write: `python -m tests.faults.kill --kills 200`.

Each writes one version of a file after another, and is killed at a random moment. Then the last finished version is
there, or the one after it; nothing else has its name; what was left beside is a temporary file that goes with the next
writing once it is old; and the next program writes as if nothing had been.
"""

from __future__ import annotations

import argparse
import os
import select
import signal
import sys
import tempfile
import time
from datetime import date
from fnmatch import fnmatch
from pathlib import Path

import numpy as np

from assets.file_access import STALE_AGE
from tests.faults.writers import WRITERS, Writer, child

LONGEST = 0.3  # [s] after the first version, in which a program is killed


def killed_after(writer: Writer, folder: Path, first: int, seconds: float) -> int:
    """Let a program write from version `first` on, kill it some seconds after that one; the last that it finished."""
    receive, send = os.pipe()

    def act() -> None:
        k = first
        while True:
            writer.write(folder, k)
            os.write(send, k.to_bytes(8, "little"))
            k += 1

    with child(act) as process:
        os.close(send)
        if not select.select([receive], [], [], 60.0)[0]:
            os.kill(process, signal.SIGKILL)
            raise AssertionError("the writer hangs")
        time.sleep(seconds)
        os.kill(process, signal.SIGKILL)
    done = b""
    while block := os.read(receive, 1 << 16):
        done += block
    os.close(receive)
    assert done, "the writer failed"
    return int.from_bytes(done[-8:], "little")


def left_beside(writer: Writer, folder: Path) -> list[Path]:
    """Files that have not the name of what is written."""
    return [path for path in sorted(folder.iterdir()) if not fnmatch(path.name, writer.name)]


def kill_once(name: str, folder: Path, seconds: float) -> None:
    """One killing, and what must hold after it. Raises AssertionError."""
    writer = WRITERS[name]
    there = writer.version(folder)
    first = 0 if there is None else there + 1
    done = killed_after(writer, folder, first, seconds)
    there = writer.version(folder)
    assert there in (done, done + 1), f"version {there} is there, {done} was finished"
    left = left_beside(writer, folder)
    assert all(path.name.startswith(".") or path.name.endswith(".h5.part") for path in left), f"left behind: {left}"
    for path in left:
        os.utime(path, (0, time.time() - 2 * STALE_AGE))
    writer.write(folder, there + 1)
    assert writer.version(folder) == there + 1
    left = [path for path in left_beside(writer, folder) if not path.name.endswith(".h5.part")]
    assert not left, f"never removed: {left}"


def kill_recording(folder: Path, seconds: float) -> None:
    """A recording that is killed in the middle replays up to its last writing. Raises AssertionError."""
    from display.record import recording as module
    from display.record.replay import Replay
    from tests.display.test_recording import Ball, same, some_frames

    path, frames = folder / "long.h5", some_frames(3000)

    receive, send = os.pipe()

    def play() -> None:
        module.WRITE_PERIOD = 0.03  # [s]: each third frame
        world, recording = Ball(), module.Recording(path)
        recording.about = {"scene": "ring_toss"}
        for i, frame in enumerate(frames):
            world.step(recording.note(frame))
            recording.after(world)
            if i % 30 == 29:
                recording.flush()
                os.write(send, (i - 2).to_bytes(8, "little"))
            time.sleep(0.0005)

    with child(play) as process:
        os.close(send)
        select.select([receive], [], [], 60.0)
        time.sleep(seconds)
        os.kill(process, signal.SIGKILL)
    done = b""
    while block := os.read(receive, 1 << 16):
        done += block
    os.close(receive)
    part = folder / "long.h5.part"
    recorded = Replay.load(part).recorded
    least = int.from_bytes(done[-8:], "little")
    assert len(recorded) >= least, f"{len(recorded)} frames of {least} are there"
    assert all(same(a, b) for a, b in zip(frames[: len(recorded)], recorded, strict=True))
    part.unlink()


def main(words: list[str] | None = None) -> int:
    """Run the command line; exit status 1 if something was lost."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--kills", type=int, default=200, help="of each writer (default 200)")
    p.add_argument("--seed", type=int, default=date.today().toordinal(), help="(default: another one each day)")
    p.add_argument("--writer", choices=[*WRITERS, "long recording"], action="append", help="only these")
    args = p.parse_args(words)
    os.environ |= {"ENABLE_TAICHI_HEADER_PRINT": "False", "OPENCV_FFMPEG_LOGLEVEL": "-8"}
    rng, failed = np.random.default_rng(args.seed), 0
    for name in args.writer or [*WRITERS, "long recording"]:
        begin, wrong = time.monotonic(), []
        with tempfile.TemporaryDirectory() as folder:
            for _ in range(args.kills):
                seconds = float(rng.uniform(0, LONGEST))
                try:
                    if name in WRITERS:
                        kill_once(name, Path(folder), seconds)
                    else:
                        kill_recording(Path(folder), seconds)
                except Exception as e:
                    wrong.append(f"{type(e).__name__}: {e}")
                    for path in Path(folder).iterdir():
                        path.unlink()
        failed += len(wrong)
        took = time.monotonic() - begin
        print(f"{name:14} {args.kills} kills, {took:.0f} s: {len(wrong)} failures {'; '.join(wrong)[:500]}", flush=True)
    return int(failed > 0)


if __name__ == "__main__":
    sys.exit(main())
