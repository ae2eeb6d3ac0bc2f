"""Libraries of a Linux desktop that the program needs, each after those it needs: its own copies are a last resort.

The system's OpenGL drivers need its own C++ runtime, which may be newer; Taichi needs libX11 even without a window. The
one-file program loads them at its start by this file: the system's libraries and programs stay what they are.
"""

import ctypes
import os
import sys

LIBRARIES = (
    "libgcc_s.so.1",
    "libstdc++.so.6",
    "libmd.so.0",
    "libbsd.so.0",
    "libXau.so.6",
    "libXdmcp.so.6",
    "libxcb.so.1",
    "libX11.so.6",
)

if hasattr(sys, "_MEIPASS"):
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
