"""Several programs that write the same file at once: `python -m tests.faults.together --rounds 100`."""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path

from tests.faults.writers import WRITERS, child

PROGRAMS = 3
VERSIONS = 5  # that each of them writes
ADDS = ("study",)  # writers of which none may be lost; of the others the last one wins


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
    """Run the command line; exit status 1 if something was lost."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--rounds", type=int, default=20, help="of each writer (default 20)")
    p.add_argument("--writer", choices=WRITERS, action="append", help="only these")
    args = p.parse_args(words)
    os.environ |= {"ENABLE_TAICHI_HEADER_PRINT": "False", "OPENCV_FFMPEG_LOGLEVEL": "-8"}
    failed = 0
    for name in args.writer or [name for name in WRITERS if name != "recording"]:  # two of one name are refused
        wrong = []
        for _ in range(args.rounds):
            with tempfile.TemporaryDirectory() as folder:
                try:
                    write_together(name, Path(folder))
                except Exception as e:
                    wrong.append(f"{type(e).__name__}: {e}")
        failed += len(wrong)
        print(f"{name:14} {args.rounds} rounds: {len(wrong)} failures {'; '.join(wrong)[:500]}", flush=True)
    return int(failed > 0)


if __name__ == "__main__":
    sys.exit(main())
