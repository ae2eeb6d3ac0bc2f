"""Guess of a body's front from its Gaussians alone.

Faces, limbs and most made things are alike left and right, so that the front lies in a mirror plane; and the front has
the pattern: eyes, a mouth, buttons. The confidence is calibrated by `vrgs.py bench orientation`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from assets.gaussians import Gaussians
from assets.up_axis import robust_bounds
from core.spherical_harmonics import C0

CELLS = 40  # along the largest extent, of the grid that evens out the density of Gaussians
ANGLES = np.radians(np.arange(0.0, 180.0, 5.0))  # of the mirror planes that are tried, about +y from z
OFFSETS = (-0.02, 0.0, 0.02)  # extents from the middle
FAR = 0.1  # extents from its neighbour; farther, a mirror image has none
SHAPE_WEIGHT = 10.0  # of a distance in extents against a difference of colours
NEIGHBOURS = 8  # whose colours differ from a cell's own by its contrast
# log odds of the guess to be right within 25 degrees = BIAS + WEIGHTS . (contrast in extents, symmetry), fitted.
BIAS, WEIGHTS = -5.7, (91.0, 16.4)
FRONT_SURE = 0.7  # below, a body keeps the front of its file


@dataclass(frozen=True)
class Front:
    """A guess: `angle` [rad] about +y of the front from +z, and the probability that it is right within 25 degrees.

    contrast  offset of the contrast towards the front, in extents;  symmetry  of the mirror plane, 0 to 1
    """

    angle: float
    contrast: float
    symmetry: float

    @property
    def sure(self) -> float:
        """The probability."""
        return float(1.0 / (1.0 + np.exp(-BIAS - np.dot(WEIGHTS, (self.contrast, self.symmetry)))))


def turned_about_up(angle: float) -> np.ndarray:
    """Rotation (3, 3) by an angle [rad] about +y, from +z towards +x."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])


def front_of(gaussians: Gaussians) -> Front:
    """Guess the front of a body that stands upright, +y up."""
    points, colours, spread = cell_means(gaussians)
    low, high = robust_bounds(points)
    extent = max(float((high - low).max()), 1e-12)
    middle = points.mean(axis=0)
    tree = cKDTree(points)
    misfits = np.array([_misfit(points, colours, tree, middle, extent, angle) for angle in ANGLES])
    angle = float(ANGLES[misfits.argmin()])
    _, near = tree.query(points, k=min(NEIGHBOURS + 1, len(points)))
    contrast = np.abs(colours[near[:, 1:]] - colours[:, None]).mean(axis=(1, 2)) + spread
    along = (points - middle) @ [np.sin(angle), 0.0, np.cos(angle)] / extent
    offset = float(contrast @ along / max(contrast.sum(), 1e-12))
    symmetry = 1.0 - float(misfits.min() / max(np.median(misfits), 1e-12))
    return Front(angle if offset >= 0 else angle + np.pi, abs(offset), symmetry)


def cell_means(gaussians: Gaussians) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Mean position (C, 3) and colour (C, 3) of the opaque Gaussians in each cell of a grid, and the standard deviation
    of their colours (C,)."""
    g = gaussians.select(gaussians.opacities >= min(0.3, np.median(gaussians.opacities)))
    x = g.means.astype(np.float64)
    colour = np.clip(0.5 + C0 * g.sh[:, 0].astype(np.float64), 0.0, 1.0)
    low, high = robust_bounds(x)
    cell = np.floor((x - low) / max((high - low).max(), 1e-12) * CELLS).clip(-CELLS, 2 * CELLS).astype(int)
    _, index, count = np.unique(cell, axis=0, return_inverse=True, return_counts=True)
    index = index.ravel()

    def mean(values: np.ndarray) -> np.ndarray:
        return np.stack([np.bincount(index, v) / count for v in values.T], axis=1)

    colours = mean(colour)
    spread = np.sqrt(np.maximum(mean(colour**2) - colours**2, 0.0)).mean(axis=1)
    return mean(x), colours, spread


def _misfit(points, colours, tree: cKDTree, middle, extent: float, angle: float) -> float:
    """Least misfit of the points and their mirror images, of planes that contain +y and the direction at the angle."""
    side = np.array([np.cos(angle), 0.0, -np.sin(angle)])
    found = []
    for offset in OFFSETS:
        image = points - 2.0 * ((points - middle) @ side - offset * extent)[:, None] * side
        away, near = tree.query(image)
        shape = np.minimum(away / extent, FAR).mean()
        found.append(SHAPE_WEIGHT * shape + np.abs(colours[near] - colours).mean())
    return float(min(found))
