"""Types and functions shared by all packages: rotations, cameras, materials, tet meshes, distance grids, device fields.

In: nothing of this program. Out: small modules that every other package may import.
"""

import contextlib
import os
import sys

if os.environ.get("VRGS_BACKEND") == "quadrants":  # before anything imports Taichi
    with contextlib.suppress(ModuleNotFoundError):  # a Python without the packages, which is said later
        from core.runtime import StandIn

        sys.meta_path.insert(0, StandIn())
