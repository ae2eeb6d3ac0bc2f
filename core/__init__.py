"""Types and functions shared by all packages: rotations, cameras, materials, tet meshes, distance grids, device fields.

In: nothing of this program. Out: small modules that every other package may import.
"""

import contextlib
import os
import sys

if sys.version_info >= (3, 14) and not os.environ.get("VRGS_BACKEND"):
    os.environ["VRGS_BACKEND"] = "quadrants"  # Taichi 1.7.4 has no wheel for this Python
if os.environ.get("VRGS_BACKEND") == "quadrants":  # before anything imports Taichi
    with contextlib.suppress(ModuleNotFoundError):  # a Python without the packages, which is said later
        from core.runtime import StandIn

        sys.meta_path.insert(0, StandIn())
