"""The program itself: its version, how it was started, and where it keeps what can be made again."""

from __future__ import annotations

import os
import sys
from pathlib import Path

VERSION = "0.1.0"
ONE_FILE = bool(getattr(sys, "frozen", False))  # the executable of `make binary`: it unpacks itself at each start


def called() -> str:
    """The words that start the program: `python vrgs.py`, `python -m vrgs`, or `vrgs` where that is installed."""
    name = os.path.basename(sys.argv[0])
    if ONE_FILE or name in ("vrgs", "vrgs.exe"):
        return "vrgs"
    as_module = name == "vrgs.py" and getattr(sys.modules["__main__"], "__spec__", None) is not None
    return "python -m vrgs" if as_module else "python vrgs.py"


def as_called(text: str) -> str:
    """The text with the words that start this program in place of `python vrgs.py` and `vrgs.py`."""
    words = called()
    if words == "python vrgs.py":
        return text
    return text.replace("python vrgs.py", words).replace("vrgs.py", words)


def cache_folder() -> Path:
    """Folder for what can be made again, by the platform's custom. `VRGS_CACHE` overrides it."""
    override = os.environ.get("VRGS_CACHE")
    if override:
        return Path(override)
    if sys.platform == "win32":
        return Path(os.environ.get("LOCALAPPDATA", str(Path.home()))) / "vrgs"
    if sys.platform == "darwin":
        return Path.home() / "Library" / "Caches" / "vrgs"
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "vrgs"
