"""Curtains as meshes."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from studio.shapes import Mesh, grid_mesh


def drape(span, heights, folds: int, seed: float, to_room: Callable) -> Mesh:
    """Curtain over `span` along the wall and `heights` [m], in `folds` folds that open towards its hem.

    to_room  (along, up, depth) -> the three coordinates in the room
    """
    (a, b), (low, high) = span, heights
    u = np.linspace(0, 1, 28 * folds)[:, None]
    v = np.linspace(0, 1, 30)[None, :]
    loose = 1 - 0.55 * v
    wave = np.sin(2 * np.pi * folds * u + 0.9 * np.sin(5 * u + seed) + 0.25 * np.sin(3 * v + seed))
    depth = 0.020 * wave * (0.7 + 0.5 * loose) + 0.004 * np.sin(11 * u + 4 * v + seed)
    along = a + (b - a) * (u + 0.012 * np.sin(9 * v + 7 * u + seed) * loose)
    return grid_mesh(np.stack(np.broadcast_arrays(*to_room(along, low + (high - low) * v, depth)), -1))
