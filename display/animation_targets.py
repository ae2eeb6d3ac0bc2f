"""Animated bodies: their skeleton moves the driven vertices through each frame as kinematic targets of the solver."""

from __future__ import annotations

from copy import copy

import numpy as np

from assets.animation import Animation
from core.rotation import best_fit_rotation, matrices_from_quaternions
from core.vocabulary import Body
from sim.kinematic_targets import Skinning
from sim.solver import MAX_FRAME_DT, Solver

ROUNDING = 1e-4  # [m]; a body closer to its targets has not been moved


class AnimationTargets:
    """The animation of body number `body` of a solver, where it is placed, `time` [s] after its start.

    placed    the body as the scene places it
    vertices  of the body at rest [m], scaled as it is placed, (V, 3)
    """

    def __init__(self, body: int, placed: Body, animation: Animation, vertices: np.ndarray, solver: Solver):
        self.body, self.animation, self.time = body, animation, 0.0
        q = np.asarray(placed.rotation, np.float64)
        self.world_from_body = np.eye(4)
        self.world_from_body[:3, :3] = matrices_from_quaternions((q / np.linalg.norm(q))[None])[0] * placed.scale
        self.world_from_body[:3, 3] = placed.position
        driven = animation.driven
        index = animation.vertices[driven]
        self.skinning = Skinning(
            solver.vertex_offset[body],
            index,
            vertices[index] / placed.scale,
            animation.joints[driven],
            animation.weights[driven],
            len(animation.parents),
        )

    def drive(self, solver: Solver, dt: float) -> None:
        """Give the solver the targets at the end of the next frame of dt [s]; none while it simulates no time."""
        if solver.interaction == "transform":
            return
        self.time += min(dt, MAX_FRAME_DT)
        self._pose(solver)
        solver.kinematic.drive_surface(self.body)

    def _pose(self, solver: Solver) -> None:
        matrices = self.world_from_body @ self.animation.matrices(self.time)
        self.skinning.pose(matrices, solver.kinematic.target, solver.vertex_offset[self.body])

    def at(self, time: float) -> AnimationTargets:
        """A copy at another time [s]."""
        other = copy(self)
        other.time = time
        return other

    def moved(self, by: np.ndarray, body: int | None = None) -> AnimationTargets:
        """A copy moved by an affine map (4, 4) of the world, for body number `body` if that is another one."""
        other = copy(self)
        other.world_from_body = by @ self.world_from_body
        other.body = self.body if body is None else body
        return other

    def placed_as(self, other: AnimationTargets) -> AnimationTargets:
        """A copy at the place and time of another one, for its body."""
        copied = self.at(other.time)
        copied.world_from_body, copied.body = other.world_from_body, other.body
        return copied

    def rebased(self, solver: Solver) -> AnimationTargets:
        """The animation relocated to where a hand has put the body while time stood still."""
        self._pose(solver)
        index = self.animation.vertices[self.animation.driven] + solver.vertex_offset[self.body]
        there, here = (f.to_numpy()[index].astype(np.float64) for f in (solver.kinematic.target, solver.x))
        if np.abs(here - there).max() < ROUNDING:
            return self
        by = np.eye(4)
        by[:3, :3] = best_fit_rotation((here - here.mean(0)).T @ (there - there.mean(0)))
        by[:3, 3] = here.mean(0) - by[:3, :3] @ there.mean(0)
        return self.moved(by)
