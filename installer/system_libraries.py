"""Step of the one-file program's start on Linux: the system's libraries and programs stay what they are."""

import ctypes
import os
import sys

from libraries import LIBRARIES

for name in LIBRARIES:
    try:
        ctypes.CDLL(name)
    except OSError:
        ctypes.CDLL(os.path.join(sys._MEIPASS, "fallback", name))
# Programs that this one starts, a file dialog or a browser, are to load their own libraries.
before = os.environ.pop("LD_LIBRARY_PATH_ORIG", None)
os.environ.pop("LD_LIBRARY_PATH", None)
if before is not None:
    os.environ["LD_LIBRARY_PATH"] = before
