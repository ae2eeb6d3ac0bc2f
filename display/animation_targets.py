"""Bodies that move by themselves: before each frame, where its end has them goes to the solver."""

from __future__ import annotations

from copy import copy

import numpy as np

from assets.animation import Animation
from core.rotation import matrices_from_quaternions
from scenes.scene import Body
from sim.reductions import best_rotation
from sim.skinning import Skinning
from sim.solver import LONGEST_FRAME, Solver

UNMOVED = 1e-4  # [m]; rounding


class AnimationTargets:
    """The motion of body number `body` of a solver, where it is placed; its own clock starts at rest.

    vertices  of the body at rest [m], scaled as it is placed, (V, 3)
    """

    def __init__(self, body: int, placed: Body, animation: Animation, vertices: np.ndarray, solver: Solver):
        self.body, self.animation, self.solver, self.time = body, animation, solver, 0.0
        q = np.asarray(placed.rotation, np.float64)
        self.world_from_body = np.eye(4)
        self.world_from_body[:3, :3] = matrices_from_quaternions((q / np.linalg.norm(q))[None])[0] * placed.scale
        self.world_from_body[:3, 3] = placed.position
        led = animation.driven
        mine = animation.vertices[led]
        self.skinning = Skinning(
            solver.vertex_offset[body],
            mine,
            vertices[mine] / placed.scale,
            animation.joints[led],
            animation.weights[led],
            len(animation.parents),
        )

    def drive(self, dt: float) -> None:
        """Lead the driven vertices through the frame of dt [s] that comes."""
        if self.solver.interaction == "transform":  # time stands still
            return
        self.time += min(dt, LONGEST_FRAME)
        self._pose()
        self.solver.drive_surface(self.body)

    def _pose(self) -> None:
        matrices = self.world_from_body @ self.animation.matrices(self.time)
        self.skinning.pose(matrices, self.solver.targets, self.solver.vertex_offset[self.body])

    def moved(self, by: np.ndarray, body: int | None = None) -> AnimationTargets:
        """The same motion at another place, `by` (4, 4) of an affine map of the world; also that of a copy `body`."""
        other = copy(self)
        other.world_from_body = by @ self.world_from_body
        other.body = self.body if body is None else body
        return other

    def settled(self) -> AnimationTargets:
        """The motion where a hand has put the body while time stood still."""
        self._pose()
        led = self.animation.vertices[self.animation.driven] + self.solver.vertex_offset[self.body]
        there, here = (f.to_numpy()[led].astype(np.float64) for f in (self.solver.targets, self.solver.x))
        if np.abs(here - there).max() < UNMOVED:
            return self
        by = np.eye(4)
        by[:3, :3] = best_rotation((here - here.mean(0)).T @ (there - there.mean(0)))
        by[:3, 3] = here.mean(0) - by[:3, :3] @ there.mean(0)
        return self.moved(by)

    def reset(self) -> None:
        """At rest again."""
        self.time = 0.0
