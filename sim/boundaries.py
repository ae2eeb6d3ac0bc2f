"""The solver's methods that move what is prescribed: kinematic rigid bodies and pinned vertices.

In between, poses and positions are interpolated in each substep, and have the velocity of that, which friction feels;
after the frame they stand still, unless they are driven again.
"""

from __future__ import annotations

import numpy as np

from core.errors import BadInput
from scenes.scene import IDENTITY
from sim.body_model import BodyModel
from sim.kinematic_targets import KinematicTargets
from sim.rigid.rigid_bodies import RigidBodies


class Boundaries:
    """Part of the Solver."""

    _parts: list[BodyModel]
    _movers: RigidBodies | None
    _driven: KinematicTargets

    def drive(self, body: int, position, rotation=IDENTITY) -> None:
        """Where a kinematic rigid body is at the end of the next frame: x = R(rotation) rest + position."""
        part = self._parts[self._index(body)]
        if self._movers is None or not (part.body.rigid and part.body.kinematic):
            raise BadInput(f"{part.body.name}: only a kinematic rigid body can be driven")
        self._movers.drive(body, position, rotation)

    def drive_vertices(self, body: int, vertices, positions) -> None:
        """Where pinned vertices of a soft body (n,) are at the end of the next frame [m], (n, 3)."""
        part = self._parts[self._index(body)]
        vertices, x = np.asarray(vertices, np.int64).reshape(-1), np.asarray(positions, np.float64)
        n = len(part.inv_mass)
        if len(vertices) and not 0 <= vertices.min() <= vertices.max() < n:
            raise BadInput(f"{part.body.name}: drives vertices outside 0..{n - 1}")
        if part.body.rigid or (part.inv_mass[vertices] > 0.0).any():
            raise BadInput(f"{part.body.name}: only pinned vertices of a soft body can be driven")
        if x.shape != (len(vertices), 3) or not np.isfinite(x).all():
            raise BadInput(f"{part.body.name}: {len(vertices)} vertices cannot be driven to positions {x.shape}")
        self._driven.drive(vertices + self.vertex_offset[body], x)
        self._driven.bodies.add(self._index(body))

    @property
    def targets(self):
        """vec3[V]: where `drive_surface` finds the places; a kernel may write them, nothing passes through the host."""
        return self._driven.target

    def drive_surface(self, body: int) -> None:
        """Move all pinned vertices of a body in the next frame to what `targets` holds, from vertex_offset[body] on."""
        body = self._index(body)
        self._driven.drive_range(self.vertex_offset[body], self.vertex_offset[body + 1])
        self._driven.bodies.add(body)
