"""open3d, a package of 300 MB that few commands need: rays for baked light, decimation for TetGen."""

from __future__ import annotations

from importlib.util import find_spec

from core import program
from core.errors import BadInput

INSTALL = "pip install -r studio/requirements.txt"


def check_open3d(user: str) -> None:
    """Raise BadInput, with a remedy, where open3d is not installed; takes no time. `user` is what needs it."""
    if program.ONE_FILE:
        raise BadInput(f"{user} needs the package open3d, which this executable leaves out: run it from the source")
    if find_spec("open3d") is None:
        raise BadInput(f"{user} needs the package open3d: {INSTALL}")


def open3d(user: str):
    """The module open3d. Raises BadInput where it is missing or does not load."""
    check_open3d(user)
    try:
        import open3d
    except (ImportError, OSError) as e:  # OSError: it loads system libraries, such as libusb
        raise BadInput(f"{user} needs the package open3d, which does not load ({e})") from e
    return open3d
