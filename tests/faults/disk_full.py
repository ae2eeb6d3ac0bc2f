"""Writers on a disk that is full: `python -m tests.faults.disk_full [--folder FOLDER_ON_A_TINY_DISK]`.

Each says so in one line (BadInput, or a line on stderr where the play must go on) and leaves nothing half-written: what
was there before is still there. Without --folder a limit of the size of files stands for the full disk; with it, the
folder is filled first:

    unshare -rm sh -c 'mount -t tmpfs -o size=1m tmpfs /mnt && python -m tests.faults.disk_full --folder /mnt'
"""

from __future__ import annotations

import argparse
import contextlib
import os
import resource
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path

from core.errors import BadInput
from tests.faults.writers import WRITERS, child

LIMIT = 16  # [bytes] that a file may have: every writer needs more
SPARE = 4096  # [bytes] left on a small disk
GOES_ON = ("recording", "study", "preferences", "checkpoint")  # writers that a play or a preparation outlives


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


def main(words: list[str] | None = None) -> int:
    """Run the command line; exit status 1 if a writer failed."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--folder", type=Path, help="on a disk of 1 MB")
    p.add_argument("--writer", choices=WRITERS, action="append", help="only these")
    args = p.parse_args(words)
    os.environ |= {"ENABLE_TAICHI_HEADER_PRINT": "False", "OPENCV_FFMPEG_LOGLEVEL": "-8"}
    failed = 0
    for name in args.writer or WRITERS:
        with tempfile.TemporaryDirectory(dir=args.folder) as folder:
            try:
                fill_once(name, Path(folder), small_disk=args.folder is not None)
                print(f"{name:14} ok", flush=True)
            except Exception as e:
                failed += 1
                print(f"{name:14} FAILED: {type(e).__name__}: {e}", flush=True)
    return int(failed > 0)


if __name__ == "__main__":
    sys.exit(main())
