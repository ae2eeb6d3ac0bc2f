"""Triangle meshes as arrays."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Mesh:
    """Vertices [m], (V, 3); triangles (F, 3), counter-clockwise seen from outside."""

    vertices: np.ndarray
    faces: np.ndarray

    def moved(self, rotation=None, translation=(0.0, 0.0, 0.0)) -> Mesh:
        """The mesh after x -> rotation @ x + translation."""
        v = self.vertices if rotation is None else self.vertices @ np.asarray(rotation).T
        return Mesh(v + np.asarray(translation), self.faces)
