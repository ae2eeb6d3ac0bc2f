"""The outer part of the one-file program: unpacks the program into the user's cache, once, and starts it from there.

The file is this launcher's, then the program as a compressed archive, then the launcher's own modules, and at the end
TRAILER: where the archive begins, and its digest.
"""

import contextlib
import os
import shutil
import signal
import struct
import subprocess
import sys
import tarfile
import time
from pathlib import Path

import zstandard

from core.errors import BadInput
from core.program import cache_folder, find_home

TRAILER = struct.Struct("<Q16s")
PROGRAM = "vrgs.exe" if sys.platform == "win32" else "vrgs"
KEPT = 30 * 86400  # [s] since its last start, after which another version is removed


def unpacked() -> Path:
    """The folder of this file's program, unpacked now if it is not there. Raises OSError."""
    with open(sys.executable, "rb") as file:
        file.seek(-TRAILER.size, os.SEEK_END)
        begin, digest = TRAILER.unpack(file.read())
        folder = cache_folder() / "program" / digest.decode()
        if not folder.is_dir():
            file.seek(begin)
            unpack(file, folder)
    with contextlib.suppress(OSError):
        os.utime(folder)
    return folder


def unpack(file, folder: Path) -> None:
    """Unpack the archive at the file's position, and remove what was not started for long. Raises OSError."""
    folder.parent.mkdir(parents=True, exist_ok=True)
    for other in folder.parent.iterdir():
        if time.time() - other.stat().st_mtime > KEPT:
            shutil.rmtree(other, ignore_errors=True)
    print(f"vrgs: unpacking into {folder}, once", file=sys.stderr, flush=True)
    part = folder.with_name(f"{folder.name}.{os.getpid()}.part")
    try:
        with (
            zstandard.ZstdDecompressor().stream_reader(file) as reader,
            tarfile.open(fileobj=reader, mode="r|") as archive,
        ):
            archive.extraction_filter = getattr(tarfile, "fully_trusted_filter", None)  # it is our own
            archive.extractall(part)
        with contextlib.suppress(OSError):  # another start was as fast
            part.rename(folder)
    finally:
        shutil.rmtree(part, ignore_errors=True)


def start(program: Path) -> int:
    """Run the program in this one's place; on Windows, as its child."""
    environment = {**os.environ, "PYINSTALLER_RESET_ENVIRONMENT": "1"}  # it has an environment of its own
    before = environment.pop("LD_LIBRARY_PATH_ORIG", None)
    environment.pop("LD_LIBRARY_PATH", None)
    if before is not None:
        environment["LD_LIBRARY_PATH"] = before
    command = [str(program), *sys.argv[1:]]
    if sys.platform == "win32":
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # the child's matter
        return subprocess.call(command, env=environment)
    os.execve(program, command, environment)


def main() -> int:
    """Unpack the program if need be, and start it; returns the exit status."""
    try:
        find_home()
        return start(unpacked() / PROGRAM)
    except (BadInput, OSError) as e:
        print(f"vrgs: cannot unpack itself ({e}); VRGS_CACHE names another folder for that", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("vrgs: interrupted", file=sys.stderr)
        return 130


if __name__ == "__main__":
    sys.exit(main())
