"""Writers of files whose program is killed, whose disk is full, or who are not alone.

    python -m tests.faults.run kill --count 200   killed at any moment, the last finished version is whole, and nothing
                                                  half-written has its name
    python -m tests.faults.run full               a full disk is told in one line (BadInput, or on stderr where the play
                                                  goes on), and what was there before still is
    python -m tests.faults.run together           programs that write the same file at once do not harm each other

For `full` a limit of the size of files stands for the full disk; with --folder on a tiny disk, that one is filled:

    unshare -rm sh -c 'mount -t tmpfs -o size=1m tmpfs /mnt && python -m tests.faults.run full --folder /mnt'
"""

import argparse
import contextlib
import os
import resource
import select
import signal
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from datetime import date
from fnmatch import fnmatch
from itertools import count
from pathlib import Path

import numpy as np

from assets.file_access import STALE_AGE
from core.errors import BadInput
from tests.faults.writers import WRITERS, Writer, child

LONGEST = 0.3  # [s] after the first version, in which a program is killed
LIMIT = 16  # [bytes] that a file may have: every writer needs more
SPARE = 4096  # [bytes] left on a small disk
GOES_ON = ("recording", "study", "preferences", "checkpoint")  # writers that a play or a preparation outlives
PROGRAMS = 3  # that write together
VERSIONS = 5  # that each of them writes
ADDS = ("study",)  # writers of which none may be lost; of the others the last one wins


def killed_after(act: Callable[[Callable[[int], None]], None], seconds: float) -> int:
    """Let a program act, which tells the numbers of what it has done, and kill it some seconds after the first.

    Returns the last number.
    """
    receive, send = os.pipe()
    with child(lambda: act(lambda k: os.write(send, k.to_bytes(8, "little")))) as process:
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

    def write_on(tell: Callable[[int], None]) -> None:
        for k in count(first):
            writer.write(folder, k)
            tell(k)

    done = killed_after(write_on, seconds)
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
    from display.record.recording import Replay
    from tests.display.test_recording import Ball, same, some_frames

    path, frames = folder / "long.h5", some_frames(3000)

    def play(tell: Callable[[int], None]) -> None:
        module.WRITE_PERIOD = 0.03  # [s]: each third frame
        world, recording = Ball(), module.Recording(path)
        recording.about = {"scene": "ring_toss"}
        for i, frame in enumerate(frames):
            world.step(recording.note(frame))
            recording.after(world)
            if i % 30 == 29:
                recording.flush()
                tell(i - 2)
            time.sleep(0.0005)

    least = killed_after(play, seconds)
    part = folder / "long.h5.part"
    recorded = Replay.load(part).recorded
    assert len(recorded) >= least, f"{len(recorded)} frames of {least} are there"
    assert all(same(a, b) for a, b in zip(frames[: len(recorded)], recorded, strict=True))
    part.unlink()


@contextlib.contextmanager
def full(folder: Path, *, small_disk: bool) -> Iterator[None]:
    """Let the disk of the folder be full for this process."""
    if small_disk:
        filler = folder / "filler"
        with open(filler, "wb") as file, contextlib.suppress(OSError):
            while True:
                os.write(file.fileno(), bytes(1024))
        os.truncate(filler, max(filler.stat().st_size - SPARE, 0))
        with open(folder / "filler2", "wb") as file, contextlib.suppress(OSError):
            while True:
                os.write(file.fileno(), bytes(512))
        try:
            yield
        finally:
            for name in ("filler", "filler2"):
                (folder / name).unlink()
    else:
        resource.setrlimit(resource.RLIMIT_FSIZE, (LIMIT, resource.getrlimit(resource.RLIMIT_FSIZE)[1]))
        yield


def said_of(act: Callable[[], None], folder: Path, *, small_disk: bool) -> tuple[str, str]:
    """The error's message, in a process of its own, and what it printed; "" if there was none."""
    (said, send), (printed, out) = os.pipe(), os.pipe()  # of no size that is limited

    def there() -> None:
        os.dup2(out, 1)
        os.dup2(out, 2)
        try:
            with full(folder, small_disk=small_disk):
                act()
        except BadInput as e:
            os.write(send, str(e).encode())
        except BaseException as e:
            os.write(send, f"not BadInput but {type(e).__name__}: {e}".encode())
        sys.stderr.flush()

    with child(there):
        os.close(send)
        os.close(out)
        texts = []
        for end in (said, printed):
            texts.append(b"".join(iter(lambda end=end: os.read(end, 1 << 16), b"")).decode(errors="replace"))
            os.close(end)
    return texts[0], texts[1]


