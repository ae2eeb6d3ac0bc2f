"""A simulated body as the host gives it, checked, with its lumped masses (NumPy only)."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from core.distance_grid import DistanceGrid
from core.errors import BadInput
from core.material import Material
from core.rotation import matrices_from_quaternions
from core.tetmesh import tet_volumes
from core.vocabulary import IDENTITY, Quat, Vec3

MIN_RELATIVE_VOLUME = (
    1e-4  # volume / (longest edge)^3 of a regular tet is 0.12; below this its rest inverse is noise in fp32
)


@dataclass(frozen=True)
class SoftBody:
    """One elastic body at rest, and where it starts.

    vertices  rest positions in the body frame, already scaled [m], (V, 3)
    tets      (T, 4) with det[x1-x0, x2-x0, x3-x0] > 0;   surface  (S, 3) outward
    rotation, position, velocity   x = R(rotation) rest + position, all vertices at `velocity` [m/s]
    sdf       signed distance of the rest shape in the body frame [m], or None
    pinned    indices of vertices that do not move (inverse mass 0), or None
    asleep    starts asleep: nothing moves it until something reaches it
    self_contact   "parts": only disconnected parts of its cage meet, as legs and a skirt. Where a limb meets the trunk,
                   driven vertices, which nothing stops, would crush what they meet. False: it passes through itself
    """

    name: str
    vertices: np.ndarray
    tets: np.ndarray
    surface: np.ndarray
    material: Material
    rotation: Quat = IDENTITY
    position: Vec3 = (0.0, 0.0, 0.0)
    velocity: Vec3 = (0.0, 0.0, 0.0)
    sdf: DistanceGrid | None = None
    pinned: np.ndarray | None = None
    self_contact: bool | str = True
    asleep: bool = False
    rigid: ClassVar[bool] = False

    def of_material(self, material: Material) -> SoftBody:
        """The same body of another material; BadInput if no body can be of it."""
        body = replace(self, material=material)
        body.check_material()
        return body

    def start_velocities(self) -> np.ndarray:
        """Initial velocities [m/s], (V, 3) float64."""
        return np.tile(np.asarray(self.velocity, np.float64), (len(self.vertices), 1))

    def start(self) -> np.ndarray:
        """Initial positions in the world [m], (V, 3) float64."""
        return np.asarray(self.vertices, np.float64) @ matrices_from_quaternions(self.rotation).T + np.asarray(
            self.position, np.float64
        )

    def check(self) -> None:
        """Raise BadInput, naming body and defect, for anything the solver cannot simulate."""
        x, tets = np.asarray(self.vertices, np.float64), np.asarray(self.tets)
        if x.ndim != 2 or x.shape[1] != 3 or not np.isfinite(x).all():
            raise BadInput(f"{self.name}: vertices must be finite and of shape (V, 3), not {x.shape}")
        for what, index, k in (("tets", tets, 4), ("surface", np.asarray(self.surface), 3)):
            if index.ndim != 2 or index.shape[1] != k or len(index) == 0:
                raise BadInput(f"{self.name}: {what} must be of shape (n, {k}), not {index.shape}")
            if index.min() < 0 or index.max() >= len(x):
                raise BadInput(f"{self.name}: {what} refer to vertices outside 0..{len(x) - 1}")
        self.check_material()
        unused = np.setdiff1d(np.arange(len(x)), tets)
        if len(unused):
            raise BadInput(f"{self.name}: vertex {unused[0]} ({len(unused)} in all) belongs to no tetrahedron")
        volumes = tet_volumes(x, tets)
        edges = x[tets][:, [0, 0, 0, 1, 1, 2]] - x[tets][:, [1, 2, 3, 2, 3, 3]]
        longest = np.sqrt((edges**2).sum(-1).max(1))
        flat = np.flatnonzero(volumes < MIN_RELATIVE_VOLUME * longest**3)
        if len(flat):
            t = flat[0]
            raise BadInput(
                f"{self.name}: tetrahedron {t} ({len(flat)} in all) is flat or inverted at rest"
                f" (volume {volumes[t]:.3g} m^3, longest edge {longest[t]:.3g} m)"
            )

    def check_material(self) -> None:
        """Raise BadInput for a material that no body can have."""
        self.material.check(self.name)

    def masses(self) -> np.ndarray:
        """A quarter of each tet's mass on each of its corners [kg], (V,)."""
        volumes = tet_volumes(self.vertices, self.tets)
        quarters = np.repeat(self.material.density * volumes / 4, 4)
        return np.bincount(np.asarray(self.tets).ravel(), quarters, minlength=len(self.vertices))
