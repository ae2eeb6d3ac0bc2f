"""Libraries of a Linux desktop that the program needs, each after those it needs: its own copies are a last resort.

The system's OpenGL drivers need its own C++ runtime, which may be newer; Taichi needs libX11 even without a window.
"""

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
