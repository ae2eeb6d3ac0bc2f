"""Surfaces as a Wavefront .obj: an object for each body."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from assets.file_access import atomic_write


def write_surfaces(path: str | Path, surfaces: Sequence[tuple[str, np.ndarray, np.ndarray]]) -> None:
    """Write named surfaces: vertices (V, 3) [m], of which only used ones are kept, and outward triangles (S, 3).

    Raises BadInput.
    """
    lines, first = ["# VR-GS: metres, +y up"], 1
    for name, vertices, triangles in surfaces:
        used, corners = np.unique(triangles, return_inverse=True)
        lines.append("o " + (re.sub(r"\s+", "_", name) or "body"))
        lines += [f"v {x:.9g} {y:.9g} {z:.9g}" for x, y, z in np.asarray(vertices, np.float64)[used].tolist()]
        lines += [f"f {a} {b} {c}" for a, b, c in (corners.reshape(-1, 3) + first).tolist()]
        first += len(used)
    with atomic_write(path) as beside:
        beside.write_text("\n".join(lines) + "\n", encoding="utf-8")