def fill_once(name: str, folder: Path, *, small_disk: bool = False) -> None:
    """One writer on a full disk, over a version that is there, and what must hold after it. Raises AssertionError."""
    writer = WRITERS[name]
    writer.write(folder, 0)
    before = sorted(folder.iterdir())
    said, printed = said_of(lambda: writer.write(folder, 1), folder, small_disk=small_disk)
    lines = [line for line in (said.removeprefix("not BadInput"), *printed.splitlines()) if line]
    assert all(len(line) < len(str(folder)) + 200 for line in lines), f"says {lines}"
    assert not said.startswith("not BadInput") or (name in GOES_ON and "AssertionError" in said), said
    assert lines and (name == "checkpoint" or any(str(folder) in line for line in lines)), f"says {lines}"
    assert len(printed.splitlines()) <= 1, f"prints {printed}"
    assert writer.version(folder) == 0
    left = [path for path in sorted(folder.iterdir()) if path not in before and not path.name.startswith("filler")]
    for path in [path for path in left if path.name.endswith(".h5.part") and path.stat().st_size]:
        left.remove(path)  # what was recorded before the disk was full
        path.unlink()
    assert not left, f"leaves {left}"
    writer.write(folder, 1)
    assert writer.version(folder) == 1


def at_once(acts: list[Callable[[], None]]) -> None:
    """Let each act in a process of its own, all at the same time. Raises AssertionError if one fails."""
    receive, send = os.pipe()
    failed = []
    with ExitStack() as stack:
        for act in acts:

            def wait_and_act(act=act) -> None:
                os.close(send)
                os.read(receive, 1)  # until all are there
                act()

            failed.append(stack.enter_context(child(wait_and_act)))
        os.close(send)
        os.close(receive)
        statuses = [os.waitpid(process, 0)[1] for process in failed]
    assert not any(statuses), f"programs ended with status {statuses}"


def write_together(name: str, folder: Path) -> None:
    """Programs write versions of the same file at the same time. Raises AssertionError."""
    writer = WRITERS[name]

    def act() -> None:
        for k in range(VERSIONS):
            writer.write(folder, k)
            assert name in ("checkpoint", "recording") or writer.version(folder) is not None

    at_once([act] * PROGRAMS)
    last = PROGRAMS * VERSIONS - 1 if name in ADDS else VERSIONS - 1
    assert writer.version(folder) == last, f"{writer.version(folder)} is there, not {last}"
    left = [path.name for path in folder.iterdir() if path.name.startswith(".")]
    assert not left, f"left behind: {left}"


def main(words: list[str] | None = None) -> int:
    """Run the command line; exit status 1 if a writer failed."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("fault", choices=("kill", "full", "together"))
    p.add_argument("--count", type=int, help="times for each writer (default: kill 200, full 1, together 20)")
    p.add_argument("--seed", type=int, default=date.today().toordinal(), help="kill (default: another one each day)")
    p.add_argument("--folder", type=Path, help="full: on a disk of 1 MB")
    p.add_argument("--writer", choices=[*WRITERS, "long recording"], action="append", help="only these")
    args = p.parse_args(words)
    os.environ |= {"ENABLE_TAICHI_HEADER_PRINT": "False", "OPENCV_FFMPEG_LOGLEVEL": "-8"}
    rng, failed = np.random.default_rng(args.seed), 0
    more = {"kill": ["long recording"], "full": [], "together": []}[args.fault]
    names = [n for n in WRITERS if args.fault != "together" or n != "recording"]  # two recordings of one name: refused
    for name in args.writer or [*names, *more]:
        begin, wrong, times = time.monotonic(), [], args.count or {"kill": 200, "full": 1, "together": 20}[args.fault]
        for _ in range(times):
            with tempfile.TemporaryDirectory(dir=args.folder) as folder:
                try:
                    if args.fault == "full":
                        fill_once(name, Path(folder), small_disk=args.folder is not None)
                    elif args.fault == "together":
                        write_together(name, Path(folder))
                    elif name in WRITERS:
                        kill_once(name, Path(folder), float(rng.uniform(0, LONGEST)))
                    else:
                        kill_recording(Path(folder), float(rng.uniform(0, LONGEST)))
                except Exception as e:
                    wrong.append(f"{type(e).__name__}: {e}")
        failed += len(wrong)
        took = time.monotonic() - begin
        print(f"{name:14} {times} times, {took:.0f} s: {len(wrong)} failures {'; '.join(wrong)[:500]}", flush=True)
    return int(failed > 0)


if __name__ == "__main__":
    sys.exit(main())
