"""The program itself: its version, how it was started, and where it keeps what can be made again."""

from __future__ import annotations

import ctypes
import os
import stat
import sys
import tempfile
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from importlib.util import find_spec
from pathlib import Path
from typing import TypeVar

from core.errors import BadInput

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


def find_home() -> None:
    """Set HOME where a service or a container has none, before Taichi is imported: it would end the process with a core
    dump. It is that of the user database, else the temporary folder. Raises BadInput."""
    if sys.platform == "win32" or os.environ.get("HOME"):
        return
    os.environ.pop("HOME", None)  # an empty one
    home = os.path.expanduser("~")  # as it is for a user whom nobody knows
    os.environ["HOME"] = home if home.startswith("/") and os.path.isdir(home) else str(temporary_folder())


def check_backend() -> None:
    """Raise BadInput for a VRGS_BACKEND (core/runtime.py) that is not there."""
    wanted = os.environ.get("VRGS_BACKEND") or "taichi"
    if wanted not in ("taichi", "quadrants"):
        raise BadInput(f"VRGS_BACKEND={wanted}: it is taichi or quadrants")
    if find_spec(wanted) is None:
        how = "pip install -r requirements-quadrants.txt" if wanted == "quadrants" else "it is for Python 3.11 to 3.13"
        raise BadInput(f"VRGS_BACKEND={wanted} needs that package: {how}")


def temporary_folder() -> Path:
    """A folder of this user's own where no other can be had, the same each time. Raises BadInput.

    Kernels may be kept there, which are run: one that somebody else could write to is not taken.
    """
    try:
        folder = Path(tempfile.gettempdir()) / ("vrgs" if sys.platform == "win32" else f"vrgs-{os.getuid()}")
        folder.mkdir(mode=0o700, exist_ok=True)
        found = folder.lstat()
        if sys.platform == "win32" or (found.st_uid == os.getuid() and stat.filemode(found.st_mode) == "drwx------"):
            return folder
        return Path(tempfile.mkdtemp(prefix="vrgs-"))
    except OSError as e:
        raise BadInput(f"no temporary folder can be written to ({e.strerror}); TMPDIR names one") from e


def check_package(user: str, module: str, requirements: str, package: str = "") -> None:
    """Raise BadInput where a module that `user` needs is not installed; `requirements` is the file that names its
    package."""
    package = package or module
    if ONE_FILE:
        raise BadInput(f"{user} needs the package {package}, which this executable leaves out: run it from the source")
    if find_spec(module) is None:
        raise BadInput(f"{user} needs the package {package}: pip install -r {requirements}")


USD = (".usd", ".usda", ".usdc", ".usdz")


def check_usd(user: str) -> None:
    """Raise BadInput where OpenUSD, which `user` needs, is not installed."""
    check_package(user, "pxr", "requirements-usd.txt", "usd-core")


def open3d(user: str):
    """The module open3d. Raises BadInput where it is missing or does not load."""
    check_package(user, "open3d", "requirements-tetgen.txt")
    try:
        import open3d
    except (ImportError, OSError) as e:  # OSError: it loads system libraries, such as libusb
        raise BadInput(f"{user} needs the package open3d, which does not load ({e})") from e
    return open3d


def use_one_blas_thread() -> None:
    """Let the OpenBLAS of NumPy's and SciPy's wheels use one thread: beside those of a play, several wait for one
    another (eigenvectors of 267 rows took 50 to 1500 ms by two, 4 by one)."""
    for package, ending in (("numpy", "64_"), ("scipy", "")):
        for path in (Path(find_spec(package).origin).parents[1] / f"{package}.libs").glob("*openblas*"):
            getattr(ctypes.CDLL(str(path)), f"scipy_openblas_set_num_threads{ending}", int)(1)


Item, Result = TypeVar("Item"), TypeVar("Result")


def in_threads(function: Callable[[Item], Result], items: Iterable[Item]) -> list[Result]:
    """The function of each item, in the items' order, as many at a time as there are processor cores."""
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        return list(pool.map(function, items))


def batches(count: int, size: int) -> list[slice]:
    """Slices of `size` that cover `count` items; the last may be shorter. None for none."""
    return [slice(i, min(i + size, count)) for i in range(0, count, size)]
