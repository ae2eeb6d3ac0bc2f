"""Sparse points of a capture, from a point cloud's .ply."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from core.errors import BadInput

GREY = 128


def read_points(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Points (P, 3) float64 and colours (P, 3) uint8, grey where the file has none. Raises BadInput."""
    import trimesh

    if not path.is_file():
        raise BadInput(f"{path}: no such file (the capture's points)")
    try:
        with open(path, "rb") as file:
            cloud = trimesh.load(file, file_type="ply", process=False)
        points = np.asarray(cloud.vertices, np.float64)
        colors = getattr(cloud, "colors", None)
        if colors is None or len(colors) != len(points):
            colors = np.full((len(points), 3), GREY)
        colors = np.asarray(colors)[:, :3].astype(np.uint8)
    except Exception as e:  # trimesh raises what it meets in a broken file: KeyError, ValueError, struct.error...
        raise BadInput(f"{path}: no point cloud can be read ({e})") from e
    if points.ndim != 2 or points.shape[1:] != (3,):
        raise BadInput(f"{path}: holds no points")
    return points, colors
